"""Checkpoints: all that a run needs to go on to the same bits, in one file beside its result.

A run offers itself at points where its state is simple: after each step of diffusion and each round of failures, at
failures, outputs and corners of the loads. A checkpoint is taken there if the last one is old enough. What depends on
the history of the run is in it; what follows from that, such as factors of preconditioners, is made again from the
state it was made from.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import signal
import threading
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pdhe.case import Case
from pdhe.discretization import Discretization
from pdhe.dynamics import Work as MotionWork
from pdhe.errors import Interrupted, PdheError
from pdhe.increments import Increments
from pdhe.provenance import digest, fingerprint, versions
from pdhe.results import Recorder
from pdhe.solvers import Work
from pdhe.state import Motion, State
from pdhe.supersteps import SuperStepper
from pdhe.wholefile import intact, moved_when_whole

CADENCE = "PDHE_CHECKPOINT"
"""Environment variable: seconds between checkpoints, 0 for one at every safe point, ``off`` for none."""
EVERY = 30.0
"""Seconds before the first checkpoint and between two, unless the variable says otherwise."""
SHARE = 0.01
"""Largest share of the time that goes into writing: the next checkpoint waits until the last one is that cheap."""
GRACE = 10.0
"""Seconds that a signal waits for the next point at which a checkpoint can be taken; a second signal does not wait."""

_MOTION = ("u0", "u1", "force0", "force1")


@dataclasses.dataclass
class Run:
    """A run under way: what a checkpoint holds.

    Attributes
    ----------
    motion
        The displacements between the load corners that the run is between; None where they are to be found next.
    failing_from
        Extension of the crack, m, before the rounds of failures under way; None when there are none.
    step, substep
        With fixed stepping, load steps done, and diffusion sub-steps done of the one under way. With inertia, steps
        done since the last stop.
    """

    case: Case
    state: State
    recorder: Recorder
    runaways: list[str] = dataclasses.field(default_factory=list)
    motion: Motion | None = None
    failing_from: float | None = None
    step: int = 0
    substep: int = 0


def identity(scene: Mapping[str, Any], nodes: Discretization) -> dict[str, str]:
    """Digests of all that the bits of a run depend on: the resolved scene, the nodes, the code, the versions."""
    arrays = {**{f.name: getattr(nodes, f.name) for f in dataclasses.fields(nodes)}, **nodes.node_sets}
    total = hashlib.sha256()
    for name, array in sorted((name, np.asarray(a)) for name, a in arrays.items() if name != "node_sets"):
        total.update(f"{name} {array.shape} {array.dtype.str}\0".encode() + np.ascontiguousarray(array).tobytes())
    return {
        "scene": digest(scene),
        "nodes": total.hexdigest()[:12],
        "code": fingerprint("pdhe.simulation"),
        "versions": digest(versions()),
    }


class Keeper:
    """Writes the checkpoints of one run, finds the last one again, and turns signals into an orderly end.

    Parameters
    ----------
    path
        File of the checkpoint.
    identity
        What :func:`identity` says of the run: a checkpoint that says otherwise is not used.
    log
        Takes lines about what is done.

    Raises
    ------
    PdheError
        If the environment variable :data:`CADENCE` is neither a number of seconds nor ``off``.
    """

    def __init__(self, path: Path, identity: Mapping[str, str], log: Callable[[str], None]) -> None:
        self.path, self.identity, self.log = path, dict(identity), log
        self.every = _cadence()
        self.written = 0
        self.spent = 0.0
        self._due = time.monotonic() + self.every
        self._signal: int | None = None
        self._at_once = False
        self._last: Run | None = None

    def load(self, case: Case) -> Run | None:
        """Return the run as the last checkpoint has it, its bonds broken in ``case``; None where there is none."""
        try:
            if not intact(self.path):
                raise ValueError("not as it was written")
            with np.load(self.path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            held = json.loads(str(arrays.pop("meta")))
            stale = [name for name, value in self.identity.items() if held["identity"].get(name) != value]
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
            self.log(f"{self.path}: damaged, ignored ({type(error).__name__}: {error}); starting anew")
            return None
        if stale:
            self.log(f"{self.path}: stale, ignored (other {', '.join(stale)}); starting anew")
            return None
        run = _restored(case, held, arrays)
        self.log(f"going on from t = {run.state.time:.6g} s, failure round {run.state.failure_rounds} ({self.path})")
        return run

    def offer(self, run: Run) -> None:
        """Take a checkpoint if one is due; raise :class:`Interrupted` after one if a signal has come."""
        self._last = run
        if self._signal is None and time.monotonic() < self._due:
            return
        before = self.written
        self.write(run)
        if self._signal is not None:
            where = "there" if self.written > before else "the last checkpoint, if any: no new one was written"
            raise _interrupted(self._signal, f"at t = {run.state.time:.6g} s; the same command goes on from {where}")

    def write(self, run: Run) -> None:
        """Write a checkpoint; a full disk is told, not raised: the run may still end well."""
        if self.every == np.inf:
            return
        begin = time.monotonic()
        try:
            held, arrays = _taken(run)
            meta = np.array(json.dumps({**held, "identity": self.identity}))
            with moved_when_whole(self.path, sealed=True) as temporary, temporary.open("wb") as file:
                np.savez(file, meta=meta, **arrays)
            self.written += 1
        except OSError as error:
            self.log(f"{self.path}: no checkpoint could be written ({error})")
        now = time.monotonic()
        self.spent += now - begin
        self._due = now + (max(self.every, (now - begin) / SHARE) if self.every else 0.0)

    def keep(self) -> None:
        """Write a checkpoint of the run as it was offered last: its result could not be written."""
        if self._last is not None:
            self.write(self._last)

    def remove(self) -> None:
        """Remove the checkpoint: the result is there."""
        with contextlib.suppress(OSError):
            self.path.unlink()

    @contextlib.contextmanager
    def at_once(self) -> Iterator[None]:
        """Meanwhile a signal ends all at once: the run is at its end, and long ones have a checkpoint of it."""
        if self.written:
            self.keep()
        self._at_once = True
        try:
            yield
        finally:
            self._at_once = False

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Meanwhile SIGTERM and SIGINT wait for the next safe point, a while; a second one does not.

        One that comes after the last safe point lets the run write its result. One that the process was started to
        ignore, as in the background of a script, stays ignored.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def stop(number: int, _: Any) -> None:
            if number == signal.SIGALRM or self._signal is not None or self._at_once:
                reason = "without a new checkpoint; the same command goes on from the last one, if any"
                raise _interrupted(self._signal or number, reason)
            self._signal = number
            signal.setitimer(signal.ITIMER_REAL, GRACE)

        heard = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) is not signal.SIG_IGN]
        before = {number: signal.signal(number, stop) for number in (*heard, signal.SIGALRM)}
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            for number, handler in before.items():
                signal.signal(number, signal.SIG_DFL if handler is None else handler)


def _interrupted(number: int, text: str) -> Interrupted:
    return Interrupted(f"interrupted by {signal.Signals(number).name} {text}", 128 + number)


def _cadence() -> float:
    text = os.environ.get(CADENCE, "").strip()
    if text == "off":
        return np.inf
    try:
        seconds = float(text) if text else EVERY
    except ValueError:
        seconds = -1.0
    if not 0.0 <= seconds < np.inf:
        raise PdheError(f"environment variable {CADENCE}: needs seconds or 'off', not {text!r}")
    return seconds


def _taken(run: Run) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Everything that the future of a run depends on: what JSON keeps to the bit, and arrays."""
    held: dict[str, Any] = {"runaways": run.runaways, "failing_from": run.failing_from}
    held |= {"step": run.step, "substep": run.substep}
    arrays: dict[str, np.ndarray] = {}
    held["state"] = {}
    for field in dataclasses.fields(run.state):
        value = getattr(run.state, field.name)
        if isinstance(value, SuperStepper):
            held["stepper"] = value.memory()
            arrays |= {"stepper.held": value.held, "stepper.source": value.source}
        elif isinstance(value, np.ndarray):
            arrays[f"state.{field.name}"] = value
        elif value is None or isinstance(value, bool | int | float):
            held["state"][field.name] = value
        else:
            raise TypeError(f"a checkpoint cannot keep State.{field.name}, a {type(value).__name__}")
    if run.motion is not None:
        held["motion"] = [run.motion.t0, run.motion.t1]
        if run.motion.moving:
            arrays |= {f"motion.{name}": getattr(run.motion, name) for name in _MOTION}
    if run.case.equilibrium is not None:
        solver = run.case.equilibrium
        held["equilibrium"] = {**solver.memory(), "work": dataclasses.asdict(solver.work)}
        if isinstance(solver, Increments):
            arrays |= {f"points.{name}": values for name, values in solver.arrays().items()}
    if run.case.dynamics is not None:
        held["motion_work"] = dataclasses.asdict(run.case.dynamics.work)
    if run.case.body is not None:
        held["broken_sizes"], arrays["broken"] = _joined(run.case.body.broken)
    recorder = run.recorder
    arrays["times"] = np.array(recorder.times)
    arrays |= {f"snapshot.{name}": np.stack(values) for name, values in recorder.snapshots.items()}
    if recorder.rows:
        held["columns"] = list(recorder.rows[0])
        arrays["rows"] = np.array([[row[name] for name in held["columns"]] for row in recorder.rows], float)
    held["recorded_sizes"], arrays["recorded_i"] = _joined([i for i, _, _ in recorder.broken])
    arrays["recorded_j"] = _joined([j for _, j, _ in recorder.broken])[1]
    arrays["recorded_time"] = np.array([t for _, _, t in recorder.broken], float)
    return held, arrays


def _restored(case: Case, held: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Run:
    state = State(**held["state"])
    for name, value in arrays.items():
        if name.startswith("state."):
            setattr(state, name.removeprefix("state."), value)
    if "stepper" in held:
        state.stepper = SuperStepper(case.diffusion, arrays["stepper.held"], arrays["stepper.source"])
        state.stepper.recall(held["stepper"])
    if case.equilibrium is not None:
        solver, memory = case.equilibrium, dict(held["equilibrium"])
        solver.work = Work(**memory.pop("work"))
        # Piece by piece as they broke: sums that were built up over the run come out the same.
        broken = _parted(arrays["broken"], held["broken_sizes"])
        if isinstance(solver, Increments):
            points = {name.removeprefix("points."): a for name, a in arrays.items() if name.startswith("points.")}
            solver.recall(memory, broken, points)
        else:
            solver.recall(memory, broken)
    if case.dynamics is not None:
        case.dynamics.work = MotionWork(**held["motion_work"])
        for broken in _parted(arrays["broken"], held["broken_sizes"]):
            case.body.break_bonds(broken)
        case.dynamics.adopt(state.displacement, state.velocity, state.force)
        state.displacement, state.velocity, state.force = case.dynamics.u, case.dynamics.v, case.dynamics.force
    motion = None
    if "motion" in held:
        if "motion.u1" in arrays:
            motion = Motion(*held["motion"], *(arrays[f"motion.{name}"] for name in _MOTION))
        else:
            u, force = state.displacement, state.force
            motion = Motion(*held["motion"], u, u, force, force)
    recorder = Recorder()
    recorder.times = arrays["times"].tolist()
    recorder.snapshots = {
        name.removeprefix("snapshot."): list(values) for name, values in arrays.items() if name.startswith("snapshot.")
    }
    if "rows" in arrays:
        recorder.rows = [dict(zip(held["columns"], row, strict=True)) for row in arrays["rows"].tolist()]
    sizes = held["recorded_sizes"]
    i, j = (_parted(arrays[name], sizes) for name in ("recorded_i", "recorded_j"))
    recorder.broken = list(zip(i, j, arrays["recorded_time"].tolist(), strict=True))
    return Run(case, state, recorder, held["runaways"], motion, held["failing_from"], held["step"], held["substep"])


def _joined(pieces: list[np.ndarray]) -> tuple[list[int], np.ndarray]:
    return [piece.size for piece in pieces], np.concatenate(pieces) if pieces else np.zeros(0, np.int64)


def _parted(whole: np.ndarray, sizes: list[int]) -> list[np.ndarray]:
    return np.split(whole, np.cumsum(sizes)[:-1]) if sizes else []
