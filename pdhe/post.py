"""Results turned into numbers: tables, the crack as facets between cells, energy balance, times worth looking at."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import xarray as xr

from pdhe.errors import PdheError
from pdhe.provenance import fingerprint, versions
from pdhe.results import open_result
from pdhe.solid_nodes import facet_keys, facets_of_cells
from pdhe.surfaces import Surface, crossed_by, surface_of
from pdhe.whole import whole_result

#: Time at which a facet on a pre-crack counts as broken, s: before everything else.
PRE_CRACKED = -1.0
#: Share of the widest opening from which a broken facet is part of the crack. Tips open by a tenth of it and more.
_OPEN = 0.03
#: Share of the widest opening so far below which a crack counts as closed.
_CLOSED = 0.1
_UNITS_OF_TIME = (
    ("ns", 1e-9),
    ("µs", 1e-6),
    ("ms", 1e-3),
    ("s", 1.0),
    ("min", 60.0),
    ("h", 3600.0),
    ("days", 86400.0),
    ("years", 365.25 * 86400.0),
)
#: A unit of time is used from this many of it on.
_FROM = {"ns": 0.0, "µs": 3.0, "ms": 3.0, "s": 1.0, "min": 3.0, "h": 3.0, "days": 3.0, "years": 3.0}
_DIGITS = 10


@dataclass(frozen=True)
class Facets:
    """The sides of the cells of a result; in space they are polygons, of three or four vertices instead of two ends.

    Attributes
    ----------
    cells, vertices
        The two cells on either side of each inner facet, and its two ends; int (f, 2) each.
    broken
        Time at which the bond between the two cells broke, s (f,): :data:`PRE_CRACKED` where a pre-crack separates
        them, infinity where they are bonded to the end.
    outer_cells, outer_vertices
        Cell (o,) and ends (o, 2) of the facets on the boundary of the body.
    """

    cells: np.ndarray
    vertices: np.ndarray
    broken: np.ndarray
    outer_cells: np.ndarray
    outer_vertices: np.ndarray


def history_table(result_path: str | Path) -> str:
    """Write the history of a result as CSV: one line a step, ``name [unit]`` in the header, SI.

    Raises
    ------
    PdheError
        If the file is not a result or holds no history.
    """
    with open_result(result_path) as result:
        names = ["history_time", *(name for name in result.data_vars if name != "history_time")]
        columns = {name: result[name] for name in names if name in result and result[name].dims == ("step",)}
        if not columns:
            raise PdheError(f"{result_path}: the result holds no history")
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(f"{name} [{values.attrs.get('units', '1')}]" for name, values in columns.items())
        for row in zip(*(values.values.tolist() for values in columns.values()), strict=True):
            writer.writerow(f"{value:.{_DIGITS}g}" for value in row)
    return text.getvalue()


def source_of(result_path: str | Path) -> dict[str, str]:
    """Return the title, the scene and the digest of a result, and what made it, for a table made from it."""
    with open_result(result_path) as result:
        names = {"title": "title", "scene": "scene", "scene_hash": "scene_hash", "solution_sha256": "content_sha256"}
        names |= {f"solution_{name}": name for name in ("code_fingerprint", "versions", "machine", "command")}
        return {key: str(result.attrs[name]) for key, name in names.items() if name in result.attrs}


def origin(result: xr.Dataset, ending: str) -> dict[str, str]:
    """Return what made a picture of a result, for its metadata.

    Of the result its digest, scene, code, versions, machine and command; of the picture its code and versions.

    Parameters
    ----------
    ending
        Of the file of the picture: formats differ in the keys they know.
    """
    wanted = ("content_sha256", "scene", "scene_hash", "code_fingerprint", "versions", "machine", "command")
    made = {name: str(result.attrs[name]) for name in wanted if name in result.attrs}
    drawn = {"drawn_by": fingerprint("pdhe.plotting"), "drawn_with": json.dumps(versions(), sort_keys=True)}
    text = json.dumps(made | drawn)
    return {"Title": str(result.attrs.get("title", "")), "Subject" if ending == ".pdf" else "Source": text}


def scene_of(result: xr.Dataset) -> dict[str, Any]:
    """Return the resolved scene that a result was computed from."""
    return json.loads(result.attrs["scene"])


def pre_cracks(result: xr.Dataset) -> np.ndarray:
    """Return the pre-cracks of a result as segments, m (c, 2 ends, 2); discs and polygons in space are none."""
    cracks = scene_of(result).get("geometry", {}).get("cracks", [])
    return np.array([(crack["from"], crack["to"]) for crack in cracks if "from" in crack], float).reshape(-1, 2, 2)


def crack_surfaces(result: xr.Dataset) -> list[Surface]:
    """Return the pre-cracks of a result in space as surfaces."""
    geometry = scene_of(result).get("geometry", {})
    thickness = geometry.get("plate", {}).get("thickness", 0.0)
    known = {"start": None, "end": None, "disc": None, "polygon": None}
    found = []
    for crack in geometry.get("cracks", ()):
        shape = known | {"start": crack.get("from"), "end": crack.get("to")} | crack
        shape["disc"] = SimpleNamespace(**crack["disc"]) if "disc" in crack else None
        found.append(surface_of(SimpleNamespace(**shape), thickness))
    return found


def facets_of(result: xr.Dataset) -> Facets:
    """Find the facets of the cells and when each of the inner ones broke."""
    if "node_z" in result:
        return _solid_facets(result)
    cells = result["cells"].values
    n, count = len(cells), result.sizes["vertex"]
    first, second = cells.ravel(), np.roll(cells, -1, axis=1).ravel()
    owner = np.repeat(np.arange(n), cells.shape[1])
    real = first != second  # a triangle among quadrilaterals repeats a vertex
    first, second, owner = first[real], second[real], owner[real]
    key = _pair(first, second, count)
    order = np.argsort(key, kind="stable")
    key = key[order]
    shared = np.flatnonzero(key[1:] == key[:-1])
    alone = np.ones(key.size, bool)
    alone[shared] = alone[shared + 1] = False
    one, other, outer = order[shared], order[shared + 1], order[alone]
    pairs = np.column_stack([owner[one], owner[other]])
    return Facets(
        pairs,
        np.column_stack([first[one], second[one]]),
        _breaking_times(result, pairs),
        owner[outer],
        np.column_stack([first[outer], second[outer]]),
    )


def _solid_facets(result: xr.Dataset) -> Facets:
    """The same for cells that fill space."""
    facets, owner = facets_of_cells(result["cells"].values)
    key = facet_keys(facets, result.sizes["vertex"])
    order = np.argsort(key, kind="stable")
    shared = np.flatnonzero(key[order][1:] == key[order][:-1])
    alone = np.ones(key.size, bool)
    alone[shared] = alone[shared + 1] = False
    one, other, outer = order[shared], order[shared + 1], order[alone]
    pairs = np.column_stack([owner[one], owner[other]])
    return Facets(pairs, facets[one], _breaking_times(result, pairs), owner[outer], facets[outer])


def open_facets(result: xr.Dataset, facets: Facets) -> list[np.ndarray]:
    """Return the inner facets that make up the crack at each output, int (k,) each; those of pre-cracks always do.

    A cell next to a crack may lose its bonds to neighbours that it goes on moving with, through longer bonds. A broken
    facet is therefore part of the crack where the displacements of its two cells differ by 3 % of the widest opening at
    least. While the crack as a whole is nearly closed, nothing can be told and the last answer stands.
    """
    times = result["time"].values
    rows = np.flatnonzero(np.isfinite(facets.broken))
    if "displacement" not in result or not rows.size:
        return [rows[facets.broken[rows] <= time] for time in times]
    displacement, broken = result["displacement"].values, facets.broken[rows]
    one, other = facets.cells[rows].T
    shut, widest, crack = np.zeros(rows.size, bool), 0.0, []
    for index, time in enumerate(times):
        opening = np.linalg.norm(displacement[index, one] - displacement[index, other], axis=1)
        opening[broken > time] = 0.0
        wide = float(opening.max())
        widest = max(widest, wide)
        if wide > _CLOSED * widest:
            shut = (opening < _OPEN * wide) & (broken <= time)
        crack.append(rows[(broken <= time) & ~(shut & (broken > PRE_CRACKED))])
    return crack


def crack_path(result: xr.Dataset, time: float) -> np.ndarray:
    """Return the crack at the last output until a time, pre-cracks included, as segments in m (k, 2 ends, 2).

    Of a part of a symmetric body, that of the whole.
    """
    result = whole_result(result)
    facets = facets_of(result)
    index = max(int(np.searchsorted(result["time"].values, time, side="right")) - 1, 0)
    return result["vertices"].values[facets.vertices[open_facets(result, facets)[index]]]


def crack_tip(result: xr.Dataset, time: float) -> tuple[float, float] | None:
    """Return the foremost point of crack growth at a time, m; None before growth and without damage."""
    if "crack_tip_x" not in result:
        return None
    last = int(np.searchsorted(result["history_time"].values, time, side="right")) - 1
    if last < 0:
        return None
    x, y = (float(result[name].values[last]) for name in ("crack_tip_x", "crack_tip_y"))
    return (x, y) if np.isfinite(x) and np.isfinite(y) else None


def crack_speed(result: xr.Dataset, rows: int = 2) -> np.ndarray:
    """Return the speed of the foremost tip at every entry of the history, m/s (steps,).

    A tip goes from cell to cell: the speed is the mean over so many entries on either side, fewer at the ends.
    """
    time, way = result["history_time"].values, result["crack_extension"].values
    last = time.size - 1
    low, high = (np.clip(np.arange(time.size) + shift, 0, last) for shift in (-rows, rows))
    span = time[high] - time[low]
    return np.where(span > 0.0, way[high] - way[low], 0.0) / np.where(span > 0.0, span, 1.0)


def crack_direction(result: xr.Dataset, time: float, crack: int = 0) -> float | None:
    """Return the angle between a pre-crack and what grew from its end at the last output until a time, degrees.

    Of the straight line through that end which fits the grown facets best, counter-clockwise. Facets that do not hang
    together with the pre-crack do not count. None before growth, and in space, where a crack ends in a front.

    Parameters
    ----------
    crack
        Number of the pre-crack in the scene; the end is its ``to``, or its ``from`` where nothing grew from there.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if "node_z" in result:
        return None
    facets = facets_of(result)
    index = max(int(np.searchsorted(result["time"].values, time, side="right")) - 1, 0)
    rows = open_facets(result, facets)[index]
    ends, count = facets.vertices[rows], result.sizes["vertex"]
    graph = coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(count, count))
    piece = connected_components(graph, directed=False)[1][ends[:, 0]]
    start, tip = pre_cracks(result)[crack]
    middle = result["vertices"].values[ends].mean(axis=1)
    length = np.linalg.norm(np.diff(result["vertices"].values[ends], axis=1)[:, 0], axis=1)
    old = facets.broken[rows] == PRE_CRACKED
    along = (tip - start) / np.linalg.norm(tip - start)
    # Those of this pre-crack are within a side of a cell of its line.
    away = middle - tip
    own = old & (np.abs(along[0] * away[:, 1] - along[1] * away[:, 0]) < length.max(initial=0.0))
    grown = ~old & np.isin(piece, piece[own])
    if not grown.any():
        return None
    # What is nearer to the other end grew from there.
    from_tip = np.linalg.norm(away, axis=1) < np.linalg.norm(middle - start, axis=1)
    if not (grown & from_tip).any():
        from_tip, tip, along = ~from_tip, start, -along
    grown, middle = grown & from_tip, middle - tip
    moment = (middle[grown] * length[grown, None]).T @ middle[grown]
    axis = np.linalg.eigh(moment)[1][:, 1]
    axis *= np.sign(length[grown] @ (middle[grown] @ axis)) or 1.0
    return float(np.degrees(np.arctan2(along[0] * axis[1] - along[1] * axis[0], along @ axis)))


def crossings(result: xr.Dataset, x: float, time: float, damage: float = 0.35) -> int:
    """Return how many cracks a vertical line crosses at the last output until a time: runs of damaged nodes along it.

    Parameters
    ----------
    x
        Place of the line, m; nodes within a spacing of it count.
    damage
        From which a node belongs to a crack: the first row beside a sharp one has 0.39 (theory, eq. 5.10).
    """
    index = max(int(np.searchsorted(result["time"].values, time, side="right")) - 1, 0)
    width = float(np.sqrt(np.ptp(result["node_x"].values) * np.ptp(result["node_y"].values) / result.sizes["node"]))
    near = np.flatnonzero(np.abs(result["node_x"].values - x) <= width)
    y = np.sort(result["node_y"].values[near[result["damage"].values[index, near] > damage]])
    return 0 if not y.size else 1 + int(np.sum(np.diff(y) > 2.0 * width))


def at_time(result: xr.Dataset, name: str, time: float) -> float:
    """Return a quantity of the history as it stands at a time: after everything that happened until then."""
    last = int(np.searchsorted(result["history_time"].values, time, side="right")) - 1
    return float(result[name].values[max(last, 0)])


def growth(result: xr.Dataset) -> tuple[float, float] | None:
    """Return the times of the first and the last bond failure, s; None if nothing broke."""
    times = result["broken_time"].values if "broken_time" in result else np.empty(0)
    times = times[times >= 0.0]
    return (float(times.min()), float(times.max())) if times.size else None


def nearest_snapshot(result: xr.Dataset, time: float) -> int:
    """Return the index of the snapshot nearest to a time; of two equally near ones, the earlier."""
    return int(np.argmin(np.abs(result["time"].values - time)))


def telling_snapshots(result: xr.Dataset, count: int = 4) -> list[int]:
    """Choose snapshots that show what happens.

    With crack growth: the first one at or after its start, the first at or after its end, and others evenly between;
    where these coincide, others are added wherever they leave the widest gap, from the last one before growth on.
    With hydrogen alone: at 1/16, 1/4, 9/16 and all of the time, in which diffusion advances in equal steps. Otherwise
    evenly until the end. Where the outputs are too few, there are fewer than asked for.
    """
    times = result["time"].values
    share = np.linspace(0.0, 1.0, count + 1)[1:]
    span, end = growth(result), float(times[-1])
    if span is not None:
        wanted = np.linspace(*span, count) if count > 1 else span[1:]
        chosen = {min(int(np.searchsorted(times, t)), times.size - 1) for t in wanted}
        spare = [k for k in range(max(min(chosen) - 1, 0), times.size) if k not in chosen]
        while len(chosen) < count and spare:
            between = sorted(chosen)
            gaps = [min(abs(times[k] - times[b]) for b in between) for k in spare]
            chosen.add(spare.pop(int(np.argmax(gaps))))
        return sorted(chosen)
    wanted = end * (share if "displacement" in result else share**2)
    return sorted({nearest_snapshot(result, t) for t in wanted})


def unit_of_time(span: float) -> tuple[str, float]:
    """Return the unit in which a span of time is read most easily, and its length in s."""
    if span <= 0.0:
        return "s", 1.0
    return next((name, size) for name, size in reversed(_UNITS_OF_TIME) if span >= _FROM[name] * size)


def time_label(time: float, span: float) -> str:
    """Write a time for a reader, in the unit and with the digits that suit the whole span."""
    name, size = unit_of_time(span)
    decimals = 0 if span <= 0 else int(np.clip(2 - np.floor(np.log10(span / size)), 0, 3))
    return f"{time / size:.{decimals}f} {name}"


def energy_balance(result: xr.Dataset) -> dict[str, np.ndarray]:
    """Return the energies over the history, J (steps,).

    ``dissipated`` is what the prescribed displacements put in since the start and the body no longer holds. Broken
    bonds took ``fracture`` of it with them; ``relaxation`` is the rest, lost as the body fell into new equilibria.

    With inertia the body also holds ``kinetic`` energy, ``damping`` took its part of what is dissipated, and there is
    nothing to fall into: in place of ``relaxation``, the rest is ``error``. With a user material ``plastic`` and
    ``creep`` are what it says that it dissipates, and the rest is ``error`` too: by the length of the load steps.
    """
    needed = ("external_work", "elastic_energy")
    if any(name not in result for name in needed):
        raise PdheError("the result holds no energies: its scene has no `loads`")
    work, elastic = (result[name].values - result[name].values[0] for name in needed)
    dissipated = work - elastic
    fracture = result["fracture_energy"].values if "fracture_energy" in result else np.zeros_like(work)
    if "kinetic_energy" in result:
        kinetic, damping = result["kinetic_energy"].values, result["damping_loss"].values
        dissipated -= kinetic - kinetic[0]
        return {
            "work": work,
            "elastic": result["elastic_energy"].values,
            "kinetic": kinetic,
            "fracture": fracture,
            "damping": damping,
            "dissipated": dissipated,
            "error": dissipated - fracture - damping,
        }
    if "plastic_dissipation" in result:
        plastic, creep = result["plastic_dissipation"].values, result["creep_dissipation"].values
        return {
            "work": work,
            "elastic": result["elastic_energy"].values,
            "plastic": plastic,
            "creep": creep,
            "dissipated": dissipated,
            "error": dissipated - plastic - creep,
        }
    return {
        "work": work,
        "elastic": result["elastic_energy"].values,
        "fracture": fracture,
        "dissipated": dissipated,
        "relaxation": dissipated - fracture,
    }


def summary(result: xr.Dataset) -> dict[str, float | str]:
    """Return the end of a run in a few numbers, SI; those of absent physics are left out."""
    numbers: dict[str, float | str] = {
        "title": str(result.attrs.get("title", "")),
        "status": str(result.attrs.get("status", "")),
        "nodes": float(result.sizes["node"]),
        "end_time": float(result["time"].values[-1]),
    }
    names = ("crack_extension", "crack_length", "mean_damage", "broken_bonds", "mean_coverage", "hydrogen_content")
    numbers |= {name: float(result[name].values[-1]) for name in names if name in result}
    span = growth(result)
    if span is not None:
        numbers |= {"growth_start": span[0], "growth_end": span[1]}
        numbers |= dict(zip(("crack_tip_x", "crack_tip_y"), crack_tip(result, np.inf) or (), strict=False))
        if "kinetic_energy" in result:
            numbers["crack_speed"] = float(crack_speed(result).max())
            direction = crack_direction(result, np.inf) if len(pre_cracks(result)) else None
            if direction is not None:
                numbers["crack_direction"] = direction
    if "elastic_energy" in result:
        balance = energy_balance(result)
        numbers |= {f"energy_{name}": float(values[-1]) for name, values in balance.items()}
    if "hydrogen_influx" in result:
        content, influx = result["hydrogen_content"].values, result["hydrogen_influx"].values
        change = content - content[0] - (influx - influx[0])
        numbers["hydrogen_imbalance"] = float(np.abs(change).max() / max(np.abs(content).max(), np.finfo(float).tiny))
    return numbers


def _pair(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """One integer for two numbers below ``count`` in either order."""
    return np.minimum(first, second).astype(np.int64) * count + np.maximum(first, second)


def _breaking_times(result: xr.Dataset, pairs: np.ndarray) -> np.ndarray:
    """Time at which each pair of cells was separated; infinity for those that never are."""
    n = result.sizes["node"]
    times = np.full(len(pairs), np.inf)
    if "broken_time" in result and result.sizes["broken"]:
        key = _pair(result["broken_i"].values, result["broken_j"].values, n)
        order = np.argsort(key)
        wanted = _pair(*pairs.T, n)
        place = np.minimum(np.searchsorted(key[order], wanted), key.size - 1)
        found = key[order][place] == wanted
        times[found] = result["broken_time"].values[order][place[found]]
    names = ("node_x", "node_y", "node_z") if "node_z" in result else ("node_x", "node_y")
    ends = np.column_stack([result[name].values for name in names])[pairs]
    if ends.shape[2] == 3:
        times[crossed_by(ends[:, 0], ends[:, 1], crack_surfaces(result))] = PRE_CRACKED
        return times
    for crack in pre_cracks(result):
        times[_cross(ends[:, 0], ends[:, 1], *crack)] = PRE_CRACKED
    return times


def _cross(a: np.ndarray, b: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Whether segments ``a`` to ``b`` (k, 2) cross the one from ``start`` to ``end`` between its ends.

    As for bonds, a point on the crack counts as lying on its left.
    """

    def side(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
        along, away = q - p, r - p
        area = along[..., 0] * away[..., 1] - along[..., 1] * away[..., 0]
        return np.where(np.abs(area) <= 1e-12 * max(1e-300, np.abs(along).max() ** 2), 0.0, area)

    return ((side(start, end, a) >= 0) != (side(start, end, b) >= 0)) & (side(a, b, start) * side(a, b, end) < 0)
