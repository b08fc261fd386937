"""Half of the smoke study with its real steps: everything it promises is there, and a second run has nothing to do."""

import csv

import pytest
import xarray as xr
from PIL import Image

from pdhe import cli
from pdhe.stamps import read, table_of


@pytest.fixture(scope="module")
def computed(pristine, tmp_path_factory):
    project = pristine.copy(tmp_path_factory.mktemp("computed") / "project")
    project.edit("config/studies/smoke.yaml", "[5 mm, 10 mm]", "[10 mm]")
    done = project.snakemake("--configfile", "config/studies/smoke.yaml")
    assert done.returncode == 0, done.stdout + done.stderr
    return project


def test_every_case_has_its_files(computed):
    results = computed.folder / "results"
    for case, kinds in {"wet": ("damage", "displacement", "coverage"), "dry": ("damage", "displacement")}.items():
        folder = results / "smoke" / f"{case}_spacing=10mm"
        expected = {f"{kind}.{end}" for kind in kinds for end in ("png", "gif")} | {"history.csv", "history.png"}
        assert {path.name for path in folder.iterdir()} == expected
        for kind in kinds:
            with Image.open(folder / f"{kind}.gif") as animation:
                assert animation.n_frames > 3
            with Image.open(folder / f"{kind}.png") as picture:
                assert min(picture.size) > 100


def test_stages_are_shared(computed):
    store = computed.folder / "results/store"
    assert {stage: len(list((store / stage).iterdir())) for stage in ("mesh", "nodes", "solve")} == {
        "mesh": 1,
        "nodes": 1,
        "solve": 2,
    }


def test_solutions_say_what_made_them(computed):
    for path in (computed.folder / "results/store/solve").glob("*.nc"):
        with xr.open_dataset(path) as solution:
            assert solution.attrs["status"] == "complete"
            assert {"scene", "code_fingerprint", "versions"} <= set(solution.attrs)
            assert float(solution["damage"][-1].max()) > 0.0


def test_histories_are_tables(computed):
    for path in computed.folder.glob("results/smoke/*/history.csv"):
        made, text = read(path.read_text(), ".csv")
        assert made["command"].startswith("pdhe history --result") and '"geometry"' in made["scene"]
        rows = list(csv.reader(text.splitlines()))
        assert len(rows) > 5
        assert len({len(row) for row in rows}) == 1


def test_report_holds_every_picture_and_loads_nothing(computed):
    report = (computed.folder / "results/smoke/report.html").read_text()
    assert report.count("data:image/png;") == 7
    assert report.count("data:image/gif;") == 5
    assert '<script src="http' not in report
    assert read(report, ".html")[0]["module"] == "pdhe.study"


def test_all_that_is_there_matches(computed, monkeypatch, capsys):
    monkeypatch.chdir(computed.folder)
    assert cli.main(["verify"]) == 0
    # A mesh, its nodes, two solutions; two histories, the table of cases, the report.
    assert capsys.readouterr().out == "8 file(s) match\n"


def test_second_run_has_nothing_to_do(computed):
    assert computed.plan("--configfile", "config/studies/smoke.yaml") == {}


def test_table_of_cases_tells_how_they_ended(computed):
    rows = table_of(computed.folder / "results/smoke/cases.csv")
    assert [row["case"] for row in rows] == ["wet_spacing=10mm", "dry_spacing=10mm"]
    assert float(rows[0]["crack_extension"]) > 0.0
    assert float(rows[1]["crack_extension"]) == 0.0  # 0.02 mm on either side does not move a crack in dry steel
