"""A study as one dataset, with what it sweeps as dimensions."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from pdhe.errors import PdheError
from pdhe.fields import FIELDS
from pdhe.netcdf import Variable
from pdhe.post import summary
from pdhe.results import open_result
from pdhe.study import Study, labels, load_study, text_of
from pdhe.units import QuantityError, measure

#: Variables of a solution that depend on its mesh or its output times alone; they stand once where all cases agree.
STATIC = ("time", "node_x", "node_y", "node_z", "volume", "component")
COORDINATES = ("history_time", "snapshot_time", *STATIC)
#: Names that a dimension of a swept key cannot have: those of dimensions and variables of solutions.
TAKEN = {
    "case",
    "step",
    "node",
    "component",
    "vertex",
    "corner",
    "broken",
    "solve",
    "status",
    "nodes",
    "damage",
    *STATIC,
}


def open_study(study: str | Path | Study, results: str | Path = "results", fields: Sequence[str] = ()) -> xr.Dataset:
    """Gather the solutions of a study in memory.

    Every swept key is a dimension, named as in the names of the cases, with its values in SI as its coordinate; named
    cases make up a further dimension ``case``. The variables are the numbers that sum up a solution, as in
    ``cases.csv``, the histories over ``step``, named ``history_...``, and the fields that are asked for.

    Parameters
    ----------
    study
        Study file, or a study that was read.
    results
        Folder of results of the workflow.
    fields
        Further variables of the solutions, for example ``damage``. Each takes its memory for every case: 2 MB for 13
        outputs of 20,000 nodes.

    Returns
    -------
    xarray.Dataset
        SI, with units and long names. Nodes, volumes and output times stand once where all cases agree in them. What
        has another length in another case (steps, nodes of another mesh) is filled up with NaN at its end; output times
        are then ``snapshot_time``. ``status`` is ``missing`` where a case is not solved yet, its numbers are NaN.
        ``solve`` names the solution.

    Raises
    ------
    SceneError
        If the study cannot be used.
    PdheError
        If no case is solved yet, a file is damaged or no solution holds a field that is asked for.
    """
    study = study if isinstance(study, Study) else load_study(study)
    paths = {case.solve_id: Path(results, "store", "solve", f"{case.solve_id}.nc") for case in study.cases}
    solutions = {name: _variables(path, fields) for name, path in paths.items() if path.is_file()}
    if not solutions:
        raise PdheError(f"{study.file}: none of its cases is solved below {results}; run the study first")
    for name in fields:
        if not any(name in variables for variables in solutions.values()):
            raise PdheError(f"{study.file}: no solution holds '{name}'")
    axes = _axes(study)
    dims, shape = tuple(axes), tuple(len(axis.values) for axis in axes.values())
    cases = [solutions.get(case.solve_id, {}) for case in study.cases]
    ends = [str(case["status"].values) if case else "missing" for case in cases]
    data = {
        "solve": Variable(dims, _words([case.solve_id for case in study.cases], shape), {"long_name": "solution"}),
        "status": Variable(dims, _words(ends, shape), {"long_name": "how the run ended"}),
    }
    lengths: dict[str, int] = {}
    for variable in (variable for case in cases for variable in case.values()):
        for dim, length in zip(variable.dims, np.shape(variable.values), strict=True):
            lengths[dim] = max(length, lengths.get(dim, 0))
    for name in dict.fromkeys(name for case in cases for name in case if name != "status"):
        found = {place: case[name] for place, case in enumerate(cases) if name in case}
        first = next(iter(found.values()))
        if name in STATIC and all(np.array_equal(first.values, other.values) for other in found.values()):
            data[name] = first
            continue
        array = np.full((len(cases), *(lengths[dim] for dim in first.dims)), np.nan)
        for place, variable in found.items():
            array[(place, *map(slice, variable.values.shape))] = variable.values
        new = "snapshot_time" if name == "time" else name
        data[new] = Variable((*dims, *first.dims), array.reshape(*shape, *array.shape[1:]), first.attributes)
    coordinates = {name: data.pop(name) for name in COORDINATES if name in data}
    return xr.Dataset(data, {**axes, **coordinates}, {"title": study.name, "study": study.file})


def _variables(path: Path, fields: Sequence[str]) -> dict[str, Variable]:
    """Return what a solution contributes: its summary, its history, and fields with the nodes they belong to."""
    with open_result(path) as result:
        numbers = {name: value for name, value in summary(result).items() if name != "title"}
        variables = {name: Variable((), np.asarray(value), _described(name)) for name, value in numbers.items()}
        held = {str(name): variable for name, variable in result.variables.items()}
        met = {dim for name in fields if name in held for dim in held[name].dims}
        for name, variable in held.items():
            if variable.dims == ("step",):
                kept = f"history_{name.removeprefix('history_')}"
            elif name in fields or (name in STATIC and set(variable.dims) <= met):
                kept = name
            else:
                continue
            variables[kept] = Variable(tuple(map(str, variable.dims)), variable.values, variable.attrs)
    return variables


def _described(name: str) -> dict[str, str]:
    """Return unit and meaning of a number that sums up a solution."""
    field = FIELDS.get(name)
    if field is not None:
        return {"units": field.unit, "long_name": f"{field.long_name}, at the end"}
    units = {"end_time": "s", "growth_start": "s", "growth_end": "s", "crack_speed": "m/s", "crack_direction": "deg"}
    unit = "J" if name.startswith("energy_") else units.get(name, "1")
    return {"units": unit, "long_name": name.replace("_", " ")}


def _axes(study: Study) -> dict[str, Variable]:
    """Return the dimensions in the order of the cases, each with its coordinate."""
    axes = {}
    if study.named:
        axes["case"] = Variable(("case",), _words(study.named), {"long_name": "named case"})
    for key, label in labels(study.sweep).items():
        name = f"swept_{key.replace('.', '_')}" if label in TAKEN else label
        values, unit = _numbers(study.sweep[key])
        axes[name] = Variable((name,), values, {"long_name": key} | ({"units": unit} if unit else {}))
    return axes


def _numbers(given: Sequence[object]) -> tuple[np.ndarray, str | None]:
    """Return swept values as SI numbers of one unit; as words where they are anything else."""
    numbers: list[tuple[float, str]] = []
    for value in given:
        if isinstance(value, int | float) and not isinstance(value, bool):
            numbers.append((float(value), "1"))
        elif isinstance(value, str):
            with contextlib.suppress(QuantityError):
                numbers.append(measure(value))
    if len(numbers) == len(given) and len({unit for _, unit in numbers}) == 1:
        return np.array([value for value, _ in numbers]), numbers[0][1]
    return _words([value if isinstance(value, str) else text_of(value) for value in given]), None


def _words(words: Sequence[str], shape: tuple[int, ...] = (-1,)) -> np.ndarray:
    array = np.empty(len(words), object)
    array[:] = words
    return array.reshape(shape)
