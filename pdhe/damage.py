"""When a bond breaks: the critical stretch and the bonds that can reach it (theory, section 5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pdhe.bonds import Bonds
from pdhe.materials import Body, BondLoad, Model
from pdhe.materials.body import load_of

#: Directions of bonds in space are rounded to one over this where planes that they cross are compared.
_DIRECTIONS = 60


@dataclass(frozen=True)
class Criterion:
    """What a bond breaks by.

    Attributes
    ----------
    by_energy
        Compare the bond's whole energy instead of its stretch alone.
    equal_energy
        Bonds of all lengths hold the same energy per product of the two volumes when they break; otherwise they have
        the same stretch.
    """

    by_energy: bool
    equal_energy: bool


#: Criteria by the name that scenes use. A new one of these kinds is one line here.
CRITERIA = {
    "energy": Criterion(by_energy=True, equal_energy=False),
    "stretch": Criterion(by_energy=False, equal_energy=False),
    "energy density": Criterion(by_energy=True, equal_energy=True),
}


def stretch_squares(bonds: Bonds, criterion: Criterion) -> np.ndarray | None:
    """Square of every bond's critical stretch over that of :func:`critical_stretch`, (b,); None where all have it.

    Where the horizon varies, by eq. 5.11 of the theory; bonds of equal energy by eq. 5.13, in which a horizon that
    varies cancels out.
    """
    return bonds.horizon / bonds.length if criterion.equal_energy else bonds.fineness


def crossing_sum(bonds: Bonds, volume: np.ndarray, squares: np.ndarray | None = None) -> float:
    """Sum of ``beta lambda V_i V_j r`` over the bonds that cross a unit area of a crack, m^5 (theory, eq. 5.4).

    A bond of length r crosses a unit length of a crack with normal n with the mean frequency ``|xi . n|``. On a lattice
    the sum depends on the crack's orientation by some per cent; it is taken for the weakest one, which is where cracks
    run. Only nodes whose family is whole enter (all of them where none is). Where the horizon varies, every bond counts
    with its fineness, which makes the sum that of the reference horizon (theory, eq. 5.11). ``squares`` (b,), from
    :func:`stretch_squares`, go before the fineness: the sum is then for critical stretches that differ.
    """
    squares = bonds.fineness if squares is None else squares
    size, within = np.diff(bonds.offsets), np.diff(bonds.offsets)
    if bonds.horizons is not None:  # how many others see a node depends on how the horizon varies
        within = bonds.sum_by_node((bonds.length <= bonds.horizons[bonds.owners()]).astype(np.int64))
    interior = within >= 0.95 * np.median(within)
    inside = np.repeat(interior, size)
    if bonds.dimension == 3:
        rows = np.flatnonzero(inside)
        return 0.5 * _weakest_plane(bonds, rows, squares) / float(volume[interior].sum())
    angle = np.arctan2(bonds.ny[inside], bonds.nx[inside]) % np.pi
    sectors = 3600
    sector = np.rint(angle * (sectors / np.pi)).astype(np.int64) % sectors
    weight, area = bonds.weight * bonds.length**2, volume[interior].sum()
    if squares is not None:
        weight = weight * squares
    if bonds.fineness is not None:
        # Every node counts alike: most are where the mesh is fine, and that is where cracks run.
        weight, area = weight / volume[bonds.owners()], interior.sum()
    by_direction = np.bincount(sector, weight[inside], sectors)
    if bonds.images is not None:  # the images of these bonds are in the body as well
        by_direction = 0.5 * (by_direction + by_direction[-np.arange(sectors)])
    direction = np.pi / sectors * np.arange(sectors)
    normals = np.pi / 180.0 * np.arange(180)
    across = np.abs(np.cos(direction[None, :] - normals[:, None])) @ by_direction
    return float(0.5 * across.min() / area)


def _weakest_plane(bonds: Bonds, rows: np.ndarray, squares: np.ndarray | None) -> float:
    """Least sum of ``weight r |xi . n|`` of some bonds in space over the orientations n of a plane, m^8."""
    weight = bonds.weight[rows] * bonds.length[rows] ** 2
    if squares is not None:
        weight *= squares[rows]
    directions = bonds.nx, bonds.ny, bonds.nz
    # Bonds of nearly one direction count together: the directions are rounded to a grid about 1 degree wide.
    side, cell = 2 * _DIRECTIONS + 1, np.zeros(rows.size, np.int32)
    for values in directions:
        cell = cell * np.int32(side) + np.rint(values[rows] * _DIRECTIONS).astype(np.int32) + np.int32(_DIRECTIONS)
    some = np.flatnonzero(np.bincount(cell, minlength=side**3))
    mean = np.column_stack([np.bincount(cell, weight * values[rows], side**3)[some] for values in directions])
    # The projection of a sum is the sum of projections where all have one sign, as in so small a cell: nearly exact.
    # Few planes at a time: irregular nodes have bonds in tens of thousands of directions.
    return min(float(np.abs(mean @ few.T).sum(axis=0).min()) for few in np.array_split(_orientations(), 32))


def _orientations() -> np.ndarray:
    """Unit normals of planes: those along axes and diagonals of a lattice, and 500 spread over half a sphere."""
    grid = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) > (0, 0, 0)])
    k = np.arange(500) + 0.5
    z, turn = k / k.size, np.pi * (1.0 + 5.0**0.5) * k
    flat = np.sqrt(1.0 - z**2)
    spread = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])
    return np.concatenate([grid / np.linalg.norm(grid, axis=1)[:, None], spread])


def critical_stretch(
    model: Model, crossing: float, toughness: float, calibration: str, criterion: Criterion = CRITERIA["energy"]
) -> float:
    """Critical stretch of a dry bond for a fracture energy ``toughness``, J/m^2.

    ``continuum`` uses the integral over a full disc, ``G = k_n s_c^2 h delta^4 / 4`` (theory, eq. 5.3), in space over a
    full ball, ``G = pi k_n s_c^2 delta^5 / 10``; ``discrete``
    the bonds that the actual set of nodes has (``crossing`` from :func:`crossing_sum`), which differ from the integral
    by up to 18 % in energy. Of bonds of equal energy it is that of one as long as the horizon: they have
    ``w_c = 3 G / (2 h delta^3)`` in the plane and ``4 G / (pi delta^4)`` in space (theory, eq. 5.13), and
    ``crossing`` is for their :func:`stretch_squares`.
    """
    if calibration == "continuum" and criterion.equal_energy:
        whole = (
            np.pi * model.horizon**4 / 4.0 if model.plane is None else 2.0 * model.thickness * model.horizon**3 / 3.0
        )
        return float(np.sqrt(2.0 * toughness / (model.normal * model.horizon * whole)))
    if calibration == "continuum" and model.plane is None:
        return float(np.sqrt(10.0 * toughness / (np.pi * model.normal * model.horizon**5)))
    if calibration == "continuum":
        return float(np.sqrt(4.0 * toughness / (model.normal * model.thickness * model.horizon**4)))
    return float(np.sqrt(2.0 * toughness / (model.normal * crossing)))


def stretch_factors(
    bonds: Bonds, toughness: np.ndarray | None = None, criterion: Criterion = CRITERIA["energy"]
) -> dict[str, np.ndarray]:
    """``squares`` and ``least_factor`` of a :class:`FailureRule` where bonds have different critical stretches.

    ``toughness`` is the fracture energy of every directed bond over that of the material, (b,) (theory, eqs. 5.11 to
    5.13). Empty where all bonds are alike.
    """
    varying = tuple(values for values in (stretch_squares(bonds, criterion), toughness) if values is not None)
    if not varying:
        return {}
    factor = np.sqrt(np.prod(varying, axis=0))
    least, some = np.ones(bonds.node_count), np.diff(bonds.offsets) > 0
    least[some] = np.minimum.reduceat(factor, bonds.offsets[:-1][some])
    return {"squares": varying, "least_factor": least}


def together_at(tolerance: float) -> float:
    """How far short of its resistance a bond may be and yet break with a critical one, given the solver's tolerance.

    Loads of mirror images differ by up to 1.4 tolerances on the plate of the thesis at 2.5 mm and 6 at 1.25 mm (theory,
    eq. 6.2). This keeps a symmetric scene symmetric, and moves a failure by less than itself in resistance; above
    0.01 it would reach as far as the grouping of failures does.
    """
    return min(10.0 * tolerance, 0.01)


@dataclass(frozen=True)
class FailureRule:
    """What decides on failure: a bond breaks once its load reaches its resistance.

    Attributes
    ----------
    critical
        Dry critical stretch; where the horizon or the fracture energy varies, that of the reference horizon and of the
        material. Of bonds of equal energy, that of one as long as the horizon.
    crossing
        What :func:`crossing_sum` gives for these bonds, m^5.
    load
        What of a bond is compared with its critical stretch.
    resistance
        Function of the coverage giving the fraction of ``critical`` that is left; None without hydrogen.
    may_fail
        Directed bonds that are allowed to break, bool (b,); each undirected bond is marked once, seen from the lower
        node.
    squares
        Arrays (b,) whose product is the square of what ``critical`` is to be multiplied with for each directed bond
        where they differ (theory, eqs. 5.11 to 5.13). That by the horizon is the bonds' own array, not a copy.
    least_factor
        The smallest factor in the family of each node (n,), or None.
    together
        Share of its resistance that a bond may be short of, and yet break with one that has reached its own: what the
        solver leaves between mirror images (:func:`together_at`).
    """

    critical: float
    crossing: float
    load: BondLoad
    resistance: Callable[[np.ndarray], np.ndarray] | None
    may_fail: np.ndarray
    squares: tuple[np.ndarray, ...] = ()
    least_factor: np.ndarray | None = None
    together: float = 0.0

    def factor(self, bond: np.ndarray | slice = slice(None)) -> np.ndarray | float:
        """What ``critical`` is to be multiplied with for some directed bonds, all by default; 1 where all are alike."""
        return np.sqrt(np.prod([values[bond] for values in self.squares], axis=0)) if self.squares else 1.0

    @property
    def weakest(self) -> float:
        """The smallest critical stretch that any coverage can lead to, at the reference horizon."""
        return self.critical * (1.0 if self.resistance is None else float(self.resistance(np.ones(1))[0]))

    def resistance_at(self, psi: np.ndarray | None, bond: np.ndarray | None = None) -> np.ndarray | float:
        """Critical stretch of some directed bonds at their coverages; the dry one if they are None or do not matter.

        Without ``bond`` it is that of the reference horizon.
        """
        critical = self.critical if bond is None else self.critical * self.factor(bond)
        if psi is None or self.resistance is None:
            return critical
        return critical * self.resistance(psi)

    def weakest_of(self, bond: np.ndarray) -> np.ndarray | float:
        """The smallest critical stretch that any coverage can lead to, of some directed bonds."""
        return self.weakest * self.factor(bond)

    def least(self, critical: np.ndarray | float, nodes: int) -> np.ndarray:
        """For each node the critical stretch, of the reference horizon, as its weakest bond has it (n,).

        A bond has at least the lesser one of its two ends, since the resistance falls with coverage.
        """
        least = np.empty(nodes)
        least[:] = critical
        return least if self.least_factor is None else least * self.least_factor


class Candidates:
    """The bonds that could break while the displacements go linearly from ``u0`` to ``u1``.

    A bond is in the list if its load at either end reaches the least resistance that saturation could leave it, or is
    short of it by no more than :attr:`FailureRule.together`. Under proportional loads a load only rises or falls in
    between; otherwise, if its energy is a sum of squares, it is convex there while the bond is stretched, or all the
    way if shortened bonds have loads too, so that no other bond can fail (for the rest see limits: loads that are not
    proportional). With ``psi`` (n,), the coverage stays as it is, and only bonds are listed that may be critical at it.
    """

    def __init__(
        self, body: Body, rule: FailureRule, u0: np.ndarray, u1: np.ndarray, psi: np.ndarray | None = None
    ) -> None:
        self.rule = rule
        breakable = rule.may_fail & body.intact
        least = rule.least(rule.weakest if psi is None else rule.resistance_at(psi), body.bonds.node_count)
        least *= 1.0 - rule.together
        top, nodes0 = body.largest_ratios(u0, rule.load, breakable, least)
        nodes1 = None
        if u1 is not u0:
            end, nodes1 = body.largest_ratios(u1, rule.load, breakable, least)
            top = np.maximum(top, end)
        self.bond, self.i, self.j = _bonds_of(body.bonds, np.flatnonzero(top >= 1.0), breakable)
        self.measure = body.measure(self.bond, self.i)
        self.start = body.bond_parts(u0, self.bond, self.i, nodes0)
        self.change = None if nodes1 is None else body.bond_parts(u1, self.bond, self.i, nodes1) - self.start
        self._resting = None
        load = self.load(0.0) if self.change is None else np.maximum(self.load(0.0), self.load(1.0))
        keep = load >= np.minimum(least[self.i], least[self.j])
        self.bond, self.i, self.j = self.bond[keep], self.i[keep], self.j[keep]
        self.measure = body.measure(self.bond, self.i)
        self.start = self.start[:, keep]
        if self.change is None:
            self._resting = load[keep]
        else:
            self.change = self.change[:, keep]

    def _parts(self, fraction: float) -> np.ndarray:
        return self.start if self.change is None else self.start + fraction * self.change

    def load(self, fraction: float) -> np.ndarray:
        """Load of each candidate at a fraction of the way from ``u0`` to ``u1``, (k,) (theory, eq. 5.2)."""
        if self._resting is not None:
            return self._resting
        return load_of(self._parts(fraction), self.measure, self.rule.load)

    def energy(self, fraction: float) -> np.ndarray:
        """Elastic energy of each candidate, J (k,) (theory, eq. 2.1); that of one of all the bonds it stands for."""
        return 0.5 * self.measure.stiffness * self.measure.square(self._parts(fraction))

    def ratio(self, fraction: float, psi: np.ndarray | None) -> np.ndarray:
        """Load over resistance of each candidate, (k,): a bond breaks at 1.

        The coverage of a bond is the mean of its two ends (theory, eq. 5.8).
        """
        return self.ratio_at(fraction, None if psi is None else 0.5 * (psi[self.i] + psi[self.j]))

    def ratio_at(self, fraction: float, psi: np.ndarray | None, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """The same for some candidates, given the coverage of each of them, (k,)."""
        return self.load(fraction)[rows] / self.rule.resistance_at(psi, self.bond[rows])


def nearest_failure(body: Body, rule: FailureRule, u: np.ndarray, psi: np.ndarray | None) -> float:
    """Largest load over resistance of any bond: how near the next failure is, 1 being there.

    The resistance falls with coverage, hence that of a bond is at least the lesser one of its ends. What this bound
    leaves over is looked at bond by bond.
    """
    breakable = rule.may_fail & body.intact
    least = rule.least(rule.resistance_at(psi), body.bonds.node_count)
    bound, parts = body.largest_ratios(u, rule.load, breakable, least)
    largest, top = 0.0, float(bound.max(initial=0.0))
    # The node with the highest bound first; then all whose bound exceeds what it has.
    for nodes in (np.flatnonzero(bound == top)[:1], np.flatnonzero(bound > 0.0)):
        bond, i, j = _bonds_of(body.bonds, nodes[bound[nodes] > largest], breakable)
        if bond.size:
            load = load_of(body.bond_parts(u, bond, i, parts), body.measure(bond, i), rule.load)
            critical = rule.resistance_at(None if psi is None else 0.5 * (psi[i] + psi[j]), bond)
            largest = max(largest, float((load / critical).max()))
    return largest


def critical_bonds(
    body: Body, rule: FailureRule, u: np.ndarray, psi: np.ndarray | None, nodes: np.ndarray, parts: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The bonds among those of some nodes that are at or beyond their resistance: directed bonds and both ends, (k,).

    ``parts`` is what :meth:`Body.node_parts` gives for ``u``.
    """
    bond, i, j = _bonds_of(body.bonds, nodes, rule.may_fail & body.intact)
    load = load_of(body.bond_parts(u, bond, i, parts), body.measure(bond, i), rule.load)
    keep = load >= rule.resistance_at(None if psi is None else 0.5 * (psi[i] + psi[j]), bond)
    return bond[keep], i[keep], j[keep]


def _bonds_of(bonds: Bonds, nodes: np.ndarray, among: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Those directed bonds of some nodes that are ``among`` (b,) a kind, and the nodes at their two ends."""
    first, size = bonds.offsets[nodes], bonds.offsets[nodes + 1] - bonds.offsets[nodes]
    shift = np.repeat(first - np.concatenate([[0], np.cumsum(size)[:-1]]), size)
    bond, owner = np.arange(shift.size) + shift, np.repeat(nodes, size).astype(np.int32)
    kept = among[bond]
    bond, owner = bond[kept], owner[kept]
    return bond, owner, bonds.far(bond)
