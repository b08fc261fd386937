"""Warm processes: one job as good as a process of its own, and nothing left behind."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from pdhe import warm

pytestmark = pytest.mark.usefixtures("heeding_interrupts")

ROOT = Path(__file__).parents[2]
SPEC = {"geometry": {"plate": {"width": 0.04, "height": 0.02, "thickness": 0.001}}, "mesh": {"spacing": 0.005}}
MESH = ["mesh", "--spec", json.dumps(SPEC), "--out"]
WRONG = ["mesh", "--spec", "{}", "--out", "none.msh"]


@pytest.fixture
def run_of_workflow(tmp_path):
    """A process that stands for Snakemake, and the folder of its warm processes."""
    owner = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    folder = tmp_path / f"pdhe-{owner.pid}"
    yield owner, folder
    owner.kill()
    owner.wait()


def start(folder, *arguments, cwd=ROOT, **environment):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PDHE_WARM": str(folder), **environment}
    return subprocess.Popen(
        [sys.executable, "-m", "pdhe", *arguments], cwd=cwd, env=environment, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def run(folder, *arguments, **settings):
    process = start(folder, *arguments, **settings)
    out, err = process.communicate(timeout=60)
    return process.returncode, out, err


def waiting(folder):
    """Numbers of the processes that serve this folder, without those that one of them starts to do something apart."""
    found = {}
    for process in psutil.process_iter(["cmdline", "ppid"]):
        command = process.info["cmdline"] or []
        if "pdhe.warm" in command and str(folder) in command:
            found[process.pid] = process.info["ppid"]
    return [number for number, parent in found.items() if parent not in found]


def soon(condition, limit=20.0):
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)
    return True


def test_commands_run_as_by_themselves_and_share_a_process(run_of_workflow, tmp_path):
    owner, folder = run_of_workflow
    for name in ("one.msh", "two.msh"):
        assert run(folder, *MESH, name, cwd=tmp_path) == (0, "", "")
        assert (tmp_path / name).is_file()
    (process,) = waiting(folder)
    status, out, err = run(folder, *WRONG)
    assert (status, out) == (1, "")
    assert "no block 'geometry'" in err
    status, _, err = run(folder, "mesh")
    assert status == 2 and "usage: pdhe mesh" in err
    assert waiting(folder) == [process]
    direct = tmp_path / "direct.msh"
    subprocess.run([sys.executable, "-m", "pdhe", *MESH, str(direct)], cwd=ROOT, check=True)
    assert direct.read_bytes() == (tmp_path / "two.msh").read_bytes()
    owner.kill()
    owner.wait()
    assert soon(lambda: not waiting(folder) and not folder.exists())


def test_threads_have_processes_of_their_own(run_of_workflow, tmp_path):
    _, folder = run_of_workflow
    for threads in ("1", "2"):
        assert run(folder, *MESH, str(tmp_path / "plate.msh"), NUMBA_NUM_THREADS=threads)[0] == 0
    assert len(waiting(folder)) == 2


@pytest.fixture
def long_solve(run_of_workflow, tmp_path):
    """A solve that has begun in a warm process and would go on for long."""
    from pdhe.discretization import discretize, write_discretization
    from pdhe.mesh import make_mesh
    from pdhe.scene import load_scene

    _, folder = run_of_workflow
    stepping = {"mode": "fixed", "load_steps": 10**7, "diffusion_substeps": 1}
    scene = load_scene(ROOT / "config/scenes/smoke.yaml", {"mesh.spacing": "10 mm", "stepping": stepping})
    make_mesh(scene.geometry, scene.mesh, tmp_path / "plate.msh")
    write_discretization(discretize(tmp_path / "plate.msh", scene.geometry, scene.mesh), tmp_path / "nodes.nc")
    spec = {key: value for key, value in scene.resolved().items() if key != "title"}
    result = tmp_path / "solve" / "result.nc"
    files = ["--nodes", str(tmp_path / "nodes.nc"), "--out", str(result)]
    command = start(folder, "solve", "--spec", json.dumps(spec), *files)
    try:
        assert any("scene:" in line for line in command.stdout)
        (process,) = waiting(folder)
        yield command, process, result
    finally:
        command.kill()
        command.communicate()


@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_an_ended_command_ends_what_runs_for_it_with_a_last_checkpoint(long_solve, sent):
    command, process, result = long_solve
    checkpoint = result.with_name("result.nc.checkpoint")
    command.send_signal(sent)
    _, err = command.communicate(timeout=20)
    killed = sent == signal.SIGKILL
    assert command.returncode == (-sent if killed else 128 + sent)
    # What runs for it has its streams, and ends them after the command is gone.
    name = "SIGTERM" if killed else sent.name
    assert err.startswith(f"interrupted by {name} at t = ") and "the same command goes on from there" in err
    assert [path.name for path in result.parent.iterdir()] == [checkpoint.name]
    # What it leaves is a process that is fit for another command.
    assert psutil.pid_exists(process)
    written = checkpoint.stat().st_mtime_ns
    time.sleep(0.3)
    assert checkpoint.stat().st_mtime_ns == written


def test_a_command_that_no_signal_ends_is_ended_when_nobody_waits(run_of_workflow, tmp_path):
    _, folder = run_of_workflow
    package = tmp_path / "pdhe"
    package.mkdir()
    for name in ("__init__.py", "__main__.py", "warm.py"):
        text = (ROOT / "pdhe" / name).read_text()
        (package / name).write_text(text.replace("_PATIENCE = 15.0", "_PATIENCE = 0.1"))
    stuck = "import signal, time\n\ndef main(arguments):\n    signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
    (package / "cli.py").write_text(stuck + "    print('begun', flush=True)\n    time.sleep(60)\n")
    command = start(folder, "mesh", cwd=tmp_path, PYTHONPATH=str(tmp_path))
    assert command.stdout.readline() == "begun\n"
    command.kill()
    command.communicate(timeout=20)
    assert soon(lambda: not waiting(folder))


def test_a_killed_process_is_told(long_solve):
    command, process, _ = long_solve
    os.kill(process, signal.SIGKILL)
    _, err = command.communicate(timeout=20)
    assert command.returncode == 1
    assert "ended without a word" in err


def test_an_unforeseen_error_is_shown_and_ends_the_process(run_of_workflow, tmp_path):
    _, folder = run_of_workflow
    # A command line that no parser could make: cli.main raises something that is no PdheError.
    package = tmp_path / "pdhe"
    package.mkdir()
    for name in ("__init__.py", "__main__.py", "warm.py"):
        (package / name).write_text((ROOT / "pdhe" / name).read_text())
    (package / "cli.py").write_text("def main(arguments):\n    raise RuntimeError('unforeseen')\n")
    status, _, err = run(folder, "mesh", cwd=tmp_path, PYTHONPATH=str(tmp_path))
    assert status == 1 and "RuntimeError: unforeseen" in err
    assert soon(lambda: not waiting(folder))


def test_a_folder_of_somebody_else_is_not_used(run_of_workflow, tmp_path):
    _, folder = run_of_workflow
    folder.mkdir(mode=0o755)
    assert run(folder, *MESH, str(tmp_path / "plate.msh"))[0] == 0
    assert list(folder.iterdir()) == [] and waiting(folder) == []


def test_the_process_that_died_waiting_is_replaced(run_of_workflow, tmp_path):
    _, folder = run_of_workflow
    assert run(folder, *MESH, str(tmp_path / "one.msh"))[0] == 0
    os.kill(*waiting(folder), signal.SIGKILL)
    assert run(folder, *MESH, str(tmp_path / "two.msh"))[0] == 0
    assert (tmp_path / "two.msh").is_file()


def test_folder_ends_with_the_process_number():
    assert warm.folder_for(123).endswith("-123")
