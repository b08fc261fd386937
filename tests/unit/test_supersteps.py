"""Long diffusion steps: order, bounds, balance, and what they save."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pdhe import solvers, supersteps
from pdhe.bonds import build_bonds
from pdhe.implicit import ImplicitStepper
from pdhe.supersteps import SuperStepper
from pdhe.transport import DiffusionStep, Edge, build_diffusion
from tests.lattices import THICKNESS, lattice

COLUMNS, ROWS, SPACING, DIFFUSIVITY = 24, 8, 1e-3, 1e-9


@pytest.fixture(scope="module")
def slab():
    return plate(COLUMNS, ROWS)


def plate(columns, rows):
    x = lattice(columns, rows, SPACING)
    volume, spacing = np.full(len(x), SPACING**2 * THICKNESS), np.full(len(x), SPACING)
    bonds = build_bonds(x, volume, spacing, THICKNESS, 3.015 * SPACING, surface="none")
    edges = {"left": Edge(0, 0.0), "right": Edge(0, columns * SPACING)}
    edges |= {"bottom": Edge(1, 0.0), "top": Edge(1, rows * SPACING)}
    return build_diffusion(bonds, x, volume, spacing, THICKNESS, DIFFUSIVITY, "inverse square", "full", edges, {"left"})


def short_steps(slab, psi, span, held, source):
    count = int(np.ceil(4 * span / slab.stable_step(held)))
    for _ in range(count):
        psi = DiffusionStep(slab, psi, span / count, held, source).coverage(1.0)
    return psi, DiffusionStep.sweeps * count


def test_second_order_in_time(slab):
    held, source = np.zeros(slab.volume.size, bool), slab.source({"left": 1.0})
    # A smooth start: short waves of a jump would be damped at their own, lower order.
    psi = short_steps(slab, np.zeros(slab.volume.size), 2e4, held, source)[0]
    span = 200 * slab.stable_step(held)
    exact, _ = short_steps(slab, psi, span, held, source)
    stepper, errors, counts = SuperStepper(slab, held, source), [], (8, 16, 32)
    for count in counts:
        here = psi
        for _ in range(count):
            here, _ = stepper.step(
                here, *stepper.rates(here), span / count, supersteps.stages_for(span / count / stepper.short)
            )
        errors.append(np.abs(here - exact).max())
    orders = np.diff(np.log(errors)) / np.diff(np.log(counts))
    assert errors[0] > 1e-7
    assert np.all((orders < -1.8) & (orders > -2.6)), orders


def test_accurate_at_a_fraction_of_the_sweeps(slab):
    held, source = np.zeros(slab.volume.size, bool), slab.source({"left": 1.0})
    span = 2000 * slab.stable_step(held)
    stepper = SuperStepper(slab, held, source)
    psi, supply, _ = stepper.advance(np.zeros(slab.volume.size), span, 0.0)
    exact, sweeps = short_steps(slab, np.zeros(slab.volume.size), span, held, source)
    assert psi.max() > 0.5
    assert np.abs(psi - exact).max() < 3 * supersteps.TOLERANCE  # measured 0.8 of it
    assert stepper.sweeps < sweeps / 20
    content = float(psi @ slab.volume)
    assert float(supply.sum()) == pytest.approx(content, rel=1e-13)  # measured 2e-15


@pytest.mark.parametrize("implicitly", [False, True])
def test_inside_a_long_step_the_coverage_is_as_accurate_as_at_its_end(slab, monkeypatch, implicitly):
    held, source = np.zeros(slab.volume.size, bool), slab.source({"left": 1.0})
    start, _ = short_steps(slab, np.zeros(slab.volume.size), 2e4, held, source)
    if implicitly:
        monkeypatch.setattr(supersteps, "STAGES_PER_ITERATION", 0.0)
        monkeypatch.setattr(supersteps, "BUILDING", 0.0)
    stepper, length = SuperStepper(slab, held, source), 20 * slab.stable_step(held)
    step = stepper.take(start, *stepper.rates(start), length, length)
    assert step.length == length and (stepper.iterations > 0) == implicitly
    assert np.abs(step.end - start).max() > 0.01
    for share in (0.0, 0.3, 0.7, 1.0):
        exact, _ = short_steps(slab, start, share * length, held, source) if share else (start, 0)
        # Measured at most 0.4 of the estimate.
        assert np.abs(step.coverage(share) - exact).max() <= step.error
        # What has entered is what has come, but for the share that the cubic of the coverage has of the error.
        change = float((step.coverage(share) - start) @ slab.volume)
        assert float(step.supply(share).sum()) == pytest.approx(change, rel=1e-10)
    assert step.coverage(1.0) == pytest.approx(step.end, abs=1e-15)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    edge=st.floats(0.0, 1.0),
    held_share=st.floats(0.0, 0.5),
    length=st.floats(1.0, 500.0),
)
def test_never_leaves_the_bounds_of_the_data(slab, seed, edge, held_share, length):
    rng = np.random.default_rng(seed)
    psi = rng.choice([0.0, 1.0, 0.3], slab.volume.size)
    held = rng.uniform(size=psi.size) < held_share
    source = slab.source({"left": edge})
    stepper = SuperStepper(slab, held, source)
    span = length * slab.stable_step(np.zeros(psi.size, bool))
    new, supply, _ = stepper.advance(psi, span, 0.0)
    low, high = min(psi.min(), edge), max(psi.max(), edge)
    assert low - 1e-11 <= new.min() and new.max() <= high + 1e-11
    assert np.all(new[held] == psi[held])
    change = float((new - psi) @ slab.volume)
    assert abs(float(supply.sum()) - change) <= 1e-12 * float(slab.volume.sum())


def test_a_uniform_field_takes_the_longest_steps(slab):
    held, source = np.zeros(slab.volume.size, bool), slab.source({"left": 1.0})
    stepper = SuperStepper(slab, held, source)
    psi, _, step = stepper.advance(np.ones(slab.volume.size), 2 * stepper.longest, stepper.longest)
    assert step >= stepper.longest
    # Measured 2e-15.
    assert np.abs(psi - 1.0).max() < 1e-13
    assert stepper.sweeps <= 2 * supersteps.MOST_STAGES + 1


def long_steps(slab, monkeypatch, psi, span, held, source):
    """A stepper that went on implicitly as soon as it would for nothing, and what it gives."""
    monkeypatch.setattr(supersteps, "STAGES_PER_ITERATION", 0.0)
    monkeypatch.setattr(supersteps, "BUILDING", 0.0)
    stepper = SuperStepper(slab, held, source)
    return stepper, *stepper.advance(psi, span, 0.0)[:2]


def test_implicit_steps_are_accurate_and_close_the_balance(slab, monkeypatch):
    held, source = np.zeros(slab.volume.size, bool), slab.source({"left": 1.0})
    held[slab.volume.size // 2 :][:5] = True
    start, span = np.zeros(slab.volume.size), 2000 * slab.stable_step(held)
    stepper, psi, supply = long_steps(slab, monkeypatch, start, span, held, source)
    exact, _ = short_steps(slab, start, span, held, source)
    assert stepper.iterations > 100
    assert psi.max() > 0.5
    assert np.abs(psi - exact).max() < 3 * supersteps.TOLERANCE  # measured 0.3 of it
    content = float(psi @ slab.volume)
    assert float(supply.sum()) == pytest.approx(content, rel=1e-12)  # measured 1e-13
    assert np.all(psi[held] == start[held])


def test_no_step_is_too_long_for_implicit_ones(slab, monkeypatch):
    """One step to rest; its length and the mesh hardly matter to the iterations."""
    held, source = np.zeros(slab.volume.size, bool), slab.source({"left": 0.4})
    psi = np.random.default_rng(0).uniform(size=held.size)
    stepper, counts = ImplicitStepper(slab, held, source), []
    for ratio in (1e3, 1e6, 1e9):
        before = stepper.iterations
        rate, _ = SuperStepper(slab, held, source).rates(psi)
        _, end = stepper.step(psi, rate, ratio * slab.stable_step(held))
        counts.append(stepper.iterations - before)
        assert np.abs(end - 0.4).max() < 0.6 * 500.0 / ratio
    assert max(counts) <= 60, counts  # measured 49, 55, 59


def test_a_cycle_may_stand_for_the_factor_of_the_coarse_operator(monkeypatch):
    slab = plate(120, 100)  # so many nodes that a cycle has two levels and is not exact
    held, source = np.zeros(slab.volume.size, bool), slab.source({"left": 0.4})
    psi, ends, counts = np.random.default_rng(0).uniform(size=held.size), [], []
    rate, _ = SuperStepper(slab, held, source).rates(psi)
    for largest in (solvers.FACTORISE_UP_TO, 0):
        monkeypatch.setattr(solvers, "FACTORISE_UP_TO", largest)
        stepper = ImplicitStepper(slab, held, source)
        ends.append(stepper.step(psi, rate, 1e4 * slab.stable_step(held))[1])
        counts.append(stepper.iterations)
    assert np.abs(ends[0] - ends[1]).max() < 1e-11  # measured 6e-15
    assert counts[0] < counts[1] <= counts[0] + 10  # measured 60 and 64


@pytest.mark.filterwarnings("error")
def test_implicit_steps_without_any_edge_keep_the_content(slab):
    """The equations stay regular where nothing leaves the plate; nodes without a free neighbour do no harm."""
    held, source = np.zeros(slab.volume.size, bool), np.zeros(slab.volume.size)
    sealed = replace(slab, exchange={})
    psi = np.random.default_rng(0).uniform(size=held.size)
    rate, _ = SuperStepper(sealed, held, source).rates(psi)
    _, end = ImplicitStepper(sealed, held, source).step(psi, rate, 1e6 * slab.stable_step(held))
    assert np.ptp(end) < 1e-3
    # Products are a million times larger than coverages: measured 7e-12.
    assert end.mean() == pytest.approx(psi.mean(), rel=1e-10)
    held[:] = True
    held[100] = False
    rate, _ = SuperStepper(sealed, held, source).rates(psi)
    _, end = ImplicitStepper(sealed, held, source).step(psi, rate, 1e6 * slab.stable_step(held))
    assert np.all(end[held] == psi[held])


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 10**6),
    edge=st.floats(0.0, 1.0),
    held_share=st.floats(0.0, 0.5),
    length=st.floats(1.0, 1e6),
)
def test_implicit_steps_never_leave_the_bounds_of_the_data(slab, monkeypatch, seed, edge, held_share, length):
    rng = np.random.default_rng(seed)
    psi = rng.choice([0.0, 1.0, 0.3], slab.volume.size)
    held = rng.uniform(size=psi.size) < held_share
    span = length * slab.stable_step(np.zeros(psi.size, bool))
    _, new, supply = long_steps(slab, monkeypatch, psi, span, held, slab.source({"left": edge}))
    low, high = min(psi.min(), edge), max(psi.max(), edge)
    assert low - 1e-11 <= new.min() and new.max() <= high + 1e-11
    assert np.all(new[held] == psi[held])
    change = float((new - psi) @ slab.volume)
    assert abs(float(supply.sum()) - change) <= 1e-10 * float(slab.volume.sum())
