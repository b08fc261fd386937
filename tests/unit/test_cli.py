"""The command line: what it says, and how it ends."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pdhe import cli
from pdhe.errors import PdheError

ROOT = Path(__file__).parents[2]
SCENE = str(ROOT / "config/scenes/smoke.yaml")
PLATE = {"geometry": {"plate": {"width": 0.04, "height": 0.02, "thickness": 0.001}}, "mesh": {"spacing": 0.005}}


def test_help_comes_at_once():
    times = []
    for _ in range(3):
        before = os.times()
        done = subprocess.run([sys.executable, "-m", "pdhe", "--help"], capture_output=True, text=True, cwd=ROOT)
        after = os.times()
        # Time of the processor: that on the clock depends on what else the machine does.
        times.append(after.children_user + after.children_system - before.children_user - before.children_system)
    assert done.returncode == 0
    for command in ("mesh", "nodes", "solve", "run", "plan", "validate", "schema", "figures", "animate", "history"):
        assert f"\n    {command}" in done.stdout
    assert min(times) < 0.3  # 0.08 s measured


def test_help_loads_nothing_heavy():
    code = "import sys, pdhe.cli; assert not {'numpy', 'pydantic', 'yaml', 'pint'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_version(capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out.startswith("pdhe ")


@pytest.mark.parametrize("arguments", [[], ["unknown"], ["solve"], ["figures", "--kind", "colour"]])
def test_wrong_usage_ends_with_2(arguments, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(arguments)
    assert stop.value.code == 2
    assert "usage: pdhe" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["validate", "nowhere.yaml"], "nowhere.yaml"),
        (["plan", "nowhere.yaml"], "nowhere.yaml"),
        (["mesh", "--spec", "{", "--out", "x.msh"], "--spec is not JSON"),
        (["mesh", "--spec", "[]", "--out", "x.msh"], "--spec needs a JSON object"),
        (["mesh", "--spec", "{}", "--out", "x.msh"], "no block 'geometry'"),
        (["mesh", "--spec", '{"geometry": {}, "mesh": {}}', "--out", "x.msh"], "plate"),
        (["history", "--result", "x.nc"], "nothing to write"),
        (["schema", "--out", "/dev/null/schema.json"], "/dev/null"),
    ],
)
def test_errors_are_explained_on_one_line(arguments, text, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert cli.main(arguments) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert text in shown.err
    assert all(line.startswith("error: ") for line in shown.err.splitlines())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("raised", "status"), [(PdheError("no"), 1), (KeyboardInterrupt(), 130)])
def test_status_tells_errors_from_interruptions(raised, status, monkeypatch):
    def stop(*_):
        raise raised

    monkeypatch.setattr("pdhe.scene.scene_json_schema", stop)
    assert cli.main(["schema"]) == status


def test_programming_errors_keep_their_traceback(monkeypatch):
    monkeypatch.setattr("pdhe.scene.scene_json_schema", lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cli.main(["schema"])


def test_validate_goes_through_every_file(capsys, tmp_path):
    bad = tmp_path / "bad.yaml"
    bad.write_text("title: nothing else\n")
    assert cli.main(["validate", SCENE]) == 0
    assert cli.main(["validate", str(bad), SCENE]) == 1
    shown = capsys.readouterr()
    assert shown.out.count("smoke.yaml: scene") == 2
    assert "bad.yaml" in shown.err
    assert "1 of 2" in shown.err


def test_schema_is_json(capsys):
    assert cli.main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out)["title"]


def test_mesh_and_nodes_are_written(tmp_path):
    mesh, nodes = tmp_path / "a/plate.msh", tmp_path / "b/plate.nc"
    assert cli.main(["mesh", "--spec", json.dumps(PLATE), "--out", str(mesh)]) == 0
    assert cli.main(["nodes", "--spec", json.dumps(PLATE), "--mesh", str(mesh), "--out", str(nodes)]) == 0
    assert nodes.stat().st_size > 0


def test_index_lists_the_cases(capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert cli.main(["index", "config/studies/smoke.yaml"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("case,scene,mesh,solve,")
    assert len(lines) == 5
