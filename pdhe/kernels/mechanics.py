"""Forces, energies and bond loads of the linear two-parameter bond (theory, section 2).

Shared arguments: ``offsets, neighbours`` directed bonds; ``x`` node positions, m, and ``u`` displacements, m, both (n,
2); ``cubed`` the bond's ``beta lambda V_i V_j / r^3``, m^3, zero where the bond is broken, equal in both directions;
``inverse`` one over the rotation weight of a node (zero: no rotation is condensed out); ``share`` the factor on a
node's tangential stiffness.

With that weight nothing needs a square root or a division per bond, and a bond streams 12 bytes: geometry comes from
the node positions, which stay in cache, instead of from stored directions and lengths. The force sweep is bound by
memory, and this made it 2.3 times faster than with stored directions (20,000 nodes, one thread), to the same round-off.

Row starts and neighbours are taken as unsigned: a signed index may count from the end, and the test for that takes a
fifth to a half of a sweep.
"""

from __future__ import annotations

import math

from numba import prange
from numpy import uint32, uint64

from pdhe.kernels.jit import kernel, serial_kernel


@kernel
def rotation_weight(nodes, offsets, neighbours, x, cubed, inverse):
    """Write ``1 / sum_j beta lambda V_i V_j r`` of some nodes into ``inverse``; zero where no bond is left."""
    for n in prange(nodes.size):
        i = nodes[n]
        total = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            square = dx * dx + dy * dy
            total += cubed[k] * square * square
        inverse[i] = 1.0 / total if total > 0.0 else 0.0


@kernel
def node_rotation(offsets, neighbours, x, cubed, inverse, share, u, spin):
    """Write the condensed rotation of each node (theory, eq. 2.6), ``spin[:, 0]``, and that times its share."""
    for i in prange(offsets.size - 1):
        px = x[i, 0]
        py = x[i, 1]
        ux = u[i, 0]
        uy = u[i, 1]
        total = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - px
            dy = x[j, 1] - py
            total += cubed[k] * (dx * dx + dy * dy) * (dx * (u[j, 1] - uy) - dy * (u[j, 0] - ux))
        theta = total * inverse[i]
        spin[i, 0] = theta
        spin[i, 1] = theta * share[i]


@kernel
def internal_force(offsets, neighbours, x, cubed, share, normal, tangential, u, spin, force):
    """Write the internal force on each node, N (theory, eq. 2.7), into ``force`` of shape (n, 2)."""
    half = 0.5 * tangential
    for i in prange(offsets.size - 1):
        px = x[i, 0]
        py = x[i, 1]
        ux = u[i, 0]
        uy = u[i, 1]
        gi = share[i]
        ti = spin[i, 1]
        fx = 0.0
        fy = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - px
            dy = x[j, 1] - py
            ex = u[j, 0] - ux
            ey = u[j, 1] - uy
            along = cubed[k] * normal * (dx * ex + dy * ey)
            turn = (gi + share[j]) * (dx * ey - dy * ex) - (dx * dx + dy * dy) * (ti + spin[j, 1])
            across = cubed[k] * half * turn
            fx += along * dx - across * dy
            fy += along * dy + across * dx
        force[i, 0] = fx
        force[i, 1] = fy


@kernel
def stiffness_diagonal(offsets, neighbours, x, cubed, normal, tangential, diagonal):
    """Write the diagonal of the stiffness with the rotations held, N/m, into ``diagonal`` of shape (n, 2)."""
    for i in prange(offsets.size - 1):
        along_x = 0.0
        along_y = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            along_x += cubed[k] * (normal * dx * dx + tangential * dy * dy)
            along_y += cubed[k] * (normal * dy * dy + tangential * dx * dx)
        diagonal[i, 0] = along_x
        diagonal[i, 1] = along_y


@kernel
def count_short(offsets, neighbours, cubed, reach, weight, length, count, stiffness):
    """Count the unbroken bonds of each node that are no longer than the sum of the ``reach`` of their ends, m (n,).

    ``stiffness`` (n, 2) gets the sums of weight times length over such bonds, broken ones included, and over all bonds.
    """
    for i in prange(offsets.size - 1):
        found = 0
        short = 0.0
        whole = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            value = weight[k] * length[k]
            whole += value
            if length[k] <= reach[i] + reach[uint32(neighbours[k])]:
                short += value
                if cubed[k] > 0.0:
                    found += 1
        count[i] = found
        stiffness[i, 0] = short
        stiffness[i, 1] = whole


@kernel
def fill_short(offsets, neighbours, x, cubed, reach, length, free, scale, starts, column, value, own):
    """Write the stiffness of those bonds alone, times ``scale``, as 2 by 2 blocks in compressed rows.

    The block of a node with itself is number ``own[i]``. Entries of fixed degrees of freedom (``free`` 0) are zero.
    """
    for i in prange(offsets.size - 1):
        at = starts[i]
        middle = -1
        xx = 0.0
        xy = 0.0
        yy = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            j = neighbours[k]
            if middle < 0 and j > i:
                middle = at
                at += 1
            if cubed[k] > 0.0 and length[k] <= reach[i] + reach[j]:
                dx = x[j, 0] - x[i, 0]
                dy = x[j, 1] - x[i, 1]
                c = scale * cubed[k]
                xx += c * dx * dx
                xy += c * dx * dy
                yy += c * dy * dy
                column[at] = j
                value[at, 0, 0] = -c * dx * dx * free[i, 0] * free[j, 0]
                value[at, 0, 1] = -c * dx * dy * free[i, 0] * free[j, 1]
                value[at, 1, 0] = -c * dx * dy * free[i, 1] * free[j, 0]
                value[at, 1, 1] = -c * dy * dy * free[i, 1] * free[j, 1]
                at += 1
        if middle < 0:
            middle = at
        own[i] = middle
        column[middle] = i
        value[middle, 0, 0] = xx * free[i, 0]
        value[middle, 1, 1] = yy * free[i, 1]
        value[middle, 0, 1] = value[middle, 1, 0] = xy * free[i, 0] * free[i, 1]


@kernel
def elastic_energy(offsets, neighbours, x, cubed, share, normal, tangential, u, spin, energy):
    """Write the elastic energy of each node, J: half of that of its bonds."""
    for i in prange(offsets.size - 1):
        total = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            ex = u[j, 0] - u[i, 0]
            ey = u[j, 1] - u[i, 1]
            square = dx * dx + dy * dy
            s = dx * ex + dy * ey
            a = dx * ey - dy * ex
            gi = a - square * spin[i, 0]
            gj = a - square * spin[j, 0]
            total += cubed[k] * (normal * s * s + 0.5 * tangential * (share[i] * gi * gi + share[j] * gj * gj))
        energy[i] = 0.25 * total


@serial_kernel
def _load(dx, dy, ex, ey, share_i, share_j, theta_i, theta_j, ratio, by_energy, above):
    """Load of one bond, given its vector, its relative displacement, and what its two ends know."""
    square = dx * dx + dy * dy
    s = (dx * ex + dy * ey) / square
    if s <= above:
        return 0.0
    if not by_energy:
        return abs(s)
    a = (dx * ey - dy * ex) / square
    gi = a - theta_i
    gj = a - theta_j
    return math.sqrt(max(s * s + 0.5 * ratio * (share_i * gi * gi + share_j * gj * gj), 0.0))


@kernel
def bond_load(offsets, neighbours, x, share, normal, tangential, by_energy, above, u, spin, load):
    """Write the load of each directed bond: what is compared with the critical stretch (theory, eq. 5.2).

    That is the size of the stretch, or with ``by_energy`` the stretch of a bond of the same energy without shear; bonds
    whose stretch is not ``above`` a bound have load zero.
    """
    ratio = tangential / normal
    for i in prange(offsets.size - 1):
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            load[k] = _load(
                x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], u[j, 0] - u[i, 0], u[j, 1] - u[i, 1],
                share[i], share[j], spin[i, 0], spin[j, 0], ratio, by_energy, above,
            )  # fmt: skip


@kernel
def largest_ratio(
    offsets, neighbours, x, share, normal, tangential, by_energy, above, u, spin, breakable, resistance, top
):  # fmt: skip
    """Write for each node the largest load of its breakable bonds over the lesser resistance of the bond's two ends."""
    ratio = tangential / normal
    for i in prange(offsets.size - 1):
        largest = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            if breakable[k]:
                j = uint32(neighbours[k])
                load = _load(
                    x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], u[j, 0] - u[i, 0], u[j, 1] - u[i, 1],
                    share[i], share[j], spin[i, 0], spin[j, 0], ratio, by_energy, above,
                )  # fmt: skip
                least = min(resistance[i], resistance[j])
                if load > largest * least:
                    largest = load / least
        top[i] = largest


@kernel
def damage(nodes, offsets, neighbours, volume, intact, phi):
    """Write the volume-weighted share of broken bonds of some nodes into ``phi``; zero for a node without a family."""
    for n in prange(nodes.size):
        i = nodes[n]
        whole = 0.0
        broken = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            v = volume[uint32(neighbours[k])]
            whole += v
            if not intact[k]:
                broken += v
        phi[i] = broken / whole if whole > 0.0 else 0.0
