"""NetCDF files of named arrays, written whole or not at all.

They are written and read with netCDF4 itself: importing xarray takes longer than solving a small scene. What it would
write, it reads: the coordinates of a variable are named as the CF conventions ask.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pdhe.wholefile import intact, moved_when_whole, why_not_written

CONTENT = "content_sha256"
"""Attribute of a file with the digest of all the rest of it."""
CHANGED = "its content has changed since it was written"


class Variable(NamedTuple):
    """An array with the names of its dimensions and its attributes; xarray takes such a tuple as it is."""

    dims: tuple[str, ...]
    values: Any
    attributes: Mapping[str, Any] = {}


def write_netcdf(
    path: str | os.PathLike[str],
    variables: Mapping[str, Variable],
    attributes: Mapping[str, Any],
    coordinates: Collection[str] = (),
    compressed: Collection[str] = (),
    single: Collection[str] = (),
) -> None:
    """Write a NetCDF-4 file next to its place and move it there, so that a file under the final name is always whole.

    Parameters
    ----------
    path
        File; its folder is made.
    variables
        Arrays of numbers or of ``str`` objects; equal names of dimensions mean equal lengths.
    attributes
        Of the file: text or numbers.
    coordinates
        Variables that are coordinates of those that share their dimensions.
    compressed, single
        Variables to compress without loss, and to store in single precision.

    Raises
    ------
    OSError
        If the file cannot be written: the disk is full, the folder cannot be written to.
    """
    import netCDF4

    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    sizes: dict[str, int] = {}
    for variable in variables.values():
        sizes |= dict(zip(variable.dims, np.shape(variable.values), strict=True))
    with moved_when_whole(path, sealed=True) as temporary:
        temporary.touch()
        try:
            with netCDF4.Dataset(temporary, "w") as file:
                _write(file, sizes, variables, attributes, coordinates, compressed, single)
        except (RuntimeError, OSError) as error:  # a file that could be made, and "permission denied" for a full disk
            raise why_not_written(temporary, str(error)) from error


def _write(
    file: Any,
    sizes: Mapping[str, int],
    variables: Mapping[str, Variable],
    attributes: Mapping[str, Any],
    coordinates: Collection[str],
    compressed: Collection[str],
    single: Collection[str],
) -> None:
    attached: set[str] = set()
    for name, size in sizes.items():
        file.createDimension(name, size)
    for name, (dims, values, own) in variables.items():
        array = np.asarray(values)
        text = array.dtype.kind in "OU"
        kind = str if text else np.float32 if name in single else array.dtype
        settings = {"zlib": True, "complevel": 1, "shuffle": True} if name in compressed and not text else {}
        written = file.createVariable(name, kind, dims, **settings, **({} if text else {"fill_value": False}))
        described = [] if name in coordinates else [c for c in coordinates if _describes(c, variables[c], dims)]
        attached.update(described)
        written.setncatts({**own, **({"coordinates": " ".join(described)} if described else {})})
        written[...] = array.astype(object) if text else array
    loose = [c for c in coordinates if c not in attached and c not in sizes]
    file.setncatts({**attributes, **({"coordinates": " ".join(loose)} if loose else {})})
    file.setncattr(CONTENT, _digest(file))


def read_netcdf(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read every array of a file as it is stored, and the attributes of the file.

    Raises
    ------
    FileNotFoundError, OSError, RuntimeError
        The file is missing, or it is damaged, which its seal tells, or the digest of its content where it has no seal.
    """
    import netCDF4

    sealed = intact(path)
    if sealed is False:
        raise OSError(CHANGED)
    with netCDF4.Dataset(path) as file:
        file.set_auto_maskandscale(False)
        if sealed is None and CONTENT in file.ncattrs() and file.getncattr(CONTENT) != _digest(file):
            raise OSError(CHANGED)
        arrays = {name: np.asarray(variable[...]) for name, variable in file.variables.items()}
        return arrays, {name: file.getncattr(name) for name in file.ncattrs()}


def check_netcdf(path: str | os.PathLike[str]) -> None:
    """Raise the error of :func:`read_netcdf` if a file is not as it was written."""
    sealed = intact(path)
    if sealed is False:
        raise OSError(CHANGED)
    if sealed is None:
        read_netcdf(path)


def _digest(file: Any) -> str:
    """Return the SHA-256 of the arrays, as they are stored, and of all attributes but the digest itself."""
    total = hashlib.sha256()
    file.set_auto_maskandscale(False)

    def add(name: str, values: Any) -> None:
        array = np.asarray(values)
        if array.dtype.kind in "OU":
            kind, data = "text", "\0".join(map(str, array.ravel())).encode()
        else:
            kind, data = array.dtype.str, np.ascontiguousarray(array).tobytes()
        total.update(f"{name} {array.shape} {kind} {len(data)}\0".encode())
        total.update(data)

    for name in sorted(file.ncattrs()):
        if name != CONTENT:
            add(f"@{name}", file.getncattr(name))
    for name in sorted(file.variables):
        variable = file.variables[name]
        add(f"{name} {' '.join(variable.dimensions)}", variable[...])
        for attribute in sorted(variable.ncattrs()):
            add(f"{name}@{attribute}", variable.getncattr(attribute))
    return total.hexdigest()


def _describes(name: str, coordinate: Variable, dims: tuple[str, ...]) -> bool:
    """Whether a coordinate without a dimension of its own belongs to a variable with these dimensions."""
    return coordinate.dims != (name,) and set(coordinate.dims) <= set(dims)
