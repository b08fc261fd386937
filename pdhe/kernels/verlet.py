"""Sweeps of the explicit dynamics: forces together with how near bonds are to failure, and the steps of the motion.

The force sweeps are those of :mod:`pdhe.kernels.mechanics` and :mod:`pdhe.kernels.lattice`, with the same arguments,
and write for every node beside the force the square of the largest load over resistance of its bonds. ``weakness`` is
one over the square of the resistance of a node's bonds (n,), zero where none of them may break: of the two ends of a
bond the greater counts, and none if either is zero. Shears count with ``by_energy``, and only bonds
whose stretch is ``above`` a bound (theory, eq. 5.2).

Fields of the motion are flat: all components of all nodes in one array, in whatever order.
"""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy import uint32, uint64

from pdhe.kernels.jit import kernel, serial_kernel

#: Nodes of a block: its sums stay in the first-level cache.
BLOCK = 1024


@kernel
def lattice_force(
    step, dx, dy, cubed, share, normal, tangential, ux, uy, theta, by_energy, above, weakness, fx, fy, square
):  # fmt: skip
    """Write forces and squared loads over resistances of a regular lattice, in one go over the bonds."""
    n = ux.size
    half = 0.5 * tangential
    shear = half / normal if by_energy else 0.0
    for b in prange((n + BLOCK - 1) // BLOCK):
        low, high = b * BLOCK, min((b + 1) * BLOCK, n)
        sum_x, sum_y, top = np.zeros(BLOCK), np.zeros(BLOCK), np.zeros(BLOCK)
        for o in range(step.size):
            first, last = max(low, -step[o]), min(high, n - step[o])
            if first >= last:
                continue
            vx, vy = dx[o], dy[o]
            r2 = vx * vx + vy * vy
            scale = 1.0 / (r2 * r2)
            w = cubed[o, first:last]
            x0, y0 = ux[first:last], uy[first:last]
            x1, y1 = ux[first + step[o] : last + step[o]], uy[first + step[o] : last + step[o]]
            g0, g1 = share[first:last], share[first + step[o] : last + step[o]]
            a0, a1 = theta[first:last], theta[first + step[o] : last + step[o]]
            q0, q1 = weakness[first:last], weakness[first + step[o] : last + step[o]]
            sx, sy = sum_x[first - low : last - low], sum_y[first - low : last - low]
            t = top[first - low : last - low]
            for k in range(last - first):
                ex = x1[k] - x0[k]
                ey = y1[k] - y0[k]
                s = vx * ex + vy * ey
                a = vx * ey - vy * ex
                b0 = a - r2 * a0[k]
                b1 = a - r2 * a1[k]
                h0 = g0[k] * b0
                h1 = g1[k] * b1
                along = w[k] * normal * s
                across = w[k] * half * (h0 + h1)
                sx[k] += along * vx - across * vy
                sy[k] += along * vy + across * vx
                load = (s * s + shear * (h0 * b0 + h1 * b1)) * scale * max(q0[k], q1[k])
                open_ = (s > above) & (w[k] > 0.0) & (min(q0[k], q1[k]) > 0.0)
                t[k] = max(t[k], load if open_ else 0.0)
        for i in range(low, high):
            fx[i] = sum_x[i - low]
            fy[i] = sum_y[i - low]
            square[i] = top[i - low]


@kernel
def gather_force(
    offsets, neighbours, x, cubed, share, normal, tangential, u, spin, by_energy, above, weakness, force, square
):  # fmt: skip
    """Write forces and squared loads over resistances, in one go over the bonds."""
    half = 0.5 * tangential
    shear = half / normal if by_energy else 0.0
    for i in prange(offsets.size - 1):
        px = x[i, 0]
        py = x[i, 1]
        ux = u[i, 0]
        uy = u[i, 1]
        gi = share[i]
        ti = spin[i, 0]
        qi = weakness[i]
        fx = 0.0
        fy = 0.0
        top = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - px
            dy = x[j, 1] - py
            ex = u[j, 0] - ux
            ey = u[j, 1] - uy
            r2 = dx * dx + dy * dy
            s = dx * ex + dy * ey
            a = dx * ey - dy * ex
            bi = a - r2 * ti
            bj = a - r2 * spin[j, 0]
            hi = gi * bi
            hj = share[j] * bj
            along = cubed[k] * normal * s
            across = cubed[k] * half * (hi + hj)
            fx += along * dx - across * dy
            fy += along * dy + across * dx
            qj = weakness[j]
            load = (s * s + shear * (hi * bi + hj * bj)) * max(qi, qj)
            # Asked in this order the answer is nearly always no, which processors foresee.
            if load > top * r2 * r2 and s > above and cubed[k] > 0.0 and min(qi, qj) > 0.0:
                top = load / (r2 * r2)
        force[i, 0] = fx
        force[i, 1] = fy
        square[i] = top


@kernel
def begin_step(u, v, force, half, inverse_mass, step, keep, mass, lost):
    """Half a step of damping and half a kick, then the drift (theory, eq. 7.8); ``lost`` gets the energy of damping.

    Held degrees of freedom have an inverse mass of zero.
    """
    for b in prange((u.size + BLOCK - 1) // BLOCK):
        total = 0.0
        for k in range(b * BLOCK, min((b + 1) * BLOCK, u.size)):
            w = v[k]
            if keep < 1.0 and inverse_mass[k] > 0.0:
                d = w * keep
                total += 0.5 * mass[k] * (w * w - d * d)
                w = d
            w += half * inverse_mass[k] * force[k]
            v[k] = w
            u[k] += step * w
        lost[b] += total


@kernel
def end_step(v, force, half, inverse_mass, keep, mass, lost):
    """The other half of a kick and of the damping."""
    for b in prange((v.size + BLOCK - 1) // BLOCK):
        total = 0.0
        for k in range(b * BLOCK, min((b + 1) * BLOCK, v.size)):
            w = v[k] + half * inverse_mass[k] * force[k]
            if keep < 1.0 and inverse_mass[k] > 0.0:
                d = w * keep
                total += 0.5 * mass[k] * (w * w - d * d)
                w = d
            v[k] = w
        lost[b] += total


@kernel
def end_and_begin_step(u, v, force, half, inverse_mass, step):
    """What :func:`end_step` and :func:`begin_step` do one after the other without damping, in one pass."""
    for b in prange((u.size + BLOCK - 1) // BLOCK):
        for k in range(b * BLOCK, min((b + 1) * BLOCK, u.size)):
            kick = half * inverse_mass[k] * force[k]
            w = v[k] + kick + kick
            v[k] = w
            u[k] += step * w


@serial_kernel
def remember(at, u, force, old_u, old_force):
    """Copy displacements and forces at some degrees of freedom ``at`` (m,)."""
    for m in range(at.size):
        old_u[m] = u[at[m]]
        old_force[m] = force[at[m]]


@serial_kernel
def hold(at, load, factor, amount, u):
    """Set the held degrees of freedom ``at`` (m,) to the sum of two loads times their factors, both (m, 2)."""
    for m in range(at.size):
        u[at[m]] = factor[m, 0] * amount[load[m, 0]] + factor[m, 1] * amount[load[m, 1]]


@serial_kernel
def work_of_held(at, u, force, old_u, old_force, v, step):
    """Return the work against the mean of the forces before and after a step, J, and set the velocities."""
    total = 0.0
    for m in range(at.size):
        way = u[at[m]] - old_u[m]
        v[at[m]] = way / step
        total -= 0.5 * (force[at[m]] + old_force[m]) * way
    return total
