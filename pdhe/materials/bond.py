"""Two-parameter bonds: a normal and a tangential spring (theory, section 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pdhe.bonds import Bonds
from pdhe.kernels import lattice, mechanics, verlet
from pdhe.kernels.jit import as_float
from pdhe.materials import constants
from pdhe.materials.body import Body, BondLoad, Measure, Model
from pdhe.materials.solid import TANGENTIAL_FADE, SolidBondBody


class BondBody(Body):
    """Bonds that each carry a force of their own, once the rotations of their two ends are known."""

    sees_images = True

    def __init__(
        self,
        bonds: Bonds,
        model: CondensedRotation,
        coordinates: np.ndarray,
        volume: np.ndarray,
        precision: type = np.float64,
        relative: np.ndarray | None = None,
    ) -> None:
        super().__init__(bonds, model, coordinates, volume, precision, relative)
        n, count = bonds.node_count, len(self._x)
        self._by_offset = None if bonds.lattice is None else bonds.lattice.arrange(self.cubed, bonds.owners())
        self._padding = None if bonds.lattice is None else bonds.lattice.padding
        self.tangential = model.normal * model.tangential_ratio
        self._share, self._spin = np.ones(count), np.zeros((count, 2))
        self.share = self._share[:n]
        self.inverse = np.zeros(n)
        self._refresh(np.arange(n, dtype=np.int32))

    def stored_by_bond(self) -> dict[str, int]:
        """See :meth:`Body.stored_by_bond`; on a lattice weights are there by offset too."""
        stored = super().stored_by_bond()
        return stored if self._by_offset is None else stored | {"weight by offset": self._by_offset.nbytes}

    @property
    def can_be_indefinite(self) -> bool:
        """True where the tangential stiffness is negative: at large Poisson's ratios."""
        return self.tangential < 0.0

    def _refresh(self, nodes: np.ndarray) -> None:
        """Bring what depends on the broken bonds of some nodes up to date."""
        b = self.bonds
        if self.model.condenses_rotation:
            mechanics.rotation_weight(nodes, b.offsets, b.neighbours, self._x, self.cubed, self.inverse)
        if self.tangential < 0.0:
            self.share[nodes] = np.maximum(0.0, 1.0 - self._phi[nodes] / TANGENTIAL_FADE)
            if b.images is not None:
                self._share[b.node_count :] = self.share[b.images.source]
        self._grid_share, self._grid_inverse = self.share, self.inverse
        if self._padding is not None:
            self._grid_share = self._padding.spread(self.share, self._share[b.node_count :])
            self._grid_inverse = self._padding.spread(self.inverse, 0.0)

    def _without(self, both: np.ndarray, nodes: np.ndarray) -> None:
        if self._by_offset is not None:
            owner = self.bonds.lattice.place(self.bonds.far(self.bonds.reverse[both]))
            self._by_offset[self.bonds.lattice.offset[both], owner] = 0.0
        self._refresh(nodes)

    def _rotate(self, u: np.ndarray) -> np.ndarray:
        b, n = self.bonds, self.bonds.node_count
        if b.lattice is not None:
            ux, uy = self._on_grid(u)
            theta, turning = self._lattice_rotation(ux, uy)
            if self._padding is None:
                self._spin[:, 0], self._spin[:, 1] = theta, turning
                return self._spin
            self._spin[:n, 0], self._spin[:n, 1] = self._padding.gather(theta), self._padding.gather(turning)
        else:
            moved = self._with_images(u)
            mechanics.node_rotation(
                b.offsets, b.neighbours, self._x, self.cubed, self.inverse, self._share, moved, self._spin
            )
        if b.images is not None:
            self._spin[n:] = b.images.turn[:, None] * self._spin[b.images.source]
        return self._spin

    def _on_grid(self, u: np.ndarray) -> list[np.ndarray]:
        """Either component of the displacements by place in the lattice."""
        if self._padding is None:
            return [np.ascontiguousarray(u[:, 0]), np.ascontiguousarray(u[:, 1])]
        images = self.bonds.images
        return [self._padding.spread(u[:, c], images.sign[:, c] * u[images.source, c]) for c in (0, 1)]

    def _lattice_rotation(self, ux: np.ndarray, uy: np.ndarray) -> np.ndarray:
        """Rotation by place in the lattice, and that times its share, both (p,)."""
        grid, spin = self.bonds.lattice, np.empty((2, ux.size))
        vectors = grid.step, grid.dx, grid.dy, self._by_offset
        lattice.node_rotation(*vectors, self._grid_inverse, self._grid_share, ux, uy, *spin)
        return spin

    def rotation(self, u: np.ndarray) -> np.ndarray:
        """Condensed rotation of each node, rad (n,)."""
        n = self.bonds.node_count
        return self._rotate(as_float(u, (n, 2)))[:n, 0].copy()

    def force(self, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Internal force on each node, N (n, 2): minus the derivative of the energy."""
        b, x, out = self.bonds, self._x, np.empty_like(u) if out is None else out
        if b.lattice is not None:
            return self._lattice_force(u, out)
        spin = self._rotate(u)
        mechanics.internal_force(
            b.offsets, b.neighbours, x, self.cubed, self._share, self.normal, self.tangential,
            self._with_images(u), spin, out,
        )  # fmt: skip
        return out

    def _lattice_force(self, u: np.ndarray, out: np.ndarray) -> np.ndarray:
        grid, padding = self.bonds.lattice, self._padding
        ux, uy = self._on_grid(u)
        turning = self._lattice_rotation(ux, uy)[1]
        if padding is not None:
            place, images = padding.place, self.bonds.images
            turning[place[images.nodes :]] = images.turn * turning[place[images.source]]
        fx, fy = np.empty((2, ux.size))
        vectors = grid.step, grid.dx, grid.dy, self._by_offset
        lattice.internal_force(*vectors, self._grid_share, self.normal, self.tangential, ux, uy, turning, fx, fy)
        out[:, 0], out[:, 1] = (fx, fy) if padding is None else (padding.gather(fx), padding.gather(fy))
        return out

    @property
    def columns(self) -> bool:
        """True on a lattice."""
        return self.bonds.lattice is not None

    def force_and_ratios(
        self, u: np.ndarray, load: BondLoad, weakness: np.ndarray, out: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`Body.force_and_ratios`: here in one go over the bonds."""
        b, images = self.bonds, self.bonds.images
        constants = self.normal, self.tangential
        if b.lattice is not None:
            return self._lattice_force_and_ratios(u, load, weakness, out)
        square, spin = np.empty(b.node_count), self._rotate(u)
        verlet.gather_force(
            b.offsets, b.neighbours, self._x, self.cubed, self._share, *constants, self._with_images(u), spin,
            load.by_energy, load.above, weakness if images is None else images.extend(weakness), out, square,
        )  # fmt: skip
        return square, spin[:, 0]

    def _lattice_force_and_ratios(
        self, u: np.ndarray, load: BondLoad, weakness: np.ndarray, out: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        grid, padding, images = self.bonds.lattice, self._padding, self.bonds.images
        ux, uy = self._on_grid(u)
        theta, parts = self._lattice_rotation(ux, uy)[0], None
        if padding is not None:
            theta[padding.place[images.nodes :]] = images.turn * theta[padding.place[images.source]]
            parts, weakness = theta[padding.place], padding.spread(weakness, weakness[images.source])
        split = out if out.flags.f_contiguous and padding is None else np.empty((ux.size, 2), order="F")
        square = np.empty(ux.size)
        verlet.lattice_force(
            grid.step, grid.dx, grid.dy, self._by_offset, self._grid_share, self.normal, self.tangential, ux, uy, theta,
            load.by_energy, load.above, weakness, split[:, 0], split[:, 1], square,
        )  # fmt: skip
        if padding is not None:
            out[:, 0], out[:, 1] = padding.gather(split[:, 0]), padding.gather(split[:, 1])
            return padding.gather(square), parts
        if split is not out:
            out[:] = split
        return square, theta

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy of each node, J (n,): half of that of its bonds (theory, eq. 2.1)."""
        b, x, out = self.bonds, self._x, np.empty(self.bonds.node_count)
        spin = self._rotate(u)
        mechanics.elastic_energy(
            b.offsets, b.neighbours, x, self.cubed, self._share, self.normal, self.tangential,
            self._with_images(u), spin, out,
        )  # fmt: skip
        return out

    def diagonal(self) -> np.ndarray:
        """Diagonal of the stiffness with the rotations held, N/m (n, 2): an upper bound of the true diagonal."""
        b, out = self.bonds, np.empty((self.bonds.node_count, 2))
        tangential = max(self.tangential, 0.0)
        mechanics.stiffness_diagonal(b.offsets, b.neighbours, self._x, self.cubed, self.normal, tangential, out)
        if b.images is not None:
            # A node that moves against its own image stretches their bond from both ends.
            bond = np.flatnonzero(b.reverse == np.arange(b.reverse.size))
            node, image = b.far(bond), b.neighbours[bond]
            square = (self._x[image] - self._x[node]) ** 2
            against = b.images.sign[image - b.node_count] < 0.0
            more = self.cubed[bond, None] * (self.normal * square + tangential * square[:, ::-1]) * against
            np.add.at(out, node, more)
        return out

    def bond_loads(self, u: np.ndarray, load: BondLoad) -> np.ndarray:
        """Load of every directed bond, broken ones included, (b,): see :func:`pdhe.kernels.mechanics.bond_load`."""
        b, x, out = self.bonds, self._x, np.empty(self.bonds.length.size)
        spin = self._rotate(u)
        mechanics.bond_load(
            b.offsets, b.neighbours, x, self._share, self.normal, self.tangential, load.by_energy, load.above,
            self._with_images(u), spin, out,
        )  # fmt: skip
        return out

    def largest_ratios(
        self, u: np.ndarray, load: BondLoad, breakable: np.ndarray, resistance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As for any body, without writing anything per bond."""
        b, top = self.bonds, np.empty(self.bonds.node_count)
        spin = self._rotate(u)
        mechanics.largest_ratio(
            b.offsets, b.neighbours, self._x, self._share, self.normal, self.tangential, load.by_energy, load.above,
            self._with_images(u), spin, breakable, resistance if b.images is None else b.images.extend(resistance), top,
        )  # fmt: skip
        return top, spin[:, 0].copy()

    def node_parts(self, u: np.ndarray) -> np.ndarray:
        """Rotation of each node, rad (n,), and behind them those of images."""
        return self._rotate(u)[:, 0].copy()

    def bond_parts(
        self, u: np.ndarray, bond: np.ndarray, owner: np.ndarray, nodes: np.ndarray | None = None
    ) -> np.ndarray:
        """Stretch and both tangential strains of some directed bonds, (3, k)."""
        b, theta = self.bonds, self._rotate(u)[:, 0] if nodes is None else nodes
        other, u = b.neighbours[bond], self._with_images(u)
        relative = u[other] - u[owner]
        stretch = (b.nx[bond] * relative[:, 0] + b.ny[bond] * relative[:, 1]) / b.length[bond]
        angle = (b.nx[bond] * relative[:, 1] - b.ny[bond] * relative[:, 0]) / b.length[bond]
        return np.stack([stretch, angle - theta[owner], angle - theta[other]])

    def measure(self, bond: np.ndarray, owner: np.ndarray) -> Measure:
        """Energy of some directed bonds, shear included (theory, eq. 2.1)."""
        b, ratio = self.bonds, self.tangential / self.normal
        share_i, share_j = self.share[owner], self._share[b.neighbours[bond]]

        def square(parts: np.ndarray) -> np.ndarray:
            stretch, angle_i, angle_j = parts
            return stretch**2 + ratio * 0.5 * (share_i * angle_i**2 + share_j * angle_j**2)

        stiffness = self.normal * b.weight[bond] * b.length[bond]
        return Measure(stiffness if self.relative is None else stiffness * self.relative[bond], square)

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
    solid_body = SolidBondBody
    condenses_rotation: ClassVar[bool] = True

    @property
    def tangential_ratio(self) -> float:
        """Tangential over normal micromodulus (theory, eq. 2.3).

        Negative above a Poisson's ratio of 1/3 in plane stress, of 1/4 in plane strain and in space.
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
