"""Orthotropic materials in space: engineering constants, axes that turn with the body, what a scene says of them."""

import dataclasses

import numpy as np
import pytest

from pdhe.case import build_case
from pdhe.errors import SceneError
from pdhe.materials import BY_ENERGY, Correspondence, make_body
from pdhe.materials.constants import Orthotropic, mandel, turned, turned_in_space
from pdhe.scene import Scene, load_scene
from pdhe.simulation import simulate
from pdhe.solid_bonds import build_solid_bonds
from pdhe.verification.slabs import nodes_of
from tests.solids import YOUNG, block, make_solid

pytestmark = pytest.mark.usefixtures("one_thread")

#: A carbon-fibre ply whose axes 2 and 3 differ.
PLY = Orthotropic(140e9, 10e9, 0.3, 5e9, 12e9, 0.25, 0.4, 4e9, 3e9)
SPACING = 1e-3
TURN = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
TURN *= np.sign(np.linalg.det(TURN))


def frame_of(angles: np.ndarray) -> np.ndarray:
    """Axes turned about z and then about x by the same angles, (n, 3, 3)."""
    c, s, one, zero = np.cos(angles), np.sin(angles), np.ones_like(angles), np.zeros_like(angles)
    about_z = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]])
    about_x = np.array([[one, zero, zero], [zero, c, s], [zero, -s, c]])
    return np.einsum("abn,bcn->nac", about_z, about_x)


def laminate():
    """Displaced nodes of a block whose lower half has other axes than its upper half."""
    x = block(6, 6, 5) + 0.2 * SPACING * np.random.default_rng(0).uniform(-1, 1, (180, 3))
    return x, frame_of(np.where(x[:, 1] < 3e-3, 0.4, -1.1))


def body_of(x, frame, zero_energy="wan", surface="none", broken=0.1):
    volume = np.full(len(x), SPACING**3)
    bonds = build_solid_bonds(x, volume, np.full(len(x), SPACING), 2.5e-3, surface=surface)
    model = Correspondence(140e9, 0.3, 5e-3, 2.5e-3, None, zero_energy, orthotropic=PLY, frame=frame)
    body = make_body(bonds, model, x, volume)
    once = np.flatnonzero(bonds.once())
    body.break_bonds(np.random.default_rng(1).choice(once, int(broken * once.size), replace=False))
    return body


@pytest.mark.parametrize("zero_energy", ["wan", "silling"])
def test_a_turned_laminate_is_the_laminate_in_turned_axes(zero_energy):
    x, frame = laminate()
    body = body_of(x, frame, zero_energy)
    other = body_of(x @ TURN.T, frame @ TURN.T, zero_energy)
    u = np.random.default_rng(1).normal(size=x.shape)
    moved = u @ TURN.T
    # Measured 2e-15 of the largest.
    for measured, expected in (
        (other.force(moved), body.force(u) @ TURN.T),
        (other.energy(moved), body.energy(u)),
        (other.stress(moved), TURN @ body.stress(u) @ TURN.T),
        (other.bond_loads(moved, BY_ENERGY), body.bond_loads(u, BY_ENERGY)),
        (other.stiffness, body_of(x, frame @ TURN.T).stiffness),
    ):
        np.testing.assert_allclose(measured, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_the_equilibrium_of_a_turned_laminate_is_that_of_the_laminate():
    x, frame = laminate()
    held = np.flatnonzero((x[:, 1] < 1e-3) | (x[:, 1] > 5e-3))
    unknown = (3 * np.setdiff1d(np.arange(len(x)), held)[:, None] + [0, 1, 2]).ravel()

    def pulled(body, turned_by):
        stiffness = -np.stack([body.force(e.reshape(-1, 3)).ravel() for e in np.eye(x.size)], axis=1)
        given = np.zeros(x.shape)
        given[x[:, 1] > 5e-3, 1] = 1e-6
        answer = (given @ turned_by.T).ravel()
        known = -(stiffness @ answer)[unknown]
        answer[unknown] = np.linalg.solve(stiffness[np.ix_(unknown, unknown)], known)
        return answer.reshape(-1, 3)

    expected = pulled(body_of(x, frame), np.eye(3)) @ TURN.T
    found = pulled(body_of(x @ TURN.T, frame @ TURN.T), TURN)
    # Measured 2e-15.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def elasticity() -> np.ndarray:
    """Tensor of the ply in its axes from its compliance, entry by entry, Pa (3, 3, 3, 3)."""
    p, compliance = PLY, np.zeros((6, 6))
    moduli = p.youngs_modulus_1, p.youngs_modulus_2, p.youngs_modulus_3
    compliance[np.arange(3), np.arange(3)] = 1.0 / np.array(moduli)
    compliance[0, 1] = compliance[1, 0] = -p.poissons_ratio_12 / p.youngs_modulus_1
    compliance[0, 2] = compliance[2, 0] = -p.poissons_ratio_13 / p.youngs_modulus_1
    compliance[1, 2] = compliance[2, 1] = -p.poissons_ratio_23 / p.youngs_modulus_2
    compliance[3, 3], compliance[4, 4] = 1.0 / p.shear_modulus_23, 1.0 / p.shear_modulus_13
    compliance[5, 5] = 1.0 / p.shear_modulus_12
    place = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
    return np.linalg.inv(compliance)[place[:, :, None, None], place[None, None]]


@pytest.mark.parametrize("surface", ["none", "moment matched"])
def test_affine_displacements_have_the_energies_and_stresses_of_the_tensor(surface):
    """At every node, surfaces included, whatever the axes there."""
    x, frame = laminate()
    body = body_of(x, frame, surface=surface, broken=0.0)
    law = np.einsum("nai,nbj,nck,ndl,abcd->nijkl", frame, frame, frame, frame, elasticity(), optimize=True)
    shears = [np.array(s, float) for s in ([[0, 1, 0]] + [[0] * 3] * 2, [[0, 0, 1]] + [[0] * 3] * 2)]
    some = np.array([[0.3, -0.2, 0.1], [0.7, 0.1, -0.4], [0.2, 0.5, -0.6]])
    for wanted in (np.eye(3), np.diag([1.0, 0.0, 0.0]), *shears, some):
        stress = np.einsum("nabcd,cd->nab", law, wanted)
        energy = 0.5 * body.volume * np.einsum("nab,ab->n", stress, wanted)
        # Measured 2e-15 of the largest, 4e-15 of energies.
        u = x @ wanted.T
        np.testing.assert_allclose(body.stress(u), stress, rtol=0, atol=1e-11 * np.abs(stress).max())
        np.testing.assert_allclose(body.energy(u), energy, rtol=1e-10)


def test_tension_along_each_axis_has_its_modulus_and_ratios():
    compliance = np.linalg.inv(PLY.in_space())
    moduli = PLY.youngs_modulus_1, PLY.youngs_modulus_2, PLY.youngs_modulus_3
    assert 1.0 / np.diag(compliance)[:3] == pytest.approx(moduli, rel=1e-12)
    ratios = -compliance[[0, 0, 1], [1, 2, 2]] / np.diag(compliance)[[0, 0, 1]]
    assert ratios == pytest.approx([PLY.poissons_ratio_12, PLY.poissons_ratio_13, PLY.poissons_ratio_23], rel=1e-12)
    shears = PLY.shear_modulus_23, PLY.shear_modulus_13, PLY.shear_modulus_12
    assert 1.0 / np.diag(compliance)[3:] == pytest.approx(shears, rel=1e-12)


def test_turning_about_z_is_that_of_the_plane():
    for angle in (0.3, 1.2):
        plane = turned(PLY.stiffness("strain"), np.array([angle]))[0]
        c, s = np.cos(angle), np.sin(angle)
        space = turned_in_space(PLY.in_space(), np.array([[[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]]))[0]
        # No strain across the plate: what is left are the entries of xx, yy and xy. Measured 3e-17.
        inside = np.ix_([0, 1, 5], [0, 1, 5])
        np.testing.assert_allclose(space[inside], plane, rtol=0, atol=1e-13 * plane.max())


def test_isotropic_constants_make_an_isotropic_body():
    nu, shear = 0.29, YOUNG / 2.58
    same = Orthotropic(YOUNG, YOUNG, nu, shear, YOUNG, nu, nu, shear, shear)
    x, body = make_solid((5, 5, 4), model="correspondence", nu=nu, perturb=0.2, break_share=0.2)
    model = dataclasses.replace(body.model, orthotropic=same, frame=frame_of(np.linspace(0.0, 2.0, len(x))))
    other = make_body(body.bonds, model, x, body.volume)
    other.break_bonds(np.flatnonzero(~body.intact))
    assert model.normal == pytest.approx(body.model.normal, rel=1e-13)
    u = np.random.default_rng(2).normal(size=x.shape)
    # Measured 8e-16.
    np.testing.assert_allclose(other.force(u), body.force(u), rtol=0, atol=1e-12 * np.abs(body.force(u)).max())
    np.testing.assert_allclose(other.stiffness_rows(), body.stiffness_rows(), rtol=1e-12)


@pytest.mark.parametrize("zero_energy", ["wan", "silling"])
def test_no_deformation_is_free_and_rows_bound_the_stiffness(zero_energy):
    x, frame = laminate()
    body = body_of(x[: 6 * 6 * 3], frame[: 6 * 6 * 3], zero_energy, broken=0.0)
    x = body.coordinates
    assert np.linalg.eigvalsh(mandel(PLY.in_space()))[0] > 0.0
    foretold = body.stiffest_rows().max()
    for _ in range(2):
        stiffness = -np.stack([body.force(e.reshape(-1, 3)).ravel() for e in np.eye(x.size)], axis=1)
        # Measured 1e-16: forces are the slope of an energy.
        assert np.abs(stiffness - stiffness.T).max() < 1e-12 * np.abs(stiffness).max()
        values = np.linalg.eigvalsh(stiffness)
        assert np.abs(values[:6]).max() < 1e-11 * values[-1] < 1e-8 * values[6] * 1e3
        assert values[-1] <= body.stiffness_rows().max() and values[-1] <= foretold
        once = np.flatnonzero(body.bonds.once())
        body.break_bonds(np.random.default_rng(5).choice(once, once.size // 4, replace=False))


BAR = {
    "geometry": {"plate": {"width": "16 mm", "height": "6 mm", "thickness": "6 mm"}, "cracks": []},
    "mesh": {"spacing": "1 mm", "cells": "hexahedron"},
    "horizon": {"ratio": 2.015},
    "hydrogen": None,
    "damage": None,
    "fidelity": None,
    "material": {
        "youngs_modulus": "140 GPa",
        "poissons_ratio": 0.3,
        "orthotropic": {
            "youngs_modulus_2": "10 GPa", "youngs_modulus_3": "12 GPa", "poissons_ratio_13": 0.25,
            "poissons_ratio_23": 0.4, "shear_modulus_12": "5 GPa", "shear_modulus_13": "4 GPa",
            "shear_modulus_23": "3 GPa",
        },
    },
    "mechanics": {"model": "correspondence"},
    "loads": [
        {"on": "left", "displacement": {"x": "0 mm"}}, {"on": "right", "displacement": {"x": "0.01 mm"}},
    ],
    "solver.tolerance": 1e-8,
    "time": {"end": "0 s"},
    "outputs": {"count": 1},
}  # fmt: skip


def bar(axes=None) -> Scene:
    changes = BAR | ({} if axes is None else {"mechanics": {"model": "correspondence", "axes": axes}})
    return load_scene("config/scenes/smoke.yaml", changes)


@pytest.mark.parametrize(
    ("axes", "modulus"),
    [
        (None, 140e9),
        ([{"angle": "90 deg"}], 10e9),
        ([{"axis_1": [0, 1, 0], "axis_2": [0, 0, 2]}], 12e9),
        ([{"angle": "10 deg"}, {"axis_1": [0, 0, -1], "axis_2": [3, 0, 1]}], 10e9),
    ],
    ids=["along 1", "along 2", "along 3", "along 2, tipped"],
)
def test_bars_have_the_modulus_of_the_axis_along_them(axes, modulus):
    scene = bar(axes)
    assert Scene.from_resolved(scene.resolved()) == scene
    result = simulate(build_case(scene, nodes_of(scene)))
    x, u = result["node_x"].values, result["displacement"].values[-1]
    middle = np.abs(x - 8e-3) < 4e-3
    strain = np.polyfit(x[middle], u[middle, 0], 1)[0]
    found = float(result["reaction_right_x"].values[-1]) / 36e-6 / strain
    # Bars six cells thick at a horizon of two: measured 0.2 to 0.3 % more.
    assert found == pytest.approx(modulus, rel=0.01)


def test_axes_by_node_set_and_around_a_line():
    scene = load_scene(
        "config/scenes/smoke.yaml",
        BAR | {
            "regions": [{"name": "patch", "from": ["4 mm", "0 mm"], "to": ["8 mm", "6 mm"]}],
            "mechanics": {
                "model": "correspondence",
                "axes": [
                    {"angle": "10 deg", "around": ["0 mm", "0 mm"]},
                    {"on": "patch", "axis_1": [1, 0, 1], "axis_2": [0, 1, 0]},
                ],
            },
        },
    )  # fmt: skip
    case = build_case(scene, nodes_of(scene))
    frame, (x, y, _) = case.body.model.frame, case.discretization.coordinates.T
    patch = (x > 4e-3) & (x < 8e-3)
    np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frame.shape), atol=1e-15)
    assert (np.linalg.det(frame) > 0.0).all()
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        frame[patch], np.broadcast_to([[half, 0, half], [0, 1, 0], [-half, 0, half]], (144, 3, 3)), atol=1e-15
    )
    angle = np.deg2rad(10.0) + np.arctan2(y, x)
    np.testing.assert_allclose(np.arctan2(frame[:, 0, 1], frame[:, 0, 0])[~patch], angle[~patch], rtol=1e-12)
    assert case.body.stiffness.shape == (x.size, 21)


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({"mechanics.axes": [{"axis_1": [1, 0, 0]}]}, "mechanics.axes.0", "both"),
        (
            {"mechanics.axes": [{"angle": "3 deg", "axis_1": [1, 0, 0], "axis_2": [0, 1, 0]}]},
            "mechanics.axes.0", "both",
        ),
        ({"mechanics.axes": [{"axis_1": [1, 0, 0], "axis_2": [-2, 0, 0]}]}, "mechanics.axes.0.axis_2", "direction of"),
        ({"mechanics.axes": [{"axis_1": [0, 0, 0], "axis_2": [1, 0, 0]}]}, "mechanics.axes.0.axis_1", "no direction"),
        (
            {"mechanics.axes": [{"axis_1": [1, 0, 0], "axis_2": [0, 1, 0]}], "mesh.cells": "triangle"},
            "mechanics.axes.0.axis_1", "direction in space",
        ),
        ({"material.orthotropic.shear_modulus_23": None}, "material.orthotropic.shear_modulus_23", "body in space"),
        (
            {"material.orthotropic.poissons_ratio_23": 0.99, "material.orthotropic.poissons_ratio_13": 1.5},
            "material.orthotropic.poissons_ratio_23", "indefinite",
        ),
        ({"mechanics.model": "state-based"}, "material.orthotropic", "not known to model"),
    ],
)  # fmt: skip
def test_what_makes_no_material_is_refused(changes, key, words):
    raw = {**BAR, **changes}
    with pytest.raises(SceneError) as error:
        load_scene("config/scenes/smoke.yaml", raw)
    assert error.value.key == key and words in str(error.value), str(error.value)
