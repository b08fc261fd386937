"""Elastic bond models in plane stress, and the body that carries their forces (theory, section 2)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pdhe.bonds import Bonds
from pdhe.kernels import lattice, mechanics
from pdhe.kernels.jit import as_float

#: Damage at which the tangential stiffness of a node has faded out where that stiffness is negative (theory, eq. 2.5).
TANGENTIAL_FADE = 0.2


@dataclass(frozen=True)
class CondensedRotation:
    """Two-parameter bond from which each node's own rotation is removed: objective, and stable for any Poisson's ratio.

    The tangential part of a bond is measured against a rotation of the node that carries no stiffness of its own and
    is therefore eliminated node by node (theory, eqs. 2.6 and 2.7).
    """

    youngs_modulus: float = field(metadata={"unit": "Pa"})
    poissons_ratio: float = field(metadata={"unit": "1"})
    thickness: float = field(metadata={"unit": "m"})
    horizon: float = field(metadata={"unit": "m"})
    condenses_rotation = True

    @property
    def normal(self) -> float:
        """Normal micromodulus k_n, N/m^6 (theory, eq. 2.2)."""
        e, nu = self.youngs_modulus, self.poissons_ratio
        return 6.0 * e / (np.pi * self.thickness * self.horizon**3 * (1.0 - nu))

    @property
    def tangential_ratio(self) -> float:
        """Tangential over normal micromodulus (theory, eq. 2.3); negative above a Poisson's ratio of 1/3."""
        return (1.0 - 3.0 * self.poissons_ratio) / (1.0 + self.poissons_ratio)


@dataclass(frozen=True)
class ThesisSpring(CondensedRotation):
    """The same bond with its tangential spring attached to fixed axes, as the thesis has it.

    Rotating the body stores energy, and shear waves travel too fast (theory, eqs. 2.4 and 2.8). Kept for comparison
    only; indefinite for a Poisson's ratio above 1/3.
    """

    condenses_rotation = False


#: Bond models by the name that scenes use.
MODELS = {"condensed rotation": CondensedRotation, "thesis spring": ThesisSpring}


class Body:
    """Bonds with a model and their present state of breakage: forces, energies and bond loads for given displacements.

    Parameters
    ----------
    bonds
        The families. Bonds that a pre-crack cuts are broken from the start.
    model
        One of :data:`MODELS`.
    coordinates, volume
        Node positions, m (n, 2), and volumes, m^3 (n,).
    precision
        In which the weights of the bonds are stored. Both directions of a bond are rounded alike: with single precision
        forces still cancel to the last digit of a double, and the stiffness of each bond is off by at most 6e-8.
    """

    def __init__(
        self,
        bonds: Bonds,
        model: CondensedRotation,
        coordinates: np.ndarray,
        volume: np.ndarray,
        precision: type = np.float64,
    ) -> None:
        self.bonds, self.model, self.volume = bonds, model, volume
        self.coordinates = as_float(coordinates, (bonds.node_count, 2))
        self.intact = ~bonds.cut
        #: Directed bonds that were broken, call by call.
        self.broken: list[np.ndarray] = []
        self.cubed = np.where(self.intact, bonds.weight / bonds.length**3, 0.0).astype(precision, copy=False)
        self._by_offset = None if bonds.lattice is None else bonds.lattice.arrange(self.cubed, bonds.owners())
        n = bonds.node_count
        self.normal = model.normal
        self.tangential = model.normal * model.tangential_ratio
        self.share = np.ones(n)
        self.inverse = np.zeros(n)
        self._spin = np.zeros((n, 2))
        self._phi = np.zeros(n)
        self._refresh(np.arange(n, dtype=np.int32))
        #: Sum of ``beta lambda V_i V_j r`` over the broken bonds, each once, m^7, times their fineness if that differs.
        self.broken_weight = self._weight_of(np.flatnonzero(bonds.cut))

    def _refresh(self, nodes: np.ndarray) -> None:
        """Bring what depends on the broken bonds of some nodes up to date."""
        b = self.bonds
        if self.model.condenses_rotation:
            mechanics.rotation_weight(nodes, b.offsets, b.neighbours, self.coordinates, self.cubed, self.inverse)
        mechanics.damage(nodes, b.offsets, b.neighbours, self.volume, self.intact, self._phi)
        if self.tangential < 0.0:
            self.share[nodes] = np.maximum(0.0, 1.0 - self._phi[nodes] / TANGENTIAL_FADE)

    def _weight_of(self, bond: np.ndarray) -> float:
        weight = self.bonds.weight[bond] * self.bonds.length[bond]
        if self.bonds.fineness is not None:
            weight *= self.bonds.fineness[bond]
        return 0.5 * float(np.sum(weight))

    def break_bonds(self, directed: np.ndarray) -> None:
        """Break bonds for good, from both ends.

        Parameters
        ----------
        directed
            Indices of directed bonds; the reverse directions are found here.
        """
        directed = np.asarray(directed)
        directed = directed[self.intact[directed]]
        self.broken.append(directed)
        both = np.unique(np.concatenate([directed, self.bonds.reverse[directed]]))
        self.broken_weight += self._weight_of(both)
        self.intact[both] = False
        self.cubed[both] = 0.0
        if self._by_offset is not None:
            self._by_offset[self.bonds.lattice.offset[both], self.bonds.neighbours[self.bonds.reverse[both]]] = 0.0
        self._refresh(np.unique(self.bonds.neighbours[both]))

    def damage(self) -> np.ndarray:
        """Volume-weighted share of broken bonds, (n,); bonds cut by a pre-crack count as broken (theory, eq. 5.1)."""
        return self._phi.copy()

    def _rotate(self, u: np.ndarray) -> np.ndarray:
        b, x = self.bonds, self.coordinates
        if b.lattice is not None:
            ux, uy = np.ascontiguousarray(u[:, 0]), np.ascontiguousarray(u[:, 1])
            theta, turning = np.empty((2, ux.size))
            grid, weight = b.lattice, self._by_offset
            lattice.node_rotation(grid.step, grid.dx, grid.dy, weight, self.inverse, self.share, ux, uy, theta, turning)
            self._spin[:, 0], self._spin[:, 1] = theta, turning
            return self._spin
        mechanics.node_rotation(b.offsets, b.neighbours, x, self.cubed, self.inverse, self.share, u, self._spin)
        return self._spin

    def rotation(self, u: np.ndarray) -> np.ndarray:
        """Condensed rotation of each node, rad (n,)."""
        return self._rotate(as_float(u, (self.bonds.node_count, 2)))[:, 0].copy()

    def force(self, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Internal force on each node, N (n, 2): minus the derivative of the energy."""
        b, x, out = self.bonds, self.coordinates, np.empty_like(u) if out is None else out
        if b.lattice is not None:
            return self._lattice_force(u, out)
        spin = self._rotate(u)
        mechanics.internal_force(
            b.offsets, b.neighbours, x, self.cubed, self.share, self.normal, self.tangential, u, spin, out
        )
        return out

    def _lattice_force(self, u: np.ndarray, out: np.ndarray) -> np.ndarray:
        grid, weight = self.bonds.lattice, self._by_offset
        ux, uy = np.ascontiguousarray(u[:, 0]), np.ascontiguousarray(u[:, 1])
        theta, turning, fx, fy = np.empty((4, ux.size))
        vectors = grid.step, grid.dx, grid.dy, weight
        lattice.node_rotation(*vectors, self.inverse, self.share, ux, uy, theta, turning)
        lattice.internal_force(*vectors, self.share, self.normal, self.tangential, ux, uy, turning, fx, fy)
        out[:, 0], out[:, 1] = fx, fy
        return out

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy of each node, J (n,): half of that of its bonds (theory, eq. 2.1)."""
        b, x, out = self.bonds, self.coordinates, np.empty(self.bonds.node_count)
        spin = self._rotate(u)
        mechanics.elastic_energy(
            b.offsets, b.neighbours, x, self.cubed, self.share, self.normal, self.tangential, u, spin, out
        )
        return out

    def diagonal(self) -> np.ndarray:
        """Diagonal of the stiffness with the rotations held, N/m (n, 2): an upper bound of the true diagonal."""
        b, out = self.bonds, np.empty((self.bonds.node_count, 2))
        tangential = max(self.tangential, 0.0)
        mechanics.stiffness_diagonal(
            b.offsets, b.neighbours, self.coordinates, self.cubed, self.normal, tangential, out
        )
        return out

    def short_stiffness(self, reach: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stiffness of short bonds alone, scaled to the energy that all bonds have under a uniform strain, N/m.

        Parameters
        ----------
        reach
            A bond counts as short if it is no longer than the sum of its ends', m (n,).
        free
            1 for a free degree of freedom, 0 for a fixed one (n, 2). Fixed ones keep a diagonal entry only.

        Returns
        -------
        starts, column, value
            Blocks of 2 by 2 in compressed rows: int32 (n + 1,), int32 (k,) ascending within a row, and (k, 2, 2).
        """
        b, n = self.bonds, self.bonds.node_count
        count, sums = np.empty(n, np.int32), np.empty((n, 2))
        mechanics.count_short(b.offsets, b.neighbours, self.cubed, reach, b.weight, b.length, count, sums)
        short, whole = sums.sum(axis=0)
        scale = self.normal * whole / max(short, np.finfo(float).tiny)
        starts = np.concatenate([[0], np.cumsum(count + 1)]).astype(np.int32)
        column, value = np.empty(starts[-1], np.int32), np.empty((starts[-1], 2, 2))
        own = np.empty(n, np.int32)
        mechanics.fill_short(
            b.offsets, b.neighbours, self.coordinates, self.cubed, reach, b.length, free, scale, starts, column, value,
            own,
        )  # fmt: skip
        # A fixed degree of freedom, or one across a row of nodes, resists nothing: it gets an entry of the usual size.
        for axis in range(2):
            diagonal = value[own, axis, axis]
            typical = float(diagonal.max(initial=0.0)) or 1.0
            value[own, axis, axis] = np.where(diagonal > 1e-9 * typical, diagonal, typical)
        return starts, column, value

    def bond_loads(self, u: np.ndarray, by_energy: bool) -> np.ndarray:
        """Load of every directed bond, broken ones included, (b,): see :func:`pdhe.kernels.mechanics.bond_load`."""
        b, x, out = self.bonds, self.coordinates, np.empty(self.bonds.length.size)
        spin = self._rotate(u)
        mechanics.bond_load(
            b.offsets, b.neighbours, x, self.share, self.normal, self.tangential, by_energy, u, spin, out
        )
        return out

    def largest_ratios(self, u: np.ndarray, by_energy: bool, breakable: np.ndarray, resistance: np.ndarray):
        """What a search for failures starts with, without writing anything per bond.

        Parameters
        ----------
        u
            Displacements, m (n, 2).
        by_energy
            As in :meth:`bond_loads`.
        breakable
            Directed bonds to look at, bool (b,).
        resistance
            Load that a bond can bear, by its ends (n,): the lesser one counts.

        Returns
        -------
        top, theta
            Largest load over resistance among the bonds that each node owns, and rotation of the node, rad; both (n,).
        """
        b, top = self.bonds, np.empty(self.bonds.node_count)
        spin = self._rotate(u)
        mechanics.largest_ratio(
            b.offsets, b.neighbours, self.coordinates, self.share, self.normal, self.tangential, by_energy, u, spin,
            breakable, resistance, top,
        )  # fmt: skip
        return top, spin[:, 0].copy()

    def bond_parts(
        self, u: np.ndarray, bond: np.ndarray, owner: np.ndarray, theta: np.ndarray | None = None
    ) -> np.ndarray:
        """Stretch and both tangential strains of some directed bonds, (3, k): linear in the displacements.

        ``theta`` is the rotation of each node under ``u``, rad (n,), if known.
        """
        b, theta = self.bonds, self._rotate(u)[:, 0] if theta is None else theta
        other = b.neighbours[bond]
        relative = u[other] - u[owner]
        stretch = (b.nx[bond] * relative[:, 0] + b.ny[bond] * relative[:, 1]) / b.length[bond]
        angle = (b.nx[bond] * relative[:, 1] - b.ny[bond] * relative[:, 0]) / b.length[bond]
        return np.stack([stretch, angle - theta[owner], angle - theta[other]])
