"""Correspondence: slow twin, exact gradients, zero-energy modes, bond energies, and free expansion."""

import dataclasses

import numba
import numpy as np
import pytest

from pdhe import materials
from pdhe.materials import BY_ENERGY
from pdhe.materials.correspondence import CONTROLS
from tests.lattices import YOUNG, make_body
from tests.twins import correspondence_twin

CASES = {
    "regular": {},
    "perturbed and broken": {"perturb": 0.2, "break_share": 0.3, "plane": "strain"},
    "auxetic": {"nu": -0.8, "perturb": 0.2, "break_share": 0.5},
}


def correspondence(*size, zero_energy="wan", strength=1.0, **options):
    x, body = make_body(*size, model="correspondence", **options)
    model = dataclasses.replace(body.model, zero_energy=zero_energy, zero_energy_strength=strength)
    again = materials.make_body(body.bonds, model, x, body.volume)
    again.break_bonds(np.flatnonzero(~body.intact))
    return x, again


def law_of(model):
    """Elasticity tensor of an isotropic plate, Pa (2, 2, 2, 2)."""
    law = np.zeros((2, 2, 2, 2))
    pairs = [(0, 0), (1, 1), (0, 1)]
    tensor = materials.constants.stiffness_tensor(YOUNG, model.poissons_ratio, model.plane)
    for row, (i, j) in enumerate(pairs):
        for column, (k, m) in enumerate(pairs):
            for a, c in {(i, j), (j, i)}:
                for p, q in {(k, m), (m, k)}:
                    law[a, c, p, q] = tensor[row, column]
    return law


@pytest.mark.parametrize("zero_energy", CONTROLS)
@pytest.mark.parametrize("case", CASES, ids=list(CASES))
def test_kernels_equal_their_twins(case, zero_energy):
    x, body = correspondence(9, 8, zero_energy=zero_energy, strength=0.7, **CASES[case])
    assert body.unsupported().size == 0
    u = np.random.default_rng(0).normal(size=x.shape) * 1e-6
    gradient, energy, force, load = correspondence_twin(x, body, u, law_of(body.model))
    # Round-off of sums over some 30 bonds and of one inverse: measured 2e-14 of the largest.
    for measured, expected in (
        (body.displacement_gradient(u), gradient),
        (body.energy(u), energy),
        (body.force(u), force),
        (body.bond_loads(u, BY_ENERGY), load),
    ):
        np.testing.assert_allclose(measured, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    breakable = body.intact & (np.arange(load.size) % 3 > 0)
    resistance = np.random.default_rng(1).uniform(1.0, 2.0, len(x))
    top, _ = body.largest_ratios(u, BY_ENERGY, breakable, resistance)
    owner = body.bonds.owners()
    bound = np.where(breakable, load, 0.0) / np.minimum(resistance[owner], resistance[body.bonds.neighbours])
    expected = np.zeros(len(x))
    np.maximum.at(expected, owner, bound)
    np.testing.assert_allclose(top, expected, rtol=1e-9)


@pytest.mark.parametrize("weights", ["moment matched", "none"])
@pytest.mark.parametrize("case", CASES, ids=list(CASES))
def test_gradients_of_affine_displacements_are_exact_at_every_node(case, weights):
    x, body = correspondence(9, 8, surface=weights, **CASES[case])
    wanted = np.array([[0.3, -0.2], [0.7, 0.1]])
    # Measured 5e-15.
    np.testing.assert_allclose(
        body.displacement_gradient(x @ wanted.T), np.broadcast_to(wanted, (72, 2, 2)), atol=1e-12
    )
    stress = body.stress(x @ wanted.T)
    np.testing.assert_allclose(stress, stress[:1].repeat(72, axis=0), rtol=1e-10)


def test_all_bonds_have_the_energy_of_the_body_and_none_under_rotation():
    x, body = correspondence(9, 8, perturb=0.2, break_share=0.2)
    bond = np.flatnonzero(body.intact & (body.bonds.owners() < body.bonds.neighbours))
    owner = body.bonds.owners()[bond]
    measure = body.measure(bond, owner)

    def energies(u):
        return 0.5 * measure.stiffness * measure.square(body.bond_parts(u, bond, owner))

    u = np.random.default_rng(1).normal(size=x.shape)
    assert energies(u).sum() == pytest.approx(body.energy(u).sum(), rel=1e-11)
    turn = np.column_stack([-x[:, 1], x[:, 0]])
    stretched = energies(x @ np.diag([1e-3, 0.0]) + 0.0)
    assert np.abs(energies(x @ np.diag([1e-3, 0.0]) + turn) - stretched).max() < 1e-9 * stretched.max()


@pytest.mark.parametrize("zero_energy", CONTROLS)
def test_control_leaves_three_rigid_motions_and_nothing_else(zero_energy):
    def values(strength):
        x, body = correspondence(8, 7, zero_energy=zero_energy, strength=strength)
        stiffness = np.stack([-body.force(unit.reshape(-1, 2)).ravel() for unit in np.eye(x.size)])
        assert np.linalg.eigvalsh(stiffness)[-1] <= body.stiffness_rows().max() <= body.stiffest_rows().max()
        return np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T))

    # Without control, alternating displacements are nearly free: measured 4e-4 of the largest eigenvalue with it, where
    # the least is 0.064.
    free, held = values(0.0), values(1.0)
    assert free[3] < 1e-3 * held[-1]
    assert np.abs(held[:3]).max() < 1e-12 * held[-1] and held[3] > 0.05 * held[-1]


def test_both_controls_are_one_inside_an_isotropic_body():
    _, wan = correspondence(20, 20)
    _, silling = correspondence(20, 20, zero_energy="silling")
    np.testing.assert_allclose(wan.control[209], silling.control[209], rtol=0, atol=1e-12 * silling.normal)


def test_a_node_with_its_bonds_in_a_row_is_held_by_its_neighbours_alone():
    x, body = correspondence(9, 8)
    owned = np.arange(body.bonds.offsets[40], body.bonds.offsets[41])
    body.break_bonds(owned[np.abs(body.bonds.ny[owned]) > 1e-9])
    assert body.unsupported().tolist() == [40]
    stiffness = np.stack([-body.force(unit.reshape(-1, 2)).ravel() for unit in np.eye(x.size)])
    values = np.linalg.eigvalsh(stiffness)
    assert values[0] > -1e-12 * values[-1] and values[3] > 1e-6 * values[-1]


@pytest.mark.parametrize("model", [name for name, model in materials.MODELS.items() if model.objective])
def test_free_expansion_by_a_uniform_eigenstretch_is_free_of_stress(model):
    """A free body whose bonds want to be longer by 1e-3 becomes longer by that, and no force is left anywhere."""
    x, body = make_body(9, 8, perturb=0.2, model=model)
    grown = 1e-3 * (x - x[0])
    pull = -body.force(grown)  # what the wanted lengths pull with, at rest
    stiffness = np.stack([-body.force(unit.reshape(-1, 2)).ravel() for unit in np.eye(x.size)])
    free = np.setdiff1d(np.arange(x.size), [0, 1, 2 * 8 + 1])  # no rigid motion: one node, and another one's height
    u = np.zeros(x.size)
    u[free] = np.linalg.solve(stiffness[np.ix_(free, free)], pull.ravel()[free])
    scale = np.abs(body.diagonal()).max() * 1e-3 * 8e-3
    assert np.abs(body.force(u.reshape(-1, 2) - grown)).max() < 1e-10 * scale


@pytest.mark.parametrize("zero_energy", CONTROLS)
def test_no_breakage_makes_a_body_stiffer_than_foretold(zero_energy):
    x, body = correspondence(8, 7, zero_energy=zero_energy, perturb=0.1)
    foretold = body.stiffest_rows().max()
    once = np.flatnonzero(body.bonds.owners() < body.bonds.neighbours)
    order = np.random.default_rng(4).permutation(once)
    largest = []
    for piece in np.array_split(order, 12)[:-1]:
        body.break_bonds(piece)
        stiffness = np.stack([-body.force(unit.reshape(-1, 2)).ravel() for unit in np.eye(x.size)])
        values = np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T))
        assert values[0] > -1e-12 * values[-1]
        assert values[-1] <= body.stiffness_rows().max()
        largest.append(values[-1])
    assert max(largest) <= foretold
    assert body.share.min() < 0.5


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="this process may have one thread only")
def test_two_threads_give_the_same_bits():
    x, body = correspondence(perturb=0.2)
    u, before, found = np.random.default_rng(5).normal(size=x.shape), numba.get_num_threads(), []
    try:
        for threads in (1, 2):
            numba.set_num_threads(threads)
            found.append((body.force(u), body.energy(u)))
    finally:
        numba.set_num_threads(before)
    assert np.array_equal(found[0][0], found[1][0]) and np.array_equal(found[0][1], found[1][1])
