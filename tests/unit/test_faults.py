"""Faults of disks and files: a clear word, an exit status, nothing half-written, and never a wrong answer."""

import errno
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import gmsh
import numpy as np
import psutil
import pytest

from pdhe import checkpoint, cli, wholefile
from pdhe.apart import apart
from pdhe.benchmarks.problems import lattice_nodes
from pdhe.checkpoint import CADENCE, Keeper, identity
from pdhe.discretization import discretize, read_discretization
from pdhe.errors import PdheError
from pdhe.results import Contents, open_result
from pdhe.scene import load_scene
from pdhe.simulation import solve_case
from pdhe.wholefile import PART

pytestmark = pytest.mark.usefixtures("heeding_interrupts")

ROOT = Path(__file__).parents[2]
SMALL = {"mesh.spacing": "20 mm", "outputs.count": 4, "time.end": "4e6 s"}


@pytest.fixture(scope="module")
def scene():
    return load_scene(ROOT / "config/scenes/smoke.yaml", SMALL)


@pytest.fixture(scope="module")
def made(scene, tmp_path_factory):
    """One file of every kind that a workflow reads, each whole."""
    folder = tmp_path_factory.mktemp("made")
    spec = json.dumps({key: value for key, value in scene.resolved().items() if key != "title"})
    assert cli.main(["mesh", "--spec", spec, "--out", str(folder / "a.msh")]) == 0
    assert cli.main(["nodes", "--spec", spec, "--mesh", str(folder / "a.msh"), "--out", str(folder / "a.nc")]) == 0
    assert cli.main(["solve", "--spec", spec, "--nodes", str(folder / "a.nc"), "--out", str(folder / "r.nc")]) == 0
    (folder / "spec.json").write_text(spec)
    return folder


def commands(made):
    """Every command of the workflow that writes files, with the files it writes."""
    spec, result = (made / "spec.json").read_text(), str(made / "r.nc")
    small = '{"dpi": 40, "frames": 2, "frame_width": 200}'
    return {
        "mesh": (["mesh", "--spec", spec], ["--out"], ["a.msh"]),
        "nodes": (["nodes", "--spec", spec, "--mesh", str(made / "a.msh")], ["--out"], ["a.nc"]),
        "solve": (["solve", "--spec", spec, "--nodes", str(made / "a.nc")], ["--out"], ["r.nc"]),
        "figures": (["figures", "--kind", "damage", "--result", result, "--style", small], ["--out"], ["d.png"]),
        "animate": (["animate", "--kind", "damage", "--result", result, "--style", small], ["--out"], ["d.gif"]),
        "history": (["history", "--result", result], ["--out-csv", "--out-png"], ["h.csv", "h.png"]),
    }


def words_of(made, name, folder):
    words, options, files = commands(made)[name]
    pairs = zip(options, files, strict=True)
    return [*words, *(word for option, file in pairs for word in (option, str(folder / file)))], files


@contextmanager
def files_of_at_most(size):
    """No file may grow beyond a size: to the program the same as a full disk, and anybody may set it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("name", ["mesh", "nodes", "solve", "figures", "animate", "history"])
def test_a_full_disk_is_told_and_leaves_nothing_half_written(name, made, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv(CADENCE, "0")
    words, files = words_of(made, name, tmp_path)
    assert cli.main(words) == 0
    whole = {file: (tmp_path / file).read_bytes() for file in files}
    for file in files:
        (tmp_path / file).unlink()
    size = max(map(len, whole.values()))
    for limit in (0, size // 3, size - 1) if name in ("mesh", "nodes", "solve") else (100, size - 1):
        capsys.readouterr()
        with files_of_at_most(limit):
            assert cli.main(words) == 1, limit
        error = capsys.readouterr().err
        assert error.startswith("error: ") and error.count("\n") == 1, error
        assert "file too large; nothing half-written is left" in error and "give the same command again" in error
        assert any(str(tmp_path / file) in error for file in files), error
        # Of two files, the first may have fitted; a checkpoint may be smaller than the result.
        left = {path.name for path in tmp_path.iterdir()}
        assert left <= {*files[:-1], *(f"{file}.checkpoint" for file in files)}
        assert all((tmp_path / file).read_bytes() == whole[file] for file in left if file in whole)
    # The same command goes on, to the same bytes.
    assert cli.main(words) == 0
    assert {path.name for path in tmp_path.iterdir()} == set(files)
    assert all((tmp_path / file).read_bytes() == whole[file] for file in files)


def test_a_result_that_finds_no_room_leaves_a_checkpoint_of_its_end(scene, tmp_path, monkeypatch):
    """It is smaller than the result: the next call has nothing to compute."""
    write, log = Contents.write, []
    solve_case(scene, lattice_nodes(scene), tmp_path / "r.nc")
    (tmp_path / "r.nc").rename(tmp_path / "whole.nc")

    def full(self, path):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(Contents, "write", full)
    with pytest.raises(OSError, match="No space left"):
        solve_case(scene, lattice_nodes(scene), tmp_path / "r.nc")
    assert (tmp_path / "r.nc.checkpoint").is_file()
    monkeypatch.setattr(Contents, "write", write)
    solve_case(scene, lattice_nodes(scene), tmp_path / "r.nc", log.append)
    assert any(f"going on from t = {scene.time.end:.6g} s" in line for line in log)
    assert (tmp_path / "r.nc").read_bytes() == (tmp_path / "whole.nc").read_bytes()


def test_a_place_that_cannot_be_written_to_is_told_before_anything_is_computed(made, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("pdhe.simulation.build_case", lambda *_: pytest.fail("computed"))
    (tmp_path / "file").write_text("in the way")
    words, _ = words_of(made, "solve", tmp_path / "file")
    assert cli.main(words) == 1
    assert "error: " in (told := capsys.readouterr().err) and "file" in told
    (tmp_path / "taken" / "r.nc").mkdir(parents=True)
    words, _ = words_of(made, "solve", tmp_path / "taken")
    assert cli.main(words) == 1
    assert f"{tmp_path / 'taken' / 'r.nc'}: is a directory" in capsys.readouterr().err
    monkeypatch.setattr(Path, "touch", lambda self: (_ for _ in ()).throw(OSError(errno.EROFS, "Read-only", str(self))))
    words, _ = words_of(made, "solve", tmp_path)
    assert cli.main(words) == 1
    told = capsys.readouterr().err
    assert told.startswith(f"error: {tmp_path / 'r.nc'}: read-only; write elsewhere")


@pytest.mark.parametrize("name", ["mesh", "nodes", "solve", "figures", "animate", "history"])
def test_a_read_only_folder_is_told(name, made, tmp_path, capsys, held_to_permissions):
    folder = tmp_path / "results"
    folder.mkdir(mode=0o555)
    words, _ = words_of(made, name, folder)
    assert cli.main(words) == 1
    assert "permission denied; write elsewhere" in capsys.readouterr().err and not list(folder.iterdir())


def test_devices_and_links_stay_what_they_are(made, tmp_path):
    wholefile.write_text("/dev/null", "text")
    assert not Path("/dev/null").is_file()
    (tmp_path / "far").write_text("old")
    (tmp_path / "link").symlink_to("far")
    wholefile.write_text(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "far").read_text() == "new"


def test_a_log_on_a_full_disk_ends_no_solve():
    code = "from pdhe.commands.streams import progress; progress('one'); progress('two')"
    with Path("/dev/full").open("w") as log:
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, stdout=log, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 0
    assert done.stderr == "error: standard output cannot be written to: the rest of it is lost\n"


def spoilt(content, count):
    """Contents with one bit flipped anywhere, or cut off anywhere, thirds of them near the beginning and the end."""
    draw = random.Random(7)
    for k in range(count):
        span = [(0, len(content)), (0, 600), (len(content) - 600, len(content))][k % 3]
        place = draw.randrange(*span)
        if k % 4 == 3:
            yield content[:place]
        else:
            yield content[:place] + bytes([content[place] ^ 1 << draw.randrange(8)]) + content[place + 1 :]


def read_mesh(path, scene):
    return read_all(discretize(path, scene.geometry, scene.mesh))


def read_all(nodes):
    return [getattr(nodes, name).tolist() for name in ("coordinates", "volume", "vertices", "cells")] + [
        {name: members.tolist() for name, members in nodes.node_sets.items()}
    ]


def read_nodes(path, scene):
    return read_all(read_discretization(path))


def read_result(path, scene):
    with open_result(path) as opened:
        result = opened.load()
    return [{k: repr(v.values.tolist()) for k, v in result.variables.items()}, result.attrs]


@pytest.mark.parametrize(("name", "read"), [("a.msh", read_mesh), ("a.nc", read_nodes), ("r.nc", read_result)])
@pytest.mark.parametrize("count", [150, pytest.param(4000, marks=pytest.mark.slow)])
def test_a_spoilt_file_is_refused_or_read_right(name, read, count, made, scene, tmp_path):
    content, right, refused = (made / name).read_bytes(), read(made / name, scene), 0
    for wrong in spoilt(content, count):
        (tmp_path / name).write_bytes(wrong)
        try:
            assert read(tmp_path / name, scene) == right
        except PdheError as error:
            assert str(error).startswith(f"{tmp_path / name}: ") and "delete it and run again" in str(error)
            refused += 1
    # Only what follows the content, a part of the seal, can go without a word.
    assert refused > 0.7 * count


def test_a_spoilt_checkpoint_is_never_gone_on_from(scene, tmp_path, monkeypatch):
    monkeypatch.setenv(CADENCE, "0")
    nodes, path, log = lattice_nodes(scene), tmp_path / "r.nc.checkpoint", []
    monkeypatch.setattr(Keeper, "remove", lambda self: None)
    solve_case(scene, nodes, tmp_path / "r.nc")
    content = path.read_bytes()
    monkeypatch.setattr(checkpoint, "_restored", lambda *_: pytest.fail("gone on"))
    wrong = list(spoilt(content, 150))
    for part in wrong:
        path.write_bytes(part)
        assert Keeper(path, identity(scene.resolved(), nodes), log.append).load(None) is None
    assert len(log) == len(wrong) and all("damaged, ignored" in line for line in log)


def test_a_mesh_without_groups_or_of_another_program_is_refused(made, scene, tmp_path):
    path = tmp_path / "foreign.msh"
    gmsh.initialize(argv=[], readConfigFiles=False, run=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addRectangle(0, 0, 0, scene.geometry.width, scene.geometry.height)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()
    with pytest.raises(PdheError, match=r"foreign\.msh: not a usable file .*not written by pdhe.*delete it and run"):
        discretize(path, scene.geometry, scene.mesh)
    wholefile.seal(path)
    with pytest.raises(PdheError, match=r"foreign\.msh: physical group 'plate' is missing or empty; delete the file"):
        discretize(path, scene.geometry, scene.mesh)


@pytest.mark.parametrize("name", ["mesh", "nodes", "solve", "figures", "animate", "history"])
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_while_writing_leaves_nothing_half_written(name, sent, made, tmp_path, capsys, monkeypatch):
    def interrupted(*_, **__):
        os.kill(os.getpid(), sent)

    monkeypatch.setattr(wholefile, "seal", interrupted)
    monkeypatch.setattr(Path, "replace", interrupted)
    before = signal.getsignal(signal.SIGTERM)
    words, _ = words_of(made, name, tmp_path)
    status = cli.main(words)
    told = capsys.readouterr().err
    if name == "solve":
        # One that comes after the last safe point lets the run write its result; here that finds no end.
        assert status in (0, 1, 128 + sent)
    else:
        assert status == 128 + sent and told.startswith("interrupted")
    assert not [path for path in tmp_path.iterdir() if not path.name.endswith(".checkpoint")]
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.fixture
def long_mesh(tmp_path):
    """A mesh under way that one call of gmsh takes 10 s for, and the process that works on it."""
    spec = {
        "geometry": {"plate": {"width": 1.0, "height": 1.0, "thickness": 0.001}},
        "mesh": {"spacing": 0.0012, "cells": "triangle"},
    }
    words = [sys.executable, "-m", "pdhe", "mesh", "--spec", json.dumps(spec), "--out", str(tmp_path / "a.msh")]
    environment = {name: value for name, value in os.environ.items() if name != "PDHE_WARM"}
    with subprocess.Popen(words, cwd=ROOT, stderr=subprocess.PIPE, text=True, env=environment) as command:
        end = time.monotonic() + 60.0
        while not (children := psutil.Process(command.pid).children()):
            assert command.poll() is None and time.monotonic() < end
            time.sleep(0.01)
        time.sleep(0.5)
        yield command, children[0]
        command.kill()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="gmsh works in the same process elsewhere")
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_a_signal_while_gmsh_works_ends_it_at_once(sent, long_mesh, tmp_path):
    command, worker = long_mesh
    begin = time.monotonic()
    command.send_signal(sent)
    _, told = command.communicate(timeout=30)
    worker.wait(30)
    # Measured 0.05 s; all of it would take 10 s.
    assert time.monotonic() - begin < 5.0
    if sent == signal.SIGKILL:
        assert all(PART.fullmatch(path.name) for path in tmp_path.iterdir())
    else:
        assert command.returncode == 128 + sent
        assert told.startswith("interrupted") and not list(tmp_path.iterdir())


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="work is done in the same process elsewhere")
def test_errors_of_work_apart_come_back():
    def raising(error):
        def work():
            raise error

        return work

    for error in (PdheError("no"), MemoryError("none"), OSError(errno.ENOSPC, "No space left", "a place")):
        with pytest.raises(type(error)) as back:
            apart(raising(error))
        assert str(back.value) == str(error)
    with pytest.raises(RuntimeError, match=r"in work(.|\n)*ZeroDivisionError"):
        apart(raising(ZeroDivisionError()))
    with pytest.raises(PdheError, match="ended by SIGKILL; was there enough memory"):
        apart(lambda: os.kill(os.getpid(), signal.SIGKILL))
    assert apart(lambda: None) is None


def test_no_memory_is_told(made, tmp_path, capsys, monkeypatch):
    words, _ = words_of(made, "solve", tmp_path)
    monkeypatch.setattr("pdhe.simulation.build_case", lambda *_: np.empty(1 << 50))
    assert cli.main(words) == 1
    told = capsys.readouterr().err
    assert told.startswith("error: out of memory (Unable to allocate 8.00 PiB") and told.count("\n") == 1
    assert "`pdhe plan SCENE` tells what a run needs" in told and not list(tmp_path.iterdir())


#: Runs a scene, then a larger one with so many more bytes of address space than the process holds after the first.
SHORT_OF_MEMORY = """
import re, resource, sys
from pathlib import Path
from pdhe import cli
scene, folder, room = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
assert cli.main(["run", scene, "--out", str(folder / "first.nc")]) == 0
held = 1024 * int(re.search(r"VmSize:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
resource.setrlimit(resource.RLIMIT_AS, (held + room, held + room))
sys.exit(cli.main(["run", str(folder / "scene.yaml"), "--out", str(folder / "out" / "second.nc")]))
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs the size of a process from /proc")
@pytest.mark.parametrize("room", [60, *(pytest.param(room, marks=pytest.mark.slow) for room in range(10, 250, 15))])
def test_a_limit_of_memory_is_told_and_leaves_nothing(room, tmp_path):
    source = ROOT / "config/scenes/elastic.yaml"
    larger = (
        source.read_text()
        .replace("2.5 mm", "0.4 mm")
        .replace("AISI 4340", str(ROOT / "config/materials/aisi-4340.yaml"))
    )
    (tmp_path / "scene.yaml").write_text(larger)
    (tmp_path / "out").mkdir()
    words = [sys.executable, "-c", SHORT_OF_MEMORY, str(source), str(tmp_path), str(room * 1_000_000)]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, check=False)
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert done.returncode == 1 and len(errors) == 1 and "Traceback" not in done.stderr, done.stderr
    assert "memory" in errors[0]
    assert not [path for path in (tmp_path / "out").iterdir() if path.suffix != ".msh"]


def test_damaged_reports_are_named(tmp_path, capsys):
    (tmp_path / "report.json").write_text('{"topic": ')
    assert cli.main(["verdict", str(tmp_path), "--out", str(tmp_path / "passed.txt")]) == 1
    assert f"{tmp_path / 'report.json'}: not a usable file" in capsys.readouterr().err
    shutil.rmtree(tmp_path)
