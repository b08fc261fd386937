"""What is computed again after an edit, and what is not.

Every case edits a copy of a finished project and asks Snakemake for its plan. The smoke study has the cases wet and
dry on two meshes; a wet case has three pictures, a dry one two.
"""

import shutil

import pytest

SCENE = "config/scenes/smoke.yaml"
STUDY = "config/studies/smoke.yaml"
ALL_FIGURES = {"picture": 10, "animation": 10, "history": 4, "report": 1}
ALL_SOLVES = {"solve": 4, "index": 1, **ALL_FIGURES}
TABLE_ONLY = {"index": 1, "report": 1}


def touch_everything(project):
    for pattern in ("pdhe/**/*.py", "workflow/**/*", "Snakefile", "config/**/*.yaml", "results/store/**/*"):
        for path in project.folder.glob(pattern):
            if path.is_file():
                path.touch()


def add_sharing_study(project):
    text = "study:\n  name: other\n  scene: config/scenes/smoke.yaml\n  set: {mesh.spacing: 1 cm}\n"
    (project.folder / "config/studies/other.yaml").write_text(text)
    project.edit("config/config.yaml", "smoke.yaml", "smoke.yaml, config/studies/other.yaml")


def edit(file, old, new):
    return lambda project: project.edit(file, old, new)


def append(file, line="CHANGED = True"):
    def change(project):
        with (project.folder / file).open("a") as stream:
            stream.write(line + "\n")

    return change


def remove(pattern):
    def change(project):
        paths = list(project.folder.glob(pattern))
        assert paths
        for path in paths:
            path.unlink()

    return change


CASES = {
    "nothing": (lambda project: None, {}),
    "every file touched": (touch_everything, {}),
    "title of the scene": (edit(SCENE, "title: ", "title: Once more, "), {}),
    "source of a material value": (edit("config/materials/aisi-4340.yaml", "source:", "source: # cited"), {}),
    "same time in another unit": (edit(SCENE, "1.2e7 s", "12 Ms"), {}),
    "default written out": (edit(STUDY, "  sweep:", "  set: {horizon.ratio: 3.015}\n  sweep:"), {}),
    "comment in a kernel": (append("pdhe/kernels/mechanics.py", "# a comment"), {}),
    "docstring of a kernel": (edit("pdhe/kernels/mechanics.py", '"""', '"""Reworded: '), {}),
    "command line code": (edit("pdhe/cli.py", "return 0", "return 0 or 0"), {}),
    "study code": (edit("pdhe/study.py", "SPEC_LIMIT = 100_000", "SPEC_LIMIT = 110_000"), {}),
    "log path": (edit("workflow/rules/solve.smk", "logs/solve/", "logs/solving/"), {}),
    "memory of a rule": (
        edit("workflow/rules/solve.smk", "mem_mb=solve_memory", "mem_mb=9"),
        {},
    ),
    "caption": (append("workflow/report/picture.rst", "More."), {"report": 1}),
    "sweep reordered": (edit(STUDY, "[5 mm, 10 mm]", "[10 mm, 5 mm]"), TABLE_ONLY),
    "sweep value removed": (edit(STUDY, "[5 mm, 10 mm]", "[5 mm]"), TABLE_ONLY),
    "sweep value added": (
        edit(STUDY, "[5 mm, 10 mm]", "[4 mm, 5 mm, 10 mm]"),
        {"mesh": 1, "nodes": 1, "solve": 2, "picture": 5, "animation": 5, "history": 2} | TABLE_ONLY,
    ),
    "parameter of two cases": (
        edit(STUDY, "wet: {}", "wet: {hydrogen.kernel: inverse}"),
        {"solve": 2, "picture": 6, "animation": 6, "history": 2} | TABLE_ONLY,
    ),
    "parameter of all cases": (edit(STUDY, "  sweep:", "  set: {time.end: 13 Ms}\n  sweep:"), ALL_SOLVES),
    "case renamed": (
        edit(STUDY, "wet: {}", "moist: {}"),
        {"picture": 6, "animation": 6, "history": 2} | TABLE_ONLY,
    ),
    "study that shares a case": (
        add_sharing_study,
        {"picture": 3, "animation": 3, "history": 1} | TABLE_ONLY,
    ),
    "style of a study": (edit(STUDY, "dpi: 80", "dpi: 90"), {"picture": 10, "animation": 10, "report": 1}),
    "style that the study overrides": (edit("config/config.yaml", "dpi: 100", "dpi: 110"), {}),
    "plotting code": (append("pdhe/plotting/layout.py"), ALL_FIGURES),
    "kernel code": (append("pdhe/kernels/mechanics.py"), ALL_SOLVES),
    "mesh code": (
        append("pdhe/mesh.py"),
        {"mesh": 2, "nodes": 2, **ALL_SOLVES},
    ),
    "solve command": (edit("workflow/rules/solve.smk", "pdhe solve", "pdhe  solve"), ALL_SOLVES),
    "results on one mesh deleted": (
        remove("results/store/solve/*-5mm-*.nc"),
        {"solve": 2, "picture": 5, "animation": 5, "history": 2} | TABLE_ONLY,
    ),
    "picture deleted": (remove("results/smoke/wet_spacing=5mm/damage.png"), {"picture": 1, "report": 1}),
    "report deleted": (remove("results/report.html"), {"report": 1}),
}


@pytest.mark.parametrize("name", CASES)
def test_edit_plans_only_what_it_changes(name, finished, tmp_path):
    change, expected = CASES[name]
    project = finished.copy(tmp_path / "project")
    change(project)
    assert project.plan() == expected


def test_first_run_plans_everything(pristine):
    plan = pristine.plan("--configfile", STUDY)
    assert plan == {"mesh": 2, "nodes": 2, **ALL_SOLVES}


def test_threads_ask_for_nothing_again(finished):
    assert finished.plan("--set-threads", "solve=2") == {}


def test_value_put_back_finds_its_solution(finished, tmp_path):
    project = finished.copy(tmp_path / "project")
    project.edit(STUDY, "wet: {}", "wet: {hydrogen.kernel: inverse}")
    assert project.snakemake().returncode == 0
    project.edit(STUDY, "wet: {hydrogen.kernel: inverse}", "wet: {}")
    assert project.plan() == {"picture": 6, "animation": 6, "history": 2} | TABLE_ONLY


def test_store_copied_to_another_place_is_used(finished, pristine, tmp_path):
    """Results without Snakemake's records, as after copying results/store to another machine."""
    project = pristine.copy(tmp_path / "project")
    shutil.copytree(finished.folder / "results/store", project.folder / "results/store")
    assert project.plan("--configfile", STUDY) == {**ALL_FIGURES, "index": 1}
