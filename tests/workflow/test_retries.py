"""Retries: for jobs that were ended from outside, not for those that say what is wrong with their scene."""

import re

import pytest

from pdhe.needs import fails_again

# Steps of meshing that end in as many ways as there are meshes; every call is counted.
ENDING = """
import os, pathlib, signal, sys

def main(words):
    out = pathlib.Path(words[words.index("--out") + 1])
    if "mesh" not in out.parts:
        return 0
    with open(out.name + ".calls", "a") as calls:
        calls.write("x")
    first = len(pathlib.Path(out.name + ".calls").read_text()) == 1
    way = sorted(pathlib.Path("ways").read_text().split()).index(out.stem)
    if way == 0:
        print("error: scene.yaml: key 'mesh.spacing': is not what it should be", file=sys.stderr)
        return 1
    if first:
        os.kill(os.getpid(), signal.SIGKILL)
    out.write_text("mesh")
    return 0
"""


def test_only_what_was_ended_from_outside_is_tried_again(pristine, tmp_path):
    project = pristine.copy(tmp_path / "project")
    (project.folder / "pdhe/cli.py").write_text(ENDING)
    planned = project.snakemake("-n", "--configfile", "config/studies/smoke.yaml", "--until", "mesh")
    names = sorted(set(re.findall(r"results/store/mesh/(\S+)\.msh", planned.stdout)))
    assert len(names) == 2, planned.stdout
    (project.folder / "ways").write_text(" ".join(names))
    meshes = [f"results/store/mesh/{name}.msh" for name in names]
    words = ("--configfile", "config/studies/smoke.yaml", "--retries", "3", "--keep-going", "--", *meshes)
    done = project.snakemake(*words)
    assert done.returncode != 0
    calls = [(project.folder / f"{name}.msh.calls").read_text() for name in names]
    assert calls == ["x", "xx"], done.stderr
    assert (project.folder / meshes[1]).is_file() and not (project.folder / meshes[0]).exists()


@pytest.mark.parametrize(
    ("text", "again"),
    [
        ("", False),
        ("t = 7 s\n", False),
        ("interrupted by SIGTERM at t = 7 s; the same command goes on from there\n", False),
        ("error: out of memory; `pdhe plan SCENE` tells what a run needs\n", False),
        ("error: the process that ran this ended without a word; was there enough memory?\n", False),
        (
            "error: x.nc: no space left on device; nothing half-written is left; ... give the same command again\n",
            False,
        ),
        ("error: x.nc: input/output error\n", False),
        ("error: x.nc: stale file handle\n", False),
        ("t = 7 s\nerror: at t = 7 s: equilibrium not reached: relative residual 1\n", True),
        ("error: scene: key 'mesh.spacing': is larger than the plate\nsome words of a shell\n", True),
        ("error: x.nc: read-only file system; write elsewhere\n", True),
    ],
)
def test_logs_tell_which_is_which(text, again, tmp_path):
    (tmp_path / "log").write_text(text)
    assert fails_again(tmp_path / "log") == again
    assert not fails_again(tmp_path / "none")
