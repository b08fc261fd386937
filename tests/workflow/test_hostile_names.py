"""Names, titles and paths that a shell would take for commands: they stay words, or are refused in one message."""

import json
import shutil
import subprocess

import pytest

from pdhe.errors import SceneError
from pdhe.study import load_study
from pdhe.tradeoff.design import load_design

FOLDER = """a 'b' "c" $(touch made) `touch made`; touch made & Straße"""
STUDY = """config/Größe 'x' "y" $(touch made);touch made.yaml"""
SCENE = """config/scenes/it's $(touch made).yaml"""
WORDS = """'; touch made; echo "$(touch made)" `touch made` {x} {params.spec} %s \\ <b>ä</b>"""


@pytest.fixture(scope="module")
def hostile(pristine, tmp_path_factory):
    """The smallest study with everything that is free to choose chosen badly, computed with its report.

    It has no network, where this process may start another one without.
    """
    project = pristine.copy(tmp_path_factory.mktemp("hostile") / FOLDER)
    shutil.copy(project.folder / "config/scenes/smoke.yaml", project.folder / SCENE)
    study = {
        "name": "plain",
        "scene": SCENE,
        "set": {"title": WORDS, "material.name": WORDS, "mesh.spacing": "20 mm", "outputs.count": 2, "hydrogen": None},
        "figures": {"pictures": ["damage"], "animations": False, "dpi": 40},
    }
    (project.folder / STUDY).write_text(json.dumps({"study": study}), encoding="utf-8")
    return project


def test_a_study_is_planned_and_computed(hostile, monkeypatch):
    assert hostile.plan("--configfile", STUDY)["solve"] == 1
    alone = ["unshare", "--user", "--map-root-user", "--net"]
    run = subprocess.run
    if shutil.which("unshare") and run([*alone, "true"], capture_output=True, check=False).returncode == 0:
        monkeypatch.setattr(subprocess, "run", lambda command, **settings: run([*alone, *command], **settings))
    done = hostile.snakemake("--configfile", STUDY)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (hostile.folder / "results/plain/report.html").is_file()
    assert hostile.plan("--configfile", STUDY) == {}


def test_nothing_was_run_by_a_name(hostile):
    assert not list(hostile.folder.parent.rglob("made"))


@pytest.mark.parametrize(
    ("file", "content", "key"),
    [
        ("study", {"study": {"name": WORDS, "scene": SCENE}}, "study.name"),
        ("study", {"study": {"name": "../up", "scene": SCENE}}, "study.name"),
        ("study", {"study": {"name": "--help", "scene": SCENE}}, "study.name"),
        ("study", {"study": {"name": "verification", "scene": SCENE}}, "study.name"),
        ("study", {"study": {"scene": SCENE, "cases": {"$(touch made)": {}}}}, "study.cases.$(touch made)"),
        ("study", {"study": {"scene": SCENE, "sweep": {"$(touch made)": [1]}}}, "study.sweep.$(touch made)"),
        ("study", {"study": {"scene": SCENE, "figures": {"$(touch made)": 1}}}, "study.figures.$(touch made)"),
        ("design", {"tradeoff": {"$(touch made)": {"scene": SCENE}}}, "tradeoff.$(touch made)"),
        ("design", {"tradeoff": {"../up": {"scene": SCENE}}}, "tradeoff.../up"),
    ],
)
def test_what_names_a_folder_is_refused(file, content, key, hostile, tmp_path, monkeypatch):
    path = tmp_path / f"{file}.yaml"
    path.write_text(json.dumps(content), encoding="utf-8")
    monkeypatch.chdir(hostile.folder)
    with pytest.raises(SceneError) as refusal:
        load_design(path) if file == "design" else load_study(path)
    assert f"key '{key}" in str(refusal.value)
