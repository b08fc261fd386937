"""Diffusion up to the next failure: long steps while bonds may break, and the instant of a failure inside a step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from pdhe.case import Case
from pdhe.damage import Candidates
from pdhe.state import Motion, State
from pdhe.supersteps import TOLERANCE, LongStep, SuperStepper, growth_of, within
from pdhe.transport import DiffusionStep

#: Largest local error of a long step in the coverage of the bonds that could break, as a share of what the fastest of
#: them takes up in a plain stable step. Measured against a hundredth of it, failures of the notched plate move by 17 s
#: with a tip of 0.2 mm (27 s a plain step) and by 180 s on a lattice of 1 mm (790 s), plain steps by 4 s and 30 s; 1
#: instead of 0.1 moves them by 65 s and 430 s and saves a fifth of the sweeps. Failures are 5e3 to 2e5 s apart.
PACE = 0.1
#: That error is never asked to be less than this: a thousandth of what is allowed where nothing can break.
LEAST_TOLERANCE = 1e-3 * TOLERANCE
#: Shares of a long step at which bonds are looked at: in a plain one, its end is enough.
LOOKS = (0.25, 0.5, 0.75, 1.0)
#: How far a step goes beyond the failure expected inside it: less is found again, more is thrown away.
OVERSHOOT = 1.1
#: Bisection steps that locate a failure inside a step: far below any other error in time.
BISECTIONS = 40


def stride(case: Case, state: State, until: float, motion: Motion, candidates: Candidates) -> bool | None:
    """Take one long step while bonds may break but nothing prescribed changes, up to the first failure inside it.

    Its error is as small as where nothing can break, and for the candidates that of :data:`PACE`. Tells whether a bond
    fails; None, and nothing done, if plain steps serve better, as just after a jump of the coverage.
    """
    stepper, left = stepper_of(case, state), until - state.time
    if left < stepper.shortest:
        return None
    with work_booked(state, stepper):
        psi = state.coverage
        low, high = stepper.bounds(psi)
        rate, flux = stepper.rates(psi)
        pace = 0.5 * np.abs(rate[candidates.i] + rate[candidates.j]).max()
        allowed = max(PACE * pace * stepper.short, LEAST_TOLERANCE)
        length = max(state.long_step, stepper.shortest)
        while True:
            # Equal steps up to the target, so that no sliver of one is left at the end.
            length = left / min(math.ceil(left / length), math.floor(left / stepper.shortest))
            length = _before_failure(state, length, rate, motion, candidates)
            if length < stepper.shortest:
                return None
            step = stepper.take(psi, rate, flux, length, left)
            error = max(step.error / TOLERANCE, step.error_between(candidates.i, candidates.j) / allowed)
            length, growth = step.length, growth_of(error)
            if error > 1.0 or not within(step.end, low, high):
                state.long_step = length = length * min(0.5, max(0.2, growth))
                if length < stepper.shortest:
                    return None
                continue
            later = until if length >= left else state.time + length
            share = share_until_failure(step, motion, candidates, state.time, later, LOOKS)
            reached = 1.0 if share is None else share
            coverage = step.coverage(reached)
            if within(coverage, low, high):
                break
            # The cubic inside a step, unlike its end, may overshoot: a shorter one does so less.
            length *= reached
            if length < stepper.shortest:
                return None
    # A step that the end of the stretch cut off says nothing against longer ones.
    state.long_step = max(length * min(3.0, growth), state.long_step if length < state.long_step else 0.0)
    state.coverage = coverage
    state.supply += step.supply(reached)
    state.time = later if reached == 1.0 else state.time + reached * (later - state.time)
    return share is not None


def _before_failure(state: State, length: float, rate: np.ndarray, motion: Motion, candidates: Candidates) -> float:
    """Shorten a step to a little beyond the failure that the present rates lead to."""
    i, j = candidates.i, candidates.j
    start, change = 0.5 * (state.coverage[i] + state.coverage[j]), 0.5 * length * (rate[i] + rate[j])
    f0, f1 = _fractions(motion, state.time, state.time + length)

    def worst(share: float) -> float:
        psi = np.clip(start + share * change, 0.0, 1.0)
        return float(candidates.ratio_at(f0 + share * (f1 - f0), psi).max())

    return length if worst(1.0) < 1.0 else min(length, OVERSHOOT * first_crossing(worst) * length)


def stepper_of(case: Case, state: State) -> SuperStepper:
    """What takes long steps with the present nodes held and edges prescribed."""
    edges = {c.on: c.coverage(state.time) for c in case.scene.hydrogen.boundary if c.on in case.diffusion.exchange}
    source = case.diffusion.source(edges)
    if state.stepper is None or not state.stepper.fits(state.held, source):
        state.stepper = SuperStepper(case.diffusion, state.held.copy(), source)
    return state.stepper


@contextmanager
def work_booked(state: State, stepper: SuperStepper) -> Iterator[None]:
    """Count what a stepper does meanwhile."""
    sweeps, iterations = stepper.sweeps, stepper.iterations
    try:
        yield
    finally:
        state.diffusion_sweeps += stepper.sweeps - sweeps
        state.diffusion_iterations += stepper.iterations - iterations


def share_until_failure(
    step: DiffusionStep | LongStep,
    motion: Motion,
    candidates: Candidates,
    now: float,
    later: float,
    looks: tuple[float, ...] = (1.0,),
) -> float | None:
    """Share of a diffusion step after which the first candidate is critical; None if none is so at any of ``looks``."""
    f0, f1 = _fractions(motion, now, later)
    before = 0.0
    for look in looks:
        psi = 0.5 * (step.coverage(look, candidates.i) + step.coverage(look, candidates.j))
        there = candidates.ratio_at(f0 + look * (f1 - f0), psi)
        if there.max() >= 1.0:
            break
        before = look
    else:
        return None
    # Whichever is critical first is so at this look as well: the others need no second one.
    rows = np.flatnonzero(there >= 1.0)
    i, j = candidates.i[rows], candidates.j[rows]

    def worst(part: float) -> float:
        share = before + part * (look - before)
        psi = 0.5 * (step.coverage(share, i) + step.coverage(share, j))
        return float(candidates.ratio_at(f0 + share * (f1 - f0), psi, rows).max())

    return before + first_crossing(worst) * (look - before)


def _fractions(motion: Motion, now: float, later: float) -> tuple[float, float]:
    return (motion.fraction(now), motion.fraction(later)) if motion.moving else (0.0, 0.0)


def first_crossing(worst: Callable[[float], float]) -> float:
    """Share of a step at which ``worst`` reaches 1, from above: the returned point is critical."""
    if worst(0.0) >= 1.0:
        return 0.0
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if worst(middle) >= 1.0:
            high = middle
        else:
            low = middle
    return high
