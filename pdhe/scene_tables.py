"""Values of a scene at given points: tables, which are read with the scene, so that it holds all of their numbers."""

import math
import re
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pdhe import scene_fields as fields
from pdhe import units
from pdhe.errors import SceneError
from pdhe.scene_fields import Block, problem
from pdhe.yamlfile import find_file, is_file

if TYPE_CHECKING:
    import numpy as np

MOST_POINTS, LARGEST = 1000, 100_000
"""Most points of a table, and most characters of its file: a scene with its tables goes through a command line."""
COLUMNS = (["x", "y", "value"], ["x", "y", "z", "value"])
"""First lines of the files."""
PLACES = ("mechanics.axes", "mechanics.regions", "damage.regions", "hydrogen.regions")
"""Lists of a scene whose entries may have tables."""


class Table(Block):
    """A value at points, m, and the unit that it is in; none for ratios."""

    points: tuple[tuple[float, ...], ...]
    values: tuple[float, ...]
    unit: fields.Text | None = None

    def at(self, place: "np.ndarray") -> "np.ndarray":
        """Values at points (k, 2) or (k, 3), m; SI (k,). A table of x and y is the same through the thickness."""
        import numpy as np  # here, so that reading scenes without tables does not load it

        scale = 1.0 if self.unit is None else units.measure(f"1 {self.unit}")[0]
        points = np.array(self.points)
        return scale * interpolated(points, np.array(self.values), np.asarray(place, float)[:, : points.shape[1]])

    @property
    def coordinates(self) -> set[str]:
        """Those of x, y and z that it has."""
        return set("xyz"[: len(self.points[0])])


def interpolated(points: "np.ndarray", values: "np.ndarray", place: "np.ndarray") -> "np.ndarray":
    """Values (k,) at places (k, d) from those (m,) at points (m, d).

    Linear in each coordinate between the points of a grid, beyond it as on its border; where the points are no grid,
    that of the nearest one.
    """
    import numpy as np

    axes = [np.unique(points[:, axis]) for axis in range(points.shape[1])]
    if math.prod(axis.size for axis in axes) != len(points):
        nearest = [int(np.argmin(np.sum((points - one) ** 2, axis=1))) for one in place]
        return values[np.array(nearest, int)]
    grid = np.empty([axis.size for axis in axes])
    grid[tuple(np.searchsorted(axis, points[:, k]) for k, axis in enumerate(axes))] = values
    low, share = [], []
    for k, axis in enumerate(axes):
        inside = np.clip(place[:, k], axis[0], axis[-1])
        first = np.clip(np.searchsorted(axis, inside, side="right") - 1, 0, max(axis.size - 2, 0))
        step = axis[np.minimum(first + 1, axis.size - 1)] - axis[first]
        low.append(first)
        share.append(np.divide(inside - axis[first], step, out=np.zeros(len(place)), where=step > 0.0))
    total = np.zeros(len(place))
    for corner in product((0, 1), repeat=len(axes)):
        weight = np.prod([part if up else 1.0 - part for part, up in zip(share, corner, strict=True)], axis=0)
        index = tuple(np.minimum(a + up, axis.size - 1) for a, up, axis in zip(low, corner, axes, strict=True))
        total += weight * grid[index]
    return total


def read_tables(raw: Mapping[str, Any], file: str) -> None:
    """Put the numbers of its tables into a scene as it is written, in place of ``{table: file}``.

    Raises
    ------
    SceneError
        If a file is not there or is no table.
    """
    for where in PLACES:
        block, key = where.split(".")
        items = raw[block].get(key) if isinstance(raw.get(block), dict) else None
        for k, item in enumerate(items if isinstance(items, list) else ()):
            for name, value in item.items() if isinstance(item, dict) else ():
                if isinstance(value, dict) and isinstance(value.get("table"), str):
                    points, values = _read_table(value["table"], file, f"{where}.{k}.{name}.table")
                    rest = {other: given for other, given in value.items() if other != "table"}
                    item[name] = {"points": points, "values": values, **rest}


def _read_table(named: str, file: str, key: str) -> tuple[list[list[float]], list[float]]:
    """Points and values of a file."""
    found = find_file(named, [file])
    if not is_file(found):
        hint = "give its path from where you start, from the scene's folder, or from one above it"
        raise SceneError(file, key, named, "is not a file", hint)
    hint = "a table is `x,y,value`, in space `x,y,z,value`, and a line of such numbers for each point, places in metres"
    try:
        with Path(found).open(encoding="utf-8") as stream:
            text = stream.read(LARGEST + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(file, key, named, f"cannot be read: {error}", hint) from error
    lines = [[part.strip() for part in line.split(",")] for line in text.splitlines() if line.strip()]
    if len(text) > LARGEST or len(lines) > MOST_POINTS + 1:
        raise SceneError(file, key, named, f"has more than {MOST_POINTS} points", "give fewer")
    if len(lines) < 2 or lines[0] not in COLUMNS:
        raise SceneError(file, key, named, "does not begin like a table", hint)
    for count, line in enumerate(lines[1:], 2):
        if len(line) != len(lines[0]) or not all(re.fullmatch(units.NUMBER, part) for part in line):
            raise SceneError(file, key, named, f"has no {len(lines[0])} numbers in line {count}", hint)
    rows = [[float(part) for part in line] for line in lines[1:]]
    return [row[:-1] for row in rows], [row[-1] for row in rows]


def table_of(value: Mapping[str, Any]) -> Table:
    """Check the numbers of a table, read or resolved, and make it."""
    points, values = value.get("points"), value.get("values")
    for key in value:
        if key not in ("points", "values", "unit"):
            raise problem("is not a known key", "a table has `table` and `unit`", str(key)[:60])
    if not (isinstance(points, list | tuple) and isinstance(values, list | tuple) and 0 < len(points) == len(values)):
        raise problem("has not one value for each point", "give `table: file.csv`")
    if len(points) > MOST_POINTS:
        raise problem(f"has more than {MOST_POINTS} points", "give fewer")
    if not all(isinstance(point, list | tuple) and len(point) == len(points[0]) in (2, 3) for point in points):
        raise problem("has points without x and y", "give `table: file.csv`", "points")
    for item in (*values, *(length for point in points for length in point)):
        if isinstance(item, bool) or not isinstance(item, int | float) or not math.isfinite(item):
            raise problem("has what is not a finite number", "give `table: file.csv`")
    places = tuple(tuple(float(length) for length in point) for point in points)
    if len(set(places)) < len(places):
        raise problem("has a point twice", "keep one value for each")
    return Table(points=places, values=tuple(float(item) for item in values), unit=value.get("unit"))
