"""The moves of a run: displacements between load corners, hydrogen up to the next failure, rounds of bond failures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdhe.case import EDGES, Case
from pdhe.damage import Candidates
from pdhe.results import Recorder
from pdhe.state import State
from pdhe.transport import STEP_SAFETY

#: Bonds this close to the most critical one break with it. Mirror-image bonds differ by the solver's tolerance only; the
#: margin keeps a symmetric scene symmetric, and moves a failure by less than this in resistance.
TOGETHER = 1e-4
#: Bisection steps that locate a failure inside a step: far below any other error in time.
BISECTIONS = 40


@dataclass
class Motion:
    """Displacements between two times under prescribed values that are linear in between: linear too, while nothing breaks."""

    t0: float
    t1: float
    u0: np.ndarray
    u1: np.ndarray
    force0: np.ndarray
    force1: np.ndarray

    def fraction(self, t: float) -> float:
        """Share of the way from ``t0`` to ``t1`` at time t."""
        return 1.0 if self.t1 <= self.t0 else min(max((t - self.t0) / (self.t1 - self.t0), 0.0), 1.0)

    @property
    def moving(self) -> bool:
        """Whether the displacements change at all."""
        return self.u1 is not self.u0

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Displacements and forces at time t."""
        if not self.moving:
            return self.u0, self.force0
        f = self.fraction(t)
        return self.u0 + f * (self.u1 - self.u0), self.force0 + f * (self.force1 - self.force0)


def start_motion(case: Case, state: State, until: float, guess: np.ndarray | None = None) -> Motion:
    """Find the displacements at the end of a stretch over which the prescribed values are linear.

    Solves nothing if they do not change.
    """
    u0, force0 = state.displacement, state.force
    if not case.conditions.changes(state.time, until):
        return Motion(state.time, until, u0, u0, force0, force0)
    target = case.conditions.values(until)
    u1, force1 = case.equilibrium.solve(_proportional(u0, case, state.time, target) if guess is None else guess, target)
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
    state.external_work += float(np.sum(mean * (u[fixed] - state.displacement[fixed])))
    state.displacement, state.force = u, force


def hold_prescribed_coverage(case: Case, state: State) -> None:
    """Set the coverage of node sets with a prescribed value, and of saturated nodes, to what it is at the present time."""
    hydrogen = case.scene.hydrogen
    for condition in hydrogen.boundary:
        if condition.on not in EDGES:
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


def advance(case: Case, state: State, until: float, motion: Motion | None, candidates: Candidates | None) -> bool:
    """Go on in time until ``until`` or the first failure, whichever comes first; tell whether a bond fails.

    With hydrogen, explicit steps at the diffusion's own stable length; within the step in which a candidate reaches its
    resistance, the coverage is linear in time (that is what a forward Euler step is), so the instant is found by
    bisection. Without hydrogen, the first crossing along the motion.
    """
    if candidates is not None and candidates.bond.size == 0:
        candidates = None
    if case.diffusion is None:
        if candidates is not None and motion.moving:
            start, end = motion.fraction(state.time), motion.fraction(until)
            if candidates.ratio(end, None).max() >= 1.0:
                share = _first_crossing(lambda x: candidates.ratio(start + x * (end - start), None).max())
                state.time += share * (until - state.time)
                return True
        state.time = until
        return False
    return _diffuse_until(case, state, until, motion, candidates)


def _diffuse_until(case, state, until, motion, candidates) -> bool:
    diffusion, hydrogen = case.diffusion, case.scene.hydrogen
    edges = [c for c in hydrogen.boundary if c.on in EDGES]
    span = until - state.time
    steps = max(1, int(np.ceil(span / (STEP_SAFETY * diffusion.stable_step(state.held)))))
    dt, begin = span / steps, state.time
    steady = not any(len(set(c.coverage.values)) > 1 for c in hydrogen.boundary)
    new = np.empty_like(state.coverage)
    for step in range(1, steps + 1):
        now = state.time
        later = until if step == steps else begin + step * dt
        source = diffusion.source({c.on: c.coverage(0.5 * (now + later)) for c in edges})

        def sweep(length: float, source=source) -> None:
            state.diffusion_sweeps += 1
            diffusion.step(state.coverage, length, state.held, source, new, state.supply)

        sweep(later - now)
        if candidates is not None:
            f0, f1 = (motion.fraction(now), motion.fraction(later)) if motion.moving else (0.0, 0.0)
            old = state.coverage
            if candidates.ratio(f1, new).max() >= 1.0:

                def worst(x: float, old=old, f0=f0, f1=f1) -> float:
                    return candidates.ratio(f0 + x * (f1 - f0), old + x * (new - old)).max()

                share = _first_crossing(worst)
                if share < 1.0:
                    reached = old + share * (new - old)
                    sweep((share - 1.0) * (later - now))  # takes back what entered after the failure
                    new[:] = reached
                state.coverage, new = new, state.coverage
                state.time = now + share * (later - now)
                hold_prescribed_coverage(case, state)
                return True
        settled = steady and not motion_moves(motion) and np.array_equal(new, state.coverage)
        state.coverage, new = new, state.coverage
        state.time = later
        if not steady:
            hold_prescribed_coverage(case, state)
        if settled:
            state.time = until
            break
    return False


def motion_moves(motion: Motion | None) -> bool:
    """Whether there is a motion, and it moves."""
    return motion is not None and motion.moving


def _first_crossing(worst) -> float:
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


def fail_until_stable(case: Case, state: State, candidates: Candidates, fraction: float, recorder: Recorder) -> int:
    """Break critical bonds and restore equilibrium, round after round at a fixed time, until no bond is critical.

    In a round every critical bond breaks whose load over resistance is within ``grouping`` of the largest. Returns the
    number of rounds.
    """
    grouping = case.scene.stepping.grouping or 0.0
    prescribed = case.conditions.values(state.time)
    rounds = 0
    while candidates.bond.size:
        ratio = candidates.ratio(fraction, state.coverage)
        worst = ratio.max()
        if worst < 1.0:
            break
        chosen = ratio >= max(1.0 - TOGETHER, (1.0 - max(grouping, TOGETHER)) * worst)
        break_bonds(case, state, candidates, chosen, fraction, recorder)
        state.displacement, state.force = case.equilibrium.solve(state.displacement, prescribed)
        saturate_broken(case, state)
        candidates, fraction = Candidates(case.body, case.rule, state.displacement, state.displacement), 0.0
        rounds += 1
    state.failure_rounds += rounds
    return rounds


def break_bonds(case: Case, state: State, candidates: Candidates, chosen, fraction: float, recorder: Recorder) -> None:
    """Break the chosen candidates and book their energy and how far the crack has come."""
    body, i, j = case.body, candidates.i[chosen], candidates.j[chosen]
    bond = candidates.bond[chosen]
    state.fracture_energy += float(np.sum(candidates.energy(fraction)[chosen]))
    body.break_bonds(bond)
    state.broken_bonds += bond.size
    recorder.broke(i, j, state.time)
    d = case.discretization
    short = body.bonds.length[bond] <= 1.5 * 0.5 * (d.spacing[i] + d.spacing[j])
    if short.any() and case.scene.geometry.cracks:
        middle = 0.5 * (d.coordinates[i[short]] + d.coordinates[j[short]])
        away = np.min([distance_to_segment(middle, c.start, c.end) for c in case.scene.geometry.cracks], axis=0)
        if away.max() > state.crack_extension:
            state.crack_extension = float(away.max())
            state.crack_tip = middle[int(away.argmax())]


def distance_to_segment(points: np.ndarray, start, end) -> np.ndarray:
    """Distance of points (k, 2) from a segment, m (k,)."""
    start, along = np.asarray(start), np.subtract(end, start)
    t = np.clip((points - start) @ along / float(along @ along), 0.0, 1.0)
    return np.hypot(*(points - (start + t[:, None] * along)).T)
