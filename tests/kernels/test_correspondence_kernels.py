"""Correspondence: slow twin, exact gradients, zero-energy modes, bond energies, and free expansion."""

import dataclasses

import numba
import numpy as np
import pytest

from pdhe import materials
from pdhe.materials import BY_ENERGY
from pdhe.materials.correspondence import CONTROLS
from tests.lattices import YOUNG, make_body

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


def twin(x, body, u):
    """Gradients, energies, forces and loads, tensor by tensor from theory eqs. 2.14 to 2.21."""
    b, owner, n = body.bonds, body.bonds.owners(), len(x)
    xi, eta = x[b.neighbours] - x[owner], u[b.neighbours] - u[owner]
    over_r = np.where(body.intact, b.weight, 0.0) / b.length
    law = np.zeros((2, 2, 2, 2))
    pairs = [(0, 0), (1, 1), (0, 1)]
    tensor = materials.constants.stiffness_tensor(YOUNG, body.model.poissons_ratio, body.model.plane)
    for row, (i, j) in enumerate(pairs):
        for column, (k, m) in enumerate(pairs):
            for a, c in {(i, j), (j, i)}:
                for p, q in {(k, m), (m, k)}:
                    law[a, c, p, q] = tensor[row, column]
    gradient, inverse, control = np.zeros((n, 2, 2)), np.zeros((n, 2, 2)), np.zeros((n, 2, 2))
    share = np.ones(n)
    for i in range(n):
        mine = owner == i
        shape = np.einsum("k,ka,kb->ab", over_r[mine], xi[mine], xi[mine]) / body.volume[i]
        inverse[i] = np.linalg.inv(shape)
        whole = np.einsum("k,ka,kb->ab", (b.weight / b.length)[mine], xi[mine], xi[mine]) / body.volume[i]
        share[i] = min(1.0, np.linalg.eigvalsh(shape)[0] / (0.25 * np.linalg.eigvalsh(whole)[0]))
        gradient[i] = np.einsum("k,ka,kb->ab", over_r[mine], eta[mine], xi[mine]) / body.volume[i] @ inverse[i]
        control[i] = np.einsum("acbd,bd->ac", law, inverse[i])
        if body.model.zero_energy == "silling":
            control[i] = 0.5 * body.normal * np.eye(2)
        values, vectors = np.linalg.eigh(control[i])
        control[i] = share[i] * body.model.zero_energy_strength * vectors @ np.diag(np.maximum(values, 0.0)) @ vectors.T
    stress = share[:, None, None] * np.einsum("acbd,nbd->nac", law, gradient)
    z = eta - np.einsum("kab,kb->ka", gradient[owner], xi)
    # Force states over the weight; the energy of a bond is defined for broken ones as well.
    state = np.einsum("kab,kb->ka", (stress @ inverse)[owner], xi) + np.einsum("kab,kb->ka", control[owner], z)
    state /= b.length[:, None]
    force = np.zeros((n, 2))
    np.add.at(force, owner, (over_r * b.length)[:, None] * (state - state[b.reverse]))
    energy = 0.5 * body.volume * np.einsum("nab,nab->n", stress, gradient)
    np.add.at(energy, owner, 0.5 * over_r * np.einsum("ka,kab,kb->k", z, control[owner], z))
    turned = eta - np.einsum("kab,kb->ka", 0.5 * (gradient - gradient.transpose(0, 2, 1))[owner], xi)
    work = np.sum(state * turned, axis=1)
    square = (work + work[b.reverse]) / b.length / body.normal
    stretch = np.sum(xi * eta, axis=1) / b.length**2
    return gradient, energy, force, np.where(stretch > 0.0, np.sqrt(np.maximum(square, 0.0)), 0.0)


@pytest.mark.parametrize("zero_energy", CONTROLS)
@pytest.mark.parametrize("case", CASES, ids=list(CASES))
def test_kernels_equal_their_twins(case, zero_energy):
    x, body = correspondence(9, 8, zero_energy=zero_energy, strength=0.7, **CASES[case])
    assert body.unsupported().size == 0
    u = np.random.default_rng(0).normal(size=x.shape) * 1e-6
    gradient, energy, force, load = twin(x, body, u)
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
