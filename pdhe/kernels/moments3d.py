"""Bond geometry in space, and weights that give every node the moments of a full ball (theory, eq. 3.11)."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from pdhe.kernels.jit import kernel, serial_kernel

#: Exponents of the monomials of fourth and of third order of a direction.
FOURTH = tuple((4 - b - c, b, c) for b in range(5) for c in range(5 - b))
THIRD = tuple((3 - b - c, b, c) for b in range(4) for c in range(4 - b))
EVEN, ODD = len(FOURTH), len(THIRD)


@kernel
def bond_geometry(offsets, neighbours, x, length, nx, ny, nz):
    """Write length, m, and unit vector of each directed bond; a bond of length zero gets a zero vector."""
    for i in prange(offsets.size - 1):
        for k in range(offsets[i], offsets[i + 1]):
            j = neighbours[k]
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            dz = x[j, 2] - x[i, 2]
            r = math.sqrt(dx * dx + dy * dy + dz * dz)
            length[k] = r
            inverse = 1.0 / r if r > 0.0 else 0.0
            nx[k] = dx * inverse
            ny[k] = dy * inverse
            nz[k] = dz * inverse


@serial_kernel
def _even(x, y, z, out):
    """Write the fifteen monomials of fourth order of a direction, in the order of :data:`FOURTH`."""
    x2, y2, z2 = x * x, y * y, z * z
    x3, y3, z3 = x * x2, y * y2, z * z2
    x4, y4, z4 = x2 * x2, y2 * y2, z2 * z2
    out[0] = x4
    out[1] = x3 * z
    out[2] = x2 * z2
    out[3] = x * z3
    out[4] = z4
    out[5] = x3 * y
    out[6] = x2 * y * z
    out[7] = x * y * z2
    out[8] = y * z3
    out[9] = x2 * y2
    out[10] = x * y2 * z
    out[11] = y2 * z2
    out[12] = x * y3
    out[13] = y3 * z
    out[14] = y4


@serial_kernel
def _odd(x, y, z, out):
    """Write the ten monomials of third order of a direction, in the order of :data:`THIRD`."""
    x2, y2, z2 = x * x, y * y, z * z
    x3, y3, z3 = x * x2, y * y2, z * z2
    out[0] = x3
    out[1] = x2 * z
    out[2] = x * z2
    out[3] = z3
    out[4] = x2 * y
    out[5] = x * y * z
    out[6] = y * z2
    out[7] = x * y2
    out[8] = y2 * z
    out[9] = y3


@kernel
def joint_correction(offsets, neighbours, length, nx, ny, nz, y, correction):
    """Write the change of each directed bond that the multipliers of its two ends make (theory, eq. 3.11).

    ``y`` (n, 25): fifteen multipliers of the even terms and ten of the odd ones, these in metres.
    """
    for i in prange(offsets.size - 1):
        first, second = np.empty(EVEN), np.empty(ODD)
        for k in range(offsets[i], offsets[i + 1]):
            j = neighbours[k]
            _even(nx[k], ny[k], nz[k], first)
            _odd(nx[k], ny[k], nz[k], second)
            value = 0.0
            for a in range(EVEN):
                value += (y[i, a] + y[j, a]) * first[a]
            tilt = 0.0
            for a in range(ODD):
                tilt += (y[i, EVEN + a] - y[j, EVEN + a]) * second[a]
            correction[k] = value + tilt / length[k]


@kernel
def joint_moments(offsets, length, nx, ny, nz, weight, values, out):
    """Write the sums of ``weight * values`` times the even terms and the odd ones over length, (n, 25)."""
    for i in prange(offsets.size - 1):
        first, second = np.empty(EVEN), np.empty(ODD)
        out[i] = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            _even(nx[k], ny[k], nz[k], first)
            _odd(nx[k], ny[k], nz[k], second)
            value = weight[k] * values[k]
            for a in range(EVEN):
                out[i, a] += value * first[a]
            value /= length[k]
            for a in range(ODD):
                out[i, EVEN + a] += value * second[a]
