"""When a bond breaks: the critical stretch and the bonds that can reach it (theory, section 5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pdhe.bonds import Bonds
from pdhe.materials import Body, CondensedRotation


def crossing_sum(bonds: Bonds, volume: np.ndarray) -> float:
    """Sum of ``beta lambda V_i V_j r`` over the bonds that cross a unit area of a crack, m^5 (theory, eq. 5.4).

    A bond of length r crosses a unit length of a crack with normal n with the mean frequency ``|xi . n|``. On a lattice
    the sum depends on the crack's orientation by some per cent; it is taken for the weakest one, which is where cracks
    run. Only nodes whose family is whole enter (all of them where none is).
    """
    size = np.diff(bonds.offsets)
    interior = size >= 0.95 * np.median(size)
    inside = np.repeat(interior, size)
    angle = np.arctan2(bonds.ny[inside], bonds.nx[inside]) % np.pi
    sectors = 3600
    sector = np.rint(angle * (sectors / np.pi)).astype(np.int64) % sectors
    by_direction = np.bincount(sector, (bonds.weight * bonds.length**2)[inside], sectors)
    direction = np.pi / sectors * np.arange(sectors)
    normals = np.pi / 180.0 * np.arange(180)
    across = np.abs(np.cos(direction[None, :] - normals[:, None])) @ by_direction
    return float(0.5 * across.min() / volume[interior].sum())


def critical_stretch(model: CondensedRotation, crossing: float, toughness: float, calibration: str) -> float:
    """Critical stretch of a dry bond for a fracture energy ``toughness``, J/m^2.

    ``continuum`` uses the integral over a full disc, ``G = k_n s_c^2 h delta^4 / 4`` (theory, eq. 5.3); ``discrete``
    the bonds that the actual set of nodes has (``crossing`` from :func:`crossing_sum`), which differ from the integral
    by up to 18 % in energy.
    """
    if calibration == "continuum":
        return float(np.sqrt(4.0 * toughness / (model.normal * model.thickness * model.horizon**4)))
    return float(np.sqrt(2.0 * toughness / (model.normal * crossing)))


@dataclass(frozen=True)
class FailureRule:
    """What decides on failure: a bond breaks once its load reaches its resistance.

    Attributes
    ----------
    critical
        Dry critical stretch.
    crossing
        What :func:`crossing_sum` gives for these bonds, m^5.
    by_energy
        Compare the bond's whole energy (as a stretch without shear) instead of its stretch alone.
    resistance
        Function of the coverage giving the fraction of ``critical`` that is left; None without hydrogen.
    may_fail
        Directed bonds that are allowed to break, bool (b,); each undirected bond is marked once, seen from the lower
        node.
    """

    critical: float
    crossing: float
    by_energy: bool
    resistance: Callable[[np.ndarray], np.ndarray] | None
    may_fail: np.ndarray

    @property
    def weakest(self) -> float:
        """The smallest critical stretch that any coverage can lead to."""
        return self.critical * (1.0 if self.resistance is None else float(self.resistance(np.ones(1))[0]))


class Candidates:
    """The bonds that could break while the displacements go linearly from ``u0`` to ``u1``.

    A bond is in the list if its load at either end reaches the least resistance that saturation could leave it. Loads
    are convex in time between the two ends, so no other bond can fail in between. With ``watch`` the list is
    lengthened, if need be, until it surely holds the bond that is nearest to failure.
    """

    def __init__(self, body: Body, rule: FailureRule, u0: np.ndarray, u1: np.ndarray, *, watch: bool = False) -> None:
        self.rule = rule
        self.ratio_of_moduli = body.tangential / body.normal
        moving = u1 is not u0
        breakable = rule.may_fail & body.intact
        load = body.bond_loads(u0, rule.by_energy)
        if moving:
            load = np.maximum(load, body.bond_loads(u1, rule.by_energy))
        least = rule.weakest
        if watch:
            least = min(least, float(load.max(where=breakable, initial=0.0)) * rule.weakest / rule.critical)
        self.bond = np.flatnonzero(breakable & (load >= least))
        self.i, self.j = _owners(body.bonds, self.bond), body.bonds.neighbours[self.bond]
        self.share_i, self.share_j = body.share[self.i], body.share[self.j]
        self.stiffness = body.normal * body.bonds.weight[self.bond] * body.bonds.length[self.bond]
        self.start = body.bond_parts(u0, self.bond, self.i)
        self.change = body.bond_parts(u1, self.bond, self.i) - self.start if moving else None

    def _strains(self, fraction: float) -> tuple[np.ndarray, np.ndarray]:
        """Stretch, and the squared stretch that has the same energy, shear included."""
        stretch, angle_i, angle_j = self.start if self.change is None else self.start + fraction * self.change
        shear = 0.5 * (self.share_i * angle_i**2 + self.share_j * angle_j**2)
        return stretch, stretch**2 + self.ratio_of_moduli * shear

    def load(self, fraction: float) -> np.ndarray:
        """Load of each candidate at a fraction of the way from ``u0`` to ``u1``, (k,) (theory, eq. 5.2)."""
        stretch, square = self._strains(fraction)
        if self.rule.by_energy:
            return np.where(stretch > 0.0, np.sqrt(np.maximum(square, 0.0)), 0.0)
        return np.maximum(stretch, 0.0)

    def energy(self, fraction: float) -> np.ndarray:
        """Elastic energy of each candidate, J (k,) (theory, eq. 2.1)."""
        return 0.5 * self.stiffness * self._strains(fraction)[1]

    def ratio(self, fraction: float, psi: np.ndarray | None) -> np.ndarray:
        """Load over resistance of each candidate, (k,): a bond breaks at 1.

        The coverage of a bond is the mean of its two ends (theory, eq. 5.8).
        """
        return self.ratio_at(fraction, None if psi is None else 0.5 * (psi[self.i] + psi[self.j]))

    def ratio_at(self, fraction: float, psi: np.ndarray | None) -> np.ndarray:
        """The same for the coverage of each candidate, (k,)."""
        critical = self.rule.critical
        if psi is not None and self.rule.resistance is not None:
            critical = critical * self.rule.resistance(psi)
        return self.load(fraction) / critical


def _owners(bonds: Bonds, bond: np.ndarray) -> np.ndarray:
    """Owner of some directed bonds."""
    return (np.searchsorted(bonds.offsets, bond, side="right") - 1).astype(np.int32)
