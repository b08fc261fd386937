"""Orthotropic materials: engineering constants, and axes that turn with the body."""

import dataclasses

import numpy as np
import pytest

from pdhe.bonds import build_bonds
from pdhe.case import build_case
from pdhe.materials import BY_ENERGY, Correspondence, make_body
from pdhe.materials.constants import Orthotropic, stiffness_tensor, turned
from pdhe.scene import Scene, load_scene
from pdhe.verification.slabs import nodes_of
from tests.lattices import THICKNESS, lattice

#: A carbon-fibre ply.
PLY = Orthotropic(140e9, 10e9, 0.3, 5e9, 10e9, 0.3, 0.45)
SPACING, HORIZON = 1e-3, 3.015e-3


def body_of(x, angle, plane="stress", zero_energy="wan"):
    volume = np.full(len(x), SPACING**2 * THICKNESS)
    bonds = build_bonds(x, volume, np.full(len(x), SPACING), THICKNESS, HORIZON)
    model = Correspondence(140e9, 0.3, THICKNESS, HORIZON, plane, zero_energy, orthotropic=PLY, angle=angle)
    return make_body(bonds, model, x, volume)


def laminate():
    """Displaced nodes whose lower half has its fibres at 20 degrees and whose upper half at -65 degrees."""
    x = lattice(11, 10) + 0.2e-3 * np.random.default_rng(0).uniform(-1, 1, (110, 2))
    return x, np.deg2rad(np.where(x[:, 1] < 5e-3, 20.0, -65.0))


@pytest.mark.parametrize("zero_energy", ["wan", "silling"])
@pytest.mark.parametrize("degrees", [30.0, 90.0, 137.0])
def test_a_turned_laminate_is_the_laminate_in_turned_axes(degrees, zero_energy):
    x, angle = laminate()
    turn = np.deg2rad(degrees)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    body = body_of(x, angle, zero_energy=zero_energy)
    other = body_of(x @ rotation.T, angle + turn, zero_energy=zero_energy)
    u = np.random.default_rng(1).normal(size=x.shape)
    moved = u @ rotation.T
    # Measured 2e-13 of the largest.
    for measured, expected in (
        (other.force(moved), body.force(u) @ rotation.T),
        (other.energy(moved), body.energy(u)),
        (other.stress(moved), rotation @ body.stress(u) @ rotation.T),
        (other.bond_loads(moved, BY_ENERGY), body.bond_loads(u, BY_ENERGY)),
    ):
        np.testing.assert_allclose(measured, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    # And so is its equilibrium: the lower row held, the upper one pulled.
    held = np.concatenate([np.arange(11), np.arange(99, 110)])
    free = np.setdiff1d(np.arange(110), held)

    def pulled(some, turned_by):
        stiffness = -np.stack([some.force(e.reshape(-1, 2)).ravel() for e in np.eye(220)], axis=1)
        unknown = (2 * free[:, None] + [0, 1]).ravel()
        given = np.zeros((110, 2))
        given[99:, 1] = 1e-6
        given = (given @ turned_by.T).ravel()
        answer = given.copy()
        answer[unknown] = np.linalg.solve(stiffness[np.ix_(unknown, unknown)], -(stiffness @ given)[unknown])
        return answer.reshape(-1, 2)

    expected = pulled(body, np.eye(2)) @ rotation.T
    # Measured 4e-13.
    np.testing.assert_allclose(pulled(other, rotation), expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("plane", ["stress", "strain"])
def test_stresses_off_the_axes_are_those_of_the_ply(plane):
    x, _ = laminate()
    angle = 0.4
    body = body_of(x, angle, plane)
    # Tension along the fibres at 0.4 rad: engineering constants say what strains that makes in their axes.
    e1, e2, e3 = PLY.youngs_modulus_1, PLY.youngs_modulus_2, PLY.youngs_modulus_3
    nu12, nu13, nu23 = PLY.poissons_ratio_12, PLY.poissons_ratio_13, PLY.poissons_ratio_23
    across = nu13 * e3 / e1 if plane == "strain" else 0.0  # stress that keeps the thickness
    local = np.diag([1.0 / e1 - across * nu13 / e1, -nu12 / e1 - across * nu23 / e2]) * 1e8
    c, s = np.cos(angle), np.sin(angle)
    axes = np.array([[c, -s], [s, c]])
    stress = body.stress(x @ (axes @ local @ axes.T))
    expected = 1e8 * np.outer(axes[:, 0], axes[:, 0])
    # Measured 1e-14 of the stress.
    np.testing.assert_allclose(stress, np.broadcast_to(expected, stress.shape), rtol=0, atol=1e-3)
    assert body.energy(np.column_stack([-x[:, 1], x[:, 0]])).sum() < 1e-12 * body.energy(x).sum()


@pytest.mark.parametrize("plane", ["stress", "strain"])
def test_isotropic_constants_make_an_isotropic_ply(plane):
    young, nu = 207e9, 0.29
    same = Orthotropic(young, young, nu, young / (2.0 * (1.0 + nu)), young, nu, nu)
    tensors = turned(same.stiffness(plane), np.array([0.0, 0.7, 2.0]))
    expected = np.broadcast_to(stiffness_tensor(young, nu, plane), tensors.shape)
    np.testing.assert_allclose(tensors, expected, rtol=1e-13, atol=1e-3)
    model = Correspondence(young, nu, THICKNESS, HORIZON, plane)
    assert dataclasses.replace(model, orthotropic=same).normal == pytest.approx(model.normal, rel=1e-14)


def test_scenes_give_axes_by_node_set_and_around_points():
    changed = {
        "mesh.spacing": "5 mm",
        "hydrogen": None,
        "geometry.cracks": [],
        "material.orthotropic": {"youngs_modulus_2": "10 GPa", "shear_modulus_12": "5 GPa"},
        "material.critical_energy_release_rate": "0.3 kJ/m^2",
        "material.fracture_toughness": None,
        "regions": [{"name": "patch", "from": ["50 mm", "0 mm"], "to": ["100 mm", "100 mm"]}],
        "mechanics": {
            "model": "correspondence",
            "axes": [{"angle": "10 deg", "around": ["0 mm", "0 mm"]}, {"on": "patch", "angle": "-0.5 rad"}],
        },
    }
    scene = load_scene("config/scenes/smoke.yaml", changed)
    assert Scene.from_resolved(scene.resolved()) == scene
    case = build_case(scene, nodes_of(scene))
    x, y = case.discretization.coordinates.T
    patch = (x > 0.05) & (x < 0.1)
    expected = np.where(patch, -0.5, np.deg2rad(10.0) + np.arctan2(y, x))
    np.testing.assert_allclose(case.body.model.angle, expected, rtol=1e-12)
    assert case.body.stiffness.shape == (x.size, 6)
    u, force = case.equilibrium.solve(np.zeros((x.size, 2)), case.conditions.values(scene.time.end))
    assert np.abs(force[~case.conditions.fixed]).max() < 1e-3 * np.abs(force).max() and np.abs(u).max() > 0.0
