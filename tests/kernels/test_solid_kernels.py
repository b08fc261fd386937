"""Kernels in space against slow twins in NumPy."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pdhe.kernels import moments3d
from pdhe.kernels.families3d import find_families
from pdhe.materials import BY_ENERGY
from pdhe.materials.solid import TANGENTIAL_FADE
from tests.solids import make_solid

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def cracked():
    """A rough body with a tenth of its bonds broken, where the tangential stiffness is negative."""
    return make_solid(perturb=0.2, break_share=0.1, partial="ramp")


def slow(x, body, u):
    """Bond by bond: rotation of each node, force on it, its energy and the load of every bond."""
    b, n = body.bonds, len(x)
    rest = np.zeros((n, 3, 3))
    moment, theta, force, energy = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
    owner = b.owners()
    ends = [(k, int(owner[k]), int(b.neighbours[k])) for k in range(owner.size)]
    for k, i, j in ends:
        xi = x[j] - x[i]
        r = np.linalg.norm(xi)
        normal = xi / r
        weight = b.weight[k] * r * body.intact[k]
        rest[i] += weight * (np.eye(3) - np.outer(normal, normal))
        moment[i] += weight * np.cross(normal, (u[j] - u[i]) / r)
    for i in range(n):
        theta[i] = np.linalg.pinv(rest[i], rcond=1e-9, hermitian=True) @ moment[i]
    share = np.maximum(0.0, 1.0 - body.damage() / TANGENTIAL_FADE)
    loads = np.zeros(owner.size)
    for k, i, j in ends:
        xi = x[j] - x[i]
        r = np.linalg.norm(xi)
        normal, eta = xi / r, (u[j] - u[i]) / r
        s = eta @ normal
        seen = [eta - s * normal - np.cross(theta[end], normal) for end in (i, j)]
        square = s**2 + 0.5 * body.tangential / body.normal * sum(
            share[end] * part @ part for end, part in zip((i, j), seen, strict=True)
        )
        loads[k] = np.sqrt(max(square, 0.0)) if s > 0.0 else 0.0
        if body.intact[k]:
            pull = body.normal * s * normal
            pull = pull + 0.5 * body.tangential * (share[i] * seen[0] + share[j] * seen[1])
            force[i] += b.weight[k] * pull
            energy[i] += 0.25 * b.weight[k] * r * body.normal * square
    return theta, force, energy, loads


def test_bodies_in_space_are_those_of_the_twin(cracked):
    x, body = cracked
    u = np.random.default_rng(1).normal(size=x.shape) * 1e-6
    theta, force, energy, loads = slow(x, body, u)
    assert body.tangential < 0.0 and body.share.min() < 0.9
    for want, got in (
        (theta, body.rotation(u)),
        (force, body.force(u)),
        (energy, body.energy(u)),
        (loads, body.bond_loads(u, BY_ENERGY)),
    ):
        # Measured 2e-14 at most: sums in another order, and the inverse of the rotation weight.
        assert np.abs(got - want).max() < 1e-12 * np.abs(want).max()


def test_the_search_for_failures_is_that_of_any_body(cracked):
    x, body = cracked
    u = np.random.default_rng(2).normal(size=x.shape) * 1e-6
    breakable = body.bonds.once() & body.intact
    resistance = np.random.default_rng(3).uniform(0.5, 1.0, len(x)) * 1e-3
    top, nodes = body.largest_ratios(u, BY_ENERGY, breakable, resistance)
    want, _ = super(type(body), body).largest_ratios(u, BY_ENERGY, breakable, resistance)
    assert top.max() > 0.0
    assert np.abs(top - want).max() < 1e-12 * want.max()
    assert np.array_equal(nodes, body.node_parts(u))
    bond = np.flatnonzero(breakable)
    parts = body.bond_parts(u, bond, body.bonds.owners()[bond], nodes)
    loads = np.sqrt(np.maximum(body.measure(bond, body.bonds.owners()[bond]).square(parts), 0.0)) * (parts[0] > 0.0)
    assert np.abs(loads - body.bond_loads(u, BY_ENERGY)[bond]).max() < 1e-12 * loads.max()


def test_families_in_space_are_those_of_a_tree():
    rng = np.random.default_rng(4)
    x, radius = rng.uniform(0.0, 1.0, (300, 3)) * [3.0, 1.0, 0.5], rng.uniform(0.1, 0.3, 300)
    offsets, neighbours = find_families(x, radius)
    pairs = cKDTree(x).query_pairs(0.3, output_type="ndarray")
    reach = np.maximum(*radius[pairs.T])
    near = pairs[np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1) <= reach]
    want = {(i, j) for i, j in np.concatenate([near, near[:, ::-1]]).tolist()}
    owner = np.repeat(np.arange(300), np.diff(offsets))
    assert len(want) > 1000
    assert set(zip(owner.tolist(), neighbours.tolist(), strict=True)) == want
    assert all((np.diff(neighbours[offsets[i] : offsets[i + 1]]) > 0).all() for i in range(300))


def test_a_tiny_horizon_in_a_large_body_takes_few_boxes():
    x = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [1.0 + 1e-9, 2.0, 3.0]])
    offsets, neighbours = find_families(x, np.full(3, 1e-8))
    assert offsets.tolist() == [0, 0, 1, 2] and neighbours.tolist() == [2, 1]


def test_moments_are_sums_of_monomials(cracked):
    x, body = cracked
    b, rng = body.bonds, np.random.default_rng(5)
    families = b.offsets, b.length, b.nx, b.ny, b.nz
    normal = np.column_stack([b.nx, b.ny, b.nz])
    even = np.prod(normal[:, None, :] ** np.array(moments3d.FOURTH), axis=2)
    odd = np.prod(normal[:, None, :] ** np.array(moments3d.THIRD), axis=2) / b.length[:, None]
    weight, values, out = rng.normal(size=b.length.size), rng.normal(size=b.length.size), np.empty((len(x), 25))
    moments3d.joint_moments(*families, weight, values, out)
    want = b.sum_by_node((weight * values)[:, None] * np.concatenate([even, odd], axis=1))
    assert np.abs(out - want).max() < 1e-12 * np.abs(want).max()
    y, change = rng.normal(size=(len(x), 25)), np.empty(b.length.size)
    moments3d.joint_correction(b.offsets, b.neighbours, *families[1:], y, change)
    i, j = b.owners(), b.neighbours
    want = ((y[i, :15] + y[j, :15]) * even).sum(axis=1) + ((y[i, 15:] - y[j, 15:]) * odd).sum(axis=1)
    assert np.abs(change - want).max() < 1e-12 * np.abs(want).max()
    # Both ends of a bond see the same change: measured exact.
    assert np.abs(change - change[b.reverse]).max() < 1e-14 * np.abs(change).max()


def test_the_short_stiffness_is_that_of_the_short_bonds(cracked):
    x, body = cracked
    b, n = body.bonds, len(x)
    free = np.random.default_rng(6).integers(0, 2, x.shape).astype(float)
    starts, column, value = body.short_stiffness(np.full(n, 0.7e-3), free)
    matrix = np.zeros((n, n, 3, 3))
    rows = np.repeat(np.arange(n), np.diff(starts))
    matrix[rows, column] = value
    short = b.length <= 1.4e-3
    stiff = b.weight * b.length
    scale = body.normal * stiff.sum() / stiff[short].sum()
    want = np.zeros((n, n, 3, 3))
    normal = np.column_stack([b.nx, b.ny, b.nz])
    for k in np.flatnonzero(short & body.intact):
        i, j = b.owners()[k], b.neighbours[k]
        part = scale * b.weight[k] / b.length[k] * np.outer(normal[k], normal[k])
        want[i, j] -= part
        want[i, i] += part
    want *= free[:, None, :, None] * free[None, :, None, :]
    own = np.arange(n)
    held = np.einsum("nncc->nc", want) == 0.0
    assert 0 < held.sum() < held.size
    for axis in range(3):  # fixed ones have an entry of the usual size
        typical = want[own, own, axis, axis].max()
        want[own[held[:, axis]], own[held[:, axis]], axis, axis] = typical
    assert np.abs(matrix - want).max() < 1e-12 * np.abs(want).max()


def test_the_diagonal_is_that_of_the_force():
    x, body = make_solid((4, 4, 4), nu=0.2)
    body.inverse[:] = 0.0  # rotations held
    diagonal = body.diagonal()
    for i, axis in ((0, 0), (21, 1), (42, 2)):
        u = np.zeros_like(x)
        u[i, axis] = 1.0
        assert diagonal[i, axis] == pytest.approx(-body.force(u)[i, axis], rel=1e-12)
    assert (body.stiffness_rows() >= diagonal).all()
