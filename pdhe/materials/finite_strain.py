"""Correspondence at large strains and rotations, for any stress that follows from the gradient (theory, section 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pdhe.bonds import Bonds
from pdhe.errors import PdheError
from pdhe.kernels import correspondence, correspondence3d
from pdhe.kernels import finite_strain as kernels
from pdhe.kernels.jit import as_float
from pdhe.materials.body import Body, Measure, Model
from pdhe.materials.correspondence import CorrespondenceBody
from pdhe.materials.solid_correspondence import SolidCorrespondenceBody


@dataclass(frozen=True)
class StressLaw:
    """A stress function and its properties.

    Attributes
    ----------
    function
        What has an ``address``: from :func:`pdhe.kernels.finite_strain.compiled`, or of any C function of five arrays
        of doubles, properties, displacement gradient (d d), energy per volume, J/m^3, first Piola-Kirchhoff stress, Pa
        (d d), and its derivative by the gradient, Pa (d d, d d); it writes the last three. Tensors are laid out row by
        row. It must be fit for several threads; the stress is the derivative of the energy.
    properties
        Of all nodes (1, p), or of each (n, p).
    """

    function: Any
    properties: np.ndarray


def saint_venant_kirchhoff(body: CorrespondenceBody | SolidCorrespondenceBody) -> StressLaw:
    """Stress linear in the Green-Lagrange strain, with the constants that a body has at small strains."""
    if body.coordinates.shape[1] == 2:
        return StressLaw(kernels.compiled(kernels.saint_venant_kirchhoff), body.stiffness)
    if body.stiffness is not None:
        return StressLaw(kernels.compiled(kernels.saint_venant_kirchhoff_any), body.stiffness)
    properties = as_float([[body.lame, body.shear]])
    return StressLaw(kernels.compiled(kernels.saint_venant_kirchhoff_solid), properties)


class Pose:
    """A body in one position: its stresses, energies and forces, and how forces change from there.

    It stands for the body where a preconditioner wants one: bonds lie as they do in this position.

    Attributes
    ----------
    body, u
        The body, and its displacements, m (n, dim).
    gradient, stress, tangent
        Displacement gradients (n, d d), first Piola-Kirchhoff stresses, Pa (n, d d), and their derivatives, Pa
        (n, d d d d).
    density
        Energy of the stress law per volume, J/m^3 (n,).
    """

    def __init__(self, body: FiniteStrain, u: np.ndarray) -> None:
        n, size = body.bonds.node_count, body.coordinates.shape[1] ** 2
        self.body, self.u, self.bonds = body, u, body.bonds
        self._u = np.array(body._with_images(u))
        self.gradient = body._gradient(u)
        self.density, self.stress = np.empty(n), np.empty((n, size))
        self.tangent = np.empty((n, size * size))
        law = body.law
        kernels.respond(law.function.address, law.properties, self.gradient, self.density, self.stress, self.tangent)
        self._moment = self._carried = np.empty((0, 0))
        self._own = body.control[:n]
        if body.turns:
            self._moment, self._carried = np.empty((n, size)), np.empty((n, size))
            self._own = np.empty_like(self._own)
            body._moment(*body._bonded, self.gradient, self._u, self._u, self._moment)
            kernels.turned(body.place, body.control, self.gradient, self._carried, self._own)
        #: What resists zero-energy modes in this position, N/m^6, images behind nodes.
        self.present = body._beyond(self._own, body.control_turns)
        self._scratch = np.empty((n, size))

    def force(self, out: np.ndarray | None = None) -> np.ndarray:
        """Internal force on each node, N (n, dim): minus the derivative of the energy (theory, eq. 2.29)."""
        body, out = self.body, np.empty_like(self.u) if out is None else out
        state = np.empty_like(self.gradient)
        kernels.node_state(
            body.place, body.volume, body.share, body.inverse, self._own, self.gradient, self.stress, self._moment,
            self._carried, self._scratch, state,
        )  # fmt: skip
        body._kernels.internal_force(*body._bonded, self.present, body._beyond(state, body.state_turns), self._u, out)
        return out

    def energy(self) -> np.ndarray:
        """Elastic energy of each node, J (n,) (theory, eq. 2.27)."""
        body, out = self.body, np.empty(self.bonds.node_count)
        body._kernels.elastic_energy(
            *body._bonded, body.volume, body.share, self._own, self.gradient, np.zeros_like(self.gradient), self._u, out
        )
        return out + body.share * body.volume * self.density

    def change(self, v: np.ndarray) -> np.ndarray:
        """Derivative of the internal forces along displacements ``v``, m (n, dim): minus stiffness times ``v``, N."""
        body, out, n = self.body, np.empty_like(v), self.bonds.node_count
        change, v = body._gradient(v), np.array(body._with_images(v))
        cross = turning = np.empty((0, 0))
        if body.turns:
            cross, turning = np.empty_like(change), np.empty_like(self._own)
            body._moment(*body._bonded, self.gradient, self._u, v, cross)
        state, step = np.empty_like(change), np.empty_like(change)
        kernels.state_change(
            body.place, body.volume, body.share, body.inverse, body.control[:n], self._own, self.gradient, self.tangent,
            self._moment, self._carried, change, cross, step, self._scratch, turning, state,
        )  # fmt: skip
        state = body._beyond(state, body.state_turns)
        if body.turns:
            turning = body._beyond(turning, body.control_turns)
            body._change(*body._bonded, self.present, turning, state, self._u, v, out)
        else:
            body._kernels.internal_force(*body._bonded, self.present, state, v, out)
        return out

    def stretched_out(self) -> np.ndarray:
        """Ratio of the present area or volume to that at rest, (n,): what is not positive is turned inside out."""
        d = self.u.shape[1]
        return np.linalg.det(np.eye(d) + self.gradient.reshape(-1, d, d))

    def diagonal(self) -> np.ndarray:
        """Diagonal of the stiffness with all gradients held, N/m (n, dim): what short waves feel."""
        out = np.empty_like(self.u)
        self.body._kernels.control_diagonal(*self.body._bonded, self.present, out)
        return out

    def short_stiffness(self, reach: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stiffness of short bonds alone, as they lie in this position: as for :class:`Body`."""
        body, at_rest = self.body, self.body._x
        try:
            body._x = at_rest + self._u
            return body.short_stiffness(reach, free)
        finally:
            body._x = at_rest


class FiniteStrain:
    """What bodies in the plane and in space share: forces of any size of strain, by their :class:`Pose`.

    Energies and forces do not change when everything turns. What resists zero-energy modes by Wan et al. turns and
    stretches with its node, that of Silling is the same in all directions anyway.

    Attributes
    ----------
    law
        The stress of a node as a function of its gradient.
    bonds_have_loads
        Whether it is the law of Saint Venant and Kirchhoff, for which energies of bonds are known.
    """

    law: StressLaw
    bonds_have_loads: bool
    place: np.ndarray
    control_turns: tuple[bool, ...]
    state_turns: tuple[bool, ...]

    @property
    def turns(self) -> bool:
        """Whether what resists zero-energy modes differs by direction and so has to turn."""
        return self.model.zero_energy != "silling"

    def at(self, u: np.ndarray) -> Pose:
        """Return the body in the position of displacements, m (n, dim)."""
        return Pose(self, as_float(u, self.coordinates.shape))

    def force(self, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Internal force on each node, N (n, dim): minus the derivative of the energy (theory, eq. 2.29)."""
        return self.at(u).force(out)

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy of each node, J (n,) (theory, eq. 2.27)."""
        return self.at(u).energy()

    def stress(self, u: np.ndarray) -> np.ndarray:
        """First Piola-Kirchhoff stress of each node, force over area at rest, Pa (n, dim, dim)."""
        d = self.coordinates.shape[1]
        return self.at(u).stress.reshape(-1, d, d)

    def cauchy(self, u: np.ndarray) -> np.ndarray:
        """Stress of each node, force over present area, Pa (n, dim, dim), for Saint Venant-Kirchhoff's law."""
        gradient = self.deformation_gradient(u)
        volume = np.linalg.det(gradient) * self.thickness_stretch(u)
        return self.stress(u) @ gradient.swapaxes(1, 2) / volume[:, None, None]

    def thickness_stretch(self, u: np.ndarray) -> np.ndarray:
        """Present thickness over that at rest, (n,): in space, the gradient has it."""
        return np.ones(self.bonds.node_count)

    def deformation_gradient(self, u: np.ndarray) -> np.ndarray:
        """Deformation gradient of each node, (n, dim, dim)."""
        return np.eye(self.coordinates.shape[1]) + self.displacement_gradient(u)

    def strain(self, u: np.ndarray) -> np.ndarray:
        """Green-Lagrange strain of each node, (n, dim, dim)."""
        h = self.displacement_gradient(u)
        return 0.5 * (h + h.swapaxes(1, 2) + h.swapaxes(1, 2) @ h)

    def node_parts(self, u: np.ndarray) -> np.ndarray:
        """Displacement gradient of each node, and images behind them, and ``g S K^-1``, N/m^6 (n, 2 d d).

        Raises
        ------
        PdheError
            With another law than Saint Venant-Kirchhoff's, under which energy and strain belong together otherwise.
        """
        if not self.bonds_have_loads:
            raise PdheError("loads of bonds are known for the stress of Saint Venant and Kirchhoff alone")
        pose = self.at(u)
        n, d = u.shape
        gradient, stress = (array.reshape(n, d, d) for array in (pose.gradient, pose.stress))
        second = np.linalg.solve(np.eye(d) + gradient, stress)
        state = self.share[:, None, None] * (second @ self.inverse[:, self.place])
        return self._beyond(np.hstack([pose.gradient, state.reshape(n, d * d)]), 2 * self.state_turns)

    def bond_parts(
        self, u: np.ndarray, bond: np.ndarray, owner: np.ndarray, nodes: np.ndarray | None = None
    ) -> np.ndarray:
        """Stretch of some directed bonds, and twice the energy that either end gives them, N/m^6 (3, k).

        The stretch is the change of the length over the length, the energy that of theory, eq. 2.31, over the weight
        and the length.
        """
        nodes, other, d = self.node_parts(u) if nodes is None else nodes, self.bonds.neighbours[bond], u.shape[1]
        length, u = self.bonds.length[bond][:, None], self._with_images(u)
        direction, relative = (self._x[other] - self._x[owner]) / length, (u[other] - u[owner]) / length
        grown = np.einsum("ka,ka->k", 2.0 * direction + relative, relative)  # of the length squared
        parts = [grown / (1.0 + np.sqrt(1.0 + grown))]
        for end in (owner, other):
            gradient, state = (part.reshape(-1, d, d) for part in np.split(nodes[end], 2, axis=1))
            control = self.control[end][:, self.place]
            affine = np.einsum("kab,kb->ka", gradient, direction)
            rest = relative - affine
            # Of the deformed bond, pulled back into the directions at rest.
            strain = 0.5 * (affine + np.einsum("kba,kb->ka", gradient, direction + affine))
            back = rest + np.einsum("kba,kb->ka", gradient, rest)
            resisted = back if self.turns else rest
            parts.append(
                np.einsum("kab,kb,ka->k", state, direction, strain + back)
                + np.einsum("kab,kb,ka->k", control, back, strain)
                + np.einsum("kab,kb,ka->k", control, resisted, resisted)
            )
        return np.stack(parts)

    def measure(self, bond: np.ndarray, owner: np.ndarray) -> Measure:
        """Energy of some bonds as both ends see it: of all bonds together, that of the body (theory, eq. 2.31)."""
        normal = self.normal

        def square(parts: np.ndarray) -> np.ndarray:
            return (parts[1] + parts[2]) / normal

        return Measure(normal * self.bonds.weight[bond] * self.bonds.length[bond], square)

    largest_ratios = Body.largest_ratios


class FiniteStrainBody(FiniteStrain, CorrespondenceBody):
    """Nodes in the plane with a deformation gradient and a first Piola-Kirchhoff stress (theory, eqs. 2.26 to 2.30).

    Parameters
    ----------
    bonds, model, coordinates, volume, precision
        As for :class:`CorrespondenceBody`.
    law
        Saint Venant-Kirchhoff's when None.
    """

    place = np.array([[0, 1], [1, 2]])
    control_turns = (False, True, False)
    state_turns = (False, True, True, False)
    _kernels, _moment, _change = correspondence, staticmethod(kernels.moment), staticmethod(kernels.force_change)

    def __init__(
        self,
        bonds: Bonds,
        model: Model,
        coordinates: np.ndarray,
        volume: np.ndarray,
        precision: type = np.float64,
        law: StressLaw | None = None,
    ) -> None:
        super().__init__(bonds, model, coordinates, volume, precision)
        self.law, self.bonds_have_loads = law or saint_venant_kirchhoff(self), law is None

    @property
    def _bonded(self) -> tuple[np.ndarray, ...]:
        return self.bonds.offsets, self.bonds.neighbours, self._x, self.cubed

    def thickness_stretch(self, u: np.ndarray) -> np.ndarray:
        """Present thickness over that at rest, (n,), for Saint Venant-Kirchhoff's law (theory, eq. 2.26).

        Raises
        ------
        PdheError
            For an orthotropic material in plane stress, whose constants across the plate are not known.
        """
        if self.model.plane == "strain":
            return np.ones(self.bonds.node_count)
        if self.model.orthotropic is not None:
            raise PdheError("the thickness of a stretched plate is known for isotropic materials alone")
        nu, strain = self.model.poissons_ratio, self.strain(u)
        return np.sqrt(1.0 - 2.0 * nu / (1.0 - nu) * (strain[:, 0, 0] + strain[:, 1, 1]))


class FiniteStrainSolidBody(FiniteStrain, SolidCorrespondenceBody):
    """Nodes in space with a deformation gradient and a first Piola-Kirchhoff stress (theory, eqs. 2.26 to 2.30).

    Parameters
    ----------
    bonds, model, coordinates, volume, precision
        As for :class:`SolidCorrespondenceBody`.
    law
        Saint Venant-Kirchhoff's when None.
    """

    place = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
    control_turns = state_turns = ()
    _kernels, _moment, _change = (
        correspondence3d, staticmethod(kernels.moment_solid), staticmethod(kernels.force_change_solid),
    )  # fmt: skip

    def __init__(
        self,
        bonds: Bonds,
        model: Model,
        coordinates: np.ndarray,
        volume: np.ndarray,
        precision: type = np.float64,
        law: StressLaw | None = None,
    ) -> None:
        super().__init__(bonds, model, coordinates, volume, precision)
        self.law, self.bonds_have_loads = law or saint_venant_kirchhoff(self), law is None

    def _beyond(self, values: np.ndarray, turn: tuple[bool, ...]) -> np.ndarray:
        """Node values as they are: there are no images in space."""
        return values
