"""The linear peridynamic solid: bonds that also feel the dilatation at their two ends (theory, eqs. 2.9 to 2.13)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdhe.bonds import Bonds
from pdhe.kernels import mechanics, mechanics3d, state_based
from pdhe.kernels.jit import as_float
from pdhe.materials import constants
from pdhe.materials.body import Body, BondLoad, Measure, Model


class StateBasedBody(Body):
    """Bonds whose forces depend on their own stretch and on the dilatation of their two ends.

    The weighted volumes are those of the body before it was cracked: they normalise the sums over a family, and a
    family that loses bonds gets softer by what it loses. With weighted volumes of the bonds that are left, the last
    bond of a node would be as stiff as its whole family was.
    """

    sees_images = True

    def __init__(
        self,
        bonds: Bonds,
        model: StateBased,
        coordinates: np.ndarray,
        volume: np.ndarray,
        precision: type = np.float64,
    ) -> None:
        super().__init__(bonds, model, coordinates, volume, precision)
        bulk, shear, size = model.bulk, model.shear, model.dimensions
        #: Coefficients of theory, eqs. 2.11 and 2.12, Pa.
        self.along = size * (size + 2.0) * shear
        self.swell = size * bulk - (size + 2.0) * shear
        weighted = bonds.sum_by_node(bonds.weight * bonds.length)
        some = weighted > 0.0
        #: One over the weighted volume, 1/m^4; behind those of the nodes, those of images.
        self.spread = self._beyond(np.where(some, volume, 0.0) / np.where(some, weighted, 1.0))

    def _beyond(self, values: np.ndarray) -> np.ndarray:
        """Node values that are the same at images, with theirs behind them."""
        return values if self.bonds.images is None else self.bonds.images.extend(values)

    def dilatation(self, u: np.ndarray) -> np.ndarray:
        """Dilatation of each node, (n,): in a plate that of its plane (theory, eq. 2.10)."""
        b, theta = self.bonds, np.empty(self.bonds.node_count)
        state_based.dilatation(
            b.offsets, b.neighbours, self._x, self.cubed, self.volume, self.spread,
            self._with_images(as_float(u)), theta,
        )  # fmt: skip
        theta *= self.model.dimensions
        return theta

    def force(self, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Internal force on each node, N (n, dim): minus the derivative of the energy (theory, eq. 2.12)."""
        b, out = self.bonds, np.empty_like(u) if out is None else out
        state_based.internal_force(
            b.offsets, b.neighbours, self._x, self.cubed, self.spread, self.swell * self.node_parts(u), self.along,
            self._with_images(u), out,
        )  # fmt: skip
        return out

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy of each node, J (n,) (theory, eq. 2.11)."""
        b, out = self.bonds, np.empty(self.bonds.node_count)
        volumetric = self.swell / self.model.dimensions
        state_based.elastic_energy(
            b.offsets, b.neighbours, self._x, self.cubed, self.volume, self.spread, self.dilatation(u),
            volumetric, self.along, self._with_images(as_float(u)), out,
        )  # fmt: skip
        return out

    def diagonal(self) -> np.ndarray:
        """Diagonal of the stiffness of bonds with the same energy in an isotropic extension, N/m (n, dim)."""
        b, out = self.bonds, np.empty_like(self.coordinates)
        kernels = mechanics if b.dimension == 2 else mechanics3d
        kernels.stiffness_diagonal(b.offsets, b.neighbours, self._x, self.cubed, self.normal, 0.0, out)
        return out

    def stiffness_rows(self) -> np.ndarray:
        """Gershgorin's bound for bonds that have at least the energy of this body, N/m (n, dim).

        The square of the dilatation is at most ``dim^2`` times the weighted mean of the squares of the stretches.
        """
        b, out = self.bonds, np.empty_like(self.coordinates)
        bound = max(self.along, self.along + self.swell * self.model.dimensions)
        state_based.stiffness_rows(b.offsets, b.neighbours, self._x, self.cubed, self.spread, bound, out)
        return out

    def node_parts(self, u: np.ndarray) -> np.ndarray:
        """Dilatation of each node, and of images behind them, over the weighted volume, 1/m^4 (n,)."""
        return self.spread * self._beyond(self.dilatation(u))

    def bond_parts(
        self, u: np.ndarray, bond: np.ndarray, owner: np.ndarray, nodes: np.ndarray | None = None
    ) -> np.ndarray:
        """Stretch of some directed bonds, and the dilatational and deviatoric part of their force, (3, k).

        Forces are over the weight, in N/m^6 (theory, eq. 5.15).
        """
        swollen, other = self.node_parts(u) if nodes is None else nodes, self.bonds.neighbours[bond]
        vector, u = self._x[other] - self._x[owner], self._with_images(u)
        stretch = np.sum(vector * (u[other] - u[owner]), axis=1) / self.bonds.length[bond] ** 2
        swollen, spread = swollen[owner] + swollen[other], self.spread[owner] + self.spread[other]
        isotropic = self.along / self.model.dimensions
        return np.stack(
            [stretch, (self.swell + isotropic) * swollen, self.along * spread * stretch - isotropic * swollen]
        )

    def measure(self, bond: np.ndarray, owner: np.ndarray) -> Measure:
        """Half the work of the force of a bond on its elongation (theory, eq. 2.13)."""
        normal = self.normal

        def split(parts: np.ndarray) -> np.ndarray:
            return parts[0] * parts[1:] / normal

        def square(parts: np.ndarray) -> np.ndarray:
            return parts[0] * (parts[1] + parts[2]) / normal

        return Measure(normal * self.bonds.weight[bond] * self.bonds.length[bond], square, split)

    def force_and_ratios(
        self, u: np.ndarray, load: BondLoad, weakness: np.ndarray, out: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`Body.force_and_ratios`: here in one go over the bonds."""
        b, square, nodes = self.bonds, np.empty(self.bonds.node_count), self.node_parts(u)
        swell, along = self._counted(load)
        state_based.force_and_ratio(
            b.offsets, b.neighbours, self._x, self.cubed, self.spread, self.swell * nodes, self.along, swell * nodes,
            along, self.normal, load.by_energy, load.above, self._beyond(weakness), self._with_images(u), out, square,
        )  # fmt: skip
        return square, nodes

    def _counted(self, load: BondLoad) -> tuple[float, float]:
        """Factors of the dilatation and of the stretch in the forces that a load counts with, Pa."""
        if load.split is None:
            return self.swell, self.along
        isotropic = self.along / self.model.dimensions
        swollen, sheared = load.split
        return swollen * (self.swell + isotropic) - sheared * isotropic, sheared * self.along

    def largest_ratios(
        self, u: np.ndarray, load: BondLoad, breakable: np.ndarray, resistance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As for any body, without writing anything per bond."""
        b, top, nodes = self.bonds, np.empty(self.bonds.node_count), self.node_parts(u)
        swell, along = self._counted(load)
        state_based.largest_ratio(
            b.offsets, b.neighbours, self._x, self.spread, swell * nodes, along, self.normal, load.by_energy,
            load.above, self._with_images(u), breakable, self._beyond(resistance), top,
        )  # fmt: skip
        return top, nodes


@dataclass(frozen=True)
class StateBased(Model):
    """Ordinary state-based linear elasticity for any Poisson's ratio (Silling et al. 2007), about the reference.

    In a plate, dilatation and deviator are those of its plane; with the moduli of the plane this has the energies of
    plane stress and plane strain that Le, Chan and Schwartz (2014) arrive at with the dilatation in space.
    """

    body = StateBasedBody
    solid_body = StateBasedBody

    @property
    def dimensions(self) -> int:
        """Number of directions in which families extend."""
        return 3 if self.plane is None else 2

    @property
    def bulk(self) -> float:
        """Isotropic stress over the trace of an isotropic strain, Pa."""
        return constants.bulk_modulus(self.youngs_modulus, self.poissons_ratio, self.plane)

    @property
    def shear(self) -> float:
        """Shear modulus, Pa."""
        return constants.shear_modulus(self.youngs_modulus, self.poissons_ratio)
