"""A study of so many small cases that they share processes: what fails is alone, and what changes is repeated alone."""

import json

import pytest

from pdhe.stamps import table_of

CONFIG = "config/studies/many.yaml"
TOLERANCES = [1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6, 7e-6]


def write_study(project, **cases):
    study = {
        "name": "many",
        "scene": "config/scenes/smoke.yaml",
        "set": {"mesh.spacing": "20 mm", "hydrogen": None, "outputs.count": 2},
        "cases": {f"t{k}": {"solver.tolerance": tolerance} for k, tolerance in enumerate(TOLERANCES)} | cases,
        "figures": {"pictures": [], "animations": False},
    }
    (project.folder / CONFIG).write_text(json.dumps({"study": study}))


@pytest.fixture(scope="module")
def computed(pristine, tmp_path_factory):
    """Seven cases that can be solved and one that cannot: one iteration does not reach equilibrium."""
    project = pristine.copy(tmp_path_factory.mktemp("many") / "project")
    write_study(project, stuck={"solver.max_iterations": 1})
    done = project.snakemake("--configfile", CONFIG, "--", "results/many/cases.csv")
    assert done.returncode != 0
    return project


def solutions(project):
    return {path.name: path.stat().st_mtime_ns for path in (project.folder / "results/store/solve").glob("*.nc")}


def test_a_failure_stays_alone_and_is_repeated_alone(computed):
    assert len(solutions(computed)) == len(TOLERANCES)
    logs = [path.read_text() for path in (computed.folder / "logs/solve").glob("*.log")]
    assert sum("equilibrium not reached" in text for text in logs) == 1
    assert sum(text.startswith("scene:") for text in logs) == len(TOLERANCES) + 1
    assert computed.plan("--configfile", CONFIG, "--", "results/many/cases.csv") == {"solve": 1, "index": 1}


def test_an_edited_case_is_repeated_alone(computed):
    before = solutions(computed)
    write_study(computed, stuck={"solver.tolerance": 8e-6})
    done = computed.snakemake("--configfile", CONFIG, "--", "results/many/cases.csv")
    assert done.returncode == 0, done.stdout + done.stderr
    after = solutions(computed)
    assert before.items() < after.items() and len(after) == len(before) + 1
    rows = table_of(computed.folder / "results/many/cases.csv")
    assert [row["status"] for row in rows] == ["complete"] * (len(TOLERANCES) + 1)
    write_study(computed, stuck={"solver.tolerance": 8e-6}, more={"solver.tolerance": 9e-6})
    assert computed.plan("--configfile", CONFIG, "--", "results/many/cases.csv") == {"solve": 1, "index": 1}


def test_an_unknown_case_is_named(computed):
    done = computed.snakemake("-n", "--configfile", CONFIG, "--", "results/many/nobody/history.csv")
    assert done.returncode != 0
    assert "the study 'many' has no case 'nobody'" in done.stdout + done.stderr
