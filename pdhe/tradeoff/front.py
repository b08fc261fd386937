"""The Pareto front of error and work."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def excess(points: Sequence[tuple[float, float]], slack: float = 0.0) -> list[float]:
    """Work of each point over that of the cheapest point that is no less accurate: 1 on the front.

    Parameters
    ----------
    points
        Work and error; points that are not finite get no number and stand in nobody's way.
    slack
        Differences of error up to this are not told apart.
    """
    good = [(work, error) for work, error in points if np.isfinite(work) and np.isfinite(error)]
    found = []
    for work, error in points:
        if not (np.isfinite(work) and np.isfinite(error)):
            found.append(np.nan)
            continue
        # The cheapest one that is as accurate; and it must not be the point itself that wins by slack alone.
        found.append(work / min(w for w, e in good if e <= error or (w < work and e <= error + slack)))
    return found


def front_of(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Points that no other one beats in both, from the cheapest on."""
    best, line = np.inf, []
    for work, error in sorted(point for point in points if np.isfinite(point).all()):
        if error < best:
            best = error
            line.append((work, error))
    return line
