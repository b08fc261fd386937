"""Two-parameter bonds: a normal and a tangential spring (theory, section 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pdhe.bonds import Bonds
from pdhe.kernels import lattice, mechanics
from pdhe.kernels.jit import as_float
from pdhe.materials import constants
from pdhe.materials.body import Body, Measure, Model

#: Damage at which the tangential stiffness of a node has faded out where that stiffness is negative (theory, eq. 2.5).
TANGENTIAL_FADE = 0.2


class BondBody(Body):
    """Bonds that each carry a force of their own, once the rotations of their two ends are known."""

    def __init__(
        self,
        bonds: Bonds,
        model: CondensedRotation,
        coordinates: np.ndarray,
        volume: np.ndarray,
        precision: type = np.float64,
    ) -> None:
        super().__init__(bonds, model, coordinates, volume, precision)
        n = bonds.node_count
        self._by_offset = None if bonds.lattice is None else bonds.lattice.arrange(self.cubed, bonds.owners())
        self.tangential = model.normal * model.tangential_ratio
        self.share = np.ones(n)
        self.inverse = np.zeros(n)
        self._spin = np.zeros((n, 2))
        self._refresh(np.arange(n, dtype=np.int32))

    @property
    def can_be_indefinite(self) -> bool:
        """True where the tangential stiffness is negative: at large Poisson's ratios."""
        return self.tangential < 0.0

    def _refresh(self, nodes: np.ndarray) -> None:
        """Bring what depends on the broken bonds of some nodes up to date."""
        b = self.bonds
        if self.model.condenses_rotation:
            mechanics.rotation_weight(nodes, b.offsets, b.neighbours, self.coordinates, self.cubed, self.inverse)
        if self.tangential < 0.0:
            self.share[nodes] = np.maximum(0.0, 1.0 - self._phi[nodes] / TANGENTIAL_FADE)

    def _without(self, both: np.ndarray, nodes: np.ndarray) -> None:
        if self._by_offset is not None:
            self._by_offset[self.bonds.lattice.offset[both], self.bonds.neighbours[self.bonds.reverse[both]]] = 0.0
        self._refresh(nodes)

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

    def bond_loads(self, u: np.ndarray, by_energy: bool) -> np.ndarray:
        """Load of every directed bond, broken ones included, (b,): see :func:`pdhe.kernels.mechanics.bond_load`."""
        b, x, out = self.bonds, self.coordinates, np.empty(self.bonds.length.size)
        spin = self._rotate(u)
        mechanics.bond_load(
            b.offsets, b.neighbours, x, self.share, self.normal, self.tangential, by_energy, u, spin, out
        )
        return out

    def largest_ratios(
        self, u: np.ndarray, by_energy: bool, breakable: np.ndarray, resistance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As for any body, without writing anything per bond."""
        b, top = self.bonds, np.empty(self.bonds.node_count)
        spin = self._rotate(u)
        mechanics.largest_ratio(
            b.offsets, b.neighbours, self.coordinates, self.share, self.normal, self.tangential, by_energy, u, spin,
            breakable, resistance, top,
        )  # fmt: skip
        return top, spin[:, 0].copy()

    def node_parts(self, u: np.ndarray) -> np.ndarray:
        """Rotation of each node, rad (n,)."""
        return self._rotate(u)[:, 0].copy()

    def bond_parts(
        self, u: np.ndarray, bond: np.ndarray, owner: np.ndarray, nodes: np.ndarray | None = None
    ) -> np.ndarray:
        """Stretch and both tangential strains of some directed bonds, (3, k)."""
        b, theta = self.bonds, self._rotate(u)[:, 0] if nodes is None else nodes
        other = b.neighbours[bond]
        relative = u[other] - u[owner]
        stretch = (b.nx[bond] * relative[:, 0] + b.ny[bond] * relative[:, 1]) / b.length[bond]
        angle = (b.nx[bond] * relative[:, 1] - b.ny[bond] * relative[:, 0]) / b.length[bond]
        return np.stack([stretch, angle - theta[owner], angle - theta[other]])

    def measure(self, bond: np.ndarray, owner: np.ndarray) -> Measure:
        """Energy of some directed bonds, shear included (theory, eq. 2.1)."""
        b, ratio = self.bonds, self.tangential / self.normal
        share_i, share_j = self.share[owner], self.share[b.neighbours[bond]]

        def square(parts: np.ndarray) -> np.ndarray:
            stretch, angle_i, angle_j = parts
            return stretch**2 + ratio * 0.5 * (share_i * angle_i**2 + share_j * angle_j**2)

        return Measure(self.normal * b.weight[bond] * b.length[bond], square)

    def stiffness_rows(self) -> np.ndarray:
        """Gershgorin's bound with the node rotations held, N/m (n, 2).

        Condensing the rotations out subtracts a positive semi-definite matrix where the tangential stiffness is
        positive, so that the largest eigenvalue can only fall; where it is negative, its magnitude is added instead.
        """
        b = self.bonds
        scale, cross = self.cubed * b.length**2, np.abs(b.nx * b.ny)
        normal, tangential = self.normal, abs(self.tangential)
        rows = np.column_stack(
            [
                scale * (normal * b.nx**2 + tangential * b.ny**2 + (normal + tangential) * cross),
                scale * (normal * b.ny**2 + tangential * b.nx**2 + (normal + tangential) * cross),
            ]
        )
        # Each row holds the bonds twice: in the diagonal block and in the blocks beside it.
        return 2.0 * b.sum_by_node(rows)


@dataclass(frozen=True)
class CondensedRotation(Model):
    """Two-parameter bond from which each node's own rotation is removed: objective, and stable for any Poisson's ratio.

    The tangential part of a bond is measured against a rotation of the node that carries no stiffness of its own and
    is therefore eliminated node by node (theory, eqs. 2.6 and 2.7).
    """

    body = BondBody
    condenses_rotation: ClassVar[bool] = True

    @property
    def tangential_ratio(self) -> float:
        """Tangential over normal micromodulus (theory, eq. 2.3).

        Negative above a Poisson's ratio of 1/3 in plane stress, of 1/4 in plane strain.
        """
        return constants.tangential_ratio(self.poissons_ratio, self.plane)


@dataclass(frozen=True)
class ThesisSpring(CondensedRotation):
    """The same bond with its tangential spring attached to fixed axes, as the thesis has it.

    Rotating the body stores energy, and shear waves travel too fast (theory, eqs. 2.4 and 2.8). Kept for comparison
    only; indefinite for a Poisson's ratio above 1/3.
    """

    condenses_rotation = False
    objective = False


@dataclass(frozen=True)
class OneParameter(CondensedRotation):
    """The classical bond, with a normal spring alone (Silling 2000): Poisson's ratio is 1/3, or 1/4 in plane strain.

    What else is asked for as Poisson's ratio is not regarded; Young's modulus is.
    """

    condenses_rotation = False
    tangential_ratio = 0.0

    @property
    def normal(self) -> float:
        """Micromodulus, N/m^6: eq. 2.2 of the theory at the ratio that such bonds have."""
        ratio = constants.ONE_PARAMETER[self.plane]
        return constants.micromodulus(self.youngs_modulus, ratio, self.plane, self.thickness, self.horizon)
