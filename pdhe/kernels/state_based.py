"""Forces, energies and bond loads of the linear peridynamic solid (theory, section 2), in two and three dimensions.

Shared arguments: ``offsets, neighbours`` directed bonds; ``x`` node positions, m, and ``u`` displacements, m, both (n,
dim); ``cubed`` the bond's ``beta lambda V_i V_j / r^3``, m^3, zero where the bond is broken, equal in both directions;
``spread`` one over the weighted volume of a node, 1/m^4; ``pressure`` what its dilatation adds to the force of its
bonds, N/m^6; ``along`` the factor of the stretch in that force, Pa.

As in :mod:`pdhe.kernels.mechanics`, geometry comes from the node positions, and a bond streams 12 bytes.
"""

from __future__ import annotations

import math

from numba import prange
from numpy import uint32, uint64

from pdhe.kernels.jit import kernel, serial_kernel


@kernel
def dilatation(offsets, neighbours, x, cubed, volume, spread, u, theta):
    """Write the dilatation of each node (theory, eq. 2.10); zero for a node without a family."""
    dim = x.shape[1]
    for i in prange(offsets.size - 1):
        total = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            square = dx * dx + dy * dy
            stretch = dx * (u[j, 0] - u[i, 0]) + dy * (u[j, 1] - u[i, 1])
            if dim == 3:
                dz = x[j, 2] - x[i, 2]
                square += dz * dz
                stretch += dz * (u[j, 2] - u[i, 2])
            total += cubed[k] * square * stretch
        theta[i] = total * spread[i] / volume[i] if volume[i] > 0.0 else 0.0


@kernel
def internal_force(offsets, neighbours, x, cubed, spread, pressure, along, u, force):
    """Write the internal force on each node, N (theory, eq. 2.12), into ``force`` of shape (n, dim)."""
    dim = x.shape[1]
    for i in prange(offsets.size - 1):
        pi = pressure[i]
        ai = along * spread[i]
        fx = 0.0
        fy = 0.0
        fz = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            square = dx * dx + dy * dy
            stretch = dx * (u[j, 0] - u[i, 0]) + dy * (u[j, 1] - u[i, 1])
            if dim == 3:
                dz = x[j, 2] - x[i, 2]
                square += dz * dz
                stretch += dz * (u[j, 2] - u[i, 2])
                f = cubed[k] * (square * (pi + pressure[j]) + stretch * (ai + along * spread[j]))
                fz += f * dz
            else:
                f = cubed[k] * (square * (pi + pressure[j]) + stretch * (ai + along * spread[j]))
            fx += f * dx
            fy += f * dy
        force[i, 0] = fx
        force[i, 1] = fy
        if dim == 3:
            force[i, 2] = fz


@kernel
def force_and_ratio(
    offsets, neighbours, x, cubed, spread, pressure, along, counted, counted_along, normal, by_energy, above, weakness,
    u, force, nearest,
):  # fmt: skip
    """Write forces, and the largest squared load over resistance of each node's bonds, in one go over the bonds.

    ``counted`` and ``counted_along`` are what ``pressure`` and ``along`` are for the energy that counts; ``weakness``
    is one over the square of the resistance of a node's bonds, zero where none of them may break.
    """
    dim = x.shape[1]
    for i in prange(offsets.size - 1):
        pi = pressure[i]
        ai = along * spread[i]
        ci = counted[i]
        bi = counted_along * spread[i]
        qi = weakness[i]
        fx = 0.0
        fy = 0.0
        fz = 0.0
        top = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            square = dx * dx + dy * dy
            stretch = dx * (u[j, 0] - u[i, 0]) + dy * (u[j, 1] - u[i, 1])
            if dim == 3:
                dz = x[j, 2] - x[i, 2]
                square += dz * dz
                stretch += dz * (u[j, 2] - u[i, 2])
            f = cubed[k] * (square * (pi + pressure[j]) + stretch * (ai + along * spread[j]))
            fx += f * dx
            fy += f * dy
            if dim == 3:
                fz += f * dz
            qj = weakness[j]
            load = stretch * stretch
            if by_energy:
                load = stretch * (square * (ci + counted[j]) + stretch * (bi + counted_along * spread[j])) / normal
            load *= max(qi, qj)
            # Asked in this order the answer is nearly always no, which processors foresee.
            if load > top * square * square and stretch > above and cubed[k] > 0.0 and min(qi, qj) > 0.0:
                top = load / (square * square)
        force[i, 0] = fx
        force[i, 1] = fy
        if dim == 3:
            force[i, 2] = fz
        nearest[i] = top


@kernel
def elastic_energy(offsets, neighbours, x, cubed, volume, spread, theta, volumetric, along, u, energy):
    """Write the elastic energy of each node, J (theory, eq. 2.11)."""
    dim = x.shape[1]
    for i in prange(offsets.size - 1):
        total = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            stretch = (x[j, 0] - x[i, 0]) * (u[j, 0] - u[i, 0]) + (x[j, 1] - x[i, 1]) * (u[j, 1] - u[i, 1])
            if dim == 3:
                stretch += (x[j, 2] - x[i, 2]) * (u[j, 2] - u[i, 2])
            total += cubed[k] * stretch * stretch
        energy[i] = 0.5 * (volume[i] * volumetric * theta[i] * theta[i] + along * spread[i] * total)


@kernel
def stiffness_rows(offsets, neighbours, x, cubed, spread, bound, rows):
    """Write the sums of magnitudes in the rows of bonds with the micromodulus ``bound (spread_i + spread_j)``, N/m."""
    dim = x.shape[1]
    for i in prange(offsets.size - 1):
        for a in range(dim):
            rows[i, a] = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            c = 2.0 * bound * (spread[i] + spread[j]) * cubed[k]
            for a in range(dim):
                for b in range(dim):
                    rows[i, a] += c * abs((x[j, a] - x[i, a]) * (x[j, b] - x[i, b]))


@serial_kernel
def _load(square, stretch, force, normal, by_energy, above):
    """Load of one bond, given the square of its length, its stretch times that, and its force over its weight."""
    if stretch <= above:
        return 0.0
    s = stretch / square
    return math.sqrt(max(s * force / normal, 0.0)) if by_energy else abs(s)


@kernel
def largest_ratio(
    offsets, neighbours, x, spread, pressure, along, normal, by_energy, above, u, breakable, resistance, top
):  # fmt: skip
    """Write for each node the largest load of its breakable bonds over the lesser resistance of the bond's two ends."""
    dim = x.shape[1]
    for i in prange(offsets.size - 1):
        largest = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            if breakable[k]:
                j = uint32(neighbours[k])
                dx = x[j, 0] - x[i, 0]
                dy = x[j, 1] - x[i, 1]
                square = dx * dx + dy * dy
                stretch = dx * (u[j, 0] - u[i, 0]) + dy * (u[j, 1] - u[i, 1])
                if dim == 3:
                    dz = x[j, 2] - x[i, 2]
                    square += dz * dz
                    stretch += dz * (u[j, 2] - u[i, 2])
                force = pressure[i] + pressure[j] + along * (spread[i] + spread[j]) * stretch / square
                load = _load(square, stretch, force, normal, by_energy, above)
                least = min(resistance[i], resistance[j])
                if load > largest * least:
                    largest = load / least
        top[i] = largest
