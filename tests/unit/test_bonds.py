"""Families, weights and cuts."""

import numpy as np
import pytest

from pdhe.bonds import build_bonds, partial_volume
from pdhe.errors import PdheError
from pdhe.segments import crossed_by
from tests.lattices import THICKNESS, lattice, make_body


def brute_force(x, reach):
    distance = np.hypot(*(x[:, None] - x[None]).transpose(2, 0, 1))
    return [np.flatnonzero((row <= reach) & (np.arange(len(x)) != i)) for i, row in enumerate(distance)]


@pytest.mark.parametrize("seed", range(5))
def test_families_equal_brute_force(seed):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 0.05, (rng.integers(2, 200), 2))
    b = build_bonds(x, np.ones(len(x)), np.full(len(x), 1e-3), THICKNESS, 6e-3, surface="none")
    for i, expected in enumerate(brute_force(x, 6e-3 * (1 + 1e-9))):
        assert np.array_equal(b.neighbours[b.offsets[i] : b.offsets[i + 1]], expected)
    owner = b.owners()
    assert np.array_equal(b.neighbours[b.reverse], owner)
    assert np.array_equal(owner[b.reverse], b.neighbours)


def test_interior_family_has_28_nodes_at_three_spacings():
    _, body = make_body(9, 9)
    assert np.diff(body.bonds.offsets)[40] == 28


def test_weights_are_symmetric():
    _, body = make_body(16, 16, perturb=0.15)
    b = body.bonds
    assert np.array_equal(b.weight, b.weight[b.reverse])


def test_moments_of_an_interior_node_are_those_of_a_full_disc():
    _, body = make_body(16, 16)
    b, interior = body.bonds, 8 * 16 + 8
    moments = b.sum_by_node(np.column_stack([b.weight * b.length * b.nx**4, b.weight * b.length * b.nx**2 * b.ny**2]))
    full = THICKNESS * 2 * np.pi * b.horizon**3 / 3 * np.array([3 / 8, 1 / 8]) * body.volume[0]
    # On a lattice all interior nodes are alike, so that averaging over the two ends changes nothing: round-off.
    assert moments[interior] == pytest.approx(full, rel=1e-12)


def test_partial_volume_rules():
    r = np.array([2.0, 2.6, 3.0, 3.2, 3.6])
    assert partial_volume(r, 3.0, np.ones(5), "full").tolist() == [1, 1, 1, 0, 0]
    assert partial_volume(r, 3.0, np.ones(5), "ramp") == pytest.approx([1, 0.9, 0.5, 0.3, 0])
    assert partial_volume(r, 3.0, np.ones(5), "thesis") == pytest.approx([1, 0.9, 0.5, 0, 0])


@pytest.mark.parametrize(
    ("start", "end", "cut"),
    [
        ((0, -1), (0, 1), True),
        ((0, -1), (2, 1), False),  # passes through the tip at (1, 0)
        ((0, -1), (1, 0), False),  # ends on the tip
        ((2, -1), (2, 1), False),  # ahead of the tip
        ((0, 1), (1, 2), False),  # all on one side
        ((-0.5, 0), (0.5, -1), True),  # a node on the crack counts as left of it
        ((-0.5, 0), (0.5, 1), False),
        ((-0.5, 0), (0.5, 0), False),  # both on the crack
    ],
)
def test_cuts_by_one_crack(start, end, cut):
    crack = ((-1.0, 0.0), (1.0, 0.0))
    one = crossed_by(np.array([start], float), np.array([end], float), [crack])
    other = crossed_by(np.array([end], float), np.array([start], float), [crack])
    assert one[0] == cut == other[0]


def test_a_bond_through_the_joint_of_two_cracks_is_cut():
    joined = [((-1.0, 0.0), (0.0, 0.0)), ((0.0, 0.0), (1.0, 0.5))]
    assert crossed_by(np.array([[0.1, -1.0]]), np.array([[-0.1, 1.0]]), joined)[0]
    assert not crossed_by(np.array([[0.1, -1.0]]), np.array([[-0.1, 1.0]]), joined[:1])[0]


@pytest.mark.parametrize("angle", [0, 17, 45, 90, 133])
def test_a_crack_through_the_whole_plate_separates_it(angle):
    x = lattice(20, 20)
    way = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))]) * 0.1
    centre = x.mean(axis=0) + 1e-5
    b = build_bonds(
        x, np.ones(len(x)), np.full(len(x), 1e-3), THICKNESS, 3.015e-3, cracks=[(centre - way, centre + way)]
    )
    side = (x - centre) @ [-way[1], way[0]] > 0
    assert np.array_equal(b.cut, side[b.owners()] != side[b.neighbours])


def test_coinciding_nodes_are_refused():
    x = lattice(4, 4)
    x[5] = x[6]
    with pytest.raises(PdheError, match="nodes 5 and 6 coincide"):
        build_bonds(x, np.ones(16), np.full(16, 1e-3), THICKNESS, 3e-3)


@pytest.mark.parametrize("surface", ["moment matched", "volume", "energy", "none"])
@pytest.mark.parametrize(("columns", "rows"), [(1, 1), (1, 7), (2, 2)])
def test_tiny_bodies_have_finite_weights(surface, columns, rows):
    x = lattice(columns, rows)
    b = build_bonds(x, np.ones(len(x)), np.full(len(x), 1e-3), THICKNESS, 3e-3, surface=surface)
    assert np.all(np.isfinite(b.weight))
    assert np.all(b.weight > 0)


def test_round_off_does_not_decide_on_neighbours():
    # The ramp of a horizon of 1.5 spacings ends at 2: nodes there have no weight, whatever the digits of their places.
    for shift in (0.0, 0.0123, 0.71):
        x = lattice(9, 9) + shift
        n = len(x)
        bonds = build_bonds(x, np.ones(n), np.full(n, 1e-3), THICKNESS, 1.5e-3, partial="ramp", surface="none")
        assert set(np.diff(bonds.offsets).reshape(9, 9)[2:-2, 2:-2].ravel()) == {8}
