"""A body whose nodes follow a compiled user material: correspondence with any stress and its history."""

from __future__ import annotations

import numpy as np

from pdhe.bonds import Bonds
from pdhe.errors import PdheError
from pdhe.kernels import correspondence as kernels
from pdhe.kernels.jit import as_float
from pdhe.materials.correspondence import Correspondence, CorrespondenceBody
from pdhe.materials.umat import UserMaterial, UserPoints


class UserBody(CorrespondenceBody):
    """Correspondence (theory, eqs. 2.14 to 2.19) with the stress of a user material at every node.

    Forces depend on the displacements in any way, and on the history that :attr:`points` holds.

    Parameters
    ----------
    bonds, model, coordinates, volume
        As for :class:`CorrespondenceBody`; the model's elastic constants resist zero-energy modes and no more.
    material
        Its ``plane`` is that of the model.

    Attributes
    ----------
    points
        The nodes with their history.
    """

    def __init__(
        self, bonds: Bonds, model: Correspondence, coordinates: np.ndarray, volume: np.ndarray, material: UserMaterial
    ) -> None:
        super().__init__(bonds, model, coordinates, volume)
        if material.plane != model.plane:
            raise PdheError(f"user material {material.name}: plane {material.plane} in a body of plane {model.plane}")
        self.points = UserPoints(material, self.coordinates, np.sqrt(volume / model.thickness))
        #: Length of the increment that forces are asked for, s.
        self.increment = 1.0

    def _stress(self, gradient: np.ndarray) -> np.ndarray:
        return self.points.trial(gradient, self.increment)

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy of each node at the last committed step, J (n,): SSE, and that of what is not affine."""
        b, u, out = self.bonds, as_float(u), np.empty(self.bonds.node_count)
        gradient = self._gradient(u)
        kernels.elastic_energy(
            b.offsets, b.neighbours, self._x, self.cubed, self.volume, self.share, self.control, gradient,
            np.zeros_like(gradient), self._with_images(u), out,
        )  # fmt: skip
        return out + self.share * self.volume * self.points.energy[:, 0]

    def dissipation(self) -> np.ndarray:
        """Plastic and creep dissipation of each node up to the last committed step, J (n, 2): SPD and SCD."""
        return (self.share * self.volume)[:, None] * self.points.energy[:, 1:]

    def tangent(self) -> CorrespondenceBody:
        """Return the linear body of small changes about the last trial: DDSDDE, its symmetric part, at every node."""
        return _Tangent(self)


class _Tangent(CorrespondenceBody):
    """A body in all but its stress, which is linear."""

    def __init__(self, body: UserBody) -> None:
        self.__dict__.update(body.__dict__)
        # The strain across the plate is zero, or eliminated.
        inside = [0, 1, 3] if body.points.material.components == 4 else [0, 1, 2]
        tangent = body.points.tangent[:, inside][:, :, inside]
        tangent = 0.5 * (tangent + tangent.swapaxes(1, 2))
        rows, columns = np.triu_indices(3)
        self.stiffness = as_float(tangent[:, rows, columns])
