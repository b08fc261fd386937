"""Sums in a fixed order, so that a scalar product is the same to the bit on any number of threads."""

from __future__ import annotations

import numpy as np
from numba import prange

from pdhe.kernels.jit import kernel

CHUNK = 2048


@kernel
def _partial_dots(a, b, partial):
    for c in prange(partial.size):
        total = 0.0
        for i in range(c * CHUNK, min((c + 1) * CHUNK, a.size)):
            total += a[i] * b[i]
        partial[c] = total


def dot(a: np.ndarray, b: np.ndarray) -> float:
    """Scalar product of two contiguous arrays of equal size, summed chunk by chunk in a fixed order."""
    partial = np.empty((a.size + CHUNK - 1) // CHUNK)
    _partial_dots(a.reshape(-1), b.reshape(-1), partial)
    total = 0.0
    for value in partial:
        total += float(value)
    return total


def row_sums(values: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Sum the rows of a compressed-row quantity; empty rows give zero (``np.add.reduceat`` alone would not)."""
    padded = np.concatenate([values, np.zeros((1, *values.shape[1:]))])
    sums = np.add.reduceat(padded, offsets[:-1], axis=0)
    sums[np.diff(offsets) == 0] = 0.0
    return sums
