"""Quantities of interest of a result, their limit at zero spacing, and how far a run is from it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pdhe.scene import Scene

if TYPE_CHECKING:
    import xarray as xr

#: Times at which histories are compared, and lengths at which growing cracks are.
SAMPLES = 40
LENGTHS = 400
#: Orders of convergence that are believed.
ORDERS = (0.5, 3.0)
#: An order other than the first is believed where its fit leaves less than this share of the misfit.
CLEARLY = 0.5
#: Distance over the spacing within which nodes are at the same place.
SAME_PLACE = 1e-3
#: Error of a quantity that does not exist, such as the time of a failure that does not happen.
MISSING = 1.0


def values_of(result: xr.Dataset, scene: Scene, names: Sequence[str], failure: float) -> dict[str, np.ndarray]:
    """Quantities of a result by name, SI: numbers as arrays of one, histories at :data:`SAMPLES` equal times.

    Parameters
    ----------
    names
        Out of :data:`pdhe.tradeoff.design.QUANTITIES`.
    failure
        Growth of the crack that counts as failure, m.
    """
    return {name: np.atleast_1d(np.asarray(_VALUES[name](result, scene, failure), float)) for name in names}


def standard_values(result: xr.Dataset, scene: Scene) -> dict[str, np.ndarray]:
    """What an accuracy is about: growth of cracks, reactions, elastic energy, mean coverage, openings of notches.

    Histories at :data:`SAMPLES` times, SI; openings at the end, and only where nothing breaks.
    """
    names = [str(name) for name in result.data_vars if str(name).startswith("reaction_")]
    names += [name for name in ("elastic_energy", "mean_coverage") if name in result]
    values = {name: _history(result, scene, name) for name in names}
    if "crack_length" in result:
        return values | {"crack": _crack_in_time(result, scene)}
    if "displacement" in result:
        sets, displacement = json.loads(result.attrs["node_sets"]), result["displacement"].values[-1]
        for crack in scene.geometry.cracks:
            values[f"opening of {crack.name}"] = np.atleast_1d(np.ptp(displacement[sets[crack.name]], axis=0).max())
    return values


def asymmetry(result: xr.Dataset, coordinates: np.ndarray) -> float:
    """Share of the broken bonds whose mirror image across the mid-height is whole; not a number if nodes have none.

    Parameters
    ----------
    coordinates
        Of the nodes (n, 2), m.
    """
    if "broken_i" not in result or not result["broken_i"].size:
        return 0.0
    from scipy.spatial import KDTree

    low, high = coordinates.min(axis=0), coordinates.max(axis=0)
    mirrored = np.column_stack([coordinates[:, 0], low[1] + high[1] - coordinates[:, 1]])
    away, image = KDTree(coordinates).query(mirrored)
    if away.max() > SAME_PLACE * math.sqrt(float(np.prod(high - low)) / len(coordinates)):
        return math.nan
    bonds = np.column_stack([result["broken_i"].values, result["broken_j"].values]).astype(np.int64)
    broken = {(min(pair), max(pair)) for pair in bonds.tolist()}
    images = {(min(pair), max(pair)) for pair in image[bonds].tolist()}
    return len(images - broken) / len(broken)


def _history(result: xr.Dataset, scene: Scene, name: str) -> np.ndarray:
    values = result[name].values
    return values[-1:] if scene.time.end == 0.0 else np.interp(_times(scene), result["history_time"].values, values)


def _times(scene: Scene) -> np.ndarray:
    return scene.time.end * np.arange(1, SAMPLES + 1) / SAMPLES


def _growth(result: xr.Dataset) -> np.ndarray:
    # The equivalent length counts every broken bond: it has no jumps of a cell, as the place of the tip has.
    return result["crack_length"].values - result["crack_length"].values[0]


def _crack(result: xr.Dataset, scene: Scene, failure: float) -> np.ndarray:
    """Times at which the crack first has grown by each of :data:`LENGTHS` lengths, s; the end time if it never has.

    The area between two histories is the same along either axis. But a crack that jumps is a step in time: the mean of
    steps on several meshes is no step, that of the times at which they happen is such a time.
    """
    longest = max((math.dist(crack.start, crack.end) for crack in scene.geometry.cracks), default=0.0)
    room = max(scene.geometry.width, scene.geometry.height) - longest
    lengths = room * (np.arange(LENGTHS) + 0.5) / LENGTHS
    largest = np.maximum.accumulate(_growth(result))
    first = np.searchsorted(largest, lengths)
    return np.append(result["history_time"].values, scene.time.end)[first]


def _crack_in_time(result: xr.Dataset, scene: Scene) -> np.ndarray:
    # Constant between failures: the last entry until each time is the value at it.
    last = np.searchsorted(result["history_time"].values, _times(scene), side="right") - 1
    return _growth(result)[last]


def _failure_time(result: xr.Dataset, scene: Scene, failure: float) -> float:
    reached = _growth(result) >= failure
    return float(result["history_time"].values[reached.argmax()]) if reached.any() else np.nan


def _reaction(result: xr.Dataset, scene: Scene, failure: float) -> np.ndarray:
    values = np.abs(result["reaction_top_y"].values)
    return values[-1] if scene.time.end == 0.0 else np.interp(_times(scene), result["history_time"].values, values)


def _peak_reaction(result: xr.Dataset, scene: Scene, failure: float) -> float:
    return float(np.abs(result["reaction_top_y"].values).max())


def _opening(result: xr.Dataset, scene: Scene, failure: float) -> float:
    lips = json.loads(result.attrs["node_sets"])[scene.geometry.cracks[0].name]
    return float(np.ptp(result["displacement"].values[-1, lips, 1]))


def _mean_damage(result: xr.Dataset, scene: Scene, failure: float) -> float:
    # A crack damages a band as wide as the horizon: only the ratio has a limit.
    return float(result["mean_damage"].values[-1]) / scene.horizon_length


def _mean_coverage(result: xr.Dataset, scene: Scene, failure: float) -> np.ndarray:
    return np.interp(_times(scene), result["history_time"].values, result["mean_coverage"].values)


def _far_coverage(result: xr.Dataset, scene: Scene, failure: float) -> float:
    return float(result["coverage"].values[-1, json.loads(result.attrs["node_sets"])["right"]].mean())


_VALUES: dict[str, Callable[[xr.Dataset, Scene, float], np.ndarray | float]] = {
    "crack": _crack,
    "failure_time": _failure_time,
    "reaction": _reaction,
    "peak_reaction": _peak_reaction,
    "opening": _opening,
    "mean_damage": _mean_damage,
    "mean_coverage": _mean_coverage,
    "far_coverage": _far_coverage,
}


@dataclass(frozen=True)
class Limit:
    """A quantity at zero spacing.

    Attributes
    ----------
    value
        The limit, SI.
    order
        Order of convergence of the fit.
    uncertainty
        Largest distance from it of the limits that fits of the same order give without one of the meshes, relative.
    finest
        Distance of the finest mesh from the limit, relative.
    told
        Entries that some mesh reaches, bool: errors are means over them. Times at which cracks have lengths that they
        never reach would dilute them.
    """

    value: np.ndarray
    order: float
    uncertainty: float
    finest: float
    told: np.ndarray

    def error(self, value: np.ndarray) -> float:
        """Mean distance of a value from the limit, relative to the limit's largest entry."""
        return distance(value[self.told], self.value[self.told])


def distance(value: np.ndarray, limit: np.ndarray) -> float:
    """Mean distance of a value from a limit, relative to the limit's largest entry."""
    scale = float(np.abs(limit).max())
    if scale == 0.0:
        return 0.0 if not np.any(value) else MISSING
    return float(np.nan_to_num(np.abs(value - limit), nan=MISSING * scale).mean()) / scale


def limit_of(spacings: Sequence[float], values: Sequence[np.ndarray], never: float = math.inf) -> Limit:
    """Extrapolate a quantity to zero spacing (Richardson): least squares of ``q + c h^p`` over at least four meshes.

    Fits use all meshes, because those of fracture scatter (a crack advances cell by cell), and extrapolating the two
    finest would multiply their scatter (Eça and Hoekstra, J. Comput. Phys. 262, 2014).

    Parameters
    ----------
    never
        Value that stands for what does not happen.
    """
    h, q = np.asarray(spacings, float), np.array(values, float)
    told = ~(q == never).all(axis=0)
    told |= not told.any()
    order = _order(h, q[:, told])
    value = _fit(h, q, order)[0]
    kept = [np.arange(h.size) != k for k in range(h.size)]
    spread = max(distance(_fit(h[rows], q[rows], order)[0][told], value[told]) for rows in kept)
    return Limit(value, order, spread, distance(q[-1][told], value[told]), told)


def _order(h: np.ndarray, q: np.ndarray) -> float:
    """Order of the best fit; the first where another one is not clearly better."""
    from scipy.optimize import minimize_scalar

    def misfit(order: float) -> float:
        return _fit(h, q, order)[1]

    best = minimize_scalar(misfit, bounds=ORDERS, method="bounded", options={"xatol": 1e-9}).x
    return float(best) if misfit(best) < CLEARLY * misfit(1.0) else 1.0


def _fit(h: np.ndarray, q: np.ndarray, order: float) -> tuple[np.ndarray, float]:
    """Limit of the least-squares fit with an order, and its mean misfit."""
    basis = np.column_stack([np.ones_like(h), (h / h.max()) ** order])
    found, *_ = np.linalg.lstsq(basis, q, rcond=None)
    return found[0], float(np.abs(basis @ found - q).mean())
