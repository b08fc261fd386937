"""The moves of a run: displacements between load corners, hydrogen up to the next failure, rounds of bond failures."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pdhe.case import Case
from pdhe.damage import Candidates
from pdhe.errors import SimulationError
from pdhe.results import Recorder
from pdhe.state import Motion, State
from pdhe.strides import first_crossing, share_until_failure, stepper_of, stride, work_booked
from pdhe.supersteps import SHORTEST
from pdhe.transport import STEP_SAFETY, DiffusionStep

#: How far below 1 a ratio counts as critical all the same. The instant of a failure is a double: loads at it may come
#: out smaller by round-off (found 2e-16) than in the search for it. A bond that then held would be found for ever.
ROUND_OFF = 1e-9
#: Largest second-order term, relative to the first-order one, of the coverage of the bonds that could break, in one
#: step. The scheme is of second order, so its own error is the next, smaller term. Measured at 2.5 mm against 0.01: 0.1
#: leaves the fast scene's crack within 0.3 mm of 140 mm (without the limit: 5 mm) and costs the slow scene 7 % more
#: sweeps.
CURVATURE = 0.1
#: Share of the stable diffusion step below which none gets anywhere. The smallest that :data:`CURVATURE` asked for was
#: 5e-4 in ``mode_i_fast`` at 5 mm, and 0.02 to 0.4 in five other runs of the scenes in ``config/scenes``.
FLOOR = 1e-9


def start_motion(case: Case, state: State, until: float, guess: np.ndarray | None = None) -> Motion:
    """Find the displacements at the end of a stretch over which the prescribed values are linear.

    Solves nothing if they do not change.
    """
    u0, force0 = state.displacement, state.force
    if not case.conditions.changes(state.time, until):
        return Motion(state.time, until, u0, u0, force0, force0)
    target = case.conditions.values(until)
    if guess is None:
        guess = _proportional(u0, case, state.time, target) if case.linear else u0
    reference = case.equilibrium.reference
    u1, force1 = case.equilibrium.solve(guess, target)
    if case.linear:
        # The end is where loads lead if nothing breaks before: its forces count for residuals once they are there.
        case.equilibrium.reference = reference
    return Motion(state.time, until, u0, u1, force0, force1)


def _proportional(u: np.ndarray, case: Case, t: float, target: np.ndarray) -> np.ndarray:
    """Scale the present displacements by how far the prescribed values grow: exact under proportional load."""
    now = case.conditions.values(t)
    size = float(np.vdot(now, now))
    return u * (float(np.vdot(now, target)) / size) if size > 0.0 else u


def move_to(case: Case, state: State, motion: Motion, t: float) -> None:
    """Take the displacements of the motion at time t, and book the work that the prescribed ones did."""
    u, force = motion.at(t)
    fixed = case.conditions.fixed
    mean = -0.5 * (force[fixed] + state.force[fixed])
    work = float(np.sum(mean * (u[fixed] - state.displacement[fixed])))
    state.external_work += case.copies * work
    state.displacement, state.force = u, force
    if case.linear:
        case.equilibrium.meet(force)


def hold_prescribed_coverage(case: Case, state: State) -> None:
    """Set the coverage of node sets with a prescribed value, and of saturated nodes, to that of the present time."""
    hydrogen = case.scene.hydrogen
    for condition in hydrogen.boundary:
        if condition.on not in case.diffusion.exchange:
            nodes = case.discretization.node_sets[condition.on]
            _set_coverage(case, state, nodes, condition.coverage(state.time))
    if hydrogen.saturation is not None:
        _set_coverage(case, state, np.flatnonzero(state.saturated), hydrogen.saturation.coverage)


def _set_coverage(case: Case, state: State, nodes: np.ndarray, value: float) -> None:
    state.supply[nodes] += (value - state.coverage[nodes]) * case.discretization.volume[nodes]
    state.coverage[nodes] = value
    state.held[nodes] = True


def saturate_broken(case: Case, state: State) -> None:
    """Hold nodes whose damage exceeds the threshold at saturation: fresh crack faces meet the environment."""
    rule = case.scene.hydrogen.saturation if case.scene.hydrogen else None
    if rule is None or case.body is None:
        return
    fresh = (case.body.damage() > rule.damage) & ~state.held
    state.saturated |= fresh
    _set_coverage(case, state, np.flatnonzero(fresh), rule.coverage)


def advance(
    case: Case,
    state: State,
    until: float,
    motion: Motion | None,
    candidates: Candidates | None,
    between: Callable[[], None] = lambda: None,
) -> bool:
    """Go on in time until ``until`` or the first failure, whichever comes first; tell whether a bond fails.

    With hydrogen, second-order steps at the diffusion's own stable length; each gives the coverage at any instant
    inside it, so that the failure is found there by bisection. Without hydrogen, the first crossing along the motion.
    After each step but the last, ``between`` is called: this function goes on from there if it is called anew with the
    same arguments.

    Raises
    ------
    SimulationError
        If the coverage is not finite, or no step is short enough.
    """
    if candidates is not None and candidates.bond.size == 0:
        candidates = None
    if case.diffusion is None:
        if candidates is not None and motion.moving:
            start, end = motion.fraction(state.time), motion.fraction(until)
            if candidates.ratio(end, None).max() >= 1.0:
                share = first_crossing(lambda x: candidates.ratio(start + x * (end - start), None).max())
                state.time += share * (until - state.time)
                return True
        state.time = until
        return False
    state.began = state.time if state.began is None else state.began
    failed = _diffuse_until(case, state, until, motion, candidates, between)
    state.began = state.allowed = state.resume = None
    return failed


def _diffuse_until(
    case: Case,
    state: State,
    until: float,
    motion: Motion | None,
    candidates: Candidates | None,
    between: Callable[[], None],
) -> bool:
    diffusion, hydrogen = case.diffusion, case.scene.hydrogen
    edges = [c for c in hydrogen.boundary if c.on in diffusion.exchange]
    # Histories have no corner before `until`: equal at both ends, they are constant.
    steady = all(c.coverage(state.began) == c.coverage(until) for c in hydrogen.boundary)
    if candidates is not None and motion.moving:
        # Loads are convex in time: below the least resistance at both ends, below it in between.
        ends = candidates.load(motion.fraction(state.began)), candidates.load(motion.fraction(until))
        if (np.maximum(*ends) < candidates.rule.weakest_of(candidates.bond)).all():
            candidates = None
    if steady and candidates is None:
        _diffuse_far(case, state, until, between)
    limit = STEP_SAFETY * diffusion.stable_step(state.held)
    if state.allowed is None:
        state.allowed, state.resume = limit, state.time
    while state.time < until:
        if steady and candidates is not None and state.time >= state.resume:
            failed = stride(case, state, until, motion, candidates)
            if failed:
                return True
            if failed is not None:
                if state.time < until:
                    between()
                continue
            # How long a step may be grows in proportion to the time since the last jump of the coverage.
            later = SHORTEST * limit * min(max(SHORTEST * limit / max(state.long_step, 1e-300), 1.0), 5.0)
            state.resume = state.time + later
        now, left, allowed = state.time, until - state.time, state.allowed
        # Equal steps up to the target, so that no sliver of a step is left at the end.
        later = until if left <= allowed else now + left / math.ceil(left / max(allowed, FLOOR * limit))
        if allowed < FLOOR * limit or later <= now:
            raise SimulationError(
                f"the diffusion step has shrunk to {allowed:.3g} s, below the floor of {FLOOR:g} of the stable one "
                f"({limit:.3g} s) or the digits of the time; likely reason: the coverage of a bond that may break jumps"
            )
        source = diffusion.source({c.on: c.coverage(0.5 * (now + later)) for c in edges})
        step = DiffusionStep(diffusion, state.coverage, later - now, state.held, source)
        state.diffusion_sweeps += step.sweeps
        if not math.isfinite(float(step.slope.sum() + step.bend.sum())):
            node = int(np.flatnonzero(~np.isfinite(step.slope + step.bend))[:1].sum())
            raise SimulationError(
                f"the coverage of node {node} is not finite after a step of {later - now:.3g} s", node
            )
        if steady and step.settled:
            step.at_rest((until - now) / (later - now))
            later = until
        share = None
        if candidates is not None:
            curvature = step.curvature_at(candidates.i, candidates.j)
            state.allowed = min(limit, (later - now) * min(2.0, CURVATURE / max(curvature, 1e-300)))
            if curvature > 1.5 * CURVATURE:
                continue
            share = share_until_failure(step, motion, candidates, now, later)
        reached = 1.0 if share is None else share
        state.coverage = step.coverage(reached)
        state.supply += step.supply(reached)
        state.time = later if reached == 1.0 else now + reached * (later - now)
        if not steady:
            hold_prescribed_coverage(case, state)
        if share is not None:
            return True
        if state.time < until:
            between()
    return False


def _diffuse_far(case: Case, state: State, until: float, between: Callable[[], None]) -> None:
    """Go on with long steps while they pay: nothing can break, and nothing prescribed changes."""
    stepper = stepper_of(case, state)
    span = until - state.time
    if state.far is not None:
        stretch = stepper.go_on_from(state.coverage, state.far)
    elif span < stepper.shortest:
        return
    else:
        with work_booked(state, stepper):
            stretch = stepper.begin(state.coverage, span, state.long_step)
    while stretch.left > 0.0:
        with work_booked(state, stepper):
            state.supply += stepper.go_on(stretch)
        state.coverage, state.long_step, state.far = stretch.psi, stretch.step, stretch.memory()
        state.time = max(state.time, until - stretch.left)
        if stretch.left > 0.0:
            between()
    state.time, state.far = until, None


def substep(case: Case, state: State, until: float) -> None:
    """One forward Euler step up to ``until``, as fixed stepping asks for."""
    diffusion = case.diffusion
    edges = [c for c in case.scene.hydrogen.boundary if c.on in diffusion.exchange]
    source = diffusion.source({c.on: c.coverage(state.time) for c in edges})
    new = np.empty_like(state.coverage)
    diffusion.step(state.coverage, until - state.time, state.held, source, new, state.supply)
    state.coverage, state.time = new, until
    state.diffusion_sweeps += 1
    hold_prescribed_coverage(case, state)


def fail_until_stable(
    case: Case,
    state: State,
    candidates: Candidates,
    fraction: float,
    recorder: Recorder,
    between: Callable[[], None] | None = None,
) -> None:
    """Break critical bonds and restore equilibrium, round after round at a fixed time, until no bond is critical.

    In a round every critical bond breaks whose load over resistance is within ``grouping`` of the largest; one short of
    critical by no more than :attr:`FailureRule.together` counts. After each, ``between`` is called.
    """
    together = case.rule.together
    grouping = max(case.scene.stepping.grouping or 0.0, together)
    prescribed = case.conditions.values(state.time)
    while candidates.bond.size:
        ratio = candidates.ratio(fraction, state.coverage)
        worst = ratio.max()
        if worst < 1.0 - ROUND_OFF:
            break
        if not math.isfinite(worst):
            k = int(np.flatnonzero(~np.isfinite(ratio))[0])
            i, j = int(candidates.i[k]), int(candidates.j[k])
            raise SimulationError(f"the load of the bond of nodes {i} and {j} is not finite", i)
        chosen = ratio >= max(1.0 - together, (1.0 - grouping) * worst)
        break_bonds(case, state, candidates, chosen, fraction, recorder)
        state.displacement, state.force = case.equilibrium.solve(state.displacement, prescribed)
        saturate_broken(case, state)
        u = state.displacement
        candidates, fraction = Candidates(case.body, case.rule, u, u, state.coverage), 0.0
        state.failure_rounds += 1
        if between is not None:
            between()


def break_bonds(case: Case, state: State, candidates: Candidates, chosen, fraction: float, recorder: Recorder) -> None:
    """Break the chosen candidates and book their energy and how far the crack has come."""
    body, i, j = case.body, candidates.i[chosen], candidates.j[chosen]
    bond = candidates.bond[chosen]
    counted = np.broadcast_to(body.bonds.counted(bond), bond.shape)
    state.fracture_energy += float(np.sum(counted * candidates.energy(fraction)[chosen]))
    body.break_bonds(bond)
    note_broken(case, state, bond, i, j, recorder)


def note_broken(case: Case, state: State, bond: np.ndarray, i: np.ndarray, j: np.ndarray, recorder: Recorder) -> None:
    """Book bonds that broke just now, directed ones with their ends, and how far the crack has come."""
    counted = np.broadcast_to(case.bonds.counted(bond), bond.shape)
    state.broken_bonds += round(float(counted.sum()))
    recorder.broke(i, case.bonds.numbered(bond), state.time)
    d = case.discretization
    short = case.bonds.length[bond] <= 1.5 * 0.5 * (d.spacing[i] + d.spacing[j])
    if short.any() and case.scene.geometry.cracks:
        middle = case.bonds.middles(d.coordinates, i[short], bond[short])
        away = case.from_cracks(middle)
        if away.max() > state.crack_extension:
            state.crack_extension = float(away.max())
            state.crack_tip = middle[int(away.argmax())]
