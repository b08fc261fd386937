"""Every study can be planned, and a study that cannot says why in one message."""

from pathlib import Path

import pytest

FILES = sorted((Path(__file__).parents[2] / "config/studies").glob("*.yaml"))
STUDIES = [path.name for path in FILES if path.name != "tradeoff.yaml"]


@pytest.mark.parametrize("name", STUDIES)
def test_study_can_be_planned(name, pristine):
    plan = pristine.plan("--configfile", f"config/studies/{name}")
    assert plan["solve"] >= 1
    assert plan["report"] == 1


@pytest.mark.parametrize("arguments", [("tradeoff",), ("--configfile", "config/studies/tradeoff.yaml")])
def test_design_can_be_planned(arguments, pristine):
    plan = pristine.plan(*arguments)
    assert plan["trade"] >= 4
    assert plan["tradeoff_page"] == 1
    assert "solve" not in plan


def test_configured_studies_can_be_planned(pristine):
    assert pristine.plan()["solve"] >= 1


def test_figures_alone_leave_the_report_out(pristine):
    assert "report" not in pristine.plan("figures")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mesh.spacing", "mesh.spaceing", "key 'study.sweep.mesh.spaceing'"),
        ("[5 mm, 10 mm]", "[]", "needs a list of at least one value"),
        ("scenes/smoke.yaml", "scenes/smok.yaml", "no such scene file"),
        ("  figures:", "  figurs:", "did you mean 'figures'?"),
        ("[5 mm, 10 mm]", "[5, 10]", "unit"),
    ],
)
def test_bad_study_stops_with_one_message(old, new, message, pristine, tmp_path):
    project = pristine.copy(tmp_path / "project")
    project.edit("config/studies/smoke.yaml", old, new)
    done = project.snakemake("--configfile", "config/studies/smoke.yaml")
    assert done.returncode != 0
    errors = [line for line in done.stderr.splitlines() if "error: " in line]
    assert len(errors) == 1
    assert message in errors[0]
    assert "Traceback" not in done.stdout + done.stderr
    assert not (project.folder / "results").exists()
