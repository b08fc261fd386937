"""Forces, energies and bond loads of the linear two-parameter bond (theory, section 2).

Shared arguments: ``offsets, neighbours`` directed bonds; ``nx, ny`` unit bond vectors; ``length`` m; ``weight`` the bond's
``beta lambda V_i V_j`` (m^6), zero where the bond is broken, equal in both directions; ``inverse`` one over the rotation
weight of a node (zero: no rotation is condensed out); ``share`` the factor on the tangential stiffness of a node;
``u`` displacements, shape (n, 2), m.
"""

from __future__ import annotations

import math

from numba import prange

from pdhe.kernels.jit import kernel


@kernel
def rotation_weight(offsets, length, weight, inverse):
    """Write ``1 / sum_j weight * length`` of each node into ``inverse``; zero where no bond is left."""
    for i in prange(offsets.size - 1):
        total = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            total += weight[k] * length[k]
        inverse[i] = 1.0 / total if total > 0.0 else 0.0


@kernel
def node_rotation(offsets, neighbours, nx, ny, weight, inverse, u, theta):
    """Write the condensed rotation of each node (theory, eq. 2.6) into ``theta``."""
    for i in prange(offsets.size - 1):
        ux = u[i, 0]
        uy = u[i, 1]
        total = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            j = neighbours[k]
            total += weight[k] * (nx[k] * (u[j, 1] - uy) - ny[k] * (u[j, 0] - ux))
        theta[i] = total * inverse[i]


@kernel
def internal_force(offsets, neighbours, nx, ny, length, weight, share, normal, tangential, u, theta, force):
    """Write the internal force on each node, N (theory, eq. 2.7), into ``force`` of shape (n, 2)."""
    for i in prange(offsets.size - 1):
        ux = u[i, 0]
        uy = u[i, 1]
        gi = share[i]
        ti = gi * theta[i]
        fx = 0.0
        fy = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            j = neighbours[k]
            cx = nx[k]
            cy = ny[k]
            dx = u[j, 0] - ux
            dy = u[j, 1] - uy
            scale = weight[k] / length[k]
            fn = scale * normal * (cx * dx + cy * dy)
            ft = scale * 0.5 * tangential * ((gi + share[j]) * (cx * dy - cy * dx) - length[k] * (ti + share[j] * theta[j]))
            fx += fn * cx - ft * cy
            fy += fn * cy + ft * cx
        force[i, 0] = fx
        force[i, 1] = fy


@kernel
def elastic_energy(offsets, neighbours, nx, ny, length, weight, share, normal, tangential, u, theta, energy):
    """Write the elastic energy of each node, J: half of that of its bonds."""
    for i in prange(offsets.size - 1):
        total = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            j = neighbours[k]
            dx = u[j, 0] - u[i, 0]
            dy = u[j, 1] - u[i, 1]
            s = (nx[k] * dx + ny[k] * dy) / length[k]
            a = (nx[k] * dy - ny[k] * dx) / length[k]
            gi = a - theta[i]
            gj = a - theta[j]
            total += weight[k] * length[k] * (normal * s * s + 0.5 * tangential * (share[i] * gi * gi + share[j] * gj * gj))
        energy[i] = 0.25 * total


@kernel
def bond_load(offsets, neighbours, nx, ny, length, share, normal, tangential, by_energy, u, theta, load):
    """Write the load of each directed bond: what is compared with the critical stretch (theory, eq. 5.2).

    That is the stretch, or with ``by_energy`` the stretch of a bond of the same energy without shear; bonds under
    compression have load zero.
    """
    for i in prange(offsets.size - 1):
        for k in range(offsets[i], offsets[i + 1]):
            j = neighbours[k]
            dx = u[j, 0] - u[i, 0]
            dy = u[j, 1] - u[i, 1]
            s = (nx[k] * dx + ny[k] * dy) / length[k]
            value = 0.0
            if s > 0.0:
                value = s
                if by_energy:
                    a = (nx[k] * dy - ny[k] * dx) / length[k]
                    gi = a - theta[i]
                    gj = a - theta[j]
                    shear = 0.5 * (share[i] * gi * gi + share[j] * gj * gj)
                    value = math.sqrt(max(s * s + tangential / normal * shear, 0.0))
            load[k] = value


@kernel
def damage(offsets, neighbours, volume, intact, phi):
    """Write the volume-weighted share of broken bonds of each node into ``phi``; zero for a node without a family."""
    for i in prange(offsets.size - 1):
        whole = 0.0
        broken = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            v = volume[neighbours[k]]
            whole += v
            if not intact[k]:
                broken += v
        phi[i] = broken / whole if whole > 0.0 else 0.0
