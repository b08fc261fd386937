"""The loop: staggered mechanics and hydrogen in physical time, from one event to the next."""

from __future__ import annotations

import contextlib
import json
import tempfile
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe import advance as moves
from pdhe.case import Case, build_case
from pdhe.checkpoint import Keeper, Run, identity
from pdhe.damage import Candidates, nearest_failure
from pdhe.discretization import Discretization, discretize
from pdhe.errors import PdheError, SimulationError
from pdhe.forecast import Pilot, check_memory, longer, make_forecast, pilot_scene
from pdhe.histories import energies, node_fields, units_of
from pdhe.kernels import threads_for
from pdhe.mesh import make_mesh
from pdhe.plan import make_plan
from pdhe.provenance import digest, fingerprint, machine, versions
from pdhe.results import CHECKPOINT, INCOMPLETE, Contents, Recorder
from pdhe.scene import Scene
from pdhe.solvers import INDEFINITE
from pdhe.stability import NEGATIVE, least_eigenvalue
from pdhe.state import State
from pdhe.wholefile import check_place

if TYPE_CHECKING:
    import xarray as xr

#: A crack that advances further than this many horizons at one instant is reported as running away.
RUNAWAY = 2.0
#: Conjugate gradients with fewer iterations than this may be cut short: 10 to 16 are usual for a whole plate, whatever
#: the mesh, more as it comes apart.
FEW = 100
#: Share of broken bonds from which a node that is not in equilibrium is suspected of hanging loosely.
LOOSE = 0.5
#: Nodes from which a job flies a pilot before it starts: it takes about a second, the run minutes.
PILOT_FROM = 50_000

#: Steps with inertia between two points at which a checkpoint can be taken.
SAFE_EVERY = 50

Progress = Callable[[str], None]
Remarks = Callable[[Contents], Mapping[str, Any]]


def solve_case(
    scene: Scene,
    discretization: Discretization,
    path: str | Path,
    progress: Progress | None = None,
    command: str = "",
    remarks: Remarks | None = None,
) -> None:
    """Run a scene and write its result file, which says what made it.

    While it runs, checkpoints are kept beside the result (:mod:`pdhe.checkpoint`); if there is one of this scene, these
    nodes and this code, the run goes on from there. ``command`` is the one that was given, ``remarks`` are further
    attributes of the file, given what the run came to.

    Raises
    ------
    SceneError, SimulationError
        If the scene cannot be run on this mesh, or the run cannot go on.
    OSError
        If the result cannot be written, which is tried before anything is computed.
    Interrupted
        After SIGTERM or SIGINT, if this is the main thread.
    """
    path, log = Path(path), progress or _silent
    check_place(path)
    keeper = Keeper(checkpoint_of(path), identity(scene.resolved(), discretization), log)
    if tight := check_memory(scene, discretization.volume.size):
        log(tight)
    case = build_case(scene, discretization)
    pilot = fly_pilot(scene, discretization.volume.size) if discretization.volume.size >= PILOT_FROM else None
    expected = make_forecast(case, pilot)
    plan = make_plan(case, pilot, expected)
    with keeper.listening():
        log(plan)
        if pilot is not None:
            # Not part of the plan that the result keeps: it depends on the machine.
            log(f"expected time: {expected.seconds:.3g} s of processor time on one thread")
        _solve(case, path, log, keeper, plan, command, remarks)


def checkpoint_of(result: Path) -> Path:
    """Return where the checkpoints of a run with this result file are kept."""
    return result.with_name(f"{result.name}{CHECKPOINT}")


def incomplete_of(result: Path) -> Path:
    """Return where a run with this result file leaves what it has when it cannot go on."""
    return result.with_name(f"{result.name}{INCOMPLETE}")


class Unfinished(SimulationError):
    """A run cannot go on; ``contents`` is what it came to, up to the last good state."""

    def __init__(self, text: str, node: int | None, contents: Contents) -> None:
        self.contents = contents
        super().__init__(text, node)


def _solve(
    case: Case,
    path: Path,
    log: Progress,
    keeper: Keeper,
    plan: str,
    command: str,
    remarks: Remarks | None,
) -> None:
    scene = case.scene
    made_by = {
        "plan": plan,
        "scene": json.dumps(scene.resolved(), sort_keys=True),
        "scene_hash": digest(scene.resolved()),
        "code_fingerprint": fingerprint("pdhe.simulation"),
        "versions": json.dumps(versions(), sort_keys=True),
        "machine": machine(),
        "command": command,
    }
    try:
        contents = _simulate(case, log, keeper)
    except Unfinished as error:
        error.contents.attributes.update(made_by)
        kept = incomplete_of(path)
        error.contents.write(kept)
        raise SimulationError(f"{error}; what was computed so far is in {kept} (see `pdhe diagnose`)") from error
    if remarks is not None:
        with keeper.at_once():
            made_by |= remarks(contents)
    contents.attributes.update(made_by)
    try:
        contents.write(path)
    except OSError:
        # There may be room for this, which is smaller.
        keeper.keep()
        raise
    keeper.remove()
    with contextlib.suppress(OSError):
        incomplete_of(path).unlink()


def fly_pilot(scene: Scene, nodes: int) -> Pilot | None:
    """Run a scene on a mesh so coarse that it costs next to nothing; None where ``nodes`` are few anyway."""
    coarse = pilot_scene(scene, nodes)
    if coarse is None:
        return None
    coarsening = coarse.mesh.spacing / scene.mesh.spacing
    try:
        case = mesh_case(coarse)
        variables = compute(case).variables
        counts, later = _counts_of(case, variables), None
        since = max(_loads_change_until(case), counts.get("first_failure", np.inf))
        if case.diffusion is not None and since < scene.time.end:
            more = build_case(longer(coarse, coarsening, since), case.discretization)
            later = _counts_of(more, compute(more).variables)
    except PdheError:
        return None  # too coarse for the scene's own details: that says nothing against the scene
    largest = variables.get("largest_load")
    return Pilot(
        case.discretization.volume.size, coarsening, counts,
        None if largest is None else float(np.max(largest.values)), later,
    )  # fmt: skip


def _counts_of(case: Case, variables: Mapping[str, Any]) -> dict[str, float]:
    """What a forecast needs to know of a run."""
    names = "equilibrium_solves", "equilibrium_iterations", "failure_rounds", "diffusion_sweeps", "crack_extension"
    counts = {name: float(variables[name].values[-1]) for name in names if name in variables}
    first = -1  # where nothing breaks, the last row is what counts
    if counts.get("failure_rounds"):
        rounds, times = variables["failure_rounds"].values, variables["history_time"].values
        first = int(np.argmax(rounds > 0))
        loaded = int(np.searchsorted(times, _loads_change_until(case), side="right")) - 1
        counts |= {
            "rounds_while_loaded": float(rounds[loaded]),
            "extension_while_loaded": float(variables["crack_extension"].values[loaded]),
            "failure_instants": float(np.count_nonzero(np.diff(rounds))),
            "first_failure": float(times[first]),
            "end": case.scene.time.end,
        }
    if "diffusion_sweeps" in variables:
        counts["sweeps_before_failure"] = float(variables["diffusion_sweeps"].values[first])
    return counts


def _loads_change_until(case: Case) -> float:
    """The time from which prescribed displacements and coverages stay as they are, s."""
    corners = {t for t in case.conditions.corners if t > 0.0} if case.conditions is not None else set()
    edges = case.scene.hydrogen.boundary if case.scene.hydrogen is not None else ()
    corners |= {t for item in edges for t in item.coverage.corners if t > 0.0}
    stops, changing = sorted({0.0, case.scene.time.end, *corners}), 0.0
    for begin, stop in pairwise(t for t in stops if t <= case.scene.time.end):
        wet = any(item.coverage(begin) != item.coverage(stop) for item in edges)
        if wet or (case.conditions is not None and case.conditions.changes(begin, stop)):
            changing = stop
    return changing


def mesh_case(scene: Scene) -> Case:
    """Build the case of a scene on a mesh that is made for it and not kept.

    Raises
    ------
    PdheError
        If the scene cannot be meshed, or not run on this mesh.
    """
    with tempfile.TemporaryDirectory() as folder:
        mesh_file = Path(folder, "scene.msh")
        make_mesh(scene.geometry, scene.mesh, mesh_file)
        return build_case(scene, discretize(mesh_file, scene.geometry, scene.mesh))


def compute(case: Case, progress: Progress | None = None) -> Contents:
    """Run a case from time zero to its end and return everything that it recorded, as a result file has it.

    Bonds break in the case itself: build a new one for another run.

    Raises
    ------
    SimulationError
        If the run cannot go on.
    """
    return _simulate(case, progress or _silent)


def simulate(case: Case, progress: Progress | None = None) -> xr.Dataset:
    """Run a case as :func:`compute` does and return a dataset."""
    return compute(case, progress).dataset()


def _silent(text: str) -> None:
    """Show no progress."""


def _simulate(case: Case, log: Progress = _silent, keeper: Keeper | None = None) -> Contents:
    with threads_for(case.bonds.length.size):
        run = (keeper.load(case) if keeper else None) or _begin(case)
        step = {"events": _step_events, "fixed": _step_fixed, "dynamic": _step_dynamic}[case.scene.stepping.mode]
        offer = keeper.offer if keeper else lambda run: None
        try:
            if not run.recorder.rows:
                _finish_beginning(run, offer)
            step(run, log, offer)
        except SimulationError as error:
            text = f"{_where(run)}: {error}{_likely_reason(case, error.node) if INDEFINITE not in str(error) else ''}"
            raise Unfinished(text, error.node, _last_good(run, f"incomplete: {text}")) from error
        status = "complete" if not run.runaways else "complete; crack ran away: " + "; ".join(run.runaways)
        attributes = {"title": case.scene.title, "status": status}
        return run.recorder.contents(case.discretization, attributes, units_of(case.scene))


def _where(run: Run) -> str:
    """Say where a run is: time, history entry, round of failures, and the bond that broke last."""
    state = run.state
    parts = [f"at t = {state.time:.6g} s, step {len(run.recorder.rows)}, failure round {state.failure_rounds}"]
    if run.recorder.broken:
        i, j, _ = run.recorder.broken[-1]
        # A node of the whole body beyond a mirror line is the image of one on this side.
        ends = [i[-1], j[-1] % run.case.bonds.node_count]
        x, y = 1e3 * run.case.discretization.coordinates[ends].mean(axis=0)[:2]
        parts.append(f"after the bond of nodes {i[-1]} and {j[-1]} broke about ({x:.4g}, {y:.4g}) mm")
    return ", ".join(parts)


def _likely_reason(case: Case, node: int | None) -> str:
    """Say what is special about the node at which an equilibrium was not found."""
    if node is None or case.body is None or case.history is not None:
        return ""
    solver = case.equilibrium
    if solver.max_iterations < FEW:
        return f"; likely reason: {solver.max_iterations} iterations are few, some tens are usual"
    damage = float(case.body.damage()[node])
    if damage > LOOSE:
        return (
            f"; likely reason: {damage:.0%} of the bonds of this node are gone, so that it or the fragment around it "
            "hardly hangs on to the rest"
        )
    if not case.body.broken:
        return "; likely reason: nothing has broken yet: the loads or the cracks leave the body too loosely held"
    return ""


def _last_good(run: Run, status: str) -> Contents:
    """Return what a run has recorded, with its present state, which is that before the move that failed."""
    state, recorder = run.state, run.recorder
    # A state that must not be recorded is not a good one: what was recorded before it is kept as it is.
    with contextlib.suppress(SimulationError):
        if run.motion is not None:  # inside a stretch of diffusion, the displacements are still those of its beginning
            moves.move_to(run.case, state, run.motion, state.time)
        record(run.case, state, recorder, snapshot=True)
        if recorder.times[-2:-1] == [state.time]:  # what broke since then counts
            for values in (recorder.times, *recorder.snapshots.values()):
                del values[-2]
    attributes = {"title": run.case.scene.title, "status": status}
    return recorder.contents(run.case.discretization, attributes, units_of(run.case.scene))


def _begin(case: Case) -> Run:
    """Run at time zero; with equilibria, loads that are on from the start may break bonds before time has passed."""
    try:
        failing = case.rule is not None and case.equilibrium is not None
        return Run(case, start(case), Recorder(), failing_from=0.0 if failing else None)
    except SimulationError as error:
        text = f"at t = 0 s, before the first equilibrium: {error}{_likely_reason(case, error.node)}"
        raise SimulationError(text, error.node) from error


def _finish_beginning(run: Run, offer: Callable[[Run], None]) -> None:
    """Let bonds fail at time zero, and record it."""
    case, state = run.case, run.state
    if run.failing_from is not None:
        u = state.displacement
        begin = Candidates(case.body, case.rule, u, u, state.coverage)
        moves.fail_until_stable(case, state, begin, 0.0, run.recorder, lambda: offer(run))
        run.failing_from = None
    record(case, state, run.recorder, snapshot=True)


def start(case: Case) -> State:
    """State at time zero: at rest, initial coverage, prescribed coverage in place."""
    n, axes = case.discretization.coordinates.shape
    state = State(crack_tip=np.full(axes, np.nan))
    if case.equilibrium is not None:
        state.displacement, state.force = np.zeros((n, axes)), np.zeros((n, axes))
        u, force = state.displacement, state.force
        if case.history is None:  # a history begins with the first increment
            u, force = case.equilibrium.solve(u, case.conditions.values(0.0))
        # A load that is on from the start counts as applied slowly before it: the work of a proportional ramp.
        moves.move_to(case, state, moves.Motion(0.0, 0.0, u, u, force, force), 0.0)
        if case.history is None and not case.linear:  # slowly, but not in proportion
            state.external_work = case.copies * case.equilibrium.elastic(u, force)
    if case.dynamics is not None:
        case.dynamics.sweep(0.0)
        state.displacement, state.velocity, state.force = case.dynamics.u, case.dynamics.v, case.dynamics.force
    if case.diffusion is not None:
        state.coverage = np.full(n, case.scene.hydrogen.initial)
        state.held, state.saturated, state.supply = np.zeros(n, bool), np.zeros(n, bool), np.zeros(n)
        moves.hold_prescribed_coverage(case, state)
        moves.saturate_broken(case, state)
        if case.history is not None:
            case.history.points.field = case.history.points.target = state.coverage.copy()
    return state


def _step_events(run: Run, log: Progress, offer: Callable[[Run], None]) -> None:
    """Go from event to event: load corner, output, failure. Displacements are solved for only when forces changed.

    The run may be under way: between two corners of the loads, or between two rounds of failures.
    """
    case, state = run.case, run.state
    outputs = [t for t in case.scene.outputs.times if t > 0.0]
    end = case.scene.time.end
    # Where displacements are not straight between two corners, outputs have equilibria of their own.
    turns = [*_corners(case), *([] if case.linear else outputs)]
    corners = sorted({t for t in turns if 0.0 < t < end} | {end})
    if run.failing_from is not None:
        u = state.displacement
        _fail(run, Candidates(case.body, case.rule, u, u, state.coverage), 0.0, log, offer)
        _note_event(run, True, state.time in outputs, log, offer)
    while state.time < end:
        candidates = None
        corner = next(t for t in corners if t > state.time)
        if case.equilibrium is not None:
            run.motion = run.motion or moves.start_motion(case, state, corner)
            if case.rule is not None:
                candidates = Candidates(case.body, case.rule, run.motion.u0, run.motion.u1)
        failed = False
        while state.time < corner and not failed:
            until = min([corner, *[t for t in outputs if t > state.time][:1]])
            motion, since = run.motion, (state.time, state.broken_bonds)
            failed = moves.advance(case, state, until, motion, candidates, lambda: offer(run))
            if motion is not None:
                moves.move_to(case, state, motion, state.time)
            if failed or state.time == corner:
                run.motion = None
            if failed:
                run.failing_from = state.crack_extension
                _fail(run, candidates, motion.fraction(state.time), log, offer)
                if (state.time, state.broken_bonds) == since:
                    raise SimulationError(
                        "the step to the next failure has shrunk to nothing: a bond is found critical at this instant "
                        "and does not break; likely reason: a load or a coverage that jumps"
                    )
            # A corner of the loads is an extreme of the history, whether or not an output falls on it.
            _note_event(run, failed or state.time == corner, state.time in outputs, log, offer)


def _fail(run: Run, candidates: Candidates, fraction: float, log: Progress, offer: Callable[[Run], None]) -> None:
    """Let bonds fail until none is critical any more."""
    moves.fail_until_stable(run.case, run.state, candidates, fraction, run.recorder, lambda: offer(run))
    _note_runaway(run, log)


def _note_event(run: Run, history: bool, output: bool, log: Progress, offer: Callable[[Run], None]) -> None:
    """Record an event, and let a checkpoint be taken."""
    if history or output:
        record(run.case, run.state, run.recorder, snapshot=output)
    if output:
        log(_progress_line(run.case, run.state))
    offer(run)


def _step_fixed(run: Run, log: Progress, offer: Callable[[Run], None]) -> None:
    """Equal load steps, each with equal diffusion sub-steps, an equilibrium and the failures that follow from it.

    The run may be under way inside a load step: between two diffusion sub-steps or two rounds of failures.
    """
    case, state, recorder = run.case, run.state, run.recorder
    stepping, end = case.scene.stepping, case.scene.time.end
    begun = end * run.step / stepping.load_steps
    pending = [t for t in case.scene.outputs.times if t > 0.0 and (not run.step or begun < t * (1.0 - 1e-12))]
    for step in range(run.step + 1, stepping.load_steps + 1):
        begin, t = end * (step - 1) / stepping.load_steps, end * step / stepping.load_steps
        failed = run.failing_from is not None
        if not failed:
            if case.diffusion is not None:
                for sub in range(run.substep + 1, stepping.diffusion_substeps + 1):
                    moves.substep(case, state, begin + (t - begin) * sub / stepping.diffusion_substeps)
                    run.substep = sub
                    offer(run)
            state.time = t
            if case.equilibrium is not None:
                if case.history is not None and case.diffusion is not None:
                    case.history.points.target = state.coverage.copy()
                u, force = case.equilibrium.solve(state.displacement, case.conditions.values(t))
                moves.move_to(case, state, moves.Motion(t, t, u, u, force, force), t)
                if case.rule is not None:
                    run.failing_from = state.crack_extension
        if run.failing_from is not None:
            u, rounds = state.displacement, state.failure_rounds
            candidates = Candidates(case.body, case.rule, u, u, state.coverage)
            _fail(run, candidates, 0.0, log, offer)
            failed = failed or state.failure_rounds > rounds
        output = bool(pending) and t >= pending[0] * (1.0 - 1e-12)
        while pending and t >= pending[0] * (1.0 - 1e-12):
            pending.pop(0)
        # What yields has a history worth knowing in every step.
        if failed or output or case.history is not None:
            record(case, state, recorder, snapshot=output)
        if output:
            log(_progress_line(case, state))
        run.step, run.substep = step, 0
        offer(run)


def _step_dynamic(run: Run, log: Progress, offer: Callable[[Run], None]) -> None:
    """Steps with inertia: equal ones between outputs and corners of what is prescribed, bonds failing after each.

    Hydrogen, which hardly moves meanwhile, goes ahead to the end of each such stretch.
    """
    case, state, motion, scene = run.case, run.state, run.case.dynamics, run.case.scene
    wanted = min(scene.stepping.step or scene.stepping.safety * motion.limit, scene.time.end)
    outputs = {t for t in scene.outputs.times if t > 0.0}
    stops = sorted({t for t in (*_corners(case), *outputs) if 0.0 < t < scene.time.end} | {scene.time.end})
    for begin, stop in pairwise((0.0, *stops)):
        if stop <= state.time:
            continue
        steps = motion.steps(stop - begin, wanted)
        length = (stop - begin) / steps
        if case.diffusion is not None and run.step == 0:
            moves.advance(case, state, stop, None, None)
            state.time = begin
        motion.watch(case.rule, state.coverage)
        ended = True
        for k in range(run.step + 1, steps + 1):
            if not ended and motion.damping > 0.0:
                state.damping_loss += case.copies * motion.end(length)
                ended = True
            state.time = stop if k == steps else begin + k * length
            work, lost = motion.step(state.time, length, ended)
            state.external_work += case.copies * work
            state.damping_loss += case.copies * lost
            ended, found = False, motion.critical() if case.rule is not None else None
            if found is not None or k == steps or k % SAFE_EVERY == 0:
                state.damping_loss += case.copies * motion.end(length)
                ended = True
            if found is not None:
                state.fracture_energy += case.copies * motion.break_bonds(found[0], state.time)
                moves.note_broken(case, state, *found, run.recorder)
            run.step = k % steps
            if k < steps and k % SAFE_EVERY == 0:
                offer(run)
        if case.diffusion is not None:
            moves.saturate_broken(case, state)
        _note_event(run, True, stop in outputs, log, offer)


def _corners(case: Case) -> list[float]:
    times = list(case.conditions.corners) if case.conditions is not None else []
    if case.dynamics is not None:
        times = case.dynamics.corners()
    if case.scene.hydrogen is not None:
        times += [t for condition in case.scene.hydrogen.boundary for t in condition.coverage.corners]
    return times


def _note_runaway(run: Run, log: Progress) -> None:
    """Say if the crack ran while bonds failed at one instant, which is over."""
    state, before, run.failing_from = run.state, run.failing_from, None
    horizon, local = run.case.bonds.horizon, run.case.bonds.horizons
    if local is not None and np.isfinite(state.crack_tip).all():
        x = run.case.discretization.coordinates
        horizon = local[np.argmin(np.hypot(*(x - state.crack_tip).T))]
    if state.crack_extension - before > RUNAWAY * horizon:
        text = (
            f"at {state.time:.6g} s the crack ran from {before * 1e3:.3g} to {state.crack_extension * 1e3:.3g} mm "
            "of extension at fixed time"
        )
        run.runaways.append(text)
        log(text)


def _progress_line(case: Case, state: State) -> str:
    parts = [f"t = {state.time:.4g} s"]
    if case.equilibrium is not None:
        parts.append(f"solves {case.equilibrium.work.equilibrium_solves}")
    if case.dynamics is not None:
        parts.append(f"steps {case.dynamics.work.time_steps}")
    if case.rule is not None:
        parts.append(f"broken bonds {state.broken_bonds}, extension {state.crack_extension * 1e3:.4g} mm")
    if case.diffusion is not None:
        mean = float(np.average(state.coverage, weights=case.discretization.volume))
        parts.append(f"mean coverage {mean:.3f}, diffusion sweeps {state.diffusion_sweeps}")
    return "; ".join(parts)


def _check_stability(case: Case) -> None:
    """Stop where breaking has left a stiffness that is not positive, on which an equilibrium means nothing."""
    least = least_eigenvalue(case.body, ~case.conditions.fixed)
    if least < NEGATIVE:
        raise SimulationError(f"{INDEFINITE} (least eigenvalue {least:.3g} of the largest)")


def record(case: Case, state: State, recorder: Recorder, snapshot: bool) -> None:
    """Append the present state to the history, and to the snapshots where asked.

    Raises
    ------
    SimulationError
        If a displacement or a coverage is not finite, or the stiffness not positive; nothing is appended then.
    """
    for name, values in (("displacement", state.displacement), ("coverage", state.coverage)):
        if values is not None and not np.isfinite(values).all():
            node = int(np.flatnonzero(~np.isfinite(values).reshape(values.shape[0], -1).all(axis=1))[0])
            where = case.discretization.coordinates[node].tolist()
            raise SimulationError(f"the {name} of node {node}, x = {where} m, is not finite", node)
    volume = case.discretization.volume
    row: dict[str, float] = {"history_time": state.time}
    fields: dict[str, np.ndarray] = {}
    if case.equilibrium is not None:
        work = case.equilibrium.work
        row |= case.conditions.reactions(state.force)
        row |= {f"applied_{p.on}_{'xyz'[p.component]}": p.value(state.time) for p in case.conditions.prescribed}
        if case.history is None:
            row["elastic_energy"] = case.copies * case.equilibrium.elastic(state.displacement, state.force)
        else:
            row |= energies(case.history, state.displacement, case.copies)
            fields |= node_fields(case.scene, case.history)
        row["external_work"] = state.external_work
        row |= {
            "equilibrium_solves": work.equilibrium_solves,
            "equilibrium_iterations": work.equilibrium_iterations,
            "force_sweeps": work.force_sweeps,
        }
        fields["displacement"] = state.displacement
    if case.dynamics is not None:
        row |= _dynamic_row(case, state)
        fields |= {"displacement": state.displacement, "velocity": state.velocity}
    if case.rule is not None:
        phi = case.body.damage()
        fields["damage"] = phi
        if snapshot and state.broken_bonds and case.body.can_be_indefinite:
            _check_stability(case)
        u = np.ascontiguousarray(state.displacement)
        nearest = nearest_failure(case.body, case.rule, u, state.coverage)
        row |= {
            "fracture_energy": state.fracture_energy,
            "crack_length": equivalent_crack_length(case),
            "crack_extension": state.crack_extension,
            "crack_tip_x": state.crack_tip[0],
            "crack_tip_y": state.crack_tip[1],
            **({"crack_tip_z": state.crack_tip[2]} if state.crack_tip.size == 3 else {}),
            "mean_damage": float(np.average(phi, weights=volume)),
            "broken_bonds": state.broken_bonds,
            "failure_rounds": state.failure_rounds,
            "largest_load": nearest,
        }
    if case.diffusion is not None:
        content = float(np.sum(state.coverage * volume))
        row |= {
            "mean_coverage": content / float(volume.sum()),
            "hydrogen_content": case.copies * content,
            "hydrogen_influx": case.copies * float(state.supply.sum()),
            "diffusion_sweeps": state.diffusion_sweeps,
            "diffusion_iterations": state.diffusion_iterations,
        }
        fields["coverage"] = state.coverage
    recorder.row(**row)
    if snapshot:
        recorder.snapshot(state.time, **fields)


def _dynamic_row(case: Case, state: State) -> dict[str, float]:
    """The part of a history entry that belongs to a motion with inertia."""
    motion, t = case.dynamics, state.time
    kinetic, of_held = motion.kinetic()
    row = case.conditions.reactions(state.force)
    row |= {f"applied_{p.on}_{'xyz'[p.component]}": p.value(t) for p in case.conditions.prescribed}
    row |= {f"traction_{p.on}_{'xyz'[p.component]}": p.value(t) for p in motion.tractions}
    return row | {
        "elastic_energy": case.copies * motion.elastic(),
        "kinetic_energy": case.copies * kinetic,
        # Held nodes take their own kinetic energy from what moves them.
        "external_work": state.external_work + case.copies * of_held,
        "damping_loss": state.damping_loss,
        "time_steps": motion.work.time_steps,
        "force_sweeps": motion.work.force_sweeps,
    }


def equivalent_crack_length(case: Case) -> float:
    """Length of a straight crack that would cut as much bond weight as is broken, m (theory, eq. 5.9)."""
    return case.copies * case.body.broken_weight / (case.rule.crossing * case.discretization.thickness)
