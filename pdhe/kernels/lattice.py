"""The sweeps on a regular lattice, where a bond is a fixed step in the node numbering.

On a rectangular grid numbered row by row, the neighbour at a given offset is always the same number of nodes away.
Weights are then stored offset by offset, ``weight[o, i]`` for the bond from i to ``i + step[o]`` (zero where there is
none), and each sweep runs over contiguous nodes for one offset after the other: no indices, no gathers, and the
compiler turns the inner loops into vector instructions. Sums over a family are taken in the order of the offsets
whatever the number of threads.

Shared arguments: ``step`` nodes to the neighbour, ``dx, dy`` bond vectors, m, one an offset; ``ux, uy`` displacements,
m (n,). The meaning of the rest is that of the gather kernels in :mod:`pdhe.kernels.mechanics` and
:mod:`pdhe.kernels.diffusion`.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from pdhe.kernels.jit import kernel

#: Nodes of a block: its sums stay in the first-level cache.
BLOCK = 1024


@kernel
def node_rotation(step, dx, dy, cubed, inverse, share, ux, uy, theta, turning):
    """Write the condensed rotation of each node (theory, eq. 2.6) into ``theta``, times its share into ``turning``."""
    n = ux.size
    for b in prange((n + BLOCK - 1) // BLOCK):
        low, high = b * BLOCK, min((b + 1) * BLOCK, n)
        total = np.zeros(BLOCK)
        for o in range(step.size):
            first, last = max(low, -step[o]), min(high, n - step[o])
            if first >= last:
                continue
            square = dx[o] * dx[o] + dy[o] * dy[o]
            ax = -square * dy[o]
            ay = square * dx[o]
            w = cubed[o, first:last]
            x0, y0 = ux[first:last], uy[first:last]
            x1, y1 = ux[first + step[o] : last + step[o]], uy[first + step[o] : last + step[o]]
            t = total[first - low : last - low]
            for k in range(last - first):
                t[k] += w[k] * (ax * (x1[k] - x0[k]) + ay * (y1[k] - y0[k]))
        for i in range(low, high):
            theta[i] = total[i - low] * inverse[i]
            turning[i] = theta[i] * share[i]


@kernel
def internal_force(step, dx, dy, cubed, share, normal, tangential, ux, uy, turning, fx, fy):
    """Write the internal force on each node, N (theory, eq. 2.7), into ``fx`` and ``fy``."""
    n = ux.size
    half = 0.5 * tangential
    for b in prange((n + BLOCK - 1) // BLOCK):
        low, high = b * BLOCK, min((b + 1) * BLOCK, n)
        sum_x, sum_y = np.zeros(BLOCK), np.zeros(BLOCK)
        for o in range(step.size):
            first, last = max(low, -step[o]), min(high, n - step[o])
            if first >= last:
                continue
            vx, vy = dx[o], dy[o]
            square = vx * vx + vy * vy
            w = cubed[o, first:last]
            x0, y0 = ux[first:last], uy[first:last]
            x1, y1 = ux[first + step[o] : last + step[o]], uy[first + step[o] : last + step[o]]
            g0, g1 = share[first:last], share[first + step[o] : last + step[o]]
            t0, t1 = turning[first:last], turning[first + step[o] : last + step[o]]
            sx, sy = sum_x[first - low : last - low], sum_y[first - low : last - low]
            for k in range(last - first):
                ex = x1[k] - x0[k]
                ey = y1[k] - y0[k]
                along = w[k] * normal * (vx * ex + vy * ey)
                across = w[k] * half * ((g0[k] + g1[k]) * (vx * ey - vy * ex) - square * (t0[k] + t1[k]))
                sx[k] += along * vx - across * vy
                sy[k] += along * vy + across * vx
        for i in range(low, high):
            fx[i] = sum_x[i - low]
            fy[i] = sum_y[i - low]


@kernel
def diffuse(step, rate, sink, source, held, volume, dt, psi, new, supply):
    """One forward Euler step of the coverage (theory, eq. 4.5); see :func:`pdhe.kernels.diffusion.diffuse`."""
    n = psi.size
    for b in prange((n + BLOCK - 1) // BLOCK):
        low, high = b * BLOCK, min((b + 1) * BLOCK, n)
        total = np.zeros(BLOCK)
        for o in range(step.size):
            first, last = max(low, -step[o]), min(high, n - step[o])
            if first >= last:
                continue
            w = rate[o, first:last]
            here, there = psi[first:last], psi[first + step[o] : last + step[o]]
            t = total[first - low : last - low]
            for k in range(last - first):
                t[k] += w[k] * (there[k] - here[k])
        for i in range(low, high):
            if held[i]:
                new[i] = psi[i]
                supply[i] -= dt * volume[i] * total[i - low]
            else:
                through_edge = source[i] - sink[i] * psi[i]
                new[i] = psi[i] + dt * (total[i - low] + through_edge)
                supply[i] += dt * volume[i] * through_edge
