"""Neighbour search in space; see :mod:`pdhe.kernels.families` for the plane."""

from __future__ import annotations

import numpy as np
from numba import prange

from pdhe.kernels.families import bin_nodes
from pdhe.kernels.jit import kernel


@kernel
def count_family(x, radius, column, row, layer, columns, rows, layers, start, members, count):
    """Write the number of nodes within reach of each node (itself excluded) into ``count``.

    The reach of a pair is the larger of both radii, so that every bond is found from both of its ends.
    """
    for i in prange(radius.size):
        found = 0
        for s in range(max(layer[i] - 1, 0), min(layer[i] + 2, layers)):
            for r in range(max(row[i] - 1, 0), min(row[i] + 2, rows)):
                line = (s * rows + r) * columns
                first = start[line + max(column[i] - 1, 0)]
                last = start[line + min(column[i] + 1, columns - 1) + 1]
                for k in range(first, last):
                    j = members[k]
                    reach = max(radius[i], radius[j])
                    dx = x[j, 0] - x[i, 0]
                    dy = x[j, 1] - x[i, 1]
                    dz = x[j, 2] - x[i, 2]
                    if j != i and dx * dx + dy * dy + dz * dz <= reach * reach:
                        found += 1
        count[i] = found


@kernel
def fill_family(x, radius, column, row, layer, columns, rows, layers, start, members, offsets, neighbours):
    """Write the family of node ``i``, ascending, into ``neighbours[offsets[i]:offsets[i+1]]``."""
    for i in prange(radius.size):
        position = offsets[i]
        for s in range(max(layer[i] - 1, 0), min(layer[i] + 2, layers)):
            for r in range(max(row[i] - 1, 0), min(row[i] + 2, rows)):
                line = (s * rows + r) * columns
                first = start[line + max(column[i] - 1, 0)]
                last = start[line + min(column[i] + 1, columns - 1) + 1]
                for k in range(first, last):
                    j = members[k]
                    reach = max(radius[i], radius[j])
                    dx = x[j, 0] - x[i, 0]
                    dy = x[j, 1] - x[i, 1]
                    dz = x[j, 2] - x[i, 2]
                    if j != i and dx * dx + dy * dy + dz * dz <= reach * reach:
                        neighbours[position] = j
                        position += 1
        neighbours[offsets[i] : offsets[i + 1]].sort()


def find_families(coordinates: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find all pairs of nodes no further apart than the larger of their radii.

    Parameters
    ----------
    coordinates
        Positions, shape (n, 3), m.
    radius
        Search radius of each node, shape (n,), m.

    Returns
    -------
    offsets, neighbours
        Row starts, int64 of shape (n + 1,), and node indices, int32, ascending within each row.
    """
    x = np.ascontiguousarray(coordinates, dtype=np.float64)
    count = radius.size
    box = float(radius.max()) * (1 + 1e-12)
    # A box at least as wide as the radius; never many more boxes than nodes, so that a tiny horizon in a large body
    # does not exhaust memory.
    span = np.ptp(x, axis=0) + box
    limit = 4.0 * max(count, 1)
    box = max(box, float(np.cbrt(span.prod() / limit)), float(span.max()) / (limit + 4.0))
    place = ((x - x.min(axis=0)) / box).astype(np.int64)
    columns, rows, layers = (int(k) + 1 for k in place.max(axis=0))
    column, row, layer = (np.ascontiguousarray(place[:, k]) for k in range(3))
    start = np.zeros(columns * rows * layers + 1, np.int64)
    members = np.empty(count, np.int32)
    bin_nodes(column, layer * rows + row, columns, rows * layers, start, members)
    size = np.empty(count, np.int64)
    count_family(x, radius, column, row, layer, columns, rows, layers, start, members, size)
    offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(size)])
    neighbours = np.empty(int(offsets[-1]), np.int32)
    fill_family(x, radius, column, row, layer, columns, rows, layers, start, members, offsets, neighbours)
    return offsets, neighbours
