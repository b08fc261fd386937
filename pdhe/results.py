"""Results on disk: one NetCDF file per solve, written whole or not at all."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from pdhe.discretization import Discretization
from pdhe.errors import PdheError
from pdhe.fields import field_of

#: Fields that are stored compressed in single precision: their error, 6e-8, is far below that of the model.
SINGLE = {"damage", "coverage"}


class Recorder:
    """Collects snapshots, history rows and broken bonds during a run."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.snapshots: dict[str, list[np.ndarray]] = {}
        self.rows: list[dict[str, float]] = []
        self.broken: list[tuple[np.ndarray, np.ndarray, float]] = []

    def snapshot(self, time: float, **fields: np.ndarray) -> None:
        """Keep copies of the node fields at an output time."""
        self.times.append(time)
        for name, value in fields.items():
            self.snapshots.setdefault(name, []).append(value.copy())

    def row(self, **values: float) -> None:
        """Append one entry to the history."""
        self.rows.append(values)

    def broke(self, i: np.ndarray, j: np.ndarray, time: float) -> None:
        """Note the bonds that broke at a time."""
        self.broken.append((np.asarray(i), np.asarray(j), time))

    def dataset(self, discretization: Discretization, attributes: dict[str, Any]) -> xr.Dataset:
        """Assemble everything into a dataset with units, long names and coordinates."""
        d = discretization
        data: dict[str, np.ndarray] = {
            "time": np.array(self.times),
            "node_x": d.coordinates[:, 0],
            "node_y": d.coordinates[:, 1],
            "volume": d.volume,
            "vertices": d.vertices,
            "cells": d.cells,
        }
        data |= {name: np.stack(values) for name, values in self.snapshots.items()}
        if self.rows:
            data |= {name: np.array([row[name] for row in self.rows], float) for name in self.rows[0]}
        if self.broken:
            data["broken_i"] = np.concatenate([i for i, _, _ in self.broken]).astype(np.int32)
            data["broken_j"] = np.concatenate([j for _, j, _ in self.broken]).astype(np.int32)
            data["broken_time"] = np.concatenate([np.full(i.size, t) for i, _, t in self.broken])
        variables = {}
        for name, values in data.items():
            field = field_of(name)
            variables[name] = (field.dims, values, {"units": field.unit, "long_name": field.long_name})
        sets = {name: nodes.tolist() for name, nodes in d.node_sets.items() if name != "all"}
        coordinates = {
            name: variables.pop(name) for name in ("time", "node_x", "node_y", "history_time") if name in variables
        }
        coordinates |= {"component": ["x", "y"]}
        return xr.Dataset(variables, coordinates, {**attributes, "node_sets": json.dumps(sets)})


def write_dataset(dataset: xr.Dataset, path: str | Path) -> None:
    """Write a dataset next to its place and move it there, so that a file under the final name is always whole."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    encoding: dict[str, dict[str, Any]] = {}
    for name, variable in dataset.data_vars.items():
        if variable.ndim > 1:
            encoding[str(name)] = {"zlib": True, "complevel": 1, "shuffle": True}
        if name in SINGLE:
            encoding[str(name)]["dtype"] = "float32"
    try:
        dataset.to_netcdf(temporary, engine="netcdf4", encoding=encoding)
        temporary.replace(path)
    finally:
        with contextlib.suppress(FileNotFoundError):
            temporary.unlink()


def open_result(path: str | Path) -> xr.Dataset:
    """Open a result file; raise :class:`PdheError` naming the file if it is missing or not a result."""
    if not Path(path).is_file():
        raise PdheError(f"{path}: no such result; run the study first")
    try:
        dataset = xr.open_dataset(path, engine="netcdf4", decode_times=False)
    except Exception as error:
        raise PdheError(f"{path}: cannot be read as a result ({error}); delete it and run again") from error
    if "scene" not in dataset.attrs:
        dataset.close()
        raise PdheError(f"{path}: not a result of pdhe (it holds no scene)")
    return dataset
