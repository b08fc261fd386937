"""Bond geometry, and the weights that give every node the moments of a full neighbourhood (theory, eq. 3.4)."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from pdhe.kernels.jit import kernel

#: A pivot below this share of the largest diagonal entry counts as zero: the node's bonds cannot bear the constraints.
SINGULAR = 1e-10


@kernel
def bond_geometry(offsets, neighbours, x, length, nx, ny):
    """Write length, m, and unit vector of each directed bond; a bond of length zero gets a zero vector."""
    for i in prange(offsets.size - 1):
        for k in range(offsets[i], offsets[i + 1]):
            j = neighbours[k]
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            r = math.sqrt(dx * dx + dy * dy)
            length[k] = r
            nx[k] = dx / r if r > 0.0 else 0.0
            ny[k] = dy / r if r > 0.0 else 0.0


@kernel
def match_moments(offsets, length, nx, ny, volumes, target, matrix, multiplier, solved):
    """Solve for the Lagrange multipliers of each node.

    ``target`` (p,) are the moments of the full disc and ``multiplier`` (n, p) is written; ``solved`` (n,) tells where.
    Where the system is singular, ``multiplier`` holds its right-hand side instead. ``matrix`` (n, 2 p - 1) gets the
    moments that make up the system, entry (a, b) being number a + b.
    """
    p = target.size
    for i in prange(offsets.size - 1):
        moment = np.zeros(2 * p - 1)
        for k in range(offsets[i], offsets[i + 1]):
            # The terms w nx^(2p-2-a) ny^a, one from the other: no powers to take where a component vanishes.
            for a in range(2 * p - 1):
                term = volumes[k] * length[k]
                for _ in range(2 * p - 2 - a):
                    term *= nx[k]
                for _ in range(a):
                    term *= ny[k]
                moment[a] += term
        # nx^2 + ny^2 = 1 takes the moments of order 2p-2 down to those of order p-1.
        lower = moment.copy()
        for order in range(2 * p - 2, p - 1, -2):
            for a in range(order - 1):
                lower[a] += lower[a + 2]
        rhs = target - lower[:p]
        full = np.empty((p, p))
        largest = 0.0
        for a in range(p):
            for b in range(p):
                full[a, b] = moment[a + b]
            largest = max(largest, full[a, a])
        matrix[i] = moment
        # Factorise as L D L^T: D on the diagonal, L below it.
        fine = largest > 0.0
        for a in range(p):
            for b in range(a):
                full[a, a] -= full[a, b] ** 2 * full[b, b]
            fine = fine and full[a, a] > SINGULAR * largest
            if not fine:
                break
            for c in range(a + 1, p):
                for b in range(a):
                    full[c, a] -= full[c, b] * full[a, b] * full[b, b]
                full[c, a] /= full[a, a]
        solved[i] = fine
        if fine:
            for a in range(p):
                for b in range(a):
                    rhs[a] -= full[a, b] * rhs[b]
            for a in range(p):
                rhs[a] /= full[a, a]
            for a in range(p - 1, -1, -1):
                for b in range(a + 1, p):
                    rhs[a] -= full[b, a] * rhs[b]
        multiplier[i] = rhs


@kernel
def apply_multipliers(offsets, nx, ny, multiplier, correction):
    """Write the correction ``1 + sum_a multiplier_a nx^(p-1-a) ny^a`` of each directed bond."""
    p = multiplier.shape[1]
    for i in prange(offsets.size - 1):
        for k in range(offsets[i], offsets[i + 1]):
            value = 1.0
            for a in range(p):
                term = multiplier[i, a]
                for _ in range(p - 1 - a):
                    term *= nx[k]
                for _ in range(a):
                    term *= ny[k]
                value += term
            correction[k] = value


@kernel
def joint_correction(offsets, neighbours, length, nx, ny, y, correction):
    """Write the change of each directed bond that the multipliers of its two ends make (theory, eq. 3.9).

    ``y`` (n, 9): five multipliers of the even terms and four of the odd ones, these in metres.
    """
    for i in prange(offsets.size - 1):
        for k in range(offsets[i], offsets[i + 1]):
            j = neighbours[k]
            even = 0.0
            for a in range(5):
                even = even + (y[i, a] + y[j, a]) * nx[k] ** (4 - a) * ny[k] ** a
            odd = 0.0
            for a in range(4):
                odd = odd + (y[i, 5 + a] - y[j, 5 + a]) * nx[k] ** (3 - a) * ny[k] ** a
            correction[k] = even + odd / length[k]


@kernel
def joint_moments(offsets, length, nx, ny, weight, values, out):
    """Write the sums of ``weight * values`` times the five even terms and the four odd ones over length, (n, 9)."""
    for i in prange(offsets.size - 1):
        out[i] = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            even = weight[k] * values[k]
            for a in range(5):
                out[i, a] += even * nx[k] ** (4 - a) * ny[k] ** a
            odd = even / length[k]
            for a in range(4):
                out[i, 5 + a] += odd * nx[k] ** (3 - a) * ny[k] ** a
