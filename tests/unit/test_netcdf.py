"""Files of arrays: what is written is what xarray would write, whole or not at all."""

import json

import numpy as np
import pytest
import xarray as xr

from pdhe.netcdf import Variable, read_netcdf, write_netcdf
from pdhe.results import open_result, write_dataset

VARIABLES = {
    "time": Variable(("time",), np.array([0.0, 1.0]), {"units": "s"}),
    "node_x": Variable(("node",), np.arange(3.0), {"units": "m"}),
    "volume": Variable(("node",), np.array([1.0, np.nan, 2.0]), {"units": "m^3"}),
    "damage": Variable(("time", "node"), np.linspace(0.0, 1.0, 6).reshape(2, 3)),
    "nobody": Variable(("nobody",), np.empty(0, np.int32)),
    "name": Variable(("set",), ["left", "rück"]),
}


def test_round_trip_to_the_bit(tmp_path):
    write_netcdf(
        tmp_path / "deep/file.nc", VARIABLES, {"title": "plate", "count": 3, "length": 0.1}, compressed=["damage"]
    )
    arrays, attributes = read_netcdf(tmp_path / "deep/file.nc")
    assert len(attributes.pop("content_sha256")) == 64
    assert attributes == {"title": "plate", "count": 3, "length": 0.1}
    for name, variable in VARIABLES.items():
        np.testing.assert_array_equal(arrays[name], variable.values)
        assert arrays[name].dtype in (np.asarray(variable.values).dtype, object)
    assert [file.name for file in (tmp_path / "deep").iterdir()] == ["file.nc"]


def test_xarray_finds_the_dataset_it_would_have_written(tmp_path):
    coordinates = ("time", "node_x", "name")
    write_netcdf(tmp_path / "file.nc", VARIABLES, {"title": "plate"}, coordinates)
    expected = xr.Dataset(VARIABLES, attrs={"title": "plate"}).set_coords(coordinates)
    with xr.open_dataset(tmp_path / "file.nc", decode_times=False) as found:
        assert found.attrs.pop("content_sha256")
        xr.testing.assert_identical(found.load(), expected)


def test_result_keeps_its_dataset(tmp_path):
    found = xr.Dataset(
        {"coverage": (("time", "node"), np.full((2, 3), 0.5, np.float32), {"units": "1"})},
        {"time": [0.0, 2.0], "node_x": ("node", np.arange(3.0)), "component": ["x", "y"]},
        {"scene": json.dumps({})},
    )
    write_dataset(found, tmp_path / "result.nc")
    with open_result(tmp_path / "result.nc") as again:
        assert again.attrs.pop("content_sha256")
        xr.testing.assert_identical(again.load(), found)


def test_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "file.nc"
    write_netcdf(path, VARIABLES, {})
    before = path.read_bytes()
    with pytest.raises(ValueError):
        write_netcdf(path, VARIABLES | {"wrong": Variable(("time",), np.array([1j, 2j]))}, {})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
