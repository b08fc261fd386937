"""Large strains in correspondence models: stress functions, states of nodes, and changes of forces (theory, section 2).

Arguments as in :mod:`pdhe.kernels.correspondence` and :mod:`pdhe.kernels.correspondence3d`; tensors are laid out row by
row, (n, d d), symmetric ones as there, with the place of entry a, b in ``place`` (d, d). ``control`` is what resists
zero-energy modes in the undeformed body, ``present`` the same turned and stretched with a node, both N/m^6.

A stress function is a C function that gets the addresses of properties, of a displacement gradient (d d), and of what
to write: energy per volume, J/m^3; first Piola-Kirchhoff stress, Pa (d d); its derivative by the gradient, Pa
(d d, d d). Its address is an argument like any other, so that what is compiled here serves every law.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba import prange, types
from numba.extending import intrinsic, register_jitable
from numpy import int64, uint32, uint64

from pdhe.kernels.jit import kernel

_POINTERS = 5


@functools.cache
def compiled(function: Callable[..., None]) -> Any:
    """Compile a stress function, of five arrays of doubles as described above, to something with an ``address``."""
    pointer = types.CPointer(types.float64)
    return numba.cfunc(types.void(*[pointer] * _POINTERS), cache=True, error_model="numpy")(function)


def saint_venant_kirchhoff(properties, h, energy, stress, tangent):
    """Stress linear in the Green-Lagrange strain, in the plane: the stiffness for xx, yy and engineering xy (6).

    In plane stress, with the stiffness of that, the strain across the plate is eliminated exactly.
    """
    fxx = 1.0 + h[0]
    fyy = 1.0 + h[3]
    # Of the displacement gradient, since 1 + h squared minus 1 would lose the digits of small strains.
    exx = h[0] + 0.5 * (h[0] * h[0] + h[2] * h[2])
    eyy = h[3] + 0.5 * (h[1] * h[1] + h[3] * h[3])
    exy = h[1] + h[2] + h[0] * h[1] + h[2] * h[3]
    sxx = properties[0] * exx + properties[1] * eyy + properties[2] * exy
    syy = properties[1] * exx + properties[3] * eyy + properties[4] * exy
    sxy = properties[2] * exx + properties[4] * eyy + properties[5] * exy
    energy[0] = 0.5 * (sxx * exx + syy * eyy + sxy * exy)
    stress[0] = fxx * sxx + h[1] * sxy
    stress[1] = fxx * sxy + h[1] * syy
    stress[2] = h[2] * sxx + fyy * sxy
    stress[3] = h[2] * sxy + fyy * syy
    for b in range(4):
        # Derivatives of the strains by entry b, then of the stresses.
        dxx = fxx if b == 0 else (h[2] if b == 2 else 0.0)
        dyy = h[1] if b == 1 else (fyy if b == 3 else 0.0)
        dxy = h[1] if b == 0 else (fxx if b == 1 else (fyy if b == 2 else h[2]))
        txx = properties[0] * dxx + properties[1] * dyy + properties[2] * dxy
        tyy = properties[1] * dxx + properties[3] * dyy + properties[4] * dxy
        txy = properties[2] * dxx + properties[4] * dyy + properties[5] * dxy
        tangent[b] = fxx * txx + h[1] * txy
        tangent[4 + b] = fxx * txy + h[1] * tyy
        tangent[8 + b] = h[2] * txx + fyy * txy
        tangent[12 + b] = h[2] * txy + fyy * tyy
    for a in range(2):
        tangent[10 * a] += sxx
        tangent[10 * a + 1] += sxy
        tangent[10 * a + 4] += sxy
        tangent[10 * a + 5] += syy


@register_jitable
def _to_first_piola(h, stress):
    """Turn the second Piola-Kirchhoff stress S of a solid into ``F S``, in place."""
    for j in range(3):
        # A column of F S needs the same column of S alone.
        sx = stress[j]
        sy = stress[3 + j]
        sz = stress[6 + j]
        for i in range(3):
            stress[3 * i + j] = h[3 * i] * sx + h[3 * i + 1] * sy + h[3 * i + 2] * sz
        stress[j] += sx
        stress[3 + j] += sy
        stress[6 + j] += sz


def saint_venant_kirchhoff_solid(properties, h, energy, stress, tangent):
    """Stress linear in the Green-Lagrange strain, in space and isotropic: both constants of Lamé, Pa (2)."""
    lame = properties[0]
    shear = properties[1]
    trace = 0.0
    square = 0.0
    # The second Piola-Kirchhoff stress first, where the result will be.
    for a in range(3):
        for b in range(3):
            e = 0.5 * (h[3 * a + b] + h[3 * b + a])
            for c in range(3):
                e += 0.5 * h[3 * c + a] * h[3 * c + b]
            stress[3 * a + b] = 2.0 * shear * e
            square += e * e
            if a == b:
                trace += e
    for a in range(3):
        stress[4 * a] += lame * trace
    energy[0] = 0.5 * lame * trace * trace + shear * square
    for i in range(3):
        for j in range(3):
            fij = h[3 * i + j] + (1.0 if i == j else 0.0)
            for k in range(3):
                fkj = h[3 * k + j] + (1.0 if k == j else 0.0)
                left = 0.0  # of F F^T
                for m in range(3):
                    left += (h[3 * i + m] + (1.0 if i == m else 0.0)) * (h[3 * k + m] + (1.0 if k == m else 0.0))
                for n in range(3):
                    fkn = h[3 * k + n] + (1.0 if k == n else 0.0)
                    fin = h[3 * i + n] + (1.0 if i == n else 0.0)
                    value = lame * fij * fkn + shear * fin * fkj
                    if j == n:
                        value += shear * left
                    if i == k:
                        value += stress[3 * j + n]
                    tangent[27 * i + 9 * j + 3 * k + n] = value
    _to_first_piola(h, stress)


def saint_venant_kirchhoff_any(properties, h, energy, stress, tangent):
    """Stress linear in the Green-Lagrange strain, in space: the upper triangle of the stiffness, row by row (21).

    Its rows are for xx, yy, zz and engineering yz, xz, xy.
    """
    # The second Piola-Kirchhoff stress first, where the result will be.
    energy[0] = 0.0
    for a in range(3):
        for b in range(3):
            row = a if a == b else 6 - a - b
            value = 0.0
            own = 0.0
            for c in range(3):
                for d in range(3):
                    e = 0.5 * (h[3 * c + d] + h[3 * d + c])
                    for m in range(3):
                        e += 0.5 * h[3 * m + c] * h[3 * m + d]
                    column = c if c == d else 6 - c - d
                    low = min(row, column)
                    value += properties[low * (11 - low) // 2 + max(row, column)] * e
                    if c == a and d == b:
                        own = e
            stress[3 * a + b] = value
            energy[0] += 0.5 * value * own
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for n in range(3):
                    value = stress[3 * j + n] if i == k else 0.0
                    for m in range(3):
                        row = m if m == j else 6 - m - j
                        left = h[3 * i + m] + (1.0 if i == m else 0.0)
                        for q in range(3):
                            column = q if q == n else 6 - q - n
                            low = min(row, column)
                            right = h[3 * k + q] + (1.0 if k == q else 0.0)
                            value += left * properties[low * (11 - low) // 2 + max(row, column)] * right
                    tangent[27 * i + 9 * j + 3 * k + n] = value
    _to_first_piola(h, stress)


@intrinsic
def _call(typing, address, properties, gradient, energy, stress, tangent):
    """Call the stress function at an address, given the addresses of its arguments."""
    del typing

    def generate(context, builder, signature, arguments):
        del signature
        pointer = ir.DoubleType().as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer] * _POINTERS)
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        builder.call(function, [builder.inttoptr(given, pointer) for given in arguments[1:]])
        return context.get_dummy_value()

    return types.void(*[types.int64] * (1 + _POINTERS)), generate


@kernel
def respond(address, properties, gradient, energy, stress, tangent):
    """Call a stress function at every node; ``properties`` are of all, (1, p), or of each, (n, p)."""
    first = int64(properties.ctypes.data)
    step = 8 * properties.shape[1] if properties.shape[0] > 1 else 0
    size = gradient.shape[1]
    at = int64(gradient.ctypes.data)
    to_energy = int64(energy.ctypes.data)
    to_stress = int64(stress.ctypes.data)
    to_tangent = int64(tangent.ctypes.data)
    for n in prange(gradient.shape[0]):
        i = int64(n)
        _call(
            address, first + i * step, at + 8 * i * size, to_energy + 8 * i, to_stress + 8 * i * size,
            to_tangent + 8 * i * size * size,
        )  # fmt: skip


@kernel
def turned(place, control, gradient, carried, present):
    """Write ``F C1``, N/m^6 (n, d d), and ``F C1 F^T`` of each node (theory, eq. 2.28)."""
    for i in prange(gradient.shape[0]):
        d = place.shape[0]
        for a in range(d):
            for b in range(d):
                value = control[i, place[a, b]]
                for c in range(d):
                    value += gradient[i, a * d + c] * control[i, place[c, b]]
                carried[i, a * d + b] = value
        for a in range(d):
            for b in range(a, d):
                value = carried[i, a * d + b]
                for c in range(d):
                    value += carried[i, a * d + c] * gradient[i, b * d + c]
                present[i, place[a, b]] = value


@kernel
def node_state(place, volume, share, inverse, present, gradient, stress, moment, carried, total, state):
    """Write what each node adds to the forces of its bonds, N/m^6, as ``state`` (theory, eq. 2.29).

    ``moment`` (n, d d) is the sum of ``z z^T`` over the bonds, m^4; without it, of shape (0, 0), ``present`` does not
    depend on the gradient. ``total`` (n, d d) gets the stress with what turning ``present`` adds, Pa.
    """
    for i in prange(gradient.shape[0]):
        d = place.shape[0]
        for a in range(d):
            for b in range(d):
                value = share[i] * stress[i, a * d + b]
                if moment.shape[0] > 0:
                    more = 0.0
                    for c in range(d):
                        more += moment[i, a * d + c] * carried[i, c * d + b]
                    value += more / volume[i]
                total[i, a * d + b] = value
        for a in range(d):
            for b in range(d):
                value = 0.0
                for c in range(d):
                    value += total[i, a * d + c] * inverse[i, place[c, b]]
                    value -= present[i, place[a, c]] * gradient[i, c * d + b]
                state[i, a * d + b] = value


@kernel
def state_change(
    place, volume, share, inverse, control, present, gradient, tangent, moment, carried, change, cross, step, total,
    turning, state,
):  # fmt: skip
    """Write the derivative of ``present`` as ``turning`` and of the state of each node along ``change``, a gradient.

    ``cross`` (n, d d) is the sum of ``z`` times the relative displacements of the change, m^4; ``step`` and ``total``
    (n, d d) are scratch. Without ``moment``, of shape (0, 0), ``turning`` is left alone.
    """
    for i in prange(gradient.shape[0]):
        d = place.shape[0]
        size = d * d
        turns = moment.shape[0] > 0
        if turns:
            for a in range(d):
                for b in range(d):
                    value = 0.0
                    for c in range(d):
                        value += change[i, a * d + c] * control[i, place[c, b]]
                    step[i, a * d + b] = value
            for a in range(d):
                for b in range(a, d):
                    value = step[i, a * d + b]
                    for c in range(d):
                        value += step[i, a * d + c] * gradient[i, b * d + c]
                        value += carried[i, a * d + c] * change[i, b * d + c]
                    turning[i, place[a, b]] = value
        for a in range(size):
            value = 0.0
            for b in range(size):
                value += tangent[i, a * size + b] * change[i, b]
            total[i, a] = share[i] * value
        if turns:
            for a in range(d):
                for b in range(d):
                    more = 0.0
                    for c in range(d):
                        more += moment[i, a * d + c] * step[i, c * d + b]
                        more += (cross[i, a * d + c] + cross[i, c * d + a]) * carried[i, c * d + b]
                    total[i, a * d + b] += more / volume[i]
        for a in range(d):
            for b in range(d):
                value = 0.0
                for c in range(d):
                    value += total[i, a * d + c] * inverse[i, place[c, b]]
                    value -= present[i, place[a, c]] * change[i, c * d + b]
                    if turns:
                        value -= turning[i, place[a, c]] * gradient[i, c * d + b]
                state[i, a * d + b] = value


@kernel
def moment(offsets, neighbours, x, cubed, gradient, u, v, out):
    """Write the sums of ``beta lambda V_i V_j / r`` times ``z w^T``, m^4 (n, 4), in the plane.

    ``z`` is what the gradient leaves of the relative displacement in ``u``, ``w`` that in ``v``.
    """
    for i in prange(offsets.size - 1):
        xx = 0.0
        xy = 0.0
        yx = 0.0
        yy = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            c = cubed[k] * (dx * dx + dy * dy)
            zx = c * (u[j, 0] - u[i, 0] - gradient[i, 0] * dx - gradient[i, 1] * dy)
            zy = c * (u[j, 1] - u[i, 1] - gradient[i, 2] * dx - gradient[i, 3] * dy)
            wx = v[j, 0] - v[i, 0]
            wy = v[j, 1] - v[i, 1]
            xx += zx * wx
            xy += zx * wy
            yx += zy * wx
            yy += zy * wy
        out[i, 0] = xx
        out[i, 1] = xy
        out[i, 2] = yx
        out[i, 3] = yy


@kernel
def moment_solid(offsets, neighbours, x, cubed, gradient, u, v, out):
    """Write the sums of ``beta lambda V_i V_j / r`` times ``z w^T``, m^4 (n, 9), in space."""
    for i in prange(offsets.size - 1):
        for a in range(9):
            out[i, a] = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            dz = x[j, 2] - x[i, 2]
            c = cubed[k] * (dx * dx + dy * dy + dz * dz)
            wx = v[j, 0] - v[i, 0]
            wy = v[j, 1] - v[i, 1]
            wz = v[j, 2] - v[i, 2]
            for a in range(3):
                z = u[j, a] - u[i, a]
                z -= gradient[i, 3 * a] * dx + gradient[i, 3 * a + 1] * dy + gradient[i, 3 * a + 2] * dz
                z *= c
                out[i, 3 * a] += z * wx
                out[i, 3 * a + 1] += z * wy
                out[i, 3 * a + 2] += z * wz


@kernel
def force_change(offsets, neighbours, x, cubed, present, turning, state, u, v, force):
    """Write the derivative of the internal forces along ``v``, N (n, 2), in the plane (theory, eq. 2.30)."""
    for i in prange(offsets.size - 1):
        fx = 0.0
        fy = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            ex = u[j, 0] - u[i, 0]
            ey = u[j, 1] - u[i, 1]
            wx = v[j, 0] - v[i, 0]
            wy = v[j, 1] - v[i, 1]
            c = cubed[k] * (dx * dx + dy * dy)
            cross = present[i, 1] + present[j, 1]
            turn = turning[i, 1] + turning[j, 1]
            fx += c * (
                (state[i, 0] + state[j, 0]) * dx + (state[i, 1] + state[j, 1]) * dy
                + (present[i, 0] + present[j, 0]) * wx + cross * wy
                + (turning[i, 0] + turning[j, 0]) * ex + turn * ey
            )  # fmt: skip
            fy += c * (
                (state[i, 2] + state[j, 2]) * dx + (state[i, 3] + state[j, 3]) * dy
                + cross * wx + (present[i, 2] + present[j, 2]) * wy
                + turn * ex + (turning[i, 2] + turning[j, 2]) * ey
            )  # fmt: skip
        force[i, 0] = fx
        force[i, 1] = fy


@kernel
def force_change_solid(offsets, neighbours, x, cubed, present, turning, state, u, v, force):
    """Write the derivative of the internal forces along ``v``, N (n, 3), in space (theory, eq. 2.30)."""
    for i in prange(offsets.size - 1):
        fx = 0.0
        fy = 0.0
        fz = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            dz = x[j, 2] - x[i, 2]
            ex = u[j, 0] - u[i, 0]
            ey = u[j, 1] - u[i, 1]
            ez = u[j, 2] - u[i, 2]
            wx = v[j, 0] - v[i, 0]
            wy = v[j, 1] - v[i, 1]
            wz = v[j, 2] - v[i, 2]
            c = cubed[k] * (dx * dx + dy * dy + dz * dz)
            yz = present[i, 3] + present[j, 3]
            xz = present[i, 4] + present[j, 4]
            xy = present[i, 5] + present[j, 5]
            tyz = turning[i, 3] + turning[j, 3]
            txz = turning[i, 4] + turning[j, 4]
            txy = turning[i, 5] + turning[j, 5]
            fx += c * (
                (state[i, 0] + state[j, 0]) * dx + (state[i, 1] + state[j, 1]) * dy + (state[i, 2] + state[j, 2]) * dz
                + (present[i, 0] + present[j, 0]) * wx + xy * wy + xz * wz
                + (turning[i, 0] + turning[j, 0]) * ex + txy * ey + txz * ez
            )  # fmt: skip
            fy += c * (
                (state[i, 3] + state[j, 3]) * dx + (state[i, 4] + state[j, 4]) * dy + (state[i, 5] + state[j, 5]) * dz
                + xy * wx + (present[i, 1] + present[j, 1]) * wy + yz * wz
                + txy * ex + (turning[i, 1] + turning[j, 1]) * ey + tyz * ez
            )  # fmt: skip
            fz += c * (
                (state[i, 6] + state[j, 6]) * dx + (state[i, 7] + state[j, 7]) * dy + (state[i, 8] + state[j, 8]) * dz
                + xz * wx + yz * wy + (present[i, 2] + present[j, 2]) * wz
                + txz * ex + tyz * ey + (turning[i, 2] + turning[j, 2]) * ez
            )  # fmt: skip
        force[i, 0] = fx
        force[i, 1] = fy
        force[i, 2] = fz
