"""Runs that were interrupted go on to the same bits; a checkpoint that does not fit is ignored with a word."""

import contextlib
import multiprocessing
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pdhe import checkpoint, cli, simulation
from pdhe.benchmarks.problems import lattice_nodes
from pdhe.case import build_case
from pdhe.checkpoint import CADENCE, Keeper
from pdhe.diagnosis import diagnose
from pdhe.discretization import discretize, write_discretization
from pdhe.errors import Interrupted, PdheError, SimulationError
from pdhe.implicit import ImplicitStepper
from pdhe.increments import Increments
from pdhe.materials.umat import UserMaterial, UserPoints
from pdhe.mesh import make_mesh
from pdhe.netcdf import read_netcdf
from pdhe.newton import NewtonEquilibrium
from pdhe.provenance import canonical
from pdhe.results import open_result
from pdhe.scene import load_scene
from pdhe.simulation import solve_case
from pdhe.solvers import Equilibrium
from pdhe.state import State
from pdhe.supersteps import SuperStepper
from pdhe.transport import Diffusion, DiffusionStep

pytestmark = pytest.mark.usefixtures("heeding_interrupts")

COARSE = {"mesh.spacing": "10 mm"}
#: A ramp that goes on while bonds break, round after round: preconditioners are built anew on the way.
TORN = {
    "mesh.spacing": "5 mm",
    "hydrogen": None,
    "loads": [
        {"on": "top", "displacement": {"y": {"0 h": "0 mm", "10 h": "0.3 mm"}}},
        {"on": "bottom", "displacement": {"y": "0 mm"}},
    ],
    "time.end": "11 h",
    "outputs.count": 5,
    "stepping.grouping": 0.02,
}
#: A long slab that comes to rest: implicit steps after a while.
SLAB = {
    "geometry": {"plate": {"width": "200 mm", "height": "1 mm", "thickness": "1 mm"}},
    "mesh.spacing": "0.25 mm",
    "time.end": "1e7 s",
    "outputs.count": 5,
}
#: A finer tip in a coarse plate: long steps between failures.
GRADED = {
    "mesh.spacing": "8 mm",
    "mesh.refine": [{"from": ["50 mm", "50 mm"], "to": ["54 mm", "50 mm"], "spacing": "0.8 mm", "within": "2 mm"}],
    "outputs.count": 5,
}
FIXED = {**COARSE, "stepping": {"mode": "fixed", "load_steps": 10, "diffusion_substeps": 20}, "outputs.count": 4}
#: Loads and a coverage that grow while bonds break: steps of diffusion under way with displacements that move.
RAMPS = {
    **COARSE,
    "loads": [
        {"on": "top", "displacement": {"y": {"0 s": "0 mm", "8e6 s": "0.03 mm"}}},
        {"on": "bottom", "displacement": {"y": "0 mm"}},
    ],
    "hydrogen.boundary": [{"on": "notch", "coverage": {"0 s": 0.0, "6e6 s": 1.0}}],
}
#: A load that is on from the start, and breaks bonds before any time has passed.
AT_ONCE = {
    **COARSE,
    "loads": [{"on": "top", "displacement": {"y": "0.2 mm"}}, {"on": "bottom", "displacement": {"y": "0 mm"}}],
    "stepping.grouping": 0.0,
    "time.end": "1e6 s",
    "outputs.count": 1,
}
#: A blow on one edge of a plate with hydrogen: waves, and bonds that break on their way.
STRUCK = {
    "mesh.spacing": "5 mm",
    "loads": [
        {"on": "top", "velocity": {"y": {"0 us": "0 m/s", "5 us": "20 m/s"}}},
        {"on": "bottom", "traction": {"y": "-50 MPa"}},
    ],
    "time.end": "150 us",
    "outputs.count": 2,
    "stepping": {"mode": "dynamic", "damping": "1e3 s^-1"},
}
#: Changes of a scene, and safe points between two ends.
SCENES = {
    "events": ("smoke", COARSE, 37),
    "many outputs between corners": ("smoke", {**COARSE, "outputs.count": 40, "solver.precision": "single"}, 31),
    "rounds of failures": ("smoke", TORN, 61),
    "rounds at time zero": ("smoke", AT_ONCE, 41),
    "ramps": ("smoke", RAMPS, 17),
    "fixed": ("smoke", FIXED, 29),
    "half": ("mode_i_half", {"mesh.spacing": "10 mm", "outputs.every": None, "outputs.count": 12}, 29),
    "long diffusion steps": ("diffusion", SLAB, 9),
    "triangles": ("smoke", {**COARSE, "mesh.cells": "triangle"}, 37),
    "graded": ("mode_i_graded", GRADED, 67),
    "inertia": ("smoke", STRUCK, 1),
    "inertia in space": ("mode_i_solid", STRUCK | {"mesh.spacing": "2 mm", "time.end": "80 us"}, 1),
    "in space": ("mode_i_solid", {"mesh.spacing": "2 mm", "time.end": "6 h", "outputs.count": 6}, 11),
    "user material and hydrogen": (
        "plastic_hole",
        {
            "mesh.spacing": "2 mm",
            "material.diffusivity": "1e-9 m^2/s",
            "hydrogen": {"initial": 0.2, "boundary": [{"on": "hole", "coverage": 1}]},
            "stepping": {"mode": "fixed", "load_steps": 6, "diffusion_substeps": 4},
            "outputs.count": 2,
        },
        7,
    ),
    "user material": ("plastic_hole", {"mesh.spacing": "2 mm", "stepping.load_steps": 10, "outputs.count": 4}, 3),
}


def problem(name, changes):
    scene = load_scene(f"config/scenes/{name}.yaml", changes)
    if scene.mesh.cells == "quadrilateral":
        return scene, lattice_nodes(scene)
    with tempfile.TemporaryDirectory() as folder:
        make_mesh(scene.geometry, scene.mesh, Path(folder, "plate.msh"))
        return scene, discretize(Path(folder, "plate.msh"), scene.geometry, scene.mesh)


def assert_same(path, other):
    """Every variable and attribute to the bit; results hold no time stamps."""
    (arrays, attributes), (arrays_too, attributes_too) = read_netcdf(path), read_netcdf(other)
    assert attributes == attributes_too
    assert arrays.keys() == arrays_too.keys()
    for name, values in arrays.items():
        same = values.tolist() == arrays_too[name].tolist() if values.dtype == object else None
        assert same if same is not None else values.tobytes() == arrays_too[name].tobytes(), name


class Stop(Exception):
    """Stands for a sudden end."""


def end_after(monkeypatch, count):
    """Let runs end, as if killed, at every ``count``-th safe point; the lists hold the runs, and where they ended."""
    seen, ended = [], set()
    offer = Keeper.offer

    def counted(self, run):
        offer(self, run)
        seen.append(run)
        if len(seen) % count == 0:
            state = run.state
            under_way = {"failing": run.failing_from is not None, "sub-step": run.substep, "far": state.far is not None}
            under_way["diffusing"] = state.began is not None and state.far is None
            under_way["moving"] = under_way["diffusing"] and run.motion is not None and run.motion.moving
            history = run.case.history
            under_way["yielding"] = history is not None and history.points.energy[:, 1].any()
            under_way["waves"] = run.case.dynamics is not None and run.step > 0
            ended.update(name for name, held in under_way.items() if held)
            raise Stop

    monkeypatch.setattr(Keeper, "offer", counted)
    return seen, ended


@pytest.mark.parametrize("name", SCENES)
def test_a_run_ended_at_safe_points_gives_the_same_bits(name, tmp_path, monkeypatch):
    scene_name, changes, stride = SCENES[name]
    if name.startswith("user material") and shutil.which("cc") is None:
        pytest.skip("no cc here")
    scene, nodes = problem(scene_name, changes)
    monkeypatch.setenv(CADENCE, "off")
    solve_case(scene, nodes, tmp_path / "whole.nc")
    monkeypatch.setenv(CADENCE, "0")
    seen, ended = end_after(monkeypatch, stride)
    ends = 0
    while not (tmp_path / "parts.nc").exists():
        with contextlib.suppress(Stop):
            solve_case(scene, nodes, tmp_path / "parts.nc")
            break
        ends += 1
        assert (tmp_path / "parts.nc.checkpoint").is_file() and not (tmp_path / "parts.nc").exists()
    assert ends >= 3
    assert_same(tmp_path / "whole.nc", tmp_path / "parts.nc")
    assert {path.name for path in tmp_path.iterdir()} == {"whole.nc", "parts.nc"}
    last = seen[-1]
    # Ends fell where it is hard to go on from.
    hard = {"rounds of failures": "failing", "rounds at time zero": "failing", "ramps": "moving", "fixed": "sub-step"}
    hard |= {"long diffusion steps": "far", "events": "diffusing", "inertia": "waves", "in space": "failing"}
    hard |= {"inertia in space": "waves"}
    hard |= {"user material": "yielding", "user material and hydrogen": "sub-step"}
    assert hard.get(name, "diffusing") in ended, ended
    if name == "rounds of failures":
        assert last.case.equilibrium.work.preconditioner_builds > 2
    if name.startswith("inertia"):
        assert last.state.broken_bonds > 50
    if name == "long diffusion steps":
        assert last.state.stepper.implicit is not None
    if name in ("triangles", "graded"):
        assert last.state.broken_bonds > 0 and last.case.bonds.lattice is None
        assert (last.case.bonds.horizons is not None) == (name == "graded")


def solve_through_the_command_line(words, log, cadence):
    """One ``pdhe`` command in a process of its own."""
    os.environ[CADENCE] = cadence
    os.environ["NUMBA_NUM_THREADS"] = "1"
    with Path(log).open("a") as stream:
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
    sys.exit(cli.main(words))


@pytest.fixture(scope="module")
def processes():
    """Processes forked from one that has imported everything and computed nothing."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["pdhe.simulation", "pdhe.cli", "netCDF4", __name__])
    return context


class Job:
    """A solve that can be killed and started again."""

    def __init__(self, processes, folder, changes):
        self.processes, self.folder = processes, folder
        self.out, self.log = folder / "run.nc", folder / "run.log"
        scene, nodes = problem("smoke", changes)
        write_discretization(nodes, folder / "nodes.nc")
        self.words = ["solve", "--spec", canonical(scene.resolved()), "--nodes", str(folder / "nodes.nc")]

    def start(self, cadence="0"):
        words = [*self.words, "--out", str(self.out)]
        process = self.processes.Process(target=solve_through_the_command_line, args=(words, str(self.log), cadence))
        before = self.told().count("scene: ")
        process.start()
        # The plan is printed when all is ready to run, also when an error is estimated first.
        while process.is_alive() and self.told().count("scene: ") == before:
            time.sleep(0.001)
        return process

    def told(self):
        return self.log.read_text() if self.log.exists() else ""

    def whole(self):
        """Run without interruption; return the seconds it took with a checkpoint at every safe point."""
        for cadence in ("off", "0"):  # the first may have to compile
            process, begin = self.start(cadence), time.monotonic()
            process.join(100)
            assert process.exitcode == 0, self.told()
            took = time.monotonic() - begin
        # The command that made it is an attribute: the same name, out of the way.
        self.out.rename(self.folder / "whole.nc")
        self.log.unlink()
        return took


#: Of about 40 safe points; a second on one core.
KILLED = {**COARSE, "outputs.count": 30}


@pytest.mark.parametrize("kills", [5, pytest.param(50, marks=pytest.mark.slow)])
def test_a_run_killed_at_random_instants_gives_the_same_bits(kills, processes, tmp_path):
    job, random_instant = Job(processes, tmp_path, KILLED), random.Random(kills)
    took = job.whole()
    killed = 0
    while killed < kills:
        process = job.start()
        process.join(random_instant.uniform(0.0, 0.7) * took)
        process.kill()
        process.join()
        if process.exitcode == 0:
            assert_same(tmp_path / "whole.nc", job.out)
            job.out.unlink()
        else:
            assert process.exitcode == -signal.SIGKILL, job.told()
            # A finished file is never half-written.
            if job.out.exists():
                assert_same(tmp_path / "whole.nc", job.out)
            killed += 1
    process = job.start()
    process.join(100)
    assert process.exitcode == 0, job.told()
    assert_same(tmp_path / "whole.nc", job.out)
    # The run went on from many different times.
    times = re.findall(r"going on from t = (\S+) s", job.told())
    assert len(set(times)) > kills // 4
    assert not job.out.with_name("run.nc.checkpoint").exists()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_leaves_a_checkpoint_and_a_status(number, processes, tmp_path):
    job = Job(processes, tmp_path, TORN)
    process = job.start("1000")  # none falls due: the one that is there is that of the signal
    while "t = " not in job.told():
        assert process.is_alive(), job.told()
        time.sleep(0.01)
    os.kill(process.pid, number)
    process.join(60)
    text = job.told()
    assert process.exitcode == 128 + number, text
    assert f"interrupted by {number.name} at t = " in text and "the same command goes on from there" in text
    assert job.out.with_name("run.nc.checkpoint").is_file() and not job.out.exists()
    # The next call goes on; when it is told to end as well, once it has gone on, the checkpoint is a later one.
    first = job.out.with_name("run.nc.checkpoint").read_bytes()
    process = job.start("1000")
    while "going on from t = " not in job.told():
        assert process.is_alive(), job.told()
        time.sleep(0.01)
    process.terminate()
    process.join(60)
    assert process.exitcode == 128 + signal.SIGTERM
    assert job.out.with_name("run.nc.checkpoint").read_bytes() != first


def test_an_interrupt_that_is_ignored_stays_ignored(tmp_path):
    """As in the background of a script, where Ctrl-C is meant for what runs in front."""
    heard = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with Keeper(tmp_path / "x", {}, print).listening():
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
            os.kill(os.getpid(), signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, heard)


@pytest.fixture
def left(tmp_path, monkeypatch):
    """A scene, its nodes and the result to be, of which a checkpoint is there."""
    monkeypatch.setenv(CADENCE, "0")
    scene, nodes = problem("smoke", COARSE)
    with pytest.MonkeyPatch.context() as patch:
        end_after(patch, 10)
        with pytest.raises(Stop):
            solve_case(scene, nodes, tmp_path / "run.nc")
    return scene, nodes, tmp_path / "run.nc"


@pytest.mark.parametrize(
    ("part", "spoil"),
    [
        ("scene", lambda scene, nodes, patch: (load_scene("config/scenes/smoke.yaml", {**COARSE, "title": "Other"}),)),
        ("code", lambda scene, nodes, patch: patch.setattr(checkpoint, "fingerprint", lambda name: "0")),
        ("versions", lambda scene, nodes, patch: patch.setattr(checkpoint, "versions", lambda: {"numba": "0"})),
        ("nodes", lambda scene, nodes, patch: nodes.vertices.__iadd__(1e-12)),
    ],
)
def test_a_stale_checkpoint_is_ignored_with_a_word(left, part, spoil, monkeypatch):
    scene, nodes, out = left
    changed = spoil(scene, nodes, monkeypatch)
    log = []
    solve_case(changed[0] if isinstance(changed, tuple) else scene, nodes, out, log.append)
    told = [line for line in log if "stale, ignored" in line]
    assert len(told) == 1 and f"(other {part}" in told[0]
    assert not any("going on" in line for line in log) and out.is_file()


@pytest.mark.parametrize("damage", ["empty", "cut", "flipped", "text"])
def test_a_damaged_checkpoint_is_ignored_with_a_word(left, damage):
    scene, nodes, out = left
    place = out.with_name("run.nc.checkpoint")
    content = bytearray(place.read_bytes())
    content[len(content) // 2] ^= 4
    whole = place.read_bytes()
    place.write_bytes({"empty": b"", "cut": whole[: len(whole) // 2], "flipped": content, "text": b"no zip"}[damage])
    log = []
    solve_case(scene, nodes, out, log.append)
    assert any("damaged, ignored" in line for line in log) and out.is_file() and not place.exists()


def test_short_runs_write_none_and_a_full_disk_ends_no_run(tmp_path, monkeypatch):
    scene, nodes = problem("smoke", COARSE)
    calls, log = [], []

    def full(*_, **__):
        calls.append(1)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint.np, "savez", full)
    solve_case(scene, nodes, tmp_path / "run.nc", log.append)
    assert not calls
    monkeypatch.setenv(CADENCE, "0")
    solve_case(scene, nodes, tmp_path / "run.nc", log.append)
    assert calls and sum("no checkpoint could be written" in line for line in log) == len(calls)
    assert [path.name for path in tmp_path.iterdir()] == ["run.nc"]


def test_writing_takes_a_small_share_of_the_time(tmp_path, monkeypatch):
    """A run of a million seconds with a point a second and checkpoints of up to twenty seconds."""
    clock, costs = [0.0], []

    def taken(run):
        costs.append(0.01 if len(costs) < 3 else 20.0)
        clock[0] += costs[-1]
        return {}, {}

    monkeypatch.setattr(checkpoint.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(checkpoint, "_taken", taken)
    keeper, times = Keeper(tmp_path / "x", {}, print), []
    while clock[0] < 1e6:
        clock[0] += 1.0
        before = len(costs)
        keeper.offer(None)
        times += [clock[0]] * (len(costs) > before)
    assert times[:4] == pytest.approx([30.01, 60.02, 90.03, 140.03])
    assert len(times) > 300 and keeper.spent == pytest.approx(sum(costs))
    # Each but the last is paid for before the next one comes.
    assert sum(costs[:-1]) <= checkpoint.SHARE * clock[0]


def test_a_clock_that_jumps_changes_nothing(tmp_path, monkeypatch):
    """The time of day decides on nothing: neither on checkpoints nor on results."""
    scene, nodes = problem("smoke", COARSE)
    solve_case(scene, nodes, tmp_path / "run.nc")
    (tmp_path / "run.nc").rename(tmp_path / "whole.nc")
    jumps = random.Random(0)
    monkeypatch.setattr(time, "time", lambda: 1.7e9 + jumps.uniform(-1e9, 1e9))
    written = []
    monkeypatch.setattr(Keeper, "write", lambda self, run: written.append(run))
    solve_case(scene, nodes, tmp_path / "run.nc")
    assert not written  # a run of a second, checkpoints twice a minute
    assert_same(tmp_path / "whole.nc", tmp_path / "run.nc")


@pytest.mark.parametrize("text", ["soon", "-1", "nan", "inf"])
def test_a_cadence_that_makes_no_sense_is_refused(text, tmp_path, monkeypatch):
    monkeypatch.setenv(CADENCE, text)
    with pytest.raises(PdheError, match="PDHE_CHECKPOINT: needs seconds or 'off'"):
        Keeper(tmp_path / "x", {}, print)


@pytest.mark.parametrize("cadence", ["off", "1000"])
def test_a_signal_does_not_promise_a_checkpoint_that_is_not_there(cadence, tmp_path, monkeypatch):
    monkeypatch.setenv(CADENCE, cadence)
    monkeypatch.setattr(checkpoint, "_taken", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    run = SimpleNamespace(state=SimpleNamespace(time=7.0))
    keeper = Keeper(tmp_path / "x", {}, print)
    with pytest.raises(Interrupted, match=r"at t = 7 s; .* if any: no new one was written"), keeper.listening():
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)
        keeper.offer(run)


def test_a_signal_does_not_wait_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint, "GRACE", 0.05)
    before = signal.getsignal(signal.SIGTERM)
    with (
        pytest.raises(Interrupted, match="SIGTERM without a new checkpoint") as stop,
        Keeper(tmp_path / "x", {}, print).listening(),
    ):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5.0)
    assert stop.value.status == 143
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_run_ended_while_its_error_is_estimated_goes_on_from_its_end(tmp_path, monkeypatch):
    scene, nodes = problem("smoke", COARSE)
    monkeypatch.setenv(CADENCE, "0")
    solve_case(scene, nodes, tmp_path / "whole.nc", remarks=lambda _: {"error_basis": "none"})

    def told(_):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5.0)

    with pytest.raises(Interrupted, match="SIGTERM") as stop:
        solve_case(scene, nodes, tmp_path / "run.nc", remarks=told)
    assert stop.value.status == 143
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith("run")] == ["run.nc.checkpoint"]
    lines, rounds = [], []
    broken = simulation.moves.fail_until_stable
    monkeypatch.setattr(simulation.moves, "fail_until_stable", lambda *a: (rounds.append(a), broken(*a))[1])
    solve_case(scene, nodes, tmp_path / "run.nc", lines.append, remarks=lambda _: {"error_basis": "none"})
    assert any(line.startswith(f"going on from t = {scene.time.end:.6g} s") for line in lines)
    assert not rounds
    assert (tmp_path / "run.nc").read_bytes() == (tmp_path / "whole.nc").read_bytes()


def test_a_run_that_cannot_go_on_keeps_what_it_has(tmp_path, monkeypatch):
    """The solver is stopped in the seventh round: once for good, once not."""
    scene, nodes = problem("smoke", COARSE)
    monkeypatch.setenv(CADENCE, "0")
    solve_case(scene, nodes, tmp_path / "whole.nc")
    solve = Equilibrium.solve

    def gives_up(self, u, prescribed):
        if len(self.body.broken) == 7:
            self.max_iterations = 1
        return solve(self, u, prescribed)

    out, kept = tmp_path / "run.nc", tmp_path / "run.nc.incomplete"
    for _ in range(2):  # the second goes on from the checkpoint, to the same error
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Equilibrium, "solve", gives_up)
            with pytest.raises(SimulationError, match="equilibrium not reached") as error:
                solve_case(scene, nodes, out)
        assert not out.exists()
        text = str(error.value)
        assert re.match(
            r"at t = \S+ s, step \d+, failure round 6, after the bond of nodes \d+ and \d+ broke about", text
        )
        assert re.search(r"largest at node \d+, x = .*; likely reason: 1 iterations are few", text)
        assert f"what was computed so far is in {kept}" in text
        with open_result(kept) as result, open_result(tmp_path / "whole.nc") as whole:
            assert result.attrs["status"].startswith("incomplete: at t = ")
            rows = result.sizes["step"] - 1
            for name in ("history_time", "elastic_energy", "hydrogen_content"):
                assert np.array_equal(result[name].values[:rows], whole[name].values[:rows])
            assert result["failure_rounds"].values[-1] == 6 and result["time"].values[-1] < whole["time"].values[-1]
            assert np.unique(result["time"].values).size == result.sizes["time"]
        assert "incomplete: at t = " in diagnose(kept)
    solve_case(scene, nodes, out)
    assert_same(tmp_path / "whole.nc", out)
    assert {path.name for path in tmp_path.iterdir()} == {"whole.nc", "run.nc"}


@pytest.mark.parametrize(
    ("broken", "reason"), [(True, "of the bonds of this node are gone"), (False, "nothing has broken yet"), (None, "")]
)
def test_the_likely_reason_looks_at_the_node(broken, reason):
    scene, nodes = problem("smoke", {**COARSE, "geometry.cracks": [], "hydrogen": None})
    body = (case := build_case(scene, nodes)).body
    if broken is not False:
        owned = np.flatnonzero(body.bonds.owners() == 100)
        body.break_bonds(owned[1:] if broken else owned[:1])
    assert reason in (told := simulation._likely_reason(case, 100)) and bool(told) == bool(reason)


@pytest.mark.parametrize(
    ("name", "changes", "when", "told"),
    [
        ("smoke", COARSE, "at an output", r"the coverage of node 17, x = .* is not finite"),
        ("smoke", COARSE, "at a failure", r"the load of the bond of nodes 17 and \d+ is not finite"),
        ("smoke", COARSE, "in between", r"the coverage of node \d+ is not finite after a step of \S+ s"),
        ("smoke", FIXED, "in between", r"the coverage of node \d+, x = .* is not finite"),
        ("diffusion", SLAB, "in between", r"the coverage of node \d+ is not finite after a step of \S+ s"),
    ],
)
def test_values_that_are_not_finite_are_not_recorded(name, changes, when, told, tmp_path, monkeypatch):
    # Without damage the default horizon is short, and so is the stable step.
    scene, nodes = problem(name, changes | {"damage": None, "horizon.ratio": 3.015} if changes is FIXED else changes)
    advance, step = simulation.moves.advance, Diffusion.step

    def spoilt(case, state, *rest):
        failed = advance(case, state, *rest)
        if state.time > 5e6 and failed == (when == "at a failure"):
            state.coverage[17] = np.nan
        return failed

    def spoilt_step(self, psi, dt, held, source, new, supply):
        step(self, psi, dt, held, source, new, supply)
        new[new > 0.2] = np.nan

    if when == "in between":
        monkeypatch.setattr(Diffusion, "step", spoilt_step)
    else:
        monkeypatch.setattr(simulation.moves, "advance", spoilt)
    with pytest.raises(SimulationError, match=rf"at t = \S+ s, step \d+, .*{told}"):
        solve_case(scene, nodes, tmp_path / "run.nc")
    with open_result(tmp_path / "run.nc.incomplete") as result:
        assert np.isfinite(result["coverage"].values).all() and result.sizes["step"] > (
            0 if when == "in between" else 3
        )


def test_a_first_equilibrium_that_is_not_found_is_told(tmp_path, monkeypatch):
    scene, nodes = problem("smoke", {**AT_ONCE, "solver.max_iterations": 1})
    with pytest.raises(SimulationError, match=r"at t = 0 s, before the first equilibrium: .* iterations are few"):
        solve_case(scene, nodes, tmp_path / "run.nc")
    assert not list(tmp_path.iterdir())


def test_a_step_below_the_floor_is_told(tmp_path, monkeypatch):
    """Coverage that jumps however short the step; then a bond that is found critical for ever and never breaks."""
    scene, nodes = problem("smoke", COARSE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(DiffusionStep, "curvature_at", lambda *_: 1.0)
        with pytest.raises(SimulationError, match=r"diffusion step has shrunk to \S+ s, below the floor of 1e-09"):
            solve_case(scene, nodes, tmp_path / "run.nc")
    monkeypatch.setattr(simulation.moves, "fail_until_stable", lambda *_: None)
    with pytest.raises(SimulationError, match="next failure has shrunk to nothing"):
        solve_case(scene, nodes, tmp_path / "run.nc")
    with open_result(tmp_path / "run.nc.incomplete") as result:
        assert result.sizes["step"] > 3 and "shrunk to nothing" in result.attrs["status"]


def test_round_off_does_not_shrink_a_step():
    scene, nodes = problem("smoke", COARSE)
    case, n = build_case(scene, nodes), nodes.volume.size
    psi = 0.3 + 1e-16 * np.random.default_rng(1).standard_normal(n)
    pair = np.arange(n - 1), np.arange(1, n)
    for share in (1.0, 1e-3, 1e-6):
        dt = share * case.diffusion.stable_step(np.zeros(n, bool))
        assert DiffusionStep(case.diffusion, psi, dt, np.zeros(n, bool), np.zeros(n)).curvature_at(*pair) == 0.0


def test_a_state_that_must_not_be_recorded_loses_nothing_before_it(tmp_path, monkeypatch):
    scene, nodes = problem("smoke", {**COARSE, "material.poissons_ratio": 0.4})
    monkeypatch.setattr(simulation, "least_eigenvalue", lambda body, free: -1.0)
    with pytest.raises(SimulationError, match=r"stiffness is no longer positive.*what was computed so far is in"):
        solve_case(scene, nodes, tmp_path / "run.nc")
    with open_result(tmp_path / "run.nc.incomplete") as result:
        assert result.sizes["time"] >= 1 and "no longer positive" in result.attrs["status"]


def test_nothing_that_has_a_history_is_forgotten(tmp_path):
    """Whoever adds an attribute to one of these classes decides here whether a checkpoint has to hold it."""
    scene, nodes = problem("smoke", COARSE)
    solver, body = (case := build_case(scene, nodes)).equilibrium, case.body
    given = {"body", "fixed", "coordinates", "spacing", "free", "_held_rows", "tolerance", "max_iterations"}
    given |= {"_weights", "_contrast"}
    assert vars(solver).keys() - given == {
        "reference", "work", "_preconditioner", "_baseline", "_excess", "_built_after",
    }  # fmt: skip
    follows_from_broken = {"intact", "cubed", "_by_offset", "share", "inverse", "_spin", "_phi", "broken_weight"}
    follows_from_broken |= {"_share", "_grid_share", "_grid_inverse", "_found_open"}
    given = {"bonds", "model", "volume", "coordinates", "normal", "tangential", "_x", "_volumes", "_moved", "_padding"}
    given |= {"relative"}
    assert vars(body).keys() - given - follows_from_broken == {"broken"}
    stepper = SuperStepper(case.diffusion, np.zeros(nodes.volume.size, bool), np.zeros(nodes.volume.size))
    given = {"diffusion", "held", "source", "short", "shortest", "longest"}
    assert vars(stepper).keys() - given == set(stepper.memory())
    stepper = ImplicitStepper(stepper.diffusion, stepper.held, stepper.source)
    given = {"diffusion", "held", "source", "_free", "_outflow", "_nothing", "_unused"}
    given |= {"_prolongate", "_restrict", "_modes"}
    # Of the iterations, only differences count.
    assert vars(stepper).keys() - given - {"_mass", "_flow", "_modes", "iterations"} == {"factored"}
    points = UserPoints(UserMaterial(Path(), "one", address=1), np.zeros((0, 2)), np.zeros(0))
    given = {"material", "coordinates", "sizes", "tangent", "_trial", "_work", "_guards", "_integers", "_name"}
    # Where an increment goes to is said before each.
    given |= {"_tables", "_addresses", "target"}
    increments = Increments(SimpleNamespace(points=points), np.zeros((0, 2), bool), np.zeros(0))
    held = increments.memory().keys() | increments.arrays().keys()
    assert vars(points).keys() - given == held - {"reference"}
    given = {"body", "fixed", "free", "tolerance", "most_iterations", "cuts", "max_iterations", "length", "_spacing"}
    # Residuals of the last increment are for looking at; the preconditioner is always that of the whole body.
    assert vars(increments).keys() - given == {"reference", "work", "residuals", "_precondition"}
    newton = NewtonEquilibrium(SimpleNamespace(), np.zeros((0, 2), bool), np.zeros(0))
    given = {"body", "fixed", "free", "spacing", "tolerance", "max_iterations"}
    # The preconditioner and the turns that nothing holds are found anew for every solve.
    made = {"work", "residuals", "_precondition", "_guess", "_loose"}
    assert vars(newton).keys() - given - made == set(newton.memory())
    simple = {"float", "float | None", "int", "np.ndarray", "np.ndarray | None"}
    assert [field.name for field in fields(State) if field.type not in simple] == ["stepper"]
