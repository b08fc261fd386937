"""What bonds, partial volumes and surface corrections must satisfy on any nodes."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from pdhe.bonds import build_bonds, partial_volume
from pdhe.corrections import volume_correction
from tests.lattices import THICKNESS, lattice

SPACING = 1e-3
PARTIAL, SURFACE = ("full", "ramp", "thesis"), ("none", "volume", "energy", "moment matched")
#: Turns by any angle, rad, and shifts by up to a hundred spacings, m.
angles, shifts = st.floats(0.0, 2.0 * np.pi), st.floats(-0.1, 0.1)


@st.composite
def bodies(draw):
    """Nodes of a displaced lattice that lost some of its nodes, with unequal volumes, and a horizon."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    x = lattice(draw(st.integers(2, 9)), draw(st.integers(2, 9)), SPACING)
    x += draw(st.sampled_from([0.0, 0.1, 0.3])) * SPACING * rng.uniform(-1, 1, x.shape)
    x = x[rng.uniform(size=len(x)) >= draw(st.sampled_from([0.0, 0.2]))]
    if len(x) < 2:
        x = lattice(2, 1, SPACING)
    volume = SPACING**2 * THICKNESS * rng.uniform(0.7, 1.4, len(x))
    return x, volume, draw(st.floats(1.1, 4.2)) * SPACING


def bonds_of(x, volume, horizon, partial="full", surface="none"):
    spacing = np.sqrt(volume / THICKNESS)
    return build_bonds(x, volume, spacing, THICKNESS, horizon, partial=partial, surface=surface, tangential_ratio=0.1)


@settings(max_examples=80, deadline=None)
@given(bodies())
def test_bond_vectors_and_lengths_are_those_of_the_nodes(body):
    x, volume, horizon = body
    b = bonds_of(x, volume, horizon)
    owner = b.owners()
    away = x[b.neighbours] - x[owner]
    # Norms and unit vectors from the same differences: round-off of a few digits.
    assert np.allclose(b.length, np.sqrt((away**2).sum(axis=1)), rtol=1e-14, atol=0.0)
    assert np.allclose(b.length[:, None] * np.column_stack([b.nx, b.ny]), away, rtol=0.0, atol=1e-14 * horizon)
    assert np.allclose(np.hypot(b.nx, b.ny), 1.0, rtol=1e-14)
    # From the far end the bond has the opposite direction, exactly, and the same length.
    assert np.array_equal(b.nx[b.reverse], -b.nx)
    assert np.array_equal(b.ny[b.reverse], -b.ny)
    assert np.array_equal(b.length[b.reverse], b.length)
    inside = cdist(x, x) <= horizon * (1.0 + 1e-9)
    assert b.length.size == inside.sum() - len(x)


@settings(max_examples=80, deadline=None)
@given(bodies(), st.sampled_from(PARTIAL), st.sampled_from(SURFACE))
def test_weights_are_symmetric_positive_and_bounded(body, partial, surface):
    x, volume, horizon = body
    b = bonds_of(x, volume, horizon, partial, surface)
    plain = volume[b.owners()] * volume[b.neighbours]
    # The same factors in another order: the last digit where volumes differ.
    assert np.allclose(b.weight, b.weight[b.reverse], rtol=1e-15, atol=0.0)
    assert np.all(b.weight > 0.0)
    if surface == "none":
        # Partial volumes are shares; products in another order differ by round-off.
        assert np.all(b.weight <= plain * (1.0 + 1e-14))


@settings(max_examples=60, deadline=None)
@given(bodies(), st.sampled_from(PARTIAL), st.sampled_from(("none", "volume")), angles, shifts, shifts)
def test_weights_do_not_depend_on_where_the_body_is(body, partial, surface, angle, along, across):
    """Not so for the two others: one measures along the axes, one confines what it finds, where families are poor."""
    x, volume, horizon = body
    there = x @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) + [along, across]
    here, moved = (bonds_of(place, volume, horizon, partial, surface) for place in (x, there))
    if here.length.size != moved.length.size:  # a bond as long as the horizon, to round-off
        return
    assert np.array_equal(here.neighbours, moved.neighbours)
    # Places up to 0.1 m are known to 1e-17 m. A bond at the far end of its ramp has next to no weight, known to 1e-14
    # of that of others: measured 1e-9 of its own.
    assert np.allclose(here.weight, moved.weight, rtol=1e-11, atol=1e-12 * here.weight.max(initial=0.0))


@settings(max_examples=60, deadline=None)
@given(st.floats(1.0, 6.0), st.floats(0.1, 2.0), st.sampled_from(PARTIAL))
def test_partial_volumes_fall_from_one_to_nothing(horizon, spacing, rule):
    length = np.linspace(0.01, horizon + spacing, 400)
    share = partial_volume(length, horizon, np.full(length.size, spacing), rule)
    assert np.all((share >= 0.0) & (share <= 1.0))
    assert np.all(np.diff(share) <= 0.0)
    inside, outside = length < horizon - 0.5 * spacing * (1 + 1e-9), length > horizon + 0.5 * spacing * (1 + 1e-9)
    assert np.all(share[inside] == 1.0)
    assert np.all(share[outside] == 0.0)
    if rule == "ramp":  # as much is gained outside as is lost inside
        centre = np.array([horizon - 0.2 * spacing, horizon, horizon + 0.2 * spacing])
        found = partial_volume(centre, horizon, np.full(3, spacing), rule)
        assert np.allclose(found, [0.7, 0.5, 0.3], rtol=0.0, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(bodies(), st.floats(0.1, 10.0))
def test_the_volume_correction_is_two_discs_over_two_families(body, factor):
    x, volume, horizon = body
    b = bonds_of(x, volume, horizon)
    owner = b.owners()
    if not b.length.size:
        return

    def correction(thickness, volumes):
        return volume_correction(b.offsets, owner, b.neighbours, volumes[b.neighbours], horizon, thickness)

    found = correction(THICKNESS, volume)
    assert np.allclose(found, found[b.reverse], rtol=1e-13)
    # A plate as many times as thick has as many times the volume: nothing changes.
    assert np.allclose(correction(factor * THICKNESS, factor * volume), found, rtol=1e-12)
    # Families with more nodes need less: the fullest pair of families has the smallest correction.
    family = np.add.reduceat(np.append(volume[b.neighbours], 0.0), b.offsets[:-1]) * (np.diff(b.offsets) > 0)
    both = family[owner] + family[b.neighbours]
    assert found[both.argmax()] == found.min()
