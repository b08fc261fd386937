"""Segments in the plane: what crosses a crack, and how far points are from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def distance_to_segment(points: np.ndarray, start: Sequence[float], end: Sequence[float]) -> np.ndarray:
    """Distance of points (k, 2) from a segment, m (k,)."""
    first, along = np.asarray(start, float), np.subtract(end, start)
    t = np.clip((points - first) @ along / float(along @ along), 0.0, 1.0)
    return np.hypot(*(points - (first + t[:, None] * along)).T)


def crossed_by(start: np.ndarray, end: np.ndarray, cracks: Sequence) -> np.ndarray:
    """Tell which segments ``start -> end`` (b, 2) cross one of the cracks.

    A bond that only touches a crack's tip is not cut, unless another crack goes on from there. A node that lies on a
    crack counts as lying on its left, so that a crack through a row of nodes separates it from the row on its right.
    """
    crossed = np.zeros(start.shape[0], bool)
    for index, (a, b) in enumerate(cracks):
        a, b = np.asarray(a, float), np.asarray(b, float)
        others = [segment for k, segment in enumerate(cracks) if k != index]
        along = b - a
        scale = 1e-12 * max(float(np.abs(np.concatenate([a, b])).max()), float(np.abs(start).max(initial=0.0)))
        side_start = _side(start - a, along, scale) >= 0
        side_end = _side(end - a, along, scale) >= 0
        rows = np.flatnonzero(side_start != side_end)
        bond = end[rows] - start[rows]
        at_a, at_b = _side(a - start[rows], bond, scale), _side(b - start[rows], bond, scale)
        inside = at_a * at_b < 0
        inside |= (at_a == 0) & (at_b != 0) & _continues(a, others)
        inside |= (at_b == 0) & (at_a != 0) & _continues(b, others)
        crossed[rows[inside]] = True
    return crossed


def _side(points: np.ndarray, direction: np.ndarray, scale: float) -> np.ndarray:
    """Sign of the cross product ``direction x points``; zero within round-off of the coordinates."""
    value = direction[..., 0] * points[..., 1] - direction[..., 1] * points[..., 0]
    tolerance = scale * np.hypot(direction[..., 0], direction[..., 1])
    return np.where(np.abs(value) <= tolerance, 0, np.sign(value)).astype(np.int8)


def _continues(tip: np.ndarray, others: Sequence) -> bool:
    """Tell whether one of the other cracks passes through a tip."""
    for a, b in others:
        a, b = np.asarray(a, float), np.asarray(b, float)
        along = b - a
        t = np.clip(np.dot(tip - a, along) / np.dot(along, along), 0.0, 1.0)
        if np.hypot(*(a + t * along - tip)) <= 1e-9 * np.hypot(*along):
            return True
    return False
