"""Surface corrections: weights that make up for what a family lacks near a surface (theory, section 3)."""

from __future__ import annotations

import numpy as np

from pdhe.kernels import moments
from pdhe.kernels.vectors import dot, row_sums

#: Corrections are confined to this range: a handful of bonds in corners would otherwise reach +-20 (theory, eq. 3.3).
WEIGHT_LIMITS = (0.2, 5.0)

#: Joint correction (theory, eq. 3.9): the weight of a change of the bonds against errors of the moments, and when the
#: conjugate gradients for its multipliers end. From 0.01 to 0.03 the strains of a patch are equally right.
JOINT_DAMPING, JOINT_TOLERANCE, JOINT_ITERATIONS = 0.02, 1e-3, 300
#: Depth below a surface, in horizons, from which a family counts as whole: the cap cut off beyond is 2 % of its disc.
WHOLE_FROM = 0.9


def moment_correction(offsets, length, nx, ny, volumes, horizon, thickness, order: int = 4) -> np.ndarray:
    """Weights that give every node the moments of a full isotropic neighbourhood (theory, eq. 3.4).

    With ``w = beta V_j r`` per bond, ``sum w (lambda - 1)^2`` is minimised under ``sum w lambda n..n = the moments of
    the full disc``. Order 4 makes the elasticity tensor of any affine deformation exact at every node, surface nodes
    included. A node whose bonds cannot bear the constraints (a row of nodes) gets the least-squares closest.
    """
    angular = {2: (0.5, 0.0, 0.5), 4: (3 / 8, 0.0, 1 / 8, 0.0, 3 / 8)}[order]
    target = thickness * 2.0 * np.pi * horizon**3 / 3.0 * np.array(angular)
    count, size = offsets.size - 1, order + 1
    multiplier, moment = np.empty((count, size)), np.empty((count, 2 * size - 1))
    solved, correction = np.empty(count, bool), np.empty(length.size)
    moments.match_moments(offsets, length, nx, ny, volumes, target, moment, multiplier, solved)
    # Where the constraints cannot all be met (rows of nodes), the pseudo-inverse meets those that can.
    poor = np.flatnonzero(~solved)
    if poor.size:
        index = np.arange(size)
        inverse = np.linalg.pinv(moment[poor][:, index[:, None] + index], rcond=1e-10, hermitian=True)
        multiplier[poor] = np.einsum("nab,nb->na", inverse, multiplier[poor])
    moments.apply_multipliers(offsets, nx, ny, multiplier, correction)
    return correction


def joint_correction(
    offsets, neighbours, length, nx, ny, strength, volume, grading, reference, thickness, images=None
) -> np.ndarray:
    """Weights that give all nodes the moments of a full neighbourhood at once, and no force in a uniform strain.

    What is matched at each node and then averaged over both ends is matched at neither where nodes are irregular. Here
    the two ends share one correction, the least that comes close to the five even moments at every node and to four odd
    ones of zero at those whose family is whole (theory, eqs. 3.8 and 3.9). Conjugate gradients find the multipliers.

    Parameters
    ----------
    strength
        ``beta V_i V_j r``, m^7 (b,), symmetric.
    reference
        Horizon that the even moments belong to, m.
    images
        Images of nodes beyond mirror lines (:class:`pdhe.mirrors.Images`): their multipliers are those of the nodes,
        mirrored.
    """
    count = offsets.size - 1
    volume = volume[:count]
    mirrored = None
    if images is not None:
        powers = np.array([4, 3, 2, 1, 0, 3, 2, 1, 0]), np.array([0, 1, 2, 3, 4, 0, 1, 2, 3])
        mirrored = images.sign[:, :1] ** powers[0] * images.sign[:, 1:] ** powers[1]
    whole = grading.depth >= WHOLE_FROM * grading.horizons
    full = thickness * 2.0 * np.pi * reference**3 / 3.0
    # Rows of the constraints in units of the full moment; the square root makes every node count by its volume.
    row = np.empty((count, 9))
    row[:, :5] = (1.0 / (np.sqrt(volume) * full))[:, None]
    row[:, 5:] = row[:, :1] * (0.5 * grading.horizons * whole)[:, None]
    correction, sums = np.empty(length.size), np.empty((count, 9))

    def spread(y: np.ndarray) -> np.ndarray:
        y = y * row * full
        if mirrored is not None:
            y = np.concatenate([y, mirrored * y[images.source]])
        moments.joint_correction(offsets, neighbours, length, nx, ny, y, correction)
        return correction

    def gathered(values: np.ndarray) -> np.ndarray:
        moments.joint_moments(offsets, length, nx, ny, strength, values, sums)
        return sums * row

    target = np.zeros((count, 9))
    target[:, :5] = full * np.array([3 / 8, 0.0, 1 / 8, 0.0, 3 / 8]) * volume[:, None]
    residual = target * row - gathered(np.ones(length.size))
    y, direction = np.zeros((count, 9)), residual.copy()
    square = first = dot(residual, residual)
    for _ in range(JOINT_ITERATIONS):
        if square <= JOINT_TOLERANCE**2 * first:
            break
        change = gathered(spread(direction)) + JOINT_DAMPING**2 * direction
        step = square / dot(direction, change)
        y += step * direction
        residual -= step * change
        square, previous = dot(residual, residual), square
        direction = residual + (square / previous) * direction
    return 1.0 + spread(y)


def volume_correction(offsets, owner, neighbours, volumes, horizon, thickness) -> np.ndarray:
    """Le and Bobaru's volume method as the thesis uses it: ``2 V0 / (V_i + V_j)`` with ``V0 = pi delta^2 h``."""
    family = row_sums(volumes, offsets)
    return 2.0 * np.pi * horizon**2 * thickness / (family[owner] + family[neighbours])


def energy_correction(offsets, owner, neighbours, length, nx, ny, volumes, horizon, thickness, ratio) -> np.ndarray:
    """Madenci and Oterkus' energy method: classical over discrete energy under uniaxial strain along either axis."""
    factors = []
    for axial, cross in ((nx, ny), (ny, nx)):
        w = volumes * length
        angle = -axial * cross
        rotation = row_sums(w * angle, offsets) / np.maximum(row_sums(w, offsets), np.finfo(float).tiny)
        energy = row_sums(w * (axial**4 + ratio * (angle - rotation[owner]) ** 2), offsets)
        # Full disc: the means of cos^4 and cos^2 sin^2 are 3/8 and 1/8.
        exact = thickness * 2.0 * np.pi * horizon**3 / 3.0 * (3.0 + ratio) / 8.0
        factors.append(exact / np.maximum(energy, np.finfo(float).tiny))
    gx, gy = (0.5 * (g[owner] + g[neighbours]) for g in factors)
    return 1.0 / np.sqrt((nx / gx) ** 2 + (ny / gy) ** 2)
