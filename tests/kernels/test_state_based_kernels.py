"""The linear peridynamic solid against a slow twin, and against bonds where it is the same."""

import numpy as np
import pytest

from pdhe import materials
from pdhe.damage import Candidates, FailureRule
from pdhe.materials import BY_ENERGY, BY_STRETCH
from tests.lattices import make_body

CASES = {
    "regular": {},
    "perturbed and broken": {"perturb": 0.2, "break_share": 0.2, "plane": "strain"},
    "nearly incompressible": {"nu": 0.49, "plane": "strain", "cracks": [((0.0, 4e-3), (4e-3, 4e-3))]},
}


def twin(x, body, u):
    """Dilatations, forces, energies and loads, bond by bond from theory eqs. 2.9 to 2.13."""
    b, owner, n, dim = body.bonds, body.bonds.owners(), len(x), body.model.dimensions
    weighted, theta, energy = np.zeros(n), np.zeros(n), np.zeros(n)
    force = np.zeros((n, 2))
    bulk, shear = body.model.bulk, body.model.shear
    length, extension = np.empty(owner.size), np.empty(owner.size)
    for k, i in enumerate(owner):
        xi, eta = x[b.neighbours[k]] - x[i], u[b.neighbours[k]] - u[i]
        length[k] = np.hypot(*xi)
        extension[k] = xi @ eta / length[k]
        # beta lambda V_j times the influence 1/r, times r^2
        weighted[i] += b.weight[k] / body.volume[i] * length[k]
    influence = np.where(body.intact, b.weight, 0.0) / length / body.volume[owner]
    for k, i in enumerate(owner):
        theta[i] += dim / weighted[i] * influence[k] * length[k] * extension[k]
    state = np.empty(owner.size)
    for k, i in enumerate(owner):
        alpha = dim * (dim + 2) * shear / weighted[i]
        isotropic = dim * bulk - (dim + 2) * shear
        state[k] = isotropic * theta[i] / weighted[i] * length[k] + alpha * extension[k]
        energy[i] += 0.5 * alpha * influence[k] * extension[k] ** 2 * body.volume[i]
    energy += 0.5 * (bulk - (dim + 2) * shear / dim) * theta**2 * body.volume
    load = np.empty(owner.size)
    for k, i in enumerate(owner):
        j = b.neighbours[k]
        both = (state[k] + state[b.reverse[k]]) / length[k]  # force over weight
        force[i] += np.where(body.intact[k], b.weight[k], 0.0) * both * (x[j] - x[i]) / length[k]
        stretch = extension[k] / length[k]
        load[k] = np.sqrt(max(stretch * both / body.normal, 0.0)) if stretch > 0.0 else 0.0
    return theta, force, energy, load, np.maximum(extension / length, 0.0)


@pytest.mark.parametrize("case", CASES, ids=list(CASES))
def test_kernels_equal_their_twins(case):
    x, body = make_body(9, 8, model="state-based", **CASES[case])
    u = np.random.default_rng(0).normal(size=x.shape) * 1e-6
    theta, force, energy, load, stretch = twin(x, body, u)
    # Round-off of sums over some 30 bonds: measured 3e-15 of the largest.
    for measured, expected in (
        (body.dilatation(u), theta),
        (body.force(u), force),
        (body.energy(u), energy),
        (body.bond_loads(u, BY_ENERGY), load),
        (body.bond_loads(u, BY_STRETCH), stretch),
    ):
        np.testing.assert_allclose(measured, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    breakable = body.intact & (np.arange(load.size) % 3 > 0)
    resistance = np.random.default_rng(1).uniform(1.0, 2.0, len(x))
    top, _ = body.largest_ratios(u, BY_ENERGY, breakable, resistance)
    bound = np.where(breakable, load, 0.0) / np.minimum(
        resistance[body.bonds.owners()], resistance[body.bonds.neighbours]
    )
    expected = [bound[a:b].max(initial=0.0) for a, b in zip(body.bonds.offsets, body.bonds.offsets[1:], strict=False)]
    np.testing.assert_allclose(top, expected, rtol=1e-12)


def test_energy_of_all_bonds_is_the_energy_of_the_body():
    x, body = make_body(9, 8, model="state-based", perturb=0.2, break_share=0.1)
    u = np.random.default_rng(1).normal(size=x.shape)
    bond = np.flatnonzero(body.intact & (body.bonds.owners() < body.bonds.neighbours))
    owner = body.bonds.owners()[bond]
    measure = body.measure(bond, owner)
    total = 0.5 * np.sum(measure.stiffness * measure.square(body.bond_parts(u, bond, owner)))
    assert total == pytest.approx(body.energy(u).sum(), rel=1e-12)


@pytest.mark.parametrize("plane", ["stress", "strain"])
def test_is_the_bond_based_model_at_its_poissons_ratio(plane):
    nu = materials.constants.ONE_PARAMETER[plane]
    x, solid = make_body(24, 24, nu=nu, model="state-based", plane=plane)
    _, bond = make_body(24, 24, nu=nu, model="one-parameter", plane=plane)
    u = np.random.default_rng(2).normal(size=x.shape)
    inside = np.all(np.abs(x - x.mean(axis=0)) < 1e-3, axis=1)
    expected = bond.force(u)[inside]
    # The weighted volume of whole families is that of the disc; measured 2e-15.
    np.testing.assert_allclose(solid.force(u)[inside], expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_loads_between_two_displacements_are_those_of_the_mean():
    x, body = make_body(9, 8, model="state-based", perturb=0.1)
    rule = FailureRule(1e-6, 1.0, BY_ENERGY, None, body.bonds.owners() < body.bonds.neighbours)
    u0, u1 = np.random.default_rng(3).normal(size=(2, *x.shape)) * 1e-6
    found = Candidates(body, rule, u0, u1)
    assert found.bond.size > 20
    expected = body.bond_loads(0.7 * u0 + 0.3 * u1, BY_ENERGY)[found.bond]
    np.testing.assert_allclose(found.load(0.3), expected, rtol=1e-9, atol=1e-12 * expected.max())


def test_rows_bound_the_largest_eigenvalue():
    x, body = make_body(8, 7, model="state-based", nu=0.45, plane="strain", break_share=0.3)
    n = x.size
    stiffness = np.stack([-body.force(unit.reshape(-1, 2)).ravel() for unit in np.eye(n)])
    assert np.linalg.eigvalsh(stiffness)[-1] <= body.stiffness_rows().max()
