"""Deformation gradients, forces and bond loads of correspondence models in space (theory, section 2).

As in :mod:`pdhe.kernels.correspondence`, with positions ``x`` and displacements ``u`` of shape (n, 3). Symmetric
tensors, ``inverse`` and ``control``, have the entries xx, yy, zz, yz, xz, xy (n, 6); others, ``gradient``, ``stress``
and ``state``, theirs row by row, xx, xy, xz, yx and so on (n, 9). ``turn`` is the rotation of a node, rad (n, 3).
"""

from __future__ import annotations

import math

from numba import prange
from numpy import uint32, uint64

from pdhe.kernels.jit import kernel, serial_kernel

#: Where xx, yy, zz, yz, xz, xy are among nine entries, and their counterparts across the diagonal.
PLACE, MIRROR = (0, 4, 8, 5, 2, 1), (0, 4, 8, 7, 6, 3)


@kernel
def shape(nodes, offsets, neighbours, x, cubed, tensor):
    """Write the sums of ``beta lambda V_i V_j / r`` times the bond vector squared of some nodes, m^7 (n, 6)."""
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
            c = cubed[k] * (dx * dx + dy * dy + dz * dz)
            xx += c * dx * dx
            yy += c * dy * dy
            zz += c * dz * dz
            yz += c * dy * dz
            xz += c * dx * dz
            xy += c * dx * dy
        tensor[i, 0] = xx
        tensor[i, 1] = yy
        tensor[i, 2] = zz
        tensor[i, 3] = yz
        tensor[i, 4] = xz
        tensor[i, 5] = xy


@kernel
def displacement_gradient(offsets, neighbours, x, cubed, volume, inverse, u, gradient):
    """Write the displacement gradient of each node (theory, eq. 2.15)."""
    for i in prange(offsets.size - 1):
        px = x[i, 0]
        py = x[i, 1]
        pz = x[i, 2]
        ux = u[i, 0]
        uy = u[i, 1]
        uz = u[i, 2]
        xx = 0.0
        xy = 0.0
        xz = 0.0
        yx = 0.0
        yy = 0.0
        yz = 0.0
        zx = 0.0
        zy = 0.0
        zz = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - px
            dy = x[j, 1] - py
            dz = x[j, 2] - pz
            c = cubed[k] * (dx * dx + dy * dy + dz * dz)
            ex = c * (u[j, 0] - ux)
            ey = c * (u[j, 1] - uy)
            ez = c * (u[j, 2] - uz)
            xx += ex * dx
            xy += ex * dy
            xz += ex * dz
            yx += ey * dx
            yy += ey * dy
            yz += ey * dz
            zx += ez * dx
            zy += ez * dy
            zz += ez * dz
        v = 1.0 / volume[i]
        a = inverse[i, 0] * v
        b = inverse[i, 1] * v
        c = inverse[i, 2] * v
        p = inverse[i, 3] * v
        q = inverse[i, 4] * v
        r = inverse[i, 5] * v
        gradient[i, 0] = xx * a + xy * r + xz * q
        gradient[i, 1] = xx * r + xy * b + xz * p
        gradient[i, 2] = xx * q + xy * p + xz * c
        gradient[i, 3] = yx * a + yy * r + yz * q
        gradient[i, 4] = yx * r + yy * b + yz * p
        gradient[i, 5] = yx * q + yy * p + yz * c
        gradient[i, 6] = zx * a + zy * r + zz * q
        gradient[i, 7] = zx * r + zy * b + zz * p
        gradient[i, 8] = zx * q + zy * p + zz * c


@kernel
def linear_stress(lame, shear, gradient, stress):
    """Write the stress of small strains of an isotropic material, Pa (n, 9), from both of Lamé's constants, Pa."""
    for i in prange(gradient.shape[0]):
        mean = lame * (gradient[i, 0] + gradient[i, 4] + gradient[i, 8])
        for a in range(3):
            for b in range(3):
                stress[i, 3 * a + b] = shear * (gradient[i, 3 * a + b] + gradient[i, 3 * b + a])
            stress[i, 4 * a] += mean


@kernel
def tensor_stress(stiffness, gradient, stress):
    """Write the stress of small strains of any linear material, Pa (n, 9).

    ``stiffness`` has the upper triangle, row by row, for xx, yy, zz, yz, xz, xy of all nodes (1, 21) or of each
    (n, 21), Pa.
    """
    for i in prange(gradient.shape[0]):
        own = i if stiffness.shape[0] > 1 else 0
        for a in range(6):
            total = 0.0
            for b in range(6):
                low = min(a, b)
                strain = gradient[i, PLACE[b]]
                if b > 2:
                    strain += gradient[i, MIRROR[b]]
                total += stiffness[own, low * (11 - low) // 2 + max(a, b)] * strain
            stress[i, PLACE[a]] = total
            stress[i, MIRROR[a]] = total


@kernel
def node_state(inverse, share, control, gradient, stress, state):
    """Write what each node adds to the forces of its bonds, ``g P K^-1 - C1 H`` (theory, eq. 2.17)."""
    for i in prange(gradient.shape[0]):
        g = share[i]
        a = g * inverse[i, 0]
        b = g * inverse[i, 1]
        c = g * inverse[i, 2]
        p = g * inverse[i, 3]
        q = g * inverse[i, 4]
        r = g * inverse[i, 5]
        for row in range(3):
            sx = stress[i, 3 * row]
            sy = stress[i, 3 * row + 1]
            sz = stress[i, 3 * row + 2]
            state[i, 3 * row] = sx * a + sy * r + sz * q
            state[i, 3 * row + 1] = sx * r + sy * b + sz * p
            state[i, 3 * row + 2] = sx * q + sy * p + sz * c
        for column in range(3):
            hx = gradient[i, column]
            hy = gradient[i, 3 + column]
            hz = gradient[i, 6 + column]
            state[i, column] -= control[i, 0] * hx + control[i, 5] * hy + control[i, 4] * hz
            state[i, 3 + column] -= control[i, 5] * hx + control[i, 1] * hy + control[i, 3] * hz
            state[i, 6 + column] -= control[i, 4] * hx + control[i, 3] * hy + control[i, 2] * hz


@kernel
def internal_force(offsets, neighbours, x, cubed, control, state, u, force):
    """Write the internal force on each node, N (theory, eq. 2.17), into ``force`` of shape (n, 3)."""
    for i in prange(offsets.size - 1):
        px = x[i, 0]
        py = x[i, 1]
        pz = x[i, 2]
        ux = u[i, 0]
        uy = u[i, 1]
        uz = u[i, 2]
        sxx = state[i, 0]
        sxy = state[i, 1]
        sxz = state[i, 2]
        syx = state[i, 3]
        syy = state[i, 4]
        syz = state[i, 5]
        szx = state[i, 6]
        szy = state[i, 7]
        szz = state[i, 8]
        cxx = control[i, 0]
        cyy = control[i, 1]
        czz = control[i, 2]
        cyz = control[i, 3]
        cxz = control[i, 4]
        cxy = control[i, 5]
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
            c = cubed[k] * (dx * dx + dy * dy + dz * dz)
            yz = cyz + control[j, 3]
            xz = cxz + control[j, 4]
            xy = cxy + control[j, 5]
            fx += c * (
                (sxx + state[j, 0]) * dx + (sxy + state[j, 1]) * dy + (sxz + state[j, 2]) * dz
                + (cxx + control[j, 0]) * ex + xy * ey + xz * ez
            )  # fmt: skip
            fy += c * (
                (syx + state[j, 3]) * dx + (syy + state[j, 4]) * dy + (syz + state[j, 5]) * dz
                + xy * ex + (cyy + control[j, 1]) * ey + yz * ez
            )  # fmt: skip
            fz += c * (
                (szx + state[j, 6]) * dx + (szy + state[j, 7]) * dy + (szz + state[j, 8]) * dz
                + xz * ex + yz * ey + (czz + control[j, 2]) * ez
            )  # fmt: skip
        force[i, 0] = fx
        force[i, 1] = fy
        force[i, 2] = fz


@kernel
def elastic_energy(offsets, neighbours, x, cubed, volume, share, control, gradient, stress, u, energy):
    """Write the elastic energy of each node, J (theory, eq. 2.16): of its strain, and of what is not affine."""
    for i in prange(offsets.size - 1):
        total = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            dz = x[j, 2] - x[i, 2]
            zx = u[j, 0] - u[i, 0] - gradient[i, 0] * dx - gradient[i, 1] * dy - gradient[i, 2] * dz
            zy = u[j, 1] - u[i, 1] - gradient[i, 3] * dx - gradient[i, 4] * dy - gradient[i, 5] * dz
            zz = u[j, 2] - u[i, 2] - gradient[i, 6] * dx - gradient[i, 7] * dy - gradient[i, 8] * dz
            square = control[i, 0] * zx * zx + control[i, 1] * zy * zy + control[i, 2] * zz * zz
            square += 2.0 * (control[i, 3] * zy * zz + control[i, 4] * zx * zz + control[i, 5] * zx * zy)
            total += cubed[k] * (dx * dx + dy * dy + dz * dz) * square
        work = 0.0
        for a in range(9):
            work += stress[i, a] * gradient[i, a]
        energy[i] = 0.5 * (volume[i] * share[i] * work + total)


@kernel
def control_diagonal(offsets, neighbours, x, cubed, control, diagonal):
    """Write the sums of ``beta lambda V_i V_j / r`` times the controls of both ends, N/m (n, 3)."""
    for i in prange(offsets.size - 1):
        xx = 0.0
        yy = 0.0
        zz = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            dz = x[j, 2] - x[i, 2]
            c = cubed[k] * (dx * dx + dy * dy + dz * dz)
            xx += c * (control[i, 0] + control[j, 0])
            yy += c * (control[i, 1] + control[j, 1])
            zz += c * (control[i, 2] + control[j, 2])
        diagonal[i, 0] = xx
        diagonal[i, 1] = yy
        diagonal[i, 2] = zz


@serial_kernel
def _work(dx, dy, dz, ex, ey, ez, state, control, turn):
    """Work of one end's force over its weight on the relative displacement without the rotation of that end."""
    fx = state[0] * dx + state[1] * dy + state[2] * dz + control[0] * ex + control[5] * ey + control[4] * ez
    fy = state[3] * dx + state[4] * dy + state[5] * dz + control[5] * ex + control[1] * ey + control[3] * ez
    fz = state[6] * dx + state[7] * dy + state[8] * dz + control[4] * ex + control[3] * ey + control[2] * ez
    work = fx * (ex - turn[1] * dz + turn[2] * dy)
    work += fy * (ey - turn[2] * dx + turn[0] * dz)
    return work + fz * (ez - turn[0] * dy + turn[1] * dx)


@kernel
def largest_ratio(
    offsets, neighbours, x, control, state, turn, normal, by_energy, above, u, breakable, resistance, top
):  # fmt: skip
    """Write for each node the largest load of its breakable bonds over the lesser resistance of the bond's two ends."""
    for i in prange(offsets.size - 1):
        largest = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            if breakable[k]:
                j = uint32(neighbours[k])
                dx = x[j, 0] - x[i, 0]
                dy = x[j, 1] - x[i, 1]
                dz = x[j, 2] - x[i, 2]
                ex = u[j, 0] - u[i, 0]
                ey = u[j, 1] - u[i, 1]
                ez = u[j, 2] - u[i, 2]
                square = dx * dx + dy * dy + dz * dz
                load = (dx * ex + dy * ey + dz * ez) / square
                if load <= above:
                    continue
                load = abs(load)
                if by_energy:
                    work = _work(dx, dy, dz, ex, ey, ez, state[i], control[i], turn[i])
                    work += _work(dx, dy, dz, ex, ey, ez, state[j], control[j], turn[j])
                    load = math.sqrt(max(work / (square * normal), 0.0))
                least = min(resistance[i], resistance[j])
                if load > largest * least:
                    largest = load / least
        top[i] = largest
