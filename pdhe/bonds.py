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
from pdhe.mirrors import Images, Symmetry
from pdhe.segments import crossed_by, distance_to_segment

#: Share of a neighbour's volume below which it is no neighbour. Where the ramp ends on a distance of the lattice, as
#: with a horizon of 1.5 spacings, round-off would decide node by node whether a bond without weight is in the family.
NEGLIGIBLE = 1e-9


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
    padding
        Where the nodes of a part and their images are in a larger grid; ``n`` is then the number of its places.
    """

    step: np.ndarray
    dx: np.ndarray
    dy: np.ndarray
    offset: np.ndarray
    node_count: int
    padding: Padding | None = None

    def arrange(self, values: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """Arrange a bond quantity by offset, (b,) to (o, n) of the same precision; zero where there is no bond."""
        result = np.zeros((self.step.size, self.node_count), values.dtype)
        result[self.offset, self.place(owner)] = values
        return result

    def arranged(self, precision: np.dtype) -> int:
        """Bytes of what :meth:`arrange` makes of values of that precision: padding is stored too."""
        return self.step.size * self.node_count * precision.itemsize

    def place(self, nodes: np.ndarray) -> np.ndarray:
        """Where nodes and images are in the grid."""
        return nodes if self.padding is None else self.padding.place[nodes]


@dataclass(frozen=True)
class Padding:
    """A grid that holds the nodes of a part, row by row, and beside them their images.

    Attributes
    ----------
    place
        Place of each node and image in the grid, int32 (n + g,).
    shape, block
        Rows and columns of the grid, and those that are the part.
    """

    place: np.ndarray
    shape: tuple[int, int]
    block: tuple[slice, slice]

    @classmethod
    def find(cls, images: Images) -> Padding | None:
        """The grid of a part and its images; None if the part is no grid of several rows and columns."""
        n, positions = images.nodes, images.positions
        height = np.abs(positions[:n, 1] - positions[0, 1])
        columns = int(np.argmax(height > 1e-9 * height.max(initial=0.0))) or n
        if columns in (1, n) or n % columns:
            return None
        steps = positions[[1, columns], [0, 1]] - positions[0]
        if not (steps > 0.0).all():
            return None
        column, row = np.rint((positions - positions[0]) / steps).astype(np.int64).T
        column, row = column - column.min(), row - row.min()
        shape = int(row.max()) + 1, int(column.max()) + 1
        place = row * shape[1] + column
        block = slice(row[0], row[0] + n // columns), slice(column[0], column[0] + columns)
        whole = np.arange(shape[0] * shape[1]).reshape(shape)
        if block[0].stop > shape[0] or block[1].stop > shape[1] or not np.array_equal(whole[block].ravel(), place[:n]):
            return None
        return cls(place.astype(np.int32), shape, block) if np.unique(place).size == place.size else None

    def spread(self, values: np.ndarray, images: np.ndarray) -> np.ndarray:
        """Lay values of nodes (n,) and images (g,) out on the grid, float64; zero where neither is."""
        grid = np.zeros(self.shape[0] * self.shape[1])
        view = grid.reshape(self.shape)[self.block]
        view[...] = values.reshape(view.shape)
        grid[self.place[values.size :]] = images
        return grid

    def gather(self, grid: np.ndarray) -> np.ndarray:
        """Values of the nodes on the grid, (n,)."""
        return grid.reshape(self.shape)[self.block].ravel()


def find_lattice(
    offsets: np.ndarray,
    neighbours: np.ndarray,
    owner: np.ndarray,
    length: np.ndarray,
    nx: np.ndarray,
    ny: np.ndarray,
    images: Images | None = None,
) -> Lattice | None:
    """Recognise a regular grid: every step in the node numbering belongs to one bond vector. None if it is not one."""
    count, padding = offsets.size - 1, None
    if neighbours.size == 0:
        return None
    # The fullest family has every offset there is; what it lacks makes the search below fail.
    fullest = int(np.argmax(np.diff(offsets)))
    row = slice(int(offsets[fullest]), int(offsets[fullest + 1]))
    if images is not None:
        padding = Padding.find(images)
        if padding is None:
            return None
        count, neighbours, owner = padding.shape[0] * padding.shape[1], padding.place[neighbours], padding.place[owner]
    step = neighbours[row].astype(np.int64) - owner[row]
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
    return Lattice(step, dx, dy, offset, count, padding)


@dataclass(frozen=True, kw_only=True)
class Families:
    """Which nodes are within reach of which: all that an exchange between nodes needs to know.

    Attributes
    ----------
    offsets
        Row starts, int64 (n + 1,).
    neighbours
        Node at the far end, int32 (b,), ascending within a row.
    length
        Reference length, m (b,).
    horizon
        m; where it varies, the reference one that the constants of the bond model belong to.
    lattice
        The same bonds by offset if the nodes form a regular grid, else None.
    horizons
        Where the horizon varies: that of each node, m (n,); else None.
    """

    offsets: np.ndarray
    neighbours: np.ndarray
    length: np.ndarray
    horizon: float
    lattice: Lattice | None = None
    horizons: np.ndarray | None = None

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


@dataclass(frozen=True, kw_only=True)
class Bonds(Families):
    """The families of a discretization as directed bonds; each bond stands in the list once from either end.

    Where the nodes are a part of a symmetric body, they are bonded to images of nodes too: ``neighbours`` then goes on
    beyond ``n``, and such a bond stands for two of the whole body. Only nodes of the part own bonds.

    Attributes
    ----------
    reverse
        Index of the same bond seen from the other end, int32 (b,).
    nx, ny
        Unit vector from the owner to the neighbour (b,).
    weight
        ``beta lambda V_i V_j``, m^6 (b,): partial volume, surface correction and both volumes; symmetric.
    cut
        True where a pre-crack separates the two ends (b,).
    fineness
        Where the horizon varies: the reference horizon over that of the bond (b,) (theory, eq. 3.7); else None.
    images
        Images of nodes beyond mirror lines; None where the nodes are the whole body.
    nz
        Third component of the unit vector (b,) in space; None in the plane.
    """

    reverse: np.ndarray
    nx: np.ndarray
    ny: np.ndarray
    weight: np.ndarray
    cut: np.ndarray
    fineness: np.ndarray | None = None
    images: Images | None = None
    nz: np.ndarray | None = None

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return 2 if self.nz is None else 3

    def far(self, bond: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Node at the far end of some directed bonds, or the one that the image there is of."""
        nodes = self.neighbours[bond]
        return nodes if self.images is None else self.images.fold(nodes)

    def numbered(self, bond: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Node at the far end of some directed bonds by its number in the whole body."""
        nodes = self.neighbours[bond]
        return nodes if self.images is None else self.images.numbered(nodes)

    def once(self) -> np.ndarray:
        """Mark every bond from one of its ends only, the lower node; bool (b,)."""
        owner = self.owners()
        if self.images is None:
            return owner < self.neighbours
        return owner < self.far() + (self.neighbours >= self.node_count)

    def counted(self, bond: np.ndarray) -> np.ndarray | float:
        """How many bonds of the whole body some bonds stand for: those of a node with its image, half as many."""
        if self.images is None:
            return 1.0
        return self.images.symmetry.copies * np.where(self.reverse[bond] == bond, 0.5, 1.0)

    def middles(self, coordinates: np.ndarray, owner: np.ndarray, bond: np.ndarray) -> np.ndarray:
        """Middle of some directed bonds, or its image on this side of the mirror lines, m (k, 2)."""
        if self.images is None:
            return 0.5 * (coordinates[owner] + coordinates[self.neighbours[bond]])
        positions = self.images.positions
        return self.images.symmetry.inside(0.5 * (positions[owner] + positions[self.neighbours[bond]]))

    def alone(self) -> Families:
        """The families without what only forces need."""
        part = self.within()
        return Families(
            offsets=part.offsets, neighbours=part.neighbours, length=part.length, horizon=part.horizon,
            lattice=part.lattice, horizons=part.horizons,
        )  # fmt: skip

    def within(self) -> Families:
        """The families of the part alone, without images."""
        if self.images is None:
            return self
        kept = self.neighbours < self.node_count
        offsets = np.concatenate([[0], np.cumsum(np.add.reduceat(np.append(kept, False), self.offsets[:-1]))])
        offsets = offsets.astype(np.int64)
        parts = self.neighbours[kept], self.owners()[kept], self.length[kept], self.nx[kept], self.ny[kept]
        return Families(
            offsets=offsets, neighbours=parts[0], length=parts[2], horizon=self.horizon, horizons=self.horizons,
            lattice=None if self.lattice is None else find_lattice(offsets, *parts),
        )  # fmt: skip


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
    symmetry: Symmetry | None = None,
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
    symmetry
        Mirror lines, if the nodes are a part of a symmetric body.

    Raises
    ------
    PdheError
        If two nodes coincide.
    """
    horizons = None if grading is None else grading.horizons
    # A ramp ends half the mean spacing of both cells beyond the larger horizon: with horizons of their own, a cell may
    # have the larger one and yet be the smaller of the two. What is found too much has no share.
    beyond = 0.0 if partial != "ramp" else 0.5 if horizons is None else 1.0
    reach = (horizon if horizons is None else horizons) + beyond * spacing
    images = None if symmetry is None else symmetry.images(coordinates, float(reach.max()) * (1 + 1e-9))
    if images is not None:
        coordinates, cracks = images.positions, symmetry.cracks(cracks)
        reach, volume, spacing = images.extend(reach), images.extend(volume), images.extend(spacing)
        horizons = None if horizons is None else images.extend(horizons)
    offsets, neighbours = find_families(coordinates, reach * (1 + 1e-9))
    if images is not None:
        offsets = offsets[: images.nodes + 1]
        neighbours = neighbours[: offsets[-1]]
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
    kept = share > NEGLIGIBLE
    if not kept.all():
        count = np.bincount(owner[kept], minlength=offsets.size - 1)
        offsets = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
        owner, neighbours = owner[kept], neighbours[kept]
        length, nx, ny, share = length[kept], nx[kept], ny[kept], share[kept]
        fineness = None if fineness is None else fineness[kept]
    reverse = _reverse(offsets, owner, neighbours, images)
    far = neighbours if images is None else images.fold(neighbours)
    volumes = share * volume[neighbours]  # seen from the owner
    if surface == "moment matched" and grading is not None:
        strength = volumes * volume[owner] * length
        correction = joint_correction(
            offsets, neighbours, length, nx, ny, strength, volume, grading, horizon, thickness, images
        )
    elif surface == "moment matched":
        correction = moment_correction(offsets, length, nx, ny, volumes, horizon, thickness)
    elif surface == "volume":
        correction = volume_correction(offsets, owner, far, volumes, horizon, thickness)
    elif surface == "energy":
        correction = energy_correction(
            offsets, owner, far, length, nx, ny, volumes, horizon, thickness, tangential_ratio
        )
    else:
        correction = np.ones(length.size)
    correction = np.clip(0.5 * (correction + correction[reverse]), *WEIGHT_LIMITS)
    weight = share * correction * volume[owner] * volume[neighbours]
    cut = _cut_bonds(coordinates, owner, neighbours, cracks, float(length.max(initial=0.0)))
    return Bonds(
        offsets=offsets, neighbours=neighbours, reverse=reverse, length=length, nx=nx, ny=ny, weight=weight, cut=cut,
        horizon=horizon, lattice=find_lattice(offsets, neighbours, owner, length, nx, ny, images),
        horizons=None if grading is None else grading.horizons, fineness=fineness, images=images,
    )  # fmt: skip


def _reverse(offsets: np.ndarray, owner: np.ndarray, neighbours: np.ndarray, images: Images | None) -> np.ndarray:
    """Index of each directed bond as seen from its other end, int32 (b,)."""
    reverse = np.empty(neighbours.size, np.int32)
    if images is None:
        reverse_bonds(offsets, neighbours, reverse)
        return reverse
    # Images own no bonds; theirs are found below.
    reverse_bonds(np.concatenate([offsets, np.repeat(offsets[-1:], images.source.size)]), neighbours, reverse)
    rows = np.flatnonzero(neighbours >= images.nodes)
    reverse[rows] = images.reverse(owner, neighbours, rows)
    return reverse


def _cut_bonds(coordinates, owner, neighbours, cracks, reach) -> np.ndarray:
    """Tell which bonds a crack cuts; only bonds of nodes within reach of a crack are looked at."""
    near = np.zeros(coordinates.shape[0], bool)
    for start, end in cracks:
        near |= distance_to_segment(coordinates, start, end) <= reach * (1 + 1e-9)
    rows = np.flatnonzero(near[owner] & near[neighbours])
    cut = np.zeros(owner.size, bool)
    cut[rows] = crossed_by(coordinates[owner[rows]], coordinates[neighbours[rows]], cracks)
    return cut
