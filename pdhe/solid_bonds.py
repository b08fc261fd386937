"""Bonds of a body in space: families, corrections for its surfaces, cuts by crack surfaces (theory, section 3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdhe.bonds import Bonds, partial_volume
from pdhe.errors import PdheError
from pdhe.kernels import moments3d
from pdhe.kernels.families import reverse_bonds
from pdhe.kernels.families3d import find_families
from pdhe.kernels.jit import as_float
from pdhe.kernels.moments3d import EVEN, FOURTH, ODD
from pdhe.kernels.vectors import dot, row_sums
from pdhe.surfaces import Surface, crossed_by

#: Corrections are confined to this range; with that of the plane, 0.2 to 5, bars are 2 % softer.
WEIGHT_LIMITS = (0.1, 10.0)
#: Weight of a change of the bonds against errors of the moments. Less makes moments better and bonds wilder: with 0.02
#: no solution is found on small bodies, from 0.03 to 0.05 the energies of uniform strains differ by 1 %.
JOINT_DAMPING = 0.05
#: Residual at which multipliers are good, that of one piece over its start, pieces and conjugate-gradient iterations.
JOINT_TOLERANCE, PIECE_TOLERANCE, JOINT_PIECES, JOINT_ITERATIONS = 1e-3, 0.1, 10, 300
#: Size of a family over the largest one from which it counts as whole.
WHOLE = 0.95


def build_solid_bonds(
    coordinates: np.ndarray,
    volume: np.ndarray,
    spacing: np.ndarray,
    horizon: float,
    *,
    partial: str = "full",
    surface: str = "moment matched",
    cracks: Sequence[Surface] = (),
) -> Bonds:
    """Build the bonds of a set of nodes in space; what :func:`pdhe.bonds.build_bonds` is for a plate.

    Parameters
    ----------
    coordinates, volume, spacing
        Node positions m (n, 3), volumes m^3 (n,), local spacings m (n,).
    horizon
        m.
    partial
        ``full``, ``ramp`` or ``thesis``: see :func:`pdhe.bonds.partial_volume`.
    surface
        ``moment matched``, ``volume`` or ``none``. Corrections are those of the body before it is cracked.
    cracks
        Surfaces of pre-cracks.

    Raises
    ------
    PdheError
        If two nodes coincide.
    """
    reach = horizon + (0.5 * spacing if partial == "ramp" else 0.0 * spacing)
    offsets, neighbours = find_families(coordinates, reach * (1 + 1e-9))
    owner = np.repeat(np.arange(offsets.size - 1, dtype=np.int32), np.diff(offsets))
    length, nx, ny, nz = np.empty((4, neighbours.size))
    moments3d.bond_geometry(offsets, neighbours, as_float(coordinates), length, nx, ny, nz)
    if length.size and length.min() <= 1e-9 * horizon:
        k = int(length.argmin())
        raise PdheError(f"nodes {owner[k]} and {neighbours[k]} coincide at {coordinates[owner[k]].tolist()} m")
    share = partial_volume(length, horizon, 0.5 * (spacing[owner] + spacing[neighbours]), partial)
    kept = share > 0.0
    if not kept.all():
        count = np.bincount(owner[kept], minlength=offsets.size - 1)
        offsets = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
        owner, neighbours = owner[kept], neighbours[kept]
        length, nx, ny, nz, share = length[kept], nx[kept], ny[kept], nz[kept], share[kept]
    reverse = np.empty(neighbours.size, np.int32)
    reverse_bonds(offsets, neighbours, reverse)
    volumes = share * volume[neighbours]  # seen from the owner
    if surface == "moment matched":
        strength = volumes * volume[owner] * length
        correction = joint_correction(offsets, neighbours, length, nx, ny, nz, strength, volume, horizon)
    elif surface == "volume":
        family = row_sums(volumes, offsets)
        correction = 8.0 / 3.0 * np.pi * horizon**3 / (family[owner] + family[neighbours])
    elif surface == "none":
        correction = np.ones(length.size)
    else:
        raise PdheError(f"there is no correction '{surface}' in space")
    correction = np.clip(0.5 * (correction + correction[reverse]), *WEIGHT_LIMITS)
    weight = share * correction * volume[owner] * volume[neighbours]
    cut = _cut_bonds(coordinates, owner, neighbours, cracks, float(length.max(initial=0.0)))
    return Bonds(
        offsets=offsets, neighbours=neighbours, reverse=reverse, length=length, nx=nx, ny=ny, nz=nz, weight=weight,
        cut=cut, horizon=horizon,
    )  # fmt: skip


def isotropic_moments(horizon: float) -> np.ndarray:
    """Sums of ``V r`` times the monomials of fourth order of the direction over a full ball, m^4 (15,)."""
    means = {(4, 0, 0): 1.0 / 5.0, (2, 2, 0): 1.0 / 15.0}
    return np.pi * horizon**4 * np.array([means.get(tuple(sorted(e, reverse=True)), 0.0) for e in FOURTH])


def joint_correction(offsets, neighbours, length, nx, ny, nz, strength, volume, horizon) -> np.ndarray:
    """Weights that give the nodes the fourth moments of a full ball, found for all of them at once (theory, eq. 3.11).

    Fifteen moments make the elasticity tensor of an affine deformation right at a node, surface nodes included. What
    is matched at each node and then averaged over both ends, as in the plane, is matched at neither in a body that is
    a few horizons thick: its whole inside would be up to 25 % too stiff. The two ends therefore share one correction
    between :data:`WEIGHT_LIMITS`, the least that comes close to the moments at every node and to ten odd ones of zero
    where the family is whole, which lets no force arise in a uniform strain. The limits make the problem piecewise
    linear: conjugate gradients solve one piece after another.

    Parameters
    ----------
    strength
        ``beta V_i V_j r``, m^7 (b,), symmetric.
    """
    count, full = volume.size, np.pi * horizon**4
    size = np.diff(offsets)
    # Rows of the constraints in units of the full moment; the square root makes every node count by its volume.
    row = np.empty((count, EVEN + ODD))
    row[:] = (1.0 / (np.sqrt(volume) * full))[:, None]
    row[:, EVEN:] *= 0.5 * horizon * (size >= WHOLE * size.max(initial=0))[:, None]
    correction, sums = np.empty(length.size), np.empty((count, EVEN + ODD))

    def spread(y: np.ndarray) -> np.ndarray:
        moments3d.joint_correction(offsets, neighbours, length, nx, ny, nz, y * row * full, correction)
        return correction

    def gathered(values: np.ndarray) -> np.ndarray:
        moments3d.joint_moments(offsets, length, nx, ny, nz, strength, values, sums)
        return sums * row

    target = np.zeros((count, EVEN + ODD))
    target[:, :EVEN] = isotropic_moments(horizon) * volume[:, None]
    target *= row
    y, weights, free = np.zeros_like(target), np.ones(length.size), np.ones(length.size, bool)
    residual = target - gathered(weights)
    first = left = dot(residual, residual)
    best = weights
    for _ in range(JOINT_PIECES):
        if left <= JOINT_TOLERANCE**2 * first:
            break
        direction, square = residual.copy(), dot(residual, residual)
        goal = max(JOINT_TOLERANCE**2 * first, PIECE_TOLERANCE**2 * square)
        for _ in range(JOINT_ITERATIONS):
            if square <= goal:
                break
            change = gathered(spread(direction) * free) + JOINT_DAMPING**2 * direction
            step = square / dot(direction, change)
            y += step * direction
            residual -= step * change
            square, previous = dot(residual, residual), square
            direction = residual + (square / previous) * direction
        wanted = 1.0 + spread(y)
        weights = np.clip(wanted, *WEIGHT_LIMITS)
        free = weights == wanted
        residual = target - gathered(weights) - JOINT_DAMPING**2 * y
        square = dot(residual, residual)
        if square >= left:
            break
        best, left = weights, square
    return best


def _cut_bonds(coordinates, owner, neighbours, cracks, reach) -> np.ndarray:
    """Tell which bonds a crack cuts; only bonds of nodes within reach of a crack are looked at."""
    near = np.zeros(coordinates.shape[0], bool)
    for crack in cracks:
        near |= crack.distance(coordinates) <= reach * (1 + 1e-9)
    rows = np.flatnonzero(near[owner] & near[neighbours])
    cut = np.zeros(owner.size, bool)
    cut[rows] = crossed_by(coordinates[owner[rows]], coordinates[neighbours[rows]], cracks)
    return cut
