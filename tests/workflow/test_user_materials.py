"""User materials in the workflow: compiled once for all cases that share a source, and again when it changes."""

import pytest

from pdhe.study import load_study
from tests.workflow.conftest import ROOT, STUB

STUDY = "config/studies/plasticity.yaml"
SCENE = "config/scenes/plastic_hole.yaml"


@pytest.fixture(scope="module")
def solved(pristine, tmp_path_factory):
    """The study with stand-in steps, its solutions computed."""
    project = pristine.copy(tmp_path_factory.mktemp("solved") / "project")
    (project.folder / "pdhe" / "cli.py").write_text(STUB)
    assert project.plan("--configfile", STUDY) == {
        "mesh": 1, "nodes": 1, "scene_material": 2, "solve": 3, "history": 3, "picture": 7, "index": 1, "report": 1,
    }  # fmt: skip
    done = project.snakemake("solutions", "--configfile", STUDY)
    assert done.returncode == 0, done.stdout + done.stderr
    return project


def test_a_solve_is_given_what_was_compiled(solved):
    made = {path.name: path.read_text() for path in (solved.folder / "results/store/umat").iterdir()}
    cases = load_study(ROOT / STUDY).cases
    assert made.keys() == {f"{case.user_material[0]}.so" for case in cases} and len(made) == 2
    for case in cases:
        name, source = case.user_material
        source = source.removeprefix(f"{ROOT}/")
        assert made[f"{name}.so"].startswith(f"umat-build {source} --content {name.rpartition('-')[2]} --out ")
        solution = solved.folder / f"results/store/solve/{case.solve_id}.nc"
        assert f"--umat results/store/umat/{name}.so" in solution.read_text()


def touch_and_reword(project):
    """Times of sources, a source that no case has, and the same property in another unit."""
    for path in (project.folder / "config/umat").iterdir():
        path.touch()
    project.edit("config/umat/j2.f", "RETURN", "CONTINUE")
    project.edit(STUDY, "350 MPa", "0.35 GPa")


def give_a_library(project):
    (project.folder / "mine.so").write_text("library")
    project.edit(SCENE, "source: config/umat/j2.c", "library: mine.so")
    project.edit(STUDY, "source: config/umat/j2_hydrogen.c", "library: mine.so")


CASES = {
    "nothing that counts": (touch_and_reword, {}),
    "source": (lambda project: project.edit("config/umat/j2.c", "/*", "/* edited"), {"scene_material": 2, "solve": 3}),
    "including source": (
        lambda project: project.edit("config/umat/j2_hydrogen.c", "/*", "/* edited"), {"scene_material": 1, "solve": 1},
    ),
    "property of one": (lambda project: project.edit(STUDY, "350 MPa", "360 MPa"), {"solve": 1}),
    "a library that is there": (give_a_library, {"solve": 3}),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_what_is_computed_again(name, solved, tmp_path):
    change, expected = CASES[name]
    project = solved.copy(tmp_path / "project")
    change(project)
    found = project.plan("solutions", "--configfile", STUDY)
    found.pop("solutions", None)
    found.pop("index", None)
    assert found == expected
