"""Kernels against slow twins that follow the theory line by line, and both layouts against each other."""

import dataclasses

import numba
import numpy as np
import pytest

from pdhe import materials
from pdhe.materials import BY_ENERGY, BY_STRETCH
from tests.lattices import make_body

CASES = {
    "regular": {},
    "perturbed and broken": {"perturb": 0.2, "break_share": 0.2},
    "thesis spring": {"model": "thesis spring"},
    "fading share": {"nu": 0.42, "break_share": 0.02},
}


def twin(x, body, u):
    """Rotations, forces, bond loads and energies, bond by bond from theory eqs. 2.1, 2.6, 2.7 and 5.2."""
    b, owner = body.bonds, body.bonds.owners()
    n = len(x)
    theta, force, energy = np.zeros(n), np.zeros((n, 2)), np.zeros(n)
    load, load_by_energy = np.zeros(owner.size), np.zeros(owner.size)

    def kinematics(k):
        i, j = owner[k], b.neighbours[k]
        xi, eta = x[j] - x[i], u[j] - u[i]
        r = np.hypot(*xi)
        normal = xi / r
        tangent = np.array([-normal[1], normal[0]])
        return i, j, r, normal, tangent, normal @ eta / r, tangent @ eta / r

    weight = np.where(body.intact, b.weight, 0.0)
    if body.model.condenses_rotation:
        numerator, denominator = np.zeros(n), np.zeros(n)
        for k in range(owner.size):
            i, _, r, _, _, _, angle = kinematics(k)
            numerator[i] += weight[k] * r * angle
            denominator[i] += weight[k] * r
        theta = numerator / np.where(denominator > 0, denominator, 1.0)
    kn, kt, g = body.normal, body.tangential, body.share
    for k in range(owner.size):
        i, j, r, normal, tangent, s, a = kinematics(k)
        shear = g[i] * (a - theta[i]), g[j] * (a - theta[j])
        force[i] += weight[k] * (kn * s * normal + 0.5 * kt * (shear[0] + shear[1]) * tangent)
        w = kn * s**2 + 0.5 * kt * (shear[0] * (a - theta[i]) + shear[1] * (a - theta[j]))
        energy[i] += 0.25 * weight[k] * r * w
        load[k], load_by_energy[k] = max(s, 0.0), (max(w, 0.0) / kn) ** 0.5 if s > 0 else 0.0
    return theta, force, energy, load, load_by_energy


@pytest.mark.parametrize("case", CASES, ids=list(CASES))
def test_kernels_equal_their_twins(case):
    x, body = make_body(9, 8, **CASES[case])
    u = np.random.default_rng(0).normal(size=x.shape) * 1e-6
    theta, force, energy, load, load_by_energy = twin(x, body, u)
    # Round-off of sums over some 30 bonds: measured 3e-15 of the largest.
    for measured, expected in (
        (body.rotation(u), theta),
        (body.force(u), force),
        (body.energy(u), energy),
        (body.bond_loads(u, BY_STRETCH), load),
        (body.bond_loads(u, BY_ENERGY), load_by_energy),
    ):
        np.testing.assert_allclose(measured, expected, rtol=0, atol=1e-13 * np.abs(expected).max() + 1e-300)


def test_lattice_layout_equals_the_gather_layout():
    x, body = make_body(23, 17, break_share=0.1)
    assert body.bonds.lattice is not None
    gather = materials.make_body(dataclasses.replace(body.bonds, lattice=None), body.model, x, body.volume)
    gather.break_bonds(np.flatnonzero(~body.intact))
    u = np.random.default_rng(1).normal(size=x.shape)
    expected = gather.force(u)
    # Same terms in another order: measured 1e-15 of the largest.
    np.testing.assert_allclose(body.force(u), expected, rtol=0, atol=1e-13 * np.abs(expected).max())


@pytest.mark.parametrize(("columns", "rows", "perturb"), [(23, 17, 0.1), (3, 9, 0.0), (1, 9, 0.0)])
def test_anything_but_a_wide_grid_is_gathered(columns, rows, perturb):
    # In a plate narrower than two horizons one step in the numbering can mean two different bonds.
    x, body = make_body(columns, rows, perturb=perturb)
    u = np.random.default_rng(2).normal(size=x.shape)
    np.testing.assert_allclose(body.force(u), twin(x, body, u)[1], atol=1e-12 * np.abs(body.force(u)).max())


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="needs two threads")
@pytest.mark.parametrize("perturb", [0.0, 0.1])
def test_same_bits_on_one_and_two_threads(perturb):
    x, body = make_body(70, 40, perturb=perturb)
    u = np.random.default_rng(3).normal(size=x.shape)
    results = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        results.append((body.force(u), body.energy(u), body.rotation(u), body.damage()))
    for one, two in zip(*results, strict=True):
        assert np.array_equal(one, two)
