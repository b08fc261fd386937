"""The Pareto front of error and work."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def excess(points: Sequence[tuple[float, float]], floor: float = 0.0) -> list[float]:
    """Work of each point over that of the cheapest point that is no less accurate: 1 on the front.

    Parameters
    ----------
    points
        Work and error; points that are not finite get no number and stand in nobody's way.
    floor
        Errors below this are not told apart. Above it they are: what is wrong with a reference is wrong for all runs,
        and moves their errors together.
    """
    good = [(work, max(error, floor)) for work, error in points if np.isfinite(work) and np.isfinite(error)]
    found = []
    for work, error in points:
        if not (np.isfinite(work) and np.isfinite(error)):
            found.append(np.nan)
            continue
        found.append(work / min(w for w, e in good if e <= max(error, floor)))
    return found


def front_of(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Points that no other one beats in both, from the cheapest on."""
    best, line = np.inf, []
    for work, error in sorted(point for point in points if np.isfinite(point).all()):
        if error < best:
            best = error
            line.append((work, error))
    return line
