"""A study as one dataset: dimensions, values, what is missing."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import pdhe
from pdhe.benchmarks.problems import lattice_nodes
from pdhe.errors import PdheError
from pdhe.post import summary
from pdhe.results import open_result
from pdhe.scene import Scene
from pdhe.simulation import solve_case
from pdhe.study import load_study
from pdhe.units import measure

SCENE = str(Path(__file__).parents[2] / "config/scenes/smoke.yaml")


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """Two named cases on two meshes with two settings; the last case is not solved."""
    folder = tmp_path_factory.mktemp("study")
    block = {
        "scene": SCENE,
        "set": {"outputs.count": 3},
        "sweep": {"mesh.spacing": ["10 mm", "20 mm"], "stepping.grouping": [0.05, "20 %"]},
        "cases": {"wet": {}, "dry": {"hydrogen": None}},
    }
    (folder / "trial.yaml").write_text(json.dumps({"study": block}))
    study = load_study(folder / "trial.yaml")
    for case in study.cases[:-1]:
        scene = Scene.from_resolved(case.resolved)
        solve_case(scene, lattice_nodes(scene), folder / f"results/store/solve/{case.solve_id}.nc")
    return study, folder / "results"


def solution(solved, place):
    study, results = solved
    return open_result(results / f"store/solve/{study.cases[place].solve_id}.nc")


def test_swept_keys_are_dimensions_in_si(solved):
    data = pdhe.open_study(*solved)
    assert data.solve.dims == ("case", "spacing", "grouping")
    assert data.case.values.tolist() == ["wet", "dry"]
    assert data.spacing.values.tolist() == [0.01, 0.02] and data.spacing.attrs["units"] == "m"
    assert data.grouping.values.tolist() == [0.05, 0.2] and data.grouping.attrs["units"] == "1"
    assert data.solve.values.ravel().tolist() == [case.solve_id for case in solved[0].cases]
    assert data.status.values.ravel().tolist() == ["complete"] * 7 + ["missing"]


def test_numbers_and_histories_are_those_of_the_solutions(solved):
    data = pdhe.open_study(str(solved[0].file), solved[1])
    for place, chosen in (
        (0, {"case": "wet", "spacing": 0.01, "grouping": 0.05}),
        (3, {"case": "wet", "spacing": 0.02, "grouping": 0.2}),
        (4, {"case": "dry", "spacing": 0.01, "grouping": 0.05}),
    ):
        with solution(solved, place) as result:
            for name, value in summary(result).items():
                if name not in ("title", "status"):
                    assert data[name].sel(chosen).item() == value
            found = data.history_elastic_energy.sel(chosen).values
            steps = result.sizes["step"]
            np.testing.assert_array_equal(found[:steps], result.elastic_energy.values)
            assert np.isnan(found[steps:]).all()
            np.testing.assert_array_equal(data.history_time.sel(chosen).values[:steps], result.history_time.values)
    missing = data.sel(case="dry", spacing=0.02, grouping=0.2)
    assert np.isnan(missing.crack_extension) and np.isnan(missing.history_elastic_energy).all()
    assert np.isnan(data.mean_coverage.sel(case="dry")).all()
    assert data.crack_extension.attrs["units"] == "m" and data.energy_work.attrs["units"] == "J"


def test_fields_come_with_their_nodes_when_asked_for(solved):
    assert "node" not in pdhe.open_study(*solved).sizes
    data = pdhe.open_study(*solved, fields=["damage", "displacement"])
    assert data.damage.dims == ("case", "spacing", "grouping", "time", "node")
    assert data.time.dims == ("time",) and data.component.values.tolist() == ["x", "y"]
    assert data.node_x.dims == ("case", "spacing", "grouping", "node")
    with solution(solved, 2) as result:
        nodes = result.sizes["node"]
        found = data.isel(case=0, spacing=1, grouping=0)
        np.testing.assert_array_equal(found.damage.values[:, :nodes], result.damage.values)
        np.testing.assert_array_equal(found.node_y.values[:nodes], result.node_y.values)
        assert np.isnan(found.damage.values[:, nodes:]).all()


def test_it_can_be_written_and_read_again(solved, tmp_path):
    data = pdhe.open_study(*solved, fields=["coverage"])
    data.to_netcdf(tmp_path / "study.nc")
    with xr.open_dataset(tmp_path / "study.nc", decode_times=False) as again:
        np.testing.assert_array_equal(again.crack_extension.values, data.crack_extension.values)


def test_a_study_without_solutions_or_with_an_unknown_field_is_refused(solved, tmp_path):
    with pytest.raises(PdheError, match=r"trial\.yaml: none of its cases is solved below .*run the study first"):
        pdhe.open_study(solved[0], tmp_path)
    with pytest.raises(PdheError, match="no solution holds 'colour'"):
        pdhe.open_study(*solved, fields=["colour"])


@pytest.mark.parametrize(
    ("sweep", "name", "values", "unit"),
    [
        ({"hydrogen.kernel": ["inverse", "inverse square"]}, "kernel", ["inverse", "inverse square"], None),
        ({"damage": [None]}, "swept_damage", ["none"], None),
        ({"time.end": ["1 Ms", "2e6 s"]}, "end", [1e6, 2e6], "s"),
        ({"material.toughness": ["58.4 MPa m^0.5", "16 kJ/m^2"]}, "toughness", ["58.4 MPa m^0.5", "16 kJ/m^2"], None),
    ],
)
def test_coordinates_of_many_kinds(sweep, name, values, unit):
    from pdhe.collection import _axes
    from pdhe.study import Study

    axes = _axes(Study("trial", "trial.yaml", (), sweep=sweep))
    assert list(axes) == [name]
    assert axes[name].values.tolist() == values
    assert axes[name].attributes.get("units") == unit


def test_units_of_any_quantity():
    assert measure("7 mm") == (0.007, "m")
    assert measure("58.4 MPa m^0.5") == (58.4e6, "Pa m^0.5")
    assert measure("3 m^3") == (3.0, "m^3")
    assert measure("1e-5") == (1e-5, "1")
    assert measure("20 %") == (0.2, "1")


def test_importing_the_package_loads_nothing():
    code = "import sys, pdhe; assert 'xarray' not in sys.modules and 'numpy' not in sys.modules; pdhe.open_study"
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = pdhe.nothing
