"""The Pareto front of error and work."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def excess(
    works: Sequence[float], errors: np.ndarray, floors: np.ndarray | float = 0.0, eligible: Sequence[bool] | None = None
) -> list[float]:
    """Work of each run over that of the cheapest one that is no less accurate in any quantity: 1 on the front.

    Parameters
    ----------
    works
        Of the runs (n).
    errors
        Of every quantity (n, k). Comparing them one by one keeps a setting off whose errors in one quantity make up
        for those in another. Runs with numbers that are not finite get no number and stand in nobody's way.
    floors
        Errors of a quantity below this are not told apart, (k) or one for all. Above it they are: what is wrong with a
        reference is wrong for all runs, and moves their errors together.
    eligible
        Runs that may be on the front; all without. The others are compared with those, and get no number where none is
        as accurate.
    """
    work, told = np.asarray(works, float), np.maximum(np.asarray(errors, float), floors)
    usable = np.isfinite(work) & np.isfinite(told).all(axis=1)
    allowed = usable if eligible is None else usable & np.asarray(eligible, bool)
    found = np.full(work.size, np.nan)
    for run in np.flatnonzero(usable):
        as_good = allowed & (told <= told[run]).all(axis=1)
        if as_good.any():
            found[run] = work[run] / work[as_good].min()
    return found.tolist()


def front_of(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Points that no other one beats in both, from the cheapest on."""
    best, line = np.inf, []
    for work, error in sorted(point for point in points if np.isfinite(point).all()):
        if error < best:
            best = error
            line.append((work, error))
    return line
