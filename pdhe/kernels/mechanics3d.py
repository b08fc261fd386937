"""Forces, energies and bond loads of the linear two-parameter bond in space (theory, section 2).

As in :mod:`pdhe.kernels.mechanics`, with positions ``x`` and displacements ``u`` of shape (n, 3); the rotation of a
node is a vector, ``theta`` (n, 3), and ``turning`` is that times the node's share of tangential stiffness. ``inverse``
(n, 6) holds xx, yy, zz, yz, xz, xy of the inverse of a node's rotation weight.
"""

from __future__ import annotations

import math

from numba import prange
from numpy import uint32, uint64

from pdhe.kernels.jit import kernel, serial_kernel


@kernel
def rotation_weight(nodes, offsets, neighbours, x, cubed, weight):
    """Write ``sum_j beta lambda V_i V_j r (1 - n n)`` of some nodes into ``weight`` (k, 6), ordered as ``inverse``."""
    for n in prange(nodes.size):
        i = nodes[n]
        xx = 0.0
        yy = 0.0
        zz = 0.0
        yz = 0.0
        xz = 0.0
        xy = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            dz = x[j, 2] - x[i, 2]
            w = cubed[k] * (dx * dx + dy * dy + dz * dz)
            xx += w * (dy * dy + dz * dz)
            yy += w * (dx * dx + dz * dz)
            zz += w * (dx * dx + dy * dy)
            yz -= w * dy * dz
            xz -= w * dx * dz
            xy -= w * dx * dy
        weight[n, 0] = xx
        weight[n, 1] = yy
        weight[n, 2] = zz
        weight[n, 3] = yz
        weight[n, 4] = xz
        weight[n, 5] = xy


@kernel
def node_rotation(offsets, neighbours, x, cubed, inverse, share, u, theta, turning):
    """Write the condensed rotation of each node (theory, eq. 2.23) and that times its share."""
    for i in prange(offsets.size - 1):
        px = x[i, 0]
        py = x[i, 1]
        pz = x[i, 2]
        ux = u[i, 0]
        uy = u[i, 1]
        uz = u[i, 2]
        mx = 0.0
        my = 0.0
        mz = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - px
            dy = x[j, 1] - py
            dz = x[j, 2] - pz
            ex = u[j, 0] - ux
            ey = u[j, 1] - uy
            ez = u[j, 2] - uz
            w = cubed[k] * (dx * dx + dy * dy + dz * dz)
            mx += w * (dy * ez - dz * ey)
            my += w * (dz * ex - dx * ez)
            mz += w * (dx * ey - dy * ex)
        tx = inverse[i, 0] * mx + inverse[i, 5] * my + inverse[i, 4] * mz
        ty = inverse[i, 5] * mx + inverse[i, 1] * my + inverse[i, 3] * mz
        tz = inverse[i, 4] * mx + inverse[i, 3] * my + inverse[i, 2] * mz
        theta[i, 0] = tx
        theta[i, 1] = ty
        theta[i, 2] = tz
        turning[i, 0] = tx * share[i]
        turning[i, 1] = ty * share[i]
        turning[i, 2] = tz * share[i]


@kernel
def internal_force(offsets, neighbours, x, cubed, share, normal, tangential, u, turning, force):
    """Write the internal force on each node, N (theory, eq. 2.24), into ``force`` of shape (n, 3)."""
    half = 0.5 * tangential
    for i in prange(offsets.size - 1):
        px = x[i, 0]
        py = x[i, 1]
        pz = x[i, 2]
        ux = u[i, 0]
        uy = u[i, 1]
        uz = u[i, 2]
        gi = share[i]
        tx = turning[i, 0]
        ty = turning[i, 1]
        tz = turning[i, 2]
        fx = 0.0
        fy = 0.0
        fz = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - px
            dy = x[j, 1] - py
            dz = x[j, 2] - pz
            ex = u[j, 0] - ux
            ey = u[j, 1] - uy
            ez = u[j, 2] - uz
            sx = tx + turning[j, 0]
            sy = ty + turning[j, 1]
            sz = tz + turning[j, 2]
            square = dx * dx + dy * dy + dz * dz
            stretch = dx * ex + dy * ey + dz * ez
            both = half * (gi + share[j])
            along = cubed[k] * stretch * (normal - both)
            across = cubed[k] * square * both
            turn = cubed[k] * square * half
            fx += along * dx + across * ex - turn * (sy * dz - sz * dy)
            fy += along * dy + across * ey - turn * (sz * dx - sx * dz)
            fz += along * dz + across * ez - turn * (sx * dy - sy * dx)
        force[i, 0] = fx
        force[i, 1] = fy
        force[i, 2] = fz


@kernel
def force_and_ratio(
    offsets, neighbours, x, cubed, share, normal, tangential, by_energy, above, weakness, u, theta, force, nearest
):  # fmt: skip
    """Write forces, and the largest squared load over resistance of each node's bonds, in one go over the bonds.

    ``weakness`` is one over the square of the resistance of a node's bonds, zero where none of them may break.
    """
    half = 0.5 * tangential
    shear = half / normal if by_energy else 0.0
    for i in prange(offsets.size - 1):
        px = x[i, 0]
        py = x[i, 1]
        pz = x[i, 2]
        ux = u[i, 0]
        uy = u[i, 1]
        uz = u[i, 2]
        gi = share[i]
        tx = theta[i, 0]
        ty = theta[i, 1]
        tz = theta[i, 2]
        qi = weakness[i]
        fx = 0.0
        fy = 0.0
        fz = 0.0
        top = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - px
            dy = x[j, 1] - py
            dz = x[j, 2] - pz
            ex = u[j, 0] - ux
            ey = u[j, 1] - uy
            ez = u[j, 2] - uz
            square = dx * dx + dy * dy + dz * dz
            stretch = dx * ex + dy * ey + dz * ez
            # Relative displacements without the rotation of either end, which is across the bond.
            ax = ex - (ty * dz - tz * dy)
            ay = ey - (tz * dx - tx * dz)
            az = ez - (tx * dy - ty * dx)
            bx = ex - (theta[j, 1] * dz - theta[j, 2] * dy)
            by = ey - (theta[j, 2] * dx - theta[j, 0] * dz)
            bz = ez - (theta[j, 0] * dy - theta[j, 1] * dx)
            gj = share[j]
            along = cubed[k] * stretch * (normal - half * (gi + gj))
            across = cubed[k] * square * half
            fx += along * dx + across * (gi * ax + gj * bx)
            fy += along * dy + across * (gi * ay + gj * by)
            fz += along * dz + across * (gi * az + gj * bz)
            qj = weakness[j]
            sheared = gi * (ax * ax + ay * ay + az * az) + gj * (bx * bx + by * by + bz * bz)
            load = stretch * stretch * (1.0 - shear * (gi + gj)) + shear * square * sheared
            load *= max(qi, qj)
            # Asked in this order the answer is nearly always no, which processors foresee.
            if load > top * square * square and stretch > above and cubed[k] > 0.0 and min(qi, qj) > 0.0:
                top = load / (square * square)
        force[i, 0] = fx
        force[i, 1] = fy
        force[i, 2] = fz
        nearest[i] = top


@kernel
def stiffness_diagonal(offsets, neighbours, x, cubed, normal, tangential, diagonal):
    """Write the diagonal of the stiffness with the rotations held, N/m, into ``diagonal`` of shape (n, 3)."""
    for i in prange(offsets.size - 1):
        along_x = 0.0
        along_y = 0.0
        along_z = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            xx = (x[j, 0] - x[i, 0]) ** 2
            yy = (x[j, 1] - x[i, 1]) ** 2
            zz = (x[j, 2] - x[i, 2]) ** 2
            along_x += cubed[k] * (normal * xx + tangential * (yy + zz))
            along_y += cubed[k] * (normal * yy + tangential * (xx + zz))
            along_z += cubed[k] * (normal * zz + tangential * (xx + yy))
        diagonal[i, 0] = along_x
        diagonal[i, 1] = along_y
        diagonal[i, 2] = along_z


@kernel
def fill_short(offsets, neighbours, x, cubed, reach, length, free, scale, starts, column, value, own):
    """Write the stiffness of short bonds alone, times ``scale``, as 3 by 3 blocks in compressed rows.

    The block of a node with itself is number ``own[i]``. Entries of fixed degrees of freedom (``free`` 0) are zero.
    """
    for i in prange(offsets.size - 1):
        at = starts[i]
        middle = -1
        xx = 0.0
        yy = 0.0
        zz = 0.0
        yz = 0.0
        xz = 0.0
        xy = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            j = neighbours[k]
            if middle < 0 and j > i:
                middle = at
                at += 1
            if cubed[k] > 0.0 and length[k] <= reach[i] + reach[j]:
                dx = x[j, 0] - x[i, 0]
                dy = x[j, 1] - x[i, 1]
                dz = x[j, 2] - x[i, 2]
                c = scale * cubed[k]
                xx += c * dx * dx
                yy += c * dy * dy
                zz += c * dz * dz
                yz += c * dy * dz
                xz += c * dx * dz
                xy += c * dx * dy
                column[at] = j
                value[at, 0, 0] = -c * dx * dx * free[i, 0] * free[j, 0]
                value[at, 1, 1] = -c * dy * dy * free[i, 1] * free[j, 1]
                value[at, 2, 2] = -c * dz * dz * free[i, 2] * free[j, 2]
                value[at, 0, 1] = -c * dx * dy * free[i, 0] * free[j, 1]
                value[at, 1, 0] = -c * dx * dy * free[i, 1] * free[j, 0]
                value[at, 0, 2] = -c * dx * dz * free[i, 0] * free[j, 2]
                value[at, 2, 0] = -c * dx * dz * free[i, 2] * free[j, 0]
                value[at, 1, 2] = -c * dy * dz * free[i, 1] * free[j, 2]
                value[at, 2, 1] = -c * dy * dz * free[i, 2] * free[j, 1]
                at += 1
        if middle < 0:
            middle = at
        own[i] = middle
        column[middle] = i
        value[middle, 0, 0] = xx * free[i, 0]
        value[middle, 1, 1] = yy * free[i, 1]
        value[middle, 2, 2] = zz * free[i, 2]
        value[middle, 0, 1] = xy * free[i, 0] * free[i, 1]
        value[middle, 1, 0] = xy * free[i, 0] * free[i, 1]
        value[middle, 0, 2] = xz * free[i, 0] * free[i, 2]
        value[middle, 2, 0] = xz * free[i, 0] * free[i, 2]
        value[middle, 1, 2] = yz * free[i, 1] * free[i, 2]
        value[middle, 2, 1] = yz * free[i, 1] * free[i, 2]


@kernel
def elastic_energy(offsets, neighbours, x, cubed, share, normal, tangential, u, theta, energy):
    """Write the elastic energy of each node, J: half of that of its bonds (theory, eq. 2.1)."""
    for i in prange(offsets.size - 1):
        total = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            dz = x[j, 2] - x[i, 2]
            ex = u[j, 0] - u[i, 0]
            ey = u[j, 1] - u[i, 1]
            ez = u[j, 2] - u[i, 2]
            square = dx * dx + dy * dy + dz * dz
            s = dx * ex + dy * ey + dz * ez
            sheared = share[i] * _shear(dx, dy, dz, ex, ey, ez, theta[i, 0], theta[i, 1], theta[i, 2])
            sheared += share[j] * _shear(dx, dy, dz, ex, ey, ez, theta[j, 0], theta[j, 1], theta[j, 2])
            total += cubed[k] * (normal * s * s + 0.5 * tangential * square * square * sheared)
        energy[i] = 0.25 * total


@serial_kernel
def _shear(dx, dy, dz, ex, ey, ez, tx, ty, tz):
    """Square of the tangential strain of a bond, measured against a rotation."""
    square = dx * dx + dy * dy + dz * dz
    stretch = (dx * ex + dy * ey + dz * ez) / square
    ax = ex - stretch * dx - (ty * dz - tz * dy)
    ay = ey - stretch * dy - (tz * dx - tx * dz)
    az = ez - stretch * dz - (tx * dy - ty * dx)
    return (ax * ax + ay * ay + az * az) / square


@serial_kernel
def _load(dx, dy, dz, ex, ey, ez, share_i, share_j, theta_i, theta_j, ratio, by_energy, above):
    """Load of one bond, given its vector, its relative displacement, and what its two ends know."""
    s = (dx * ex + dy * ey + dz * ez) / (dx * dx + dy * dy + dz * dz)
    if s <= above:
        return 0.0
    if not by_energy:
        return abs(s)
    sheared = share_i * _shear(dx, dy, dz, ex, ey, ez, theta_i[0], theta_i[1], theta_i[2])
    sheared += share_j * _shear(dx, dy, dz, ex, ey, ez, theta_j[0], theta_j[1], theta_j[2])
    return math.sqrt(max(s * s + 0.5 * ratio * sheared, 0.0))


@kernel
def bond_load(offsets, neighbours, x, share, normal, tangential, by_energy, above, u, theta, load):
    """Write the load of each directed bond: what is compared with the critical stretch (theory, eq. 5.2)."""
    ratio = tangential / normal
    for i in prange(offsets.size - 1):
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            load[k] = _load(
                x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2],
                u[j, 0] - u[i, 0], u[j, 1] - u[i, 1], u[j, 2] - u[i, 2],
                share[i], share[j], theta[i], theta[j], ratio, by_energy, above,
            )  # fmt: skip


@kernel
def largest_ratio(
    offsets, neighbours, x, share, normal, tangential, by_energy, above, u, theta, breakable, resistance, top
):  # fmt: skip
    """Write for each node the largest load of its breakable bonds over the lesser resistance of the bond's two ends."""
    ratio = tangential / normal
    for i in prange(offsets.size - 1):
        largest = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            if breakable[k]:
                j = uint32(neighbours[k])
                load = _load(
                    x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2],
                    u[j, 0] - u[i, 0], u[j, 1] - u[i, 1], u[j, 2] - u[i, 2],
                    share[i], share[j], theta[i], theta[j], ratio, by_energy, above,
                )  # fmt: skip
                least = min(resistance[i], resistance[j])
                if load > largest * least:
                    largest = load / least
        top[i] = largest
