"""One folder, two calls: the second says why it stops and what goes on; after a kill, that command does."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import pytest

# A step that waits until it may go on, so that a call is under way for as long as a test wants.
WAITING = """
import pathlib, time

def main(words):
    pathlib.Path("started").touch()
    while not pathlib.Path("go").exists():
        time.sleep(0.02)
    for option, value in zip(words, words[1:]):
        if option.startswith("--out"):
            pathlib.Path(value).write_text(" ".join(words))
    return 0
"""
TARGET = "results/store/mesh"


@pytest.fixture
def waiting(finished, tmp_path):
    """A project with a call under way: one mesh is missing, and its step waits."""
    project = finished.copy(tmp_path / "project")
    mesh = next((project.folder / TARGET).glob("*-5mm-*.msh"))
    mesh.unlink()
    (project.folder / "pdhe/cli.py").write_text(WAITING)
    command = [sys.executable, "-m", "snakemake", "--cores", "2", "--", f"{TARGET}/{mesh.name}"]
    environment = {**os.environ, "PYTHONPATH": str(project.folder)}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    with subprocess.Popen(command, cwd=project.folder, env=environment, **quiet) as first:
        end = time.monotonic() + 60.0
        while not (project.folder / "started").exists():
            assert first.poll() is None and time.monotonic() < end
            time.sleep(0.05)
        yield project, first, mesh
        with contextlib.suppress(ProcessLookupError):
            os.killpg(first.pid, signal.SIGKILL)


def refused(project, mesh):
    done = project.snakemake("--", f"{TARGET}/{mesh.name}")
    assert done.returncode != 0
    assert "Directory cannot be locked" in done.stderr
    assert "--unlock" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_second_call_is_refused_and_the_first_ends_well(waiting):
    project, first, mesh = waiting
    refused(project, mesh)
    (project.folder / "go").touch()
    assert first.wait(60) == 0
    assert mesh.is_file()


def test_after_a_kill_the_folder_is_unlocked_by_hand(waiting):
    project, first, mesh = waiting
    os.killpg(first.pid, signal.SIGKILL)
    first.wait(60)
    refused(project, mesh)
    assert project.snakemake("--unlock").returncode == 0
    (project.folder / "go").touch()
    done = project.snakemake("--", f"{TARGET}/{mesh.name}")
    assert done.returncode == 0, done.stdout + done.stderr
    assert mesh.is_file()
