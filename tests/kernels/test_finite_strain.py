"""Correspondence at large strains: exact gradients, closed forms, objectivity, forces and stiffness as derivatives."""

import dataclasses

import numpy as np
import pytest

from pdhe import materials
from pdhe.errors import PdheError
from pdhe.kernels.finite_strain import compiled
from pdhe.materials.body import BY_ENERGY, BY_STRETCH
from pdhe.materials.constants import Orthotropic
from pdhe.materials.finite_strain import FiniteStrainBody, FiniteStrainSolidBody, StressLaw
from tests.lattices import YOUNG, make_body
from tests.solids import make_solid

pytestmark = pytest.mark.usefixtures("one_thread")

NU = 0.29
KINDS = ("stress", "strain", None)
CONTROLS = ("wan", "silling")


def bodies(kind, zero_energy="wan", broken=0.2, law=None, size=(), **changes):
    """A perturbed body of large strain, some of its bonds broken, and that of small strain."""
    if kind is None:
        x, small = make_solid(size or (6, 5, 5), model="correspondence", perturb=0.2, break_share=broken)
    else:
        x, small = make_body(*size or (9, 8), model="correspondence", plane=kind, perturb=0.2, break_share=broken)
    model = dataclasses.replace(small.model, zero_energy=zero_energy, **changes)
    made = FiniteStrainSolidBody if kind is None else FiniteStrainBody
    body = made(small.bonds, model, x, small.volume, law=law)
    reference = materials.make_body(small.bonds, model, x, small.volume)
    for other in (body, reference):
        other.break_bonds(np.flatnonzero(~small.intact))
    return x, body, reference


def far(x, seed=0):
    """Displacements with strains of some ten per cent, smooth ones and others."""
    rng, d = np.random.default_rng(seed), x.shape[1]
    return 1.5e-4 * rng.normal(size=x.shape) + x @ (0.15 * rng.normal(size=(d, d))).T


def rotation(d, degrees):
    """Turn about z, or about an oblique axis in space."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    if d == 2:
        return np.array([[c, -s], [s, c]])
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    cross = np.cross(np.eye(3), axis)
    return c * np.eye(3) + (1.0 - c) * np.outer(axis, axis) - s * cross


@pytest.mark.parametrize("kind", KINDS)
def test_deformation_gradients_of_affine_maps_are_exact_at_every_node(kind):
    """At edges and corners too, and where bonds are broken."""
    x, body, _ = bodies(kind)
    wanted = np.array([[1.7, -0.6, 0.2], [0.4, 0.8, -0.3], [0.1, 0.5, 1.2]])[: x.shape[1], : x.shape[1]]
    found = body.deformation_gradient(x @ wanted.T - x)
    # Measured 4e-15.
    np.testing.assert_allclose(found, np.broadcast_to(wanted, found.shape), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(
        body.strain(x @ wanted.T - x), np.broadcast_to(0.5 * (wanted.T @ wanted - np.eye(x.shape[1])), found.shape),
        rtol=0.0, atol=1e-12,
    )  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("stretch", [0.8, 1.0 + 1e-6, 1.5])
def test_a_bar_in_tension_has_its_closed_form_at_every_node(kind, stretch):
    """Force over area at rest of a bar that may contract: E l (l^2 - 1) / 2, and nothing across."""
    x, body, _ = bodies(kind, broken=0.0)
    young, nu = (YOUNG / (1 - NU**2), NU / (1 - NU)) if kind == "strain" else (YOUNG, NU)
    strain = 0.5 * (stretch**2 - 1.0)
    across = np.sqrt(1.0 - 2.0 * nu * strain)
    u = x * (np.array([stretch, across, across])[: x.shape[1]] - 1.0)
    expected = np.zeros((x.shape[1], x.shape[1]))
    expected[0, 0] = young * stretch * strain
    # Measured 4e-15, at the small stretch 5e-10: the round-off of the stretch itself over the strain.
    close = 1e-13 / min(strain, 1.0) if strain > 0.0 else 1e-12
    np.testing.assert_allclose(
        body.stress(u), np.broadcast_to(expected, (len(x), *expected.shape)), rtol=0.0,
        atol=max(close, 1e-12) * np.abs(expected).max(),
    )  # fmt: skip
    thickness = 1.0 if kind == "strain" else across
    found = body.cauchy(u)[:, 0, 0]
    np.testing.assert_allclose(found, expected[0, 0] / (across * thickness), rtol=max(close, 1e-12))
    if kind is not None:
        np.testing.assert_allclose(body.thickness_stretch(u), thickness, rtol=1e-12)
    energy = 0.5 * young * strain**2
    np.testing.assert_allclose(body.energy(u), body.volume * energy, rtol=2.0 * max(close, 1e-12))


@pytest.mark.parametrize("zero_energy", CONTROLS)
@pytest.mark.parametrize("kind", KINDS)
def test_nothing_changes_when_a_body_turns(kind, zero_energy):
    """A turned body is free of stress; a deformed one has its energy at every node, and its forces turn along."""
    x, body, _ = bodies(kind, zero_energy)
    u = far(x)
    energy, force, stress = body.energy(u), body.force(u), body.stress(u)
    for degrees in (30.0, 90.0, 180.0):
        turn = rotation(x.shape[1], degrees)
        alone = x @ turn.T - x + 3e-3
        # Measured 2e-15 of the moduli, 1e-16 of the forces and 5e-30 of the energies below.
        assert np.abs(body.stress(alone)).max() < 1e-13 * YOUNG
        assert np.abs(body.force(alone)).max() < 1e-13 * np.abs(force).max()
        assert body.energy(alone).max() < 1e-25 * energy.max()
        both = (x + u) @ turn.T - x + 3e-3
        # Measured 5e-15.
        np.testing.assert_allclose(body.energy(both), energy, rtol=1e-12)
        np.testing.assert_allclose(body.force(both), force @ turn.T, rtol=0.0, atol=1e-12 * np.abs(force).max())
        np.testing.assert_allclose(body.stress(both), turn @ stress, rtol=0.0, atol=1e-12 * np.abs(stress).max())


@pytest.mark.parametrize("zero_energy", CONTROLS)
@pytest.mark.parametrize("kind", KINDS)
def test_forces_and_their_changes_are_derivatives(kind, zero_energy):
    x, body, _ = bodies(kind, zero_energy)
    u, rng = far(x), np.random.default_rng(1)
    v, w = rng.normal(size=x.shape), rng.normal(size=x.shape)
    pose = body.at(u)
    force, change = pose.force(), pose.change(v)
    work, h = np.sum(force * v), 3e-9
    slope = -(body.energy(u + h * v).sum() - body.energy(u - h * v).sum()) / (2 * h)
    # Measured 1e-11: the square of the step, and round-off over it.
    assert slope == pytest.approx(work, abs=1e-9 * np.abs(force * v).sum())
    difference = (body.force(u + h * v) - body.force(u - h * v)) / (2 * h)
    # Measured 1e-10.
    np.testing.assert_allclose(difference, change, rtol=0.0, atol=2e-9 * np.abs(change).max())
    # Measured 1e-16: symmetric.
    other = pose.change(w)
    assert np.sum(w * change) == pytest.approx(np.sum(v * other), abs=1e-13 * np.abs(w * change).sum())
    # Measured 1e-15: neither forces nor moments are left over.
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * np.abs(force).sum()
    arm = x + u
    moment = np.cross(arm, force) if x.shape[1] == 3 else arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]
    assert np.abs(moment.sum(axis=0)).max() < 1e-12 * np.abs(arm).max() * np.abs(force).sum()


@pytest.mark.parametrize("zero_energy", CONTROLS)
@pytest.mark.parametrize("kind", KINDS)
def test_small_strains_are_those_of_the_linear_model(kind, zero_energy):
    x, body, reference = bodies(kind, zero_energy)
    for size in (1e-8, 1e-5):
        u = size * far(x) / 0.15
        expected = reference.force(u)
        # Measured 1 to 6 times the strain: what is left is of second order.
        np.testing.assert_allclose(body.force(u), expected, rtol=0.0, atol=20.0 * size * np.abs(expected).max())
        np.testing.assert_allclose(
            body.energy(u), reference.energy(u), rtol=0.0, atol=20.0 * size * body.energy(u).max()
        )
    rest = body.at(np.zeros_like(x))
    expected = reference.force(u)
    # Measured 2e-16: the stiffness at rest is that of small strains.
    np.testing.assert_allclose(rest.change(u), expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())
    np.testing.assert_allclose(rest.diagonal(), reference.diagonal(), rtol=1e-13)


@pytest.mark.parametrize("kind", ["stress", None])
def test_axes_of_orthotropic_materials_turn_with_the_body(kind):
    ply = Orthotropic(140e9, 10e9, 0.3, 5e9, 9e9, 0.28, 0.4, 5e9, 3e9)
    rng = np.random.default_rng(3)
    frame = np.linalg.qr(rng.normal(size=(150, 3, 3)))[0]
    axes = {"frame": frame} if kind is None else {"angle": rng.uniform(0.0, np.pi, 72)}
    x, body, reference = bodies(kind, orthotropic=ply, **axes)
    u, v, h = far(x), np.random.default_rng(4).normal(size=x.shape), 3e-9
    turn = rotation(x.shape[1], 70.0)
    np.testing.assert_allclose(body.energy((x + u) @ turn.T - x), body.energy(u), rtol=1e-12)
    pose = body.at(u)
    change, force = pose.change(v), pose.force()
    slope = -(body.energy(u + h * v).sum() - body.energy(u - h * v).sum()) / (2 * h)
    # Measured 1e-11 and 1e-10.
    assert slope == pytest.approx(np.sum(force * v), abs=1e-9 * np.abs(force * v).sum())
    difference = (body.force(u + h * v) - body.force(u - h * v)) / (2 * h)
    np.testing.assert_allclose(difference, change, rtol=0.0, atol=2e-9 * np.abs(change).max())
    expected = reference.force(v)
    np.testing.assert_allclose(body.at(0.0 * u).change(v), expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())
    if kind is not None:
        with pytest.raises(PdheError, match="isotropic"):
            body.thickness_stretch(u)


def neo_hooke(properties, h, energy, stress, tangent):
    """Plane strain: W = mu/2 (tr F^T F - 2 - 2 ln J) + lambda/2 ln(J)^2."""
    lame, shear = properties[0], properties[1]
    a, b, c, d = 1.0 + h[0], h[1], h[2], 1.0 + h[3]
    area = a * d - b * c
    log = np.log(area)
    energy[0] = 0.5 * shear * (a * a + b * b + c * c + d * d - 2.0 - 2.0 * log) + 0.5 * lame * log * log
    factor = (lame * log - shear) / area
    stress[0] = shear * a + factor * d
    stress[1] = shear * b - factor * c
    stress[2] = shear * c - factor * b
    stress[3] = shear * d + factor * a
    for row in range(4):
        sign_row = 1.0 if row in (0, 3) else -1.0
        mine = (d, c, b, a)[row] * sign_row
        for column in range(4):
            sign = 1.0 if column in (0, 3) else -1.0
            other = (d, c, b, a)[column] * sign
            value = (lame - lame * log + shear) / area**2 * mine * other
            if row == column:
                value += shear
            if row + column == 3:
                value += factor * sign_row
            tangent[4 * row + column] = value


def test_a_node_takes_any_compiled_stress_function():
    """One compiled kernel calls all of them, by their addresses."""
    from pdhe.kernels import finite_strain as kernels

    shear, lame = YOUNG / (2 + 2 * NU), YOUNG * NU / ((1 + NU) * (1 - 2 * NU))
    law = StressLaw(compiled(neo_hooke), np.array([[lame, shear]]))
    x, body, reference = bodies("strain", law=law)
    u, v, h = far(x), np.random.default_rng(5).normal(size=x.shape), 3e-9
    pose = body.at(u)
    slope = -(body.energy(u + h * v).sum() - body.energy(u - h * v).sum()) / (2 * h)
    # Measured 3e-11.
    assert slope == pytest.approx(np.sum(pose.force() * v), abs=1e-9 * np.abs(pose.force() * v).sum())
    difference = (body.force(u + h * v) - body.force(u - h * v)) / (2 * h)
    # Measured 1e-10.
    np.testing.assert_allclose(difference, pose.change(v), rtol=0.0, atol=2e-9 * np.abs(difference).max())
    expected = reference.force(u)
    np.testing.assert_allclose(body.at(0.0 * u).change(u), expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())
    stretched = np.column_stack([0.3 * x[:, 0], 0.0 * x[:, 1]])
    across = (lame * np.log(1.3) - shear) + shear
    np.testing.assert_allclose(body.stress(stretched)[:, 1, 1], across, rtol=1e-11)
    assert len(kernels.respond._serial.signatures) == 1


@pytest.mark.parametrize("zero_energy", CONTROLS)
@pytest.mark.parametrize("kind", KINDS)
def test_bonds_have_the_energy_of_the_body_and_their_loads_turn_along(kind, zero_energy):
    x, body, reference = bodies(kind, zero_energy)
    u, bond = far(x), np.flatnonzero(body.intact & body.bonds.once())
    owner = body.bonds.owners()[bond]
    measure = body.measure(bond, owner)

    def energies(at):
        return 0.5 * measure.stiffness * measure.square(body.bond_parts(at, bond, owner))

    # Measured 3e-16.
    assert energies(u).sum() == pytest.approx(body.energy(u).sum(), rel=1e-12)
    alone, loads = energies(u), [body.bond_loads(u, load) for load in (BY_STRETCH, BY_ENERGY)]
    length = np.linalg.norm((x + u)[body.bonds.neighbours] - (x + u)[body.bonds.owners()], axis=1)
    np.testing.assert_allclose(loads[0], np.maximum(length / body.bonds.length - 1.0, 0.0), rtol=0.0, atol=1e-13)
    for degrees in (90.0, 180.0):
        turned = (x + u) @ rotation(x.shape[1], degrees).T - x
        # Measured 4e-15.
        np.testing.assert_allclose(energies(turned), alone, rtol=0.0, atol=1e-12 * np.abs(alone).max())
        for load, before in zip((BY_STRETCH, BY_ENERGY), loads, strict=True):
            after = body.bond_loads(turned, load)
            # Bonds of next to no energy or stretch have the root of the round-off.
            sure = before > 1e-3 * before.max()
            np.testing.assert_allclose(after[sure], before[sure], rtol=1e-9)
    small = 1e-8 / 0.15 * u
    for load in (BY_STRETCH, BY_ENERGY):
        expected = reference.bond_loads(small, load)
        # Measured 3e-8 of the largest.
        off = np.abs(body.bond_loads(small, load) - expected)
        assert off[expected > 0.05 * expected.max()].max() < 1e-6 * expected.max()
    resistance = np.random.default_rng(1).uniform(1.0, 2.0, len(x))
    top, _ = body.largest_ratios(u, BY_ENERGY, body.intact, resistance)
    every, j = body.bonds.owners(), body.bonds.neighbours
    expected = np.zeros(len(x))
    ratio = np.where(body.intact, loads[1], 0.0) / np.minimum(resistance[every], resistance[j])
    np.maximum.at(expected, every, ratio)
    np.testing.assert_allclose(top, expected, rtol=1e-12)


def test_bonds_of_another_law_have_no_loads():
    law = StressLaw(compiled(neo_hooke), np.array([[1e11, 1e11]]))
    x, body, _ = bodies("strain", law=law)
    with pytest.raises(PdheError, match="Saint Venant and Kirchhoff alone"):
        body.bond_loads(0.0 * x, BY_ENERGY)
