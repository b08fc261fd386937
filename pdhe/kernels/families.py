"""Neighbour search: the family of every node within a radius, as directed bonds in compressed sparse rows."""

from __future__ import annotations

import numpy as np
from numba import prange

from pdhe.kernels.jit import kernel, serial_kernel


@serial_kernel
def bin_nodes(column, row, columns, rows, start, members):
    """Sort nodes into grid boxes: ``members[start[b]:start[b+1]]`` are the nodes of box ``b``, ascending."""
    for i in range(column.size):
        start[row[i] * columns + column[i] + 1] += 1
    for b in range(columns * rows):
        start[b + 1] += start[b]
    fill = start[:-1].copy()
    for i in range(column.size):
        b = row[i] * columns + column[i]
        members[fill[b]] = i
        fill[b] += 1


@kernel
def count_family(x, y, radius, column, row, columns, rows, start, members, count):
    """Write the number of nodes within ``radius[i]``-reach of each node (itself excluded) into ``count``.

    The reach of a pair is the larger of both radii, so that every bond is found from both of its ends.
    """
    for i in prange(x.size):
        found = 0
        for r in range(max(row[i] - 1, 0), min(row[i] + 2, rows)):
            first = start[r * columns + max(column[i] - 1, 0)]
            last = start[r * columns + min(column[i] + 1, columns - 1) + 1]
            for k in range(first, last):
                j = members[k]
                reach = max(radius[i], radius[j])
                dx = x[j] - x[i]
                dy = y[j] - y[i]
                if j != i and dx * dx + dy * dy <= reach * reach:
                    found += 1
        count[i] = found


@kernel
def fill_family(x, y, radius, column, row, columns, rows, start, members, offsets, neighbours):
    """Write the family of node ``i``, ascending, into ``neighbours[offsets[i]:offsets[i+1]]``."""
    for i in prange(x.size):
        position = offsets[i]
        for r in range(max(row[i] - 1, 0), min(row[i] + 2, rows)):
            first = start[r * columns + max(column[i] - 1, 0)]
            last = start[r * columns + min(column[i] + 1, columns - 1) + 1]
            for k in range(first, last):
                j = members[k]
                reach = max(radius[i], radius[j])
                dx = x[j] - x[i]
                dy = y[j] - y[i]
                if j != i and dx * dx + dy * dy <= reach * reach:
                    neighbours[position] = j
                    position += 1
        neighbours[offsets[i] : offsets[i + 1]].sort()


@kernel
def reverse_bonds(offsets, neighbours, reverse):
    """Write for each directed bond i -> j the index of j -> i, found by bisection in the sorted row of j."""
    for i in prange(offsets.size - 1):
        for k in range(offsets[i], offsets[i + 1]):
            j = neighbours[k]
            low = offsets[j]
            high = offsets[j + 1]
            while low < high:
                middle = (low + high) // 2
                if neighbours[middle] < i:
                    low = middle + 1
                else:
                    high = middle
            reverse[k] = low


def find_families(coordinates: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find all pairs of nodes no further apart than the larger of their radii.

    Parameters
    ----------
    coordinates
        Positions, shape (n, 2), m.
    radius
        Search radius of each node, shape (n,), m.

    Returns
    -------
    offsets, neighbours
        Row starts, int64 of shape (n + 1,), and node indices, int32, ascending within each row.
    """
    x = np.ascontiguousarray(coordinates[:, 0])
    y = np.ascontiguousarray(coordinates[:, 1])
    box = float(radius.max()) * (1 + 1e-12)
    # A box at least as wide as the radius; never more boxes than about four per node, so that a tiny horizon in a large
    # plate does not exhaust memory.
    span = np.ptp(coordinates, axis=0) + box
    box = max(box, float(np.sqrt(span[0] * span[1] / (4.0 * max(x.size, 1)))), float(span.max()) / (4.0 * x.size + 4.0))
    column = ((x - x.min()) / box).astype(np.int64)
    row = ((y - y.min()) / box).astype(np.int64)
    columns, rows = int(column.max()) + 1, int(row.max()) + 1
    start = np.zeros(columns * rows + 1, np.int64)
    members = np.empty(x.size, np.int32)
    bin_nodes(column, row, columns, rows, start, members)
    count = np.empty(x.size, np.int64)
    count_family(x, y, radius, column, row, columns, rows, start, members, count)
    offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(count)])
    neighbours = np.empty(int(offsets[-1]), np.int32)
    fill_family(x, y, radius, column, row, columns, rows, start, members, offsets, neighbours)
    return offsets, neighbours
