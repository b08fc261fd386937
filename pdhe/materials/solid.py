"""Two-parameter bonds in space: rotations of nodes are vectors (theory, section 2)."""

from __future__ import annotations

import numpy as np

from pdhe.bonds import Bonds
from pdhe.kernels import mechanics3d
from pdhe.kernels.jit import as_float
from pdhe.materials.body import Body, BondLoad, Measure, Model

#: Eigenvalue of a node's rotation weight over its largest one below which the node does not resist that rotation:
#: about the axis of bonds that all lie on one line.
ROTATES_FREELY = 1e-9
#: Damage at which the tangential stiffness of a node has faded out where that stiffness is negative (theory, eq. 2.5).
TANGENTIAL_FADE = 0.2
_MATRIX = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
_ENTRIES = ([0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1])


class SolidBondBody(Body):
    """Bonds in space that each carry a force of their own, once the rotations of their two ends are known."""

    def __init__(
        self,
        bonds: Bonds,
        model: Model,
        coordinates: np.ndarray,
        volume: np.ndarray,
        precision: type = np.float64,
    ) -> None:
        super().__init__(bonds, model, coordinates, volume, precision)
        n = bonds.node_count
        self.tangential = model.normal * model.tangential_ratio
        self.share, self.inverse = np.ones(n), np.zeros((n, 6))
        self._theta, self._turning = np.zeros((n, 3)), np.zeros((n, 3))
        self._refresh(np.arange(n, dtype=np.int32))

    @property
    def can_be_indefinite(self) -> bool:
        """True where the tangential stiffness is negative: above a Poisson's ratio of 1/4."""
        return self.tangential < 0.0

    @property
    def _bonded(self) -> tuple[np.ndarray, ...]:
        return self.bonds.offsets, self.bonds.neighbours, self.coordinates

    def _refresh(self, nodes: np.ndarray) -> None:
        """Bring what depends on the broken bonds of some nodes up to date."""
        if self.model.condenses_rotation:
            weight = np.empty((nodes.size, 6))
            mechanics3d.rotation_weight(nodes, *self._bonded, self.cubed, weight)
            values, vectors = np.linalg.eigh(weight[:, _MATRIX])
            least = ROTATES_FREELY * values[:, 2:]
            inverse = np.where(values > least, 1.0 / np.where(values > least, values, 1.0), 0.0)
            matrix = np.einsum("nij,nj,nkj->nik", vectors, inverse, vectors)
            self.inverse[nodes] = matrix[:, _ENTRIES[0], _ENTRIES[1]]
        if self.tangential < 0.0:
            self.share[nodes] = np.maximum(0.0, 1.0 - self._phi[nodes] / TANGENTIAL_FADE)

    def _without(self, both: np.ndarray, nodes: np.ndarray) -> None:
        self._refresh(nodes)

    def _rotate(self, u: np.ndarray) -> np.ndarray:
        mechanics3d.node_rotation(
            *self._bonded, self.cubed, self.inverse, self.share, u, self._theta, self._turning
        )  # fmt: skip
        return self._theta

    def rotation(self, u: np.ndarray) -> np.ndarray:
        """Condensed rotation of each node, rad (n, 3)."""
        return self._rotate(as_float(u, self.coordinates.shape)).copy()

    def force(self, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Internal force on each node, N (n, 3): minus the derivative of the energy."""
        out = np.empty_like(u) if out is None else out
        self._rotate(u)
        mechanics3d.internal_force(
            *self._bonded, self.cubed, self.share, self.normal, self.tangential, u, self._turning, out
        )
        return out

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy of each node, J (n,): half of that of its bonds (theory, eq. 2.1)."""
        out = np.empty(self.bonds.node_count)
        theta = self._rotate(u)
        mechanics3d.elastic_energy(*self._bonded, self.cubed, self.share, self.normal, self.tangential, u, theta, out)
        return out

    def diagonal(self) -> np.ndarray:
        """Diagonal of the stiffness with the rotations held, N/m (n, 3): an upper bound of the true diagonal."""
        out = np.empty(self.coordinates.shape)
        mechanics3d.stiffness_diagonal(*self._bonded, self.cubed, self.normal, max(self.tangential, 0.0), out)
        return out

    def stiffness_rows(self) -> np.ndarray:
        """Gershgorin's bound with the node rotations held, N/m (n, 3), as in the plane."""
        b = self.bonds
        scale, direction = self.cubed * b.length**2, np.column_stack([b.nx, b.ny, b.nz])
        normal, tangential = self.normal, abs(self.tangential)
        size = np.abs(direction)
        cross = size * (size.sum(axis=1, keepdims=True) - size)
        rows = normal * direction**2 + tangential * (1.0 - direction**2) + (normal + tangential) * cross
        # Each row holds the bonds twice: in the diagonal block and in the blocks beside it.
        return 2.0 * b.sum_by_node(scale[:, None] * rows)

    def bond_loads(self, u: np.ndarray, load: BondLoad) -> np.ndarray:
        """Load of every directed bond, broken ones included, (b,)."""
        out = np.empty(self.bonds.length.size)
        theta = self._rotate(u)
        constants = self.normal, self.tangential, load.by_energy, load.above
        mechanics3d.bond_load(*self._bonded, self.share, *constants, u, theta, out)
        return out

    def force_and_ratios(
        self, u: np.ndarray, load: BondLoad, weakness: np.ndarray, out: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`Body.force_and_ratios`: here in one go over the bonds."""
        square, theta = np.empty(self.bonds.node_count), self._rotate(u)
        mechanics3d.force_and_ratio(
            *self._bonded, self.cubed, self.share, self.normal, self.tangential, load.by_energy, load.above, weakness,
            u, theta, out, square,
        )  # fmt: skip
        return square, theta.copy()

    def largest_ratios(
        self, u: np.ndarray, load: BondLoad, breakable: np.ndarray, resistance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As for any body, without writing anything per bond."""
        top, theta = np.empty(self.bonds.node_count), self._rotate(u)
        mechanics3d.largest_ratio(
            *self._bonded, self.share, self.normal, self.tangential, load.by_energy, load.above, u, theta, breakable,
            resistance, top,
        )  # fmt: skip
        return top, theta.copy()

    def node_parts(self, u: np.ndarray) -> np.ndarray:
        """Rotation of each node, rad (n, 3)."""
        return self._rotate(u).copy()

    def bond_parts(
        self, u: np.ndarray, bond: np.ndarray, owner: np.ndarray, nodes: np.ndarray | None = None
    ) -> np.ndarray:
        """Stretch and the tangential strains as seen from both ends, three components each, of some bonds, (7, k)."""
        b, theta = self.bonds, self._rotate(u) if nodes is None else nodes
        direction = np.column_stack([b.nx[bond], b.ny[bond], b.nz[bond]])
        other = b.neighbours[bond]
        relative = (u[other] - u[owner]) / b.length[bond][:, None]
        stretch = np.einsum("kc,kc->k", relative, direction)
        across = relative - stretch[:, None] * direction
        seen = [across - np.cross(theta[end], direction) for end in (owner, other)]
        return np.concatenate([stretch[None], seen[0].T, seen[1].T])

    def measure(self, bond: np.ndarray, owner: np.ndarray) -> Measure:
        """Energy of some directed bonds, shear included (theory, eq. 2.1)."""
        b, ratio = self.bonds, self.tangential / self.normal
        share_i, share_j = self.share[owner], self.share[b.neighbours[bond]]

        def square(parts: np.ndarray) -> np.ndarray:
            seen_i, seen_j = (parts[1:4] ** 2).sum(axis=0), (parts[4:7] ** 2).sum(axis=0)
            return parts[0] ** 2 + ratio * 0.5 * (share_i * seen_i + share_j * seen_j)

        return Measure(self.normal * b.weight[bond] * b.length[bond], square)
