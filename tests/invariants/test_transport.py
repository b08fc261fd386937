"""What hydrogen transport must satisfy on any nodes, with any kernel and any data."""

import numba
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pdhe.bonds import build_bonds
from pdhe.transport import KERNELS, Diffusion, DiffusionStep, Edge, build_diffusion
from tests.lattices import lattice

pytestmark = pytest.mark.usefixtures("one_thread")

SPACING, THICKNESS, DIFFUSIVITY = 1e-3, 4e-3, 0.84e-9
COLUMNS, ROWS = 11, 8
SIDES = ("left", "right", "bottom", "top")
PRESCRIBED = {
    "sealed": (),
    "one edge": ("left",),
    "opposite edges": ("left", "right"),
    "corner": ("left", "bottom"),
    "all edges": SIDES,
}
NODES = {"regular": ("full", 0.0), "regular, ramp": ("ramp", 0.0), "perturbed": ("ramp", 0.2)}


def make_diffusion(kernel: str, nodes: str = "regular", prescribed: str = "corner", m: float = 3.015) -> Diffusion:
    """Rates on a small rectangle, by the names of the tables above."""
    partial, perturb = NODES[nodes]
    rng = np.random.default_rng(0)
    coordinates = lattice(COLUMNS, ROWS, SPACING)
    coordinates += perturb * SPACING * rng.uniform(-1, 1, coordinates.shape)
    volume = SPACING**2 * THICKNESS * (1.0 + perturb * rng.uniform(-1, 1, len(coordinates)))
    spacing = np.sqrt(volume / THICKNESS)
    bonds = build_bonds(coordinates, volume, spacing, THICKNESS, m * SPACING, partial=partial, surface="none")
    places = (0, 0.0), (0, COLUMNS * SPACING), (1, 0.0), (1, ROWS * SPACING)
    edges = {name: Edge(*place) for name, place in zip(SIDES, places, strict=True)}
    return build_diffusion(
        bonds, coordinates, volume, spacing, THICKNESS, DIFFUSIVITY, kernel, partial, edges, set(PRESCRIBED[prescribed])
    )  # fmt: skip


def march(diffusion: Diffusion, psi, edge_values: dict[str, float], held, dt: float, steps: int):
    """Explicit steps: the coverage at the end, and what entered through each node, m^3."""
    psi, new, supply = psi.copy(), np.empty_like(psi), np.zeros_like(psi)
    source = diffusion.source(edge_values)
    for _ in range(steps):
        diffusion.step(psi, dt, held, source, new, supply)
        psi, new = new, psi
    return psi, supply


@pytest.fixture(params=KERNELS, ids=list(KERNELS))
def kernel(request):
    return request.param


@pytest.mark.parametrize("prescribed", PRESCRIBED)
@pytest.mark.parametrize("nodes", NODES)
def test_what_leaves_one_node_reaches_the_other(kernel, nodes, prescribed):
    diffusion = make_diffusion(kernel, nodes, prescribed)
    there = diffusion.rate * diffusion.volume[diffusion.bonds.owners()]
    back = there[diffusion.bonds.reverse]
    assert there.max() > 0.0
    # Both are the same product in another order: measured 4e-16.
    assert np.abs(there - back).max() < 1e-14 * there.max()


@pytest.mark.parametrize("prescribed", PRESCRIBED)
@pytest.mark.parametrize("nodes", NODES)
@pytest.mark.parametrize("m", [2.0, 3.015, 4.0, 5.0])
def test_no_rate_is_negative(kernel, nodes, prescribed, m):
    """Else the maximum principle is lost. Where two prescribed edges meet, odd images alone would give such rates."""
    diffusion = make_diffusion(kernel, nodes, prescribed, m)
    assert diffusion.rate.max() > 0.0
    assert diffusion.rate.min() >= 0.0
    assert all(rate.min() >= 0.0 and rate.max() > 0.0 for rate in diffusion.exchange.values())


@pytest.mark.parametrize("prescribed", PRESCRIBED)
@pytest.mark.parametrize("nodes", NODES)
def test_constant_coverage_stays_exactly(kernel, nodes, prescribed):
    diffusion = make_diffusion(kernel, nodes, prescribed)
    psi = np.full(COLUMNS * ROWS, 0.375)
    held = np.zeros(psi.size, bool)
    end, supply = march(diffusion, psi, dict.fromkeys(PRESCRIBED[prescribed], 0.375), held, 100.0, 20)
    # Differences between nodes vanish exactly. Source and sink of an edge are rounded one by one: measured 2e-15.
    if prescribed == "sealed":
        assert np.all(end == 0.375)
        assert np.all(supply == 0.0)
    assert np.abs(end - 0.375).max() < 1e-13


@pytest.mark.parametrize("prescribed", PRESCRIBED)
@pytest.mark.parametrize("nodes", NODES)
def test_content_changes_by_what_enters(kernel, nodes, prescribed):
    diffusion = make_diffusion(kernel, nodes, prescribed)
    rng = np.random.default_rng(1)
    psi, held = rng.uniform(size=COLUMNS * ROWS), rng.uniform(size=COLUMNS * ROWS) < 0.1
    values = {name: rng.uniform() for name in PRESCRIBED[prescribed]}
    end, supply = march(diffusion, psi, values, held, 0.5 * diffusion.stable_step(held), 200)
    change = diffusion.volume @ (end - psi)
    assert np.abs(end - psi).max() > 0.1
    assert np.abs(supply).sum() > 0.0
    # Round-off of 200 steps: measured 1e-14 of the content.
    assert abs(change - supply.sum()) < 1e-12 * diffusion.volume.sum()


@pytest.mark.parametrize("nodes", NODES)
def test_content_changes_by_what_enters_at_any_instant_of_a_step(kernel, nodes):
    diffusion = make_diffusion(kernel, nodes)
    rng = np.random.default_rng(3)
    psi, held = rng.uniform(size=COLUMNS * ROWS), rng.uniform(size=COLUMNS * ROWS) < 0.1
    source = diffusion.source({"left": 1.0, "bottom": 0.2})
    step = DiffusionStep(diffusion, psi, diffusion.stable_step(held), held, source)
    for share in (0.3, 1.0):
        change = diffusion.volume @ (step.coverage(share) - psi)
        assert np.abs(step.coverage(share) - psi).max() > 0.1
        # Round-off: measured 1e-16 of the content.
        assert abs(change - step.supply(share).sum()) < 1e-13 * diffusion.volume.sum()
    assert np.array_equal(step.coverage(1.0)[held], psi[held])


fraction = st.floats(0.0, 1.0, allow_subnormal=False)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_coverage_stays_within_the_data(data):
    kernel = data.draw(st.sampled_from(list(KERNELS)))
    nodes = data.draw(st.sampled_from(list(NODES)))
    prescribed = data.draw(st.sampled_from(list(PRESCRIBED)))
    diffusion = _cached(kernel, nodes, prescribed)
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    low, high = sorted((data.draw(fraction), data.draw(fraction)))
    # Mostly extreme values: smooth data would not reach the bounds.
    psi = np.where(rng.uniform(size=COLUMNS * ROWS) < 0.5, low, high)
    held = rng.uniform(size=psi.size) < data.draw(st.sampled_from([0.0, 0.1, 0.5]))
    values = {name: low + (high - low) * data.draw(fraction) for name in PRESCRIBED[prescribed]}
    steps = data.draw(st.integers(1, 30))
    dt = diffusion.stable_step(held) if not held.all() else 1.0
    end, _ = march(diffusion, psi, values, held, dt, steps)
    inside = DiffusionStep(diffusion, psi, dt, held, diffusion.source(values)).coverage(data.draw(fraction))
    # A convex combination per step and at any instant inside one, but for the rounding of its terms.
    for found in (end, inside):
        assert found.min() >= low - 1e-13
        assert found.max() <= high + 1e-13


_BUILT: dict[tuple[str, str, str], Diffusion] = {}


def _cached(*names: str) -> Diffusion:
    if names not in _BUILT:
        _BUILT[names] = make_diffusion(*names)
    return _BUILT[names]


def test_threads_do_not_matter(kernel):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("only one thread in this process")
    diffusion = make_diffusion(kernel)
    psi, held = np.random.default_rng(2).uniform(size=COLUMNS * ROWS), np.zeros(COLUMNS * ROWS, bool)
    ends = []
    for threads in (1, numba.config.NUMBA_NUM_THREADS):
        numba.set_num_threads(threads)
        ends.append(march(diffusion, psi, {"left": 1.0, "bottom": 0.5}, held, 100.0, 50))
    # Every node gathers its own sum, in one order: the same to the last bit.
    assert all(np.array_equal(a, b) for a, b in zip(*ends, strict=True))


def test_held_nodes_do_not_limit_the_step(kernel):
    diffusion = make_diffusion(kernel)
    free, held = np.zeros(COLUMNS * ROWS, bool), np.ones(COLUMNS * ROWS, bool)
    assert np.isinf(diffusion.stable_step(held))
    held[0] = False
    assert diffusion.stable_step(free) <= diffusion.stable_step(held) < np.inf
