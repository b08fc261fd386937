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
        "mesh": 1, "nodes": 1, "scene_material": 1, "solve": 2, "history": 2, "picture": 2, "index": 1, "report": 1,
    }  # fmt: skip
    done = project.snakemake("solutions", "--configfile", STUDY)
    assert done.returncode == 0, done.stdout + done.stderr
    return project


def test_a_solve_is_given_what_was_compiled(solved):
    (library,) = (solved.folder / "results/store/umat").iterdir()
    name, source = load_study(ROOT / STUDY).cases[0].user_material
    assert library.name == f"{name}.so" and source.endswith("config/umat/j2.c")
    content = name.rpartition("-")[2]
    assert library.read_text().startswith(f"umat-build config/umat/j2.c --content {content} --out ")
    for solution in (solved.folder / "results/store/solve").iterdir():
        assert f"--umat results/store/umat/{name}.so" in solution.read_text()


CASES = {
    "nothing": (lambda project: None, {}),
    "sources touched": (lambda project: [path.touch() for path in (project.folder / "config/umat").iterdir()], {}),
    "source": (lambda project: project.edit("config/umat/j2.c", "/*", "/* edited"), {"scene_material": 1, "solve": 2}),
    "another source": (lambda project: project.edit("config/umat/j2.f", "RETURN", "CONTINUE"), {}),
    "property of one": (lambda project: project.edit(STUDY, "350 MPa", "360 MPa"), {"solve": 1}),
    "same property": (lambda project: project.edit(STUDY, "350 MPa", "0.35 GPa"), {}),
    "name of a state variable": (
        lambda project: project.edit(SCENE, "name: plastic_strain", "name: peeq"), {"solve": 2},
    ),
    "a library that is there": (
        lambda project: (
            (project.folder / "mine.so").write_text("library"),
            project.edit(SCENE, "source: config/umat/j2.c", "library: mine.so"),
        ),
        {"solve": 2},
    ),
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
