"""Correspondence in space: nine components of the gradient, six of the shape tensor (theory, eqs. 2.14 to 2.21)."""

from __future__ import annotations

import numpy as np

from pdhe.bonds import Bonds
from pdhe.kernels import correspondence3d as kernels
from pdhe.kernels.jit import as_float
from pdhe.materials import constants
from pdhe.materials.body import Body, BondLoad, Measure, Model

#: Least over largest principal value of a shape tensor below which a family has no gradient: it counts as a row, or in
#: space as a layer. In the plane, half discs have 1 and quarter discs 0.2; two bonds at an angle of 11 degrees have
#: 0.01. In space, half balls have 1, quarter balls 0.22 and eighths 0.16.
ROW = 0.01
#: Share of the least principal value that the shape tensor had before anything was cut, below which the stress of a
#: node fades out: bonds along and beside a straight crack leave a half.
CARRIES_ALL = 0.25
_MATRIX = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])


def silling_control(model: Model, stiffness: np.ndarray | None, inverse: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Zero-energy control by Silling (2017): the same resistance in all directions (theory, eq. 2.19)."""
    return _entries(np.full_like(inverse, 0.5 * model.normal), vectors)


def wan_control(model: Model, stiffness: np.ndarray | None, inverse: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Zero-energy control by Wan et al. (2019): the stiffness on the inverse shape tensor (theory, eq. 2.18).

    What would be negative, in auxetic materials at nodes with few bonds, is left out.
    """
    if stiffness is None:
        lame, shear = _lame(model)
        return _entries(np.maximum(lame * inverse.sum(axis=1, keepdims=True) + 2.0 * shear * inverse, 0.0), vectors)
    doubled = _entries(inverse, vectors) * np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    found = np.einsum("nab,nb->na", np.broadcast_to(_whole(stiffness), (len(inverse), 6, 6)), doubled)
    values, own = np.linalg.eigh(found[:, _MATRIX])
    return _entries(np.maximum(values, 0.0), own)


def _entries(principal: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Entries xx, yy, zz, yz, xz, xy of tensors (k, 6) with some principal values (k, 3) along axes (k, 3, 3)."""
    return np.einsum("nij,nj,nkj->nik", vectors, principal, vectors)[:, constants.ROWS, constants.COLUMNS]


def _whole(stiffness: np.ndarray) -> np.ndarray:
    """Matrices (k, 6, 6) of their upper triangles (k, 21)."""
    found = np.empty((len(stiffness), 6, 6))
    rows, columns = np.triu_indices(6)
    found[:, rows, columns] = found[:, columns, rows] = stiffness
    return found


#: Zero-energy controls by the name that scenes use: tensors N/m^6 (k, 6), given the stiffness of materials that are not
#: isotropic, Pa (1, 21) or (k, 21), and the principal values, 1/m^4 (k, 3), and axes of the inverse shape tensor times
#: the volume.
CONTROLS = {"wan": wan_control, "silling": silling_control}


def _lame(model: Model) -> tuple[float, float]:
    """Both constants of Lamé, Pa."""
    shear = constants.shear_modulus(model.youngs_modulus, model.poissons_ratio)
    return constants.bulk_modulus(model.youngs_modulus, model.poissons_ratio, None) - 2.0 / 3.0 * shear, shear


class SolidCorrespondenceBody(Body):
    """Nodes in space with a displacement gradient and a stress, as :class:`CorrespondenceBody` in the plane.

    Parameters
    ----------
    bonds, model, coordinates, volume, precision
        As for :class:`Body`; a :class:`Correspondence` model.
    """

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
        self.lame, self.shear = _lame(model)
        #: Of an orthotropic material, for all nodes Pa (1, 21) or for each (n, 21).
        self.stiffness = None if model.orthotropic is None else as_float(model.stiffness())
        self._tensor, self.inverse, self.share = np.empty((n, 6)), np.zeros((n, 6)), np.ones(n)
        every = np.arange(n, dtype=np.int32)
        kernels.shape(
            every, bonds.offsets, bonds.neighbours, self.coordinates, bonds.weight / bonds.length**3, self._tensor
        )
        self._whole = np.maximum(np.linalg.eigvalsh(self._tensor[:, _MATRIX])[:, 0], 0.0)
        #: What resists zero-energy modes, N/m^6.
        self.control = np.zeros((n, 6))
        self._refresh(every)

    @property
    def _bonded(self) -> tuple[np.ndarray, ...]:
        return self.bonds.offsets, self.bonds.neighbours, self.coordinates, self.cubed

    def _refresh(self, nodes: np.ndarray) -> None:
        """Bring what depends on the broken bonds of some nodes up to date."""
        kernels.shape(nodes, *self._bonded, self._tensor)
        values, vectors = np.linalg.eigh(self._tensor[nodes][:, _MATRIX])
        least, largest = values[:, 0], values[:, 2]
        full = (largest > 0.0) & (least >= ROW * largest)
        inverse = np.where(full, self.volume[nodes], 0.0)[:, None] / np.where(full[:, None], values, 1.0)
        own = self.stiffness if self.stiffness is None or len(self.stiffness) == 1 else self.stiffness[nodes]
        control = CONTROLS[self.model.zero_energy](self.model, own, inverse, vectors)
        left = np.divide(least, CARRIES_ALL * self._whole[nodes], out=np.zeros(len(nodes)), where=full)
        self.share[nodes] = np.minimum(left, 1.0)
        self.inverse[nodes] = _entries(inverse, vectors)
        self.control[nodes] = (self.model.zero_energy_strength * self.share[nodes])[:, None] * control

    def _without(self, both: np.ndarray, nodes: np.ndarray) -> None:
        self._refresh(nodes)

    def unsupported(self) -> np.ndarray:
        """Nodes whose bonds lie in a row or in a layer, (k,)."""
        return np.flatnonzero((self.inverse[:, :3].sum(axis=1) == 0.0) & (self._tensor[:, :3].sum(axis=1) > 0.0))

    def displacement_gradient(self, u: np.ndarray) -> np.ndarray:
        """Displacement gradient of each node, (n, 3, 3), the displacement first: exact where ``u`` is affine."""
        return self._gradient(as_float(u, self.coordinates.shape)).reshape(-1, 3, 3)

    def _gradient(self, u: np.ndarray) -> np.ndarray:
        out = np.empty((self.bonds.node_count, 9))
        kernels.displacement_gradient(*self._bonded, self.volume, self.inverse, u, out)
        return out

    def _stress(self, gradient: np.ndarray) -> np.ndarray:
        """First Piola-Kirchhoff stress of each node, Pa (n, 9): here that of small strains."""
        out = np.empty_like(gradient)
        if self.stiffness is None:
            kernels.linear_stress(self.lame, self.shear, gradient, out)
        else:
            kernels.tensor_stress(self.stiffness, gradient, out)
        return out

    def stress(self, u: np.ndarray) -> np.ndarray:
        """Stress of each node, Pa (n, 3, 3)."""
        return self._stress(self._gradient(as_float(u, self.coordinates.shape))).reshape(-1, 3, 3)

    def _state(self, gradient: np.ndarray) -> np.ndarray:
        out = np.empty_like(gradient)
        kernels.node_state(self.inverse, self.share, self.control, gradient, self._stress(gradient), out)
        return out

    def force(self, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Internal force on each node, N (n, 3): minus the derivative of the energy (theory, eq. 2.17)."""
        out = np.empty_like(u) if out is None else out
        kernels.internal_force(*self._bonded, self.control, self._state(self._gradient(u)), u, out)
        return out

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy of each node, J (n,) (theory, eq. 2.16)."""
        u, out = as_float(u, self.coordinates.shape), np.empty(self.bonds.node_count)
        gradient = self._gradient(u)
        kernels.elastic_energy(
            *self._bonded, self.volume, self.share, self.control, gradient, self._stress(gradient), u, out
        )
        return out

    def diagonal(self) -> np.ndarray:
        """Diagonal of the stiffness with all gradients held, N/m (n, 3): what short waves feel."""
        out = np.empty_like(self.coordinates)
        kernels.control_diagonal(*self._bonded, self.control, out)
        return out

    def stiffness_rows(self) -> np.ndarray:
        """Gershgorin's bound for springs between nodes that have at least the energy of this body, N/m (n, 3).

        As in the plane: the affine part of a displacement of the family has at most the largest stiffness times its
        gradient squared, which the least value of the shape tensor bounds.
        """
        affine = self._stiffest() * self.share * np.linalg.eigvalsh(self.inverse[:, _MATRIX])[:, 2]
        return self._rows(np.maximum(affine, np.linalg.eigvalsh(self.control[:, _MATRIX])[:, 2]))

    def stiffest_rows(self) -> np.ndarray:
        """The same, whatever breaks: a family can get stiffer for what is left of it, up to where its stress fades."""
        some = self._whole > 0.0
        inverse = np.where(some, self.volume, 0.0) / np.where(some, CARRIES_ALL * self._whole, 1.0)
        affine = self._stiffest() * inverse
        # The stiffness makes of a tensor one of at most its own norm times the stiffest; that has root 3 of its values.
        held = np.sqrt(3.0) * affine if self.model.zero_energy == "wan" else 0.5 * self.normal
        return self._rows(np.maximum(affine, self.model.zero_energy_strength * held))

    def _stiffest(self) -> float:
        """Largest eigenvalue of the stiffness, Pa: the same in whatever axes."""
        if self.stiffness is not None:
            return float(np.linalg.eigvalsh(constants.mandel(self.model.orthotropic.in_space()))[-1])
        return max(3.0 * self.lame + 2.0 * self.shear, 2.0 * self.shear)

    def _rows(self, bound: np.ndarray) -> np.ndarray:
        """Rows of springs between nodes, given what they are at each end, N/m^6 (n,)."""
        out = np.empty_like(self.coordinates)
        kernels.control_diagonal(*self._bonded, bound[:, None] * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]), out)
        return 2.0 * out

    def node_parts(self, u: np.ndarray) -> np.ndarray:
        """What each node adds to the forces of its bonds, (n, 18).

        That is a tensor, N/m^6 (n, 9), the rotation, rad (n, 3), and what the mean stress has in the tensor, N/m^6
        (n, 6).
        """
        gradient = self._gradient(u)
        turn = 0.5 * (gradient[:, [7, 2, 3]] - gradient[:, [5, 6, 1]])
        mean = (self.lame + 2.0 / 3.0 * self.shear) * self.share * gradient[:, [0, 4, 8]].sum(axis=1)
        return np.hstack([self._state(gradient), turn, mean[:, None] * self.inverse])

    def bond_parts(
        self, u: np.ndarray, bond: np.ndarray, owner: np.ndarray, nodes: np.ndarray | None = None
    ) -> np.ndarray:
        """Stretch of some directed bonds, and nine more parts for either end, (19, k).

        These are its share of the force over the weight, N/m^6, the relative displacement over the length without the
        rotation of that end, and what the mean stress has in the force (theory, eq. 5.17).
        """
        nodes, other = self.node_parts(u) if nodes is None else nodes, self.bonds.neighbours[bond]
        length = self.bonds.length[bond][:, None]
        direction, relative = (
            (self.coordinates[other] - self.coordinates[owner]) / length,
            (u[other] - u[owner]) / length,
        )
        parts = [np.einsum("kc,kc->k", direction, relative)[None]]
        for end in (owner, other):
            state, control = nodes[end, :9].reshape(-1, 3, 3), self.control[end][:, _MATRIX]
            force = np.einsum("kab,kb->ka", state, direction) + np.einsum("kab,kb->ka", control, relative)
            swollen = np.einsum("kab,kb->ka", nodes[end, 12:][:, _MATRIX], direction)
            parts += [force.T, (relative - np.cross(nodes[end, 9:12], direction)).T, swollen.T]
        return np.concatenate(parts)

    def measure(self, bond: np.ndarray, owner: np.ndarray) -> Measure:
        """Half the work of the forces of a bond on its elongation, as either end sees it (theory, eq. 2.21)."""
        normal = self.normal

        def square(parts: np.ndarray) -> np.ndarray:
            return ((parts[1:4] * parts[4:7]).sum(axis=0) + (parts[10:13] * parts[13:16]).sum(axis=0)) / normal

        def split(parts: np.ndarray) -> np.ndarray:
            swollen = ((parts[7:10] * parts[4:7]).sum(axis=0) + (parts[16:] * parts[13:16]).sum(axis=0)) / normal
            return np.stack([swollen, square(parts) - swollen])

        known = split if self.model.orthotropic is None else None
        return Measure(normal * self.bonds.weight[bond] * self.bonds.length[bond], square, known)

    def largest_ratios(
        self, u: np.ndarray, load: BondLoad, breakable: np.ndarray, resistance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As for any body, without writing anything per bond."""
        b, top, nodes = self.bonds, np.empty(self.bonds.node_count), self.node_parts(u)
        control, state = self.control, np.ascontiguousarray(nodes[:, :9])
        if load.split is not None:  # the same sweep with the forces that each part counts with
            swollen, sheared = load.split
            mean = nodes[:, 12:][:, _MATRIX].reshape(-1, 9)
            control, state = sheared * control, sheared * state + (swollen - sheared) * mean
        kernels.largest_ratio(
            b.offsets, b.neighbours, self.coordinates, control, state,
            np.ascontiguousarray(nodes[:, 9:12]), self.normal, load.by_energy, load.above, u, breakable,
            resistance, top,
        )  # fmt: skip
        return top, nodes
