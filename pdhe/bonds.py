"""Bonds: families, partial volumes and bonds cut by pre-cracks (theory, section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdhe.corrections import WEIGHT_LIMITS, energy_correction, joint_correction, moment_correction, volume_correction
from pdhe.errors import PdheError
from pdhe.kernels import moments
from pdhe.kernels.families import find_families, reverse_bonds
from pdhe.kernels.jit import as_float
from pdhe.kernels.vectors import row_sums
from pdhe.segments import crossed_by, distance_to_segment


@dataclass(frozen=True)
class Grading:
    """What a horizon that varies from node to node adds (theory, eq. 3.6).

    Attributes
    ----------
    horizons
        Horizon of each node, m (n,).
    depth
        Distance of each node from the nearest surface, m (n,).
    """

    horizons: np.ndarray
    depth: np.ndarray


@dataclass(frozen=True)
class Lattice:
    """Bonds of a regular grid by offset: the neighbour of node i at offset o is node ``i + step[o]``.

    Attributes
    ----------
    step
        Nodes to the neighbour, int64 (o,).
    dx, dy
        Bond vector of each offset, m (o,).
    offset
        Offset of each directed bond, int16 (b,).
    """

    step: np.ndarray
    dx: np.ndarray
    dy: np.ndarray
    offset: np.ndarray
    node_count: int

    def arrange(self, values: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """Arrange a bond quantity by offset, (b,) to (o, n) of the same precision; zero where there is no bond."""
        result = np.zeros((self.step.size, self.node_count), values.dtype)
        result[self.offset, owner] = values
        return result


def find_lattice(
    offsets: np.ndarray,
    neighbours: np.ndarray,
    owner: np.ndarray,
    length: np.ndarray,
    nx: np.ndarray,
    ny: np.ndarray,
) -> Lattice | None:
    """Recognise a regular grid: every step in the node numbering belongs to one bond vector. None if it is not one."""
    count = offsets.size - 1
    if neighbours.size == 0:
        return None
    # The fullest family has every offset there is; what it lacks makes the search below fail.
    fullest = int(np.argmax(np.diff(offsets)))
    row = slice(int(offsets[fullest]), int(offsets[fullest + 1]))
    step = neighbours[row].astype(np.int64) - fullest
    dx, dy = length[row] * nx[row], length[row] * ny[row]
    reach = int(np.abs(step).max())
    table = np.full(2 * reach + 1, -1, np.int16)
    table[step + reach] = np.arange(step.size)
    jump = neighbours - owner
    if np.abs(jump).max() > reach:
        return None
    offset = table[jump + reach]
    tolerance = 1e-9 * float(length.max())
    if offset.min() < 0:
        return None
    for component, vector in ((nx, dx), (ny, dy)):
        if np.abs(length * component - vector[offset]).max() > tolerance:
            return None
    return Lattice(step, dx, dy, offset, count)


@dataclass(frozen=True)
class Bonds:
    """The families of a discretization as directed bonds; each bond stands in the list once from either end.

    Attributes
    ----------
    offsets
        Row starts, int64 (n + 1,).
    neighbours
        Node at the far end, int32 (b,), ascending within a row.
    reverse
        Index of the same bond seen from the other end, int32 (b,).
    length
        Reference length, m (b,).
    nx, ny
        Unit vector from the owner to the neighbour (b,).
    weight
        ``beta lambda V_i V_j``, m^6 (b,): partial volume, surface correction and both volumes; symmetric.
    cut
        True where a pre-crack separates the two ends (b,).
    horizon
        m; where it varies, the reference one that the constants of the bond model belong to.
    lattice
        The same bonds by offset if the nodes form a regular grid, else None.
    horizons, fineness
        Where the horizon varies: that of each node, m (n,), and the reference horizon over that of the bond (b,)
        (theory, eq. 3.7). None where it does not.
    """

    offsets: np.ndarray
    neighbours: np.ndarray
    reverse: np.ndarray
    length: np.ndarray
    nx: np.ndarray
    ny: np.ndarray
    weight: np.ndarray
    cut: np.ndarray
    horizon: float
    lattice: Lattice | None = None
    horizons: np.ndarray | None = None
    fineness: np.ndarray | None = None

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return self.offsets.size - 1

    def owners(self) -> np.ndarray:
        """Node at the near end of each directed bond, int32 (b,)."""
        return np.repeat(np.arange(self.node_count, dtype=np.int32), np.diff(self.offsets))

    def sum_by_node(self, values: np.ndarray) -> np.ndarray:
        """Sum a bond quantity over each family; (b,) or (b, k) to (n,) or (n, k)."""
        return row_sums(values, self.offsets)


def partial_volume(length: np.ndarray, horizon: float | np.ndarray, spacing: np.ndarray, rule: str) -> np.ndarray:
    """Share of the neighbour's volume that lies inside the horizon, per bond.

    ``full`` counts every node within the horizon whole; ``ramp`` falls linearly from 1 to 0 while the node's centre
    moves from half a spacing inside to half a spacing outside; ``thesis`` is the same ramp, but bonds longer than the
    horizon are dropped, which loses 13 % of the stiffness (theory, eq. 3.2).
    """
    if rule == "full":
        return np.where(length <= horizon * (1 + 1e-9), 1.0, 0.0)
    ramp = np.clip((horizon + 0.5 * spacing - length) / spacing, 0.0, 1.0)
    return ramp if rule == "ramp" else np.where(length <= horizon * (1 + 1e-9), ramp, 0.0)


def two_sided_volume(
    length: np.ndarray,
    ends: tuple[np.ndarray, np.ndarray],
    reference: float,
    spacing: np.ndarray,
    rule: str,
    power: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Share of the neighbour's volume where each end has a horizon of its own (theory, eqs. 3.6 and 3.7).

    Parameters
    ----------
    length, spacing
        Length of the bonds and mean spacing of their two cells, m (b,).
    ends
        Horizon of either end, m (b,) each; their order does not matter.
    reference
        Horizon for which the constants of the bonds are made, m.
    rule
        As in :func:`partial_volume`, applied at either end to its own horizon.
    power
        The constants go with the horizon to minus this.

    Returns
    -------
    share, fineness
        Both (b,): the mean of what the two ends see, scaled by ``(reference / horizon)^power`` of the end, and the mean
        of ``reference / horizon`` of the ends with these as weights.
    """
    share, fineness = np.zeros_like(length), np.zeros_like(length)
    for horizon in ends:
        ratio = reference / horizon
        seen = 0.5 * partial_volume(length, horizon, spacing, rule) * ratio**power
        share += seen
        fineness += seen * ratio
    return share, np.divide(fineness, share, out=np.ones_like(share), where=share > 0.0)


def build_bonds(
    coordinates: np.ndarray,
    volume: np.ndarray,
    spacing: np.ndarray,
    thickness: float,
    horizon: float,
    *,
    partial: str = "full",
    surface: str = "moment matched",
    tangential_ratio: float = 0.0,
    cracks: Sequence[tuple[tuple[float, float], tuple[float, float]]] = (),
    grading: Grading | None = None,
) -> Bonds:
    """Build the bonds of a set of nodes.

    Parameters
    ----------
    coordinates, volume, spacing
        Node positions m (n, 2), volumes m^3 (n,), local spacings m (n,).
    thickness, horizon
        m.
    partial
        ``full``, ``ramp`` or ``thesis``: see :func:`partial_volume`.
    surface
        ``moment matched``, ``volume``, ``energy`` or ``none``: see :mod:`pdhe.corrections`. Corrections are
        those of the body before it is cracked, since faces that form later cannot have one either.
    tangential_ratio
        Tangential over normal bond stiffness; only the ``energy`` correction uses it.
    cracks
        Pre-cracks as segments ``((x0, y0), (x1, y1))``, m.
    grading
        Where the horizon varies; ``horizon`` is then the reference one, which the constants of the bonds belong to.

    Raises
    ------
    PdheError
        If two nodes coincide.
    """
    horizons = None if grading is None else grading.horizons
    reach = (horizon if horizons is None else horizons) + (0.5 * spacing if partial == "ramp" else 0.0 * spacing)
    offsets, neighbours = find_families(coordinates, reach * (1 + 1e-9))
    owner = np.repeat(np.arange(offsets.size - 1, dtype=np.int32), np.diff(offsets))
    length, nx, ny = np.empty((3, neighbours.size))
    moments.bond_geometry(offsets, neighbours, as_float(coordinates), length, nx, ny)
    if length.size and length.min() <= 1e-9 * horizon:
        k = int(length.argmin())
        raise PdheError(f"nodes {owner[k]} and {neighbours[k]} coincide at {coordinates[owner[k]].tolist()} m")
    size, fineness = 0.5 * (spacing[owner] + spacing[neighbours]), None
    if horizons is None:
        share = partial_volume(length, horizon, size, partial)
    else:
        ends = horizons[owner], horizons[neighbours]
        share, fineness = two_sided_volume(length, ends, horizon, size, partial, 3)
    kept = share > 0.0
    if not kept.all():
        count = np.bincount(owner[kept], minlength=offsets.size - 1)
        offsets = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
        owner, neighbours = owner[kept], neighbours[kept]
        length, nx, ny, share = length[kept], nx[kept], ny[kept], share[kept]
        fineness = None if fineness is None else fineness[kept]
    reverse = np.empty(neighbours.size, np.int32)
    reverse_bonds(offsets, neighbours, reverse)
    volumes = share * volume[neighbours]  # seen from the owner
    if surface == "moment matched" and grading is not None:
        strength = volumes * volume[owner] * length
        correction = joint_correction(
            offsets, neighbours, length, nx, ny, strength, volume, grading, horizon, thickness
        )
    elif surface == "moment matched":
        correction = moment_correction(offsets, length, nx, ny, volumes, horizon, thickness)
    elif surface == "volume":
        correction = volume_correction(offsets, owner, neighbours, volumes, horizon, thickness)
    elif surface == "energy":
        correction = energy_correction(
            offsets, owner, neighbours, length, nx, ny, volumes, horizon, thickness, tangential_ratio
        )
    else:
        correction = np.ones(length.size)
    correction = np.clip(0.5 * (correction + correction[reverse]), *WEIGHT_LIMITS)
    weight = share * correction * volume[owner] * volume[neighbours]
    cut = _cut_bonds(coordinates, owner, neighbours, cracks, float(length.max(initial=0.0)))
    lattice = find_lattice(offsets, neighbours, owner, length, nx, ny)
    return Bonds(
        offsets, neighbours, reverse, length, nx, ny, weight, cut, horizon, lattice, horizons, fineness
    )  # fmt: skip


def _cut_bonds(coordinates, owner, neighbours, cracks, reach) -> np.ndarray:
    """Tell which bonds a crack cuts; only bonds of nodes within reach of a crack are looked at."""
    near = np.zeros(coordinates.shape[0], bool)
    for start, end in cracks:
        near |= distance_to_segment(coordinates, start, end) <= reach * (1 + 1e-9)
    rows = np.flatnonzero(near[owner] & near[neighbours])
    cut = np.zeros(owner.size, bool)
    cut[rows] = crossed_by(coordinates[owner[rows]], coordinates[neighbours[rows]], cracks)
    return cut
