"""Bodies whose nodes follow a compiled user material: correspondence with any stress and its history."""

from __future__ import annotations

from typing import Any

import numpy as np

from pdhe.bonds import Bonds
from pdhe.errors import PdheError
from pdhe.kernels import correspondence as kernels
from pdhe.kernels import correspondence3d as solid_kernels
from pdhe.kernels.jit import as_float
from pdhe.materials.correspondence import Correspondence, CorrespondenceBody
from pdhe.materials.solid_correspondence import SolidCorrespondenceBody
from pdhe.materials.umat import UserMaterial, UserPoints

#: Where the strains xx, yy, zz, yz, xz, xy of a body in space stand in the order of Abaqus.
_SOLID_ORDER = np.array([0, 1, 2, 5, 4, 3])


class History:
    """What bodies of user materials share: the points, and what is told of them.

    Forces depend on the displacements in any way, and on the history that :attr:`points` holds.

    Attributes
    ----------
    points
        The nodes with their history.
    increment
        Length of the increment that forces are asked for, s.
    """

    points: UserPoints
    increment: float = 1.0

    def _begin(self, material: UserMaterial, sizes: np.ndarray) -> None:
        body: Any = self
        if material.plane != body.model.plane:
            raise PdheError(
                f"user material {material.name}: plane {material.plane} in a body of plane {body.model.plane}"
            )
        self.points = UserPoints(material, body.coordinates, sizes)

    def _stress(self, gradient: np.ndarray) -> np.ndarray:
        return self.points.trial(gradient, self.increment)

    def dissipation(self) -> np.ndarray:
        """Plastic and creep dissipation of each node up to the last committed step, J (n, 2): SPD and SCD."""
        body: Any = self
        return (body.share * body.volume)[:, None] * self.points.energy[:, 1:]

    def _tangents(self, order: np.ndarray) -> np.ndarray:
        """Upper triangles of the symmetric parts of DDSDDE at the last trial, for some components, Pa (n, k)."""
        tangent = self.points.tangent[:, order][:, :, order]
        tangent = 0.5 * (tangent + tangent.swapaxes(1, 2))
        rows, columns = np.triu_indices(len(order))
        return as_float(tangent[:, rows, columns])


class UserBody(History, CorrespondenceBody):
    """Correspondence (theory, eqs. 2.14 to 2.19) with the stress of a user material at every node of a plate.

    Parameters
    ----------
    bonds, model, coordinates, volume
        As for :class:`CorrespondenceBody`; the model's elastic constants resist zero-energy modes and no more.
    material
        Its ``plane`` is that of the model.
    """

    def __init__(
        self, bonds: Bonds, model: Correspondence, coordinates: np.ndarray, volume: np.ndarray, material: UserMaterial
    ) -> None:
        super().__init__(bonds, model, coordinates, volume)
        self._begin(material, np.sqrt(volume / model.thickness))

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy of each node at the last committed step, J (n,): SSE, and that of what is not affine."""
        b, u, out = self.bonds, as_float(u), np.empty(self.bonds.node_count)
        gradient = self._gradient(u)
        kernels.elastic_energy(
            b.offsets, b.neighbours, self._x, self.cubed, self.volume, self.share, self.control, gradient,
            np.zeros_like(gradient), self._with_images(u), out,
        )  # fmt: skip
        return out + self.share * self.volume * self.points.energy[:, 0]

    def tangent(self) -> CorrespondenceBody:
        """Return the linear body of small changes about the last trial: DDSDDE, its symmetric part, at every node."""
        return _Tangent(self)


class SolidUserBody(History, SolidCorrespondenceBody):
    """The same in space; parameters as for :class:`UserBody`."""

    def __init__(
        self, bonds: Bonds, model: Correspondence, coordinates: np.ndarray, volume: np.ndarray, material: UserMaterial
    ) -> None:
        super().__init__(bonds, model, coordinates, volume)
        self._begin(material, np.cbrt(volume))

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy of each node at the last committed step, J (n,): SSE, and that of what is not affine."""
        u, out = as_float(u, self.coordinates.shape), np.empty(self.bonds.node_count)
        gradient = self._gradient(u)
        solid_kernels.elastic_energy(
            *self._bonded, self.volume, self.share, self.control, gradient, np.zeros_like(gradient), u, out
        )
        return out + self.share * self.volume * self.points.energy[:, 0]

    def tangent(self) -> SolidCorrespondenceBody:
        """Return the linear body of small changes about the last trial: DDSDDE, its symmetric part, at every node."""
        return _SolidTangent(self)


class _Tangent(CorrespondenceBody):
    """A body in all but its stress, which is linear."""

    def __init__(self, body: UserBody) -> None:
        self.__dict__.update(body.__dict__)
        # The strain across the plate is zero, or eliminated.
        four = body.points.material.components == 4
        self.stiffness = body._tangents(np.array([0, 1, 3] if four else [0, 1, 2]))


class _SolidTangent(SolidCorrespondenceBody):
    """The same in space."""

    def __init__(self, body: SolidUserBody) -> None:
        self.__dict__.update(body.__dict__)
        self.stiffness = body._tangents(_SOLID_ORDER)
