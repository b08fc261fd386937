"""Deformation gradients, forces and bond loads of correspondence models in the plane (theory, section 2).

Shared arguments: ``offsets, neighbours`` directed bonds; ``x`` node positions, m, and ``u`` displacements, m, both (n,
2); ``cubed`` the bond's ``beta lambda V_i V_j / r^3``, m^3, zero where the bond is broken, equal in both directions;
``inverse`` the entries xx, xy, yy of the inverse shape tensor times the volume, 1/m^4 (n, 3); ``control`` the entries
xx, xy, yy of what resists zero-energy modes, N/m^6 (n, 3); ``share`` the factor on the stress of a node; ``gradient``
displacement gradients as xx, xy, yx, yy, the displacement first (n, 4); ``state`` what a node adds to the forces of its
bonds, N/m^6, in the same order (n, 4).

As in :mod:`pdhe.kernels.mechanics`, geometry comes from the node positions, and a bond streams 12 bytes.
"""

from __future__ import annotations

import math

from numba import prange
from numpy import uint32, uint64

from pdhe.kernels.jit import kernel


@kernel
def shape(nodes, offsets, neighbours, x, cubed, tensor):
    """Write the sums of ``beta lambda V_i V_j / r`` times xx, xy, yy of the bond vector of some nodes, m^7 (n, 3)."""
    for n in prange(nodes.size):
        i = nodes[n]
        xx = 0.0
        xy = 0.0
        yy = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            c = cubed[k] * (dx * dx + dy * dy)
            xx += c * dx * dx
            xy += c * dx * dy
            yy += c * dy * dy
        tensor[i, 0] = xx
        tensor[i, 1] = xy
        tensor[i, 2] = yy


@kernel
def displacement_gradient(offsets, neighbours, x, cubed, volume, inverse, u, gradient):
    """Write the displacement gradient of each node (theory, eq. 2.15)."""
    for i in prange(offsets.size - 1):
        px = x[i, 0]
        py = x[i, 1]
        ux = u[i, 0]
        uy = u[i, 1]
        xx = 0.0
        xy = 0.0
        yx = 0.0
        yy = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - px
            dy = x[j, 1] - py
            c = cubed[k] * (dx * dx + dy * dy)
            ex = c * (u[j, 0] - ux)
            ey = c * (u[j, 1] - uy)
            xx += ex * dx
            xy += ex * dy
            yx += ey * dx
            yy += ey * dy
        v = 1.0 / volume[i]
        a = inverse[i, 0] * v
        b = inverse[i, 1] * v
        c = inverse[i, 2] * v
        gradient[i, 0] = xx * a + xy * b
        gradient[i, 1] = xx * b + xy * c
        gradient[i, 2] = yx * a + yy * b
        gradient[i, 3] = yx * b + yy * c


@kernel
def linear_stress(stiffness, gradient, stress):
    """Write the stress of small strains, Pa (n, 4); ``stiffness`` holds xx-xx, xx-yy, xx-xy, yy-yy, yy-xy, xy-xy."""
    for i in prange(gradient.shape[0]):
        m = uint64(i) if stiffness.shape[0] > 1 else uint64(0)
        xx = gradient[i, 0]
        yy = gradient[i, 3]
        xy = gradient[i, 1] + gradient[i, 2]
        shear = stiffness[m, 2] * xx + stiffness[m, 4] * yy + stiffness[m, 5] * xy
        stress[i, 0] = stiffness[m, 0] * xx + stiffness[m, 1] * yy + stiffness[m, 2] * xy
        stress[i, 1] = shear
        stress[i, 2] = shear
        stress[i, 3] = stiffness[m, 1] * xx + stiffness[m, 3] * yy + stiffness[m, 4] * xy


@kernel
def node_state(inverse, share, control, gradient, stress, state):
    """Write what each node adds to the forces of its bonds, ``g P K^-1 - C1 H`` (theory, eq. 2.17)."""
    for i in prange(gradient.shape[0]):
        a = share[i] * inverse[i, 0]
        b = share[i] * inverse[i, 1]
        c = share[i] * inverse[i, 2]
        p = control[i, 0]
        q = control[i, 1]
        r = control[i, 2]
        state[i, 0] = stress[i, 0] * a + stress[i, 1] * b - p * gradient[i, 0] - q * gradient[i, 2]
        state[i, 1] = stress[i, 0] * b + stress[i, 1] * c - p * gradient[i, 1] - q * gradient[i, 3]
        state[i, 2] = stress[i, 2] * a + stress[i, 3] * b - q * gradient[i, 0] - r * gradient[i, 2]
        state[i, 3] = stress[i, 2] * b + stress[i, 3] * c - q * gradient[i, 1] - r * gradient[i, 3]


@kernel
def internal_force(offsets, neighbours, x, cubed, control, state, u, force):
    """Write the internal force on each node, N (theory, eq. 2.17), into ``force`` of shape (n, 2)."""
    for i in prange(offsets.size - 1):
        px = x[i, 0]
        py = x[i, 1]
        ux = u[i, 0]
        uy = u[i, 1]
        gxx = state[i, 0]
        gxy = state[i, 1]
        gyx = state[i, 2]
        gyy = state[i, 3]
        pxx = control[i, 0]
        pxy = control[i, 1]
        pyy = control[i, 2]
        fx = 0.0
        fy = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - px
            dy = x[j, 1] - py
            ex = u[j, 0] - ux
            ey = u[j, 1] - uy
            c = cubed[k] * (dx * dx + dy * dy)
            cross = pxy + control[j, 1]
            fx += c * ((gxx + state[j, 0]) * dx + (gxy + state[j, 1]) * dy + (pxx + control[j, 0]) * ex + cross * ey)
            fy += c * ((gyx + state[j, 2]) * dx + (gyy + state[j, 3]) * dy + cross * ex + (pyy + control[j, 2]) * ey)
        force[i, 0] = fx
        force[i, 1] = fy


@kernel
def elastic_energy(offsets, neighbours, x, cubed, volume, share, control, gradient, stress, u, energy):
    """Write the elastic energy of each node, J (theory, eq. 2.16): of its strain, and of what is not affine."""
    for i in prange(offsets.size - 1):
        total = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            zx = u[j, 0] - u[i, 0] - gradient[i, 0] * dx - gradient[i, 1] * dy
            zy = u[j, 1] - u[i, 1] - gradient[i, 2] * dx - gradient[i, 3] * dy
            c = cubed[k] * (dx * dx + dy * dy)
            total += c * (control[i, 0] * zx * zx + 2.0 * control[i, 1] * zx * zy + control[i, 2] * zy * zy)
        work = stress[i, 0] * gradient[i, 0] + stress[i, 3] * gradient[i, 3]
        work += stress[i, 1] * gradient[i, 1] + stress[i, 2] * gradient[i, 2]
        energy[i] = 0.5 * (volume[i] * share[i] * work + total)


@kernel
def control_diagonal(offsets, neighbours, x, cubed, control, diagonal):
    """Write the sums of ``beta lambda V_i V_j / r`` times the controls of both ends, N/m (n, 2)."""
    for i in prange(offsets.size - 1):
        xx = 0.0
        yy = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            c = cubed[k] * (dx * dx + dy * dy)
            xx += c * (control[i, 0] + control[j, 0])
            yy += c * (control[i, 2] + control[j, 2])
        diagonal[i, 0] = xx
        diagonal[i, 1] = yy


@kernel
def largest_ratio(
    offsets, neighbours, x, control, state, turn, normal, by_energy, above, u, breakable, resistance, top
):  # fmt: skip
    """Write for each node the largest load of its breakable bonds over the lesser resistance of the bond's two ends.

    ``turn`` is the rotation of each node, rad (n,).
    """
    for i in prange(offsets.size - 1):
        largest = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            if breakable[k]:
                j = uint32(neighbours[k])
                dx = x[j, 0] - x[i, 0]
                dy = x[j, 1] - x[i, 1]
                ex = u[j, 0] - u[i, 0]
                ey = u[j, 1] - u[i, 1]
                square = dx * dx + dy * dy
                load = (dx * ex + dy * ey) / square
                if load <= above:
                    continue
                load = abs(load)
                if by_energy:
                    tx = state[i, 0] * dx + state[i, 1] * dy + control[i, 0] * ex + control[i, 1] * ey
                    ty = state[i, 2] * dx + state[i, 3] * dy + control[i, 1] * ex + control[i, 2] * ey
                    work = tx * (ex + turn[i] * dy) + ty * (ey - turn[i] * dx)
                    tx = state[j, 0] * dx + state[j, 1] * dy + control[j, 0] * ex + control[j, 1] * ey
                    ty = state[j, 2] * dx + state[j, 3] * dy + control[j, 1] * ex + control[j, 2] * ey
                    work += tx * (ex + turn[j] * dy) + ty * (ey - turn[j] * dx)
                    load = math.sqrt(max(work / (square * normal), 0.0))
                least = min(resistance[i], resistance[j])
                if load > largest * least:
                    largest = load / least
        top[i] = largest
