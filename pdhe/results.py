"""Results on disk: one NetCDF file per solve, written whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.discretization import Discretization
from pdhe.errors import PdheError
from pdhe.fields import field_of
from pdhe.netcdf import Variable, check_netcdf, write_netcdf

if TYPE_CHECKING:
    import xarray as xr

#: Fields that are stored compressed in single precision: their error, 6e-8, is far below that of the model.
SINGLE = {"damage", "coverage"}
#: What the name of a checkpoint has after that of the result.
CHECKPOINT = ".checkpoint"
#: What that of a result that stops early has: nothing that looks for results by their ending takes it for one.
INCOMPLETE = ".incomplete"
COORDINATES = ("time", "node_x", "node_y", "node_z", "history_time", "component", "entry")
#: Components of a stress, by their number.
ENTRIES = {3: ["11", "22", "12"], 4: ["11", "22", "33", "12"], 6: ["11", "22", "33", "12", "13", "23"]}


@dataclass(frozen=True)
class Contents:
    """What a result file holds."""

    variables: dict[str, Variable]
    attributes: dict[str, Any]

    def dataset(self) -> xr.Dataset:
        """Return them as a dataset with units, long names and coordinates."""
        import xarray as xr

        coordinates = {name: self.variables[name] for name in COORDINATES if name in self.variables}
        variables = {name: variable for name, variable in self.variables.items() if name not in coordinates}
        return xr.Dataset(variables, coordinates, self.attributes)

    def write(self, path: str | Path) -> None:
        """Write the file; it appears complete or not at all. Arrays of several dimensions are compressed."""
        several = [name for name, variable in self.variables.items() if np.ndim(variable.values) > 1]
        known = [name for name in COORDINATES if name in self.variables]
        write_netcdf(path, self.variables, self.attributes, known, several, SINGLE)


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

    def contents(
        self, discretization: Discretization, attributes: dict[str, Any], units: Mapping[str, str] | None = None
    ) -> Contents:
        """Assemble everything, with units, long names and coordinates.

        ``units`` are those of variables whose declaration leaves them to the scene.
        """
        d = discretization
        data: dict[str, np.ndarray] = {
            "time": np.array(self.times),
            "node_x": d.coordinates[:, 0],
            "node_y": d.coordinates[:, 1],
            **({"node_z": d.coordinates[:, 2]} if d.dimension == 3 else {}),
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
            unit = (units or {}).get(name, field.unit)
            variables[name] = Variable(field.dims, values, {"units": unit, "long_name": field.long_name})
        if "stress" in data:
            variables["entry"] = Variable(("entry",), ENTRIES[data["stress"].shape[-1]])
        variables["component"] = Variable(("component",), ["x", "y", "z"][: d.dimension])
        sets = {name: nodes.tolist() for name, nodes in d.node_sets.items() if name != "all"}
        return Contents(variables, {**attributes, "node_sets": json.dumps(sets)})


def write_dataset(dataset: xr.Dataset, path: str | Path) -> None:
    """Write a dataset of a run as :meth:`Contents.write` does."""
    variables = {
        str(name): Variable(tuple(map(str, variable.dims)), variable.values, variable.attrs)
        for name, variable in dataset.variables.items()
    }
    Contents(variables, dict(dataset.attrs)).write(path)


def open_result(path: str | Path) -> xr.Dataset:
    """Open a result file; raise :class:`PdheError` naming the file if it is missing, damaged or not a result."""
    import xarray as xr

    if not Path(path).is_file():
        raise PdheError(f"{path}: no such result; run the study first")
    try:
        check_netcdf(path)
        dataset = xr.open_dataset(path, engine="netcdf4", decode_times=False)
    except Exception as error:
        raise PdheError(f"{path}: cannot be read as a result ({error}); delete it and run again") from error
    if "scene" not in dataset.attrs:
        dataset.close()
        raise PdheError(f"{path}: not a result of pdhe (it holds no scene)")
    return dataset
