"""Correspondence: stresses of classical laws, from a nonlocal deformation gradient (theory, eqs. 2.14 to 2.22)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pdhe.bonds import Bonds
from pdhe.kernels import correspondence as kernels
from pdhe.kernels.jit import as_float
from pdhe.materials import constants
from pdhe.materials.body import Body, BondLoad, Measure, Model
from pdhe.materials.solid_correspondence import CARRIES_ALL, ROW, SolidCorrespondenceBody


def silling_control(model: Correspondence, stiffness: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Zero-energy control by Silling (2017): the same resistance in all directions (theory, eq. 2.19)."""
    control = np.zeros_like(inverse)
    control[:, 0] = control[:, 2] = 0.5 * model.normal
    return control


def wan_control(model: Correspondence, stiffness: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Zero-energy control by Wan et al. (2019): the stiffness on the inverse shape tensor (theory, eq. 2.18).

    Not positive for auxetic materials at nodes with few bonds: what is negative is left out.
    """
    a, b, c = inverse.T
    xxxx, xxyy, xxxy, yyyy, yyxy, xyxy = stiffness.T
    xx = xxxx * a + xxyy * c + 2.0 * xxxy * b
    yy = xxyy * a + yyyy * c + 2.0 * yyxy * b
    xy = xxxy * a + yyxy * c + 2.0 * xyxy * b
    mean, spread = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    low, high = np.maximum(mean - spread, 0.0), np.maximum(mean + spread, 0.0)
    share = np.divide(0.5 * (high - low), spread, out=np.ones_like(spread), where=spread > 0.0)
    middle = 0.5 * (high + low)
    return np.column_stack([middle + share * 0.5 * (xx - yy), share * xy, middle - share * 0.5 * (xx - yy)])


#: Zero-energy controls by the name that scenes use.
CONTROLS = {"wan": wan_control, "silling": silling_control}


class CorrespondenceBody(Body):
    """Nodes with a displacement gradient and a stress; bonds carry what the stresses of their ends amount to.

    Broken bonds leave the shape tensor, so that the gradient of an affine displacement stays exact. The few bonds that
    are left to a node cannot hold the stress of its whole volume: it fades out (theory, eq. 2.20). A node whose bonds
    have come to lie in a row has no gradient any more and only holds on to the states of its neighbours.
    """

    sees_images = True

    def __init__(
        self,
        bonds: Bonds,
        model: Correspondence,
        coordinates: np.ndarray,
        volume: np.ndarray,
        precision: type = np.float64,
    ) -> None:
        super().__init__(bonds, model, coordinates, volume, precision)
        n = bonds.node_count
        self.stiffness = as_float(model.stiffness())
        self._tensor, self.inverse, self.share = np.empty((n, 3)), np.zeros((n, 3)), np.ones(n)
        every = np.arange(n, dtype=np.int32)
        kernels.shape(every, bonds.offsets, bonds.neighbours, self._x, bonds.weight / bonds.length**3, self._tensor)
        self._whole = np.subtract(*_principal(self._tensor))
        #: What resists zero-energy modes, N/m^6; behind that of the nodes, that of images.
        self.control = np.zeros((len(self._x), 3))
        self._refresh(every)

    def _refresh(self, nodes: np.ndarray) -> None:
        b = self.bonds
        kernels.shape(nodes, b.offsets, b.neighbours, self._x, self.cubed, self._tensor)
        xx, xy, yy = self._tensor[nodes].T
        middle, spread = _principal(self._tensor[nodes])
        full = (middle > 0.0) & (middle - spread >= ROW * (middle + spread))
        scale = np.where(full, self.volume[nodes] / np.where(full, xx * yy - xy * xy, 1.0), 0.0)
        self.inverse[nodes] = scale[:, None] * np.column_stack([yy, -xy, xx])
        stiffness = self.stiffness if len(self.stiffness) == 1 else self.stiffness[nodes]
        found = CONTROLS[self.model.zero_energy](self.model, stiffness, self.inverse[nodes])
        left = np.divide(middle - spread, CARRIES_ALL * self._whole[nodes], out=np.zeros(len(nodes)), where=full)
        self.share[nodes] = np.minimum(left, 1.0)
        self.control[nodes] = (self.model.zero_energy_strength * self.share[nodes])[:, None] * found
        if b.images is not None:
            self.control = self._beyond(self.control[: b.node_count], (False, True, False))

    def _beyond(self, values: np.ndarray, turn: tuple[bool, ...]) -> np.ndarray:
        """Node values (n, k) with those of images behind them, where those marked change sign in a mirror."""
        images = self.bonds.images
        if images is None:
            return values
        mirrored = np.where(np.array(turn), images.turn[:, None], 1.0) * values[images.source]
        return np.concatenate([values, mirrored])

    def _without(self, both: np.ndarray, nodes: np.ndarray) -> None:
        self._refresh(nodes)

    def unsupported(self) -> np.ndarray:
        """Nodes whose bonds lie in a row, (k,)."""
        return np.flatnonzero(
            (self.inverse[:, 0] + self.inverse[:, 2] == 0.0) & (self._tensor[:, ::2].sum(axis=1) > 0.0)
        )

    def displacement_gradient(self, u: np.ndarray) -> np.ndarray:
        """Displacement gradient of each node, (n, 2, 2), the displacement first: exact where ``u`` is affine."""
        return self._gradient(as_float(u)).reshape(-1, 2, 2)

    def _gradient(self, u: np.ndarray) -> np.ndarray:
        b, out = self.bonds, np.empty((self.bonds.node_count, 4))
        kernels.displacement_gradient(
            b.offsets, b.neighbours, self._x, self.cubed, self.volume, self.inverse, self._with_images(u), out
        )
        return out

    def _stress(self, gradient: np.ndarray) -> np.ndarray:
        """First Piola-Kirchhoff stress of each node, Pa (n, 4): here that of small strains."""
        out = np.empty_like(gradient)
        kernels.linear_stress(self.stiffness, gradient, out)
        return out

    def stress(self, u: np.ndarray) -> np.ndarray:
        """Stress of each node, Pa (n, 2, 2)."""
        return self._stress(self._gradient(as_float(u))).reshape(-1, 2, 2)

    def _state(self, gradient: np.ndarray) -> np.ndarray:
        out = np.empty_like(gradient)
        kernels.node_state(self.inverse, self.share, self.control, gradient, self._stress(gradient), out)
        return self._beyond(out, (False, True, True, False))

    def force(self, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Internal force on each node, N (n, 2): minus the derivative of the energy (theory, eq. 2.17)."""
        b, out = self.bonds, np.empty_like(u) if out is None else out
        state = self._state(self._gradient(u))
        kernels.internal_force(
            b.offsets, b.neighbours, self._x, self.cubed, self.control, state, self._with_images(u), out
        )
        return out

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy of each node, J (n,) (theory, eq. 2.16)."""
        b, u, out = self.bonds, as_float(u), np.empty(self.bonds.node_count)
        gradient = self._gradient(u)
        kernels.elastic_energy(
            b.offsets, b.neighbours, self._x, self.cubed, self.volume, self.share, self.control, gradient,
            self._stress(gradient), self._with_images(u), out,
        )  # fmt: skip
        return out

    def diagonal(self) -> np.ndarray:
        """Diagonal of the stiffness with all gradients held, N/m (n, 2): what short waves feel."""
        b, out = self.bonds, np.empty_like(self.coordinates)
        kernels.control_diagonal(b.offsets, b.neighbours, self._x, self.cubed, self.control, out)
        return out

    def stiffness_rows(self) -> np.ndarray:
        """Gershgorin's bound for springs between nodes that have at least the energy of this body, N/m (n, 2).

        A displacement of the family splits into an affine part and a rest, orthogonal in the sums; the former has at
        most the largest stiffness times its gradient squared, which the least value of the shape tensor bounds.
        """
        held = sum(_principal(self.control[: self.bonds.node_count]))
        return self._rows(np.maximum(self._stiffest() * self.share * sum(_principal(self.inverse)), held))

    def stiffest_rows(self) -> np.ndarray:
        """The same, whatever breaks: a family can get stiffer for what is left of it, up to where its stress fades."""
        some = self._whole > 0.0
        inverse = np.where(some, self.volume, 0.0) / np.where(some, CARRIES_ALL * self._whole, 1.0)
        affine = self._stiffest() * inverse
        # The stiffness makes of a tensor one of at most its own norm times the stiffest; that has root 2 of its values.
        held = np.sqrt(2.0) * affine if self.model.zero_energy == "wan" else 0.5 * self.normal
        return self._rows(np.maximum(affine, self.model.zero_energy_strength * held))

    def _stiffest(self) -> np.ndarray:
        """Largest eigenvalue of the stiffness, Pa, of all nodes or of each."""
        return np.linalg.eigvalsh(constants.mandel(self.model.tensor()))[:, -1]

    def _rows(self, bound: np.ndarray) -> np.ndarray:
        """Rows of springs between nodes, given what they are at each end, N/m^6 (n,)."""
        b, out = self.bonds, np.empty_like(self.coordinates)
        spring = self._beyond(np.column_stack([bound, np.zeros_like(bound), bound]), (False, False, False))
        kernels.control_diagonal(b.offsets, b.neighbours, self._x, self.cubed, spring, out)
        return 2.0 * out

    def node_parts(self, u: np.ndarray) -> np.ndarray:
        """What each node, and images behind them, add to the forces of bonds, (n, 8).

        That is a tensor, N/m^6 (n, 4), the rotation, rad, and what the mean stress has in the tensor, N/m^6 (n, 3).
        """
        gradient = self._gradient(u)
        turn = self._beyond(0.5 * (gradient[:, 2:3] - gradient[:, 1:2]), (True,))
        bulk = constants.bulk_modulus(self.model.youngs_modulus, self.model.poissons_ratio, self.model.plane)
        mean = bulk * self.share * (gradient[:, 0] + gradient[:, 3])
        return np.hstack(
            [self._state(gradient), turn, self._beyond(mean[:, None] * self.inverse, (False, True, False))]
        )

    def bond_parts(
        self, u: np.ndarray, bond: np.ndarray, owner: np.ndarray, nodes: np.ndarray | None = None
    ) -> np.ndarray:
        """Stretch of some directed bonds, and six more parts for either end, (13, k).

        These are its share of the force over the weight, N/m^6, the relative displacement over the length without the
        rotation of that end, and what the mean stress has in the force (theory, eq. 5.17).
        """
        nodes, other = self.node_parts(u) if nodes is None else nodes, self.bonds.neighbours[bond]
        length, u = self.bonds.length[bond], self._with_images(u)
        dx, dy = ((self._x[other] - self._x[owner]) / length[:, None]).T
        ex, ey = ((u[other] - u[owner]) / length[:, None]).T
        parts = [dx * ex + dy * ey]
        for end in (owner, other):
            (xx, xy, yx, yy, turn, sxx, sxy, syy), (pxx, pxy, pyy) = nodes[end].T, self.control[end].T
            parts += [
                xx * dx + xy * dy + pxx * ex + pxy * ey,
                yx * dx + yy * dy + pxy * ex + pyy * ey,
                ex + turn * dy,
                ey - turn * dx,
                sxx * dx + sxy * dy,
                sxy * dx + syy * dy,
            ]
        return np.stack(parts)

    def measure(self, bond: np.ndarray, owner: np.ndarray) -> Measure:
        """Half the work of the forces of a bond on its elongation, as either end sees it (theory, eq. 2.21)."""
        normal = self.normal

        def square(parts: np.ndarray) -> np.ndarray:
            _, fx, fy, ex, ey, _, _, gx, gy, dx, dy, _, _ = parts
            return (fx * ex + fy * ey + gx * dx + gy * dy) / normal

        def split(parts: np.ndarray) -> np.ndarray:
            _, _, _, ex, ey, px, py, _, _, dx, dy, qx, qy = parts
            swollen = (px * ex + py * ey + qx * dx + qy * dy) / normal
            return np.stack([swollen, square(parts) - swollen])

        known = split if self.model.orthotropic is None else None
        return Measure(normal * self.bonds.weight[bond] * self.bonds.length[bond], square, known)

    def largest_ratios(
        self, u: np.ndarray, load: BondLoad, breakable: np.ndarray, resistance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As for any body, without writing anything per bond."""
        b, top, nodes = self.bonds, np.empty(self.bonds.node_count), self.node_parts(u)
        resistance = resistance if b.images is None else b.images.extend(resistance)
        control, state = self.control, np.ascontiguousarray(nodes[:, :4])
        if load.split is not None:  # the same sweep with the forces that each part counts with
            swollen, sheared = load.split
            control, state = sheared * control, sheared * state + (swollen - sheared) * nodes[:, [5, 6, 6, 7]]
        kernels.largest_ratio(
            b.offsets, b.neighbours, self._x, control, state,
            np.ascontiguousarray(nodes[:, 4]), self.normal, load.by_energy, load.above,
            self._with_images(u), breakable, resistance, top,
        )  # fmt: skip
        return top, nodes


def _principal(tensor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of the two principal values of tensors xx, xy, yy (n, 3), and half their difference."""
    xx, xy, yy = tensor.T
    return 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)


@dataclass(frozen=True)
class Correspondence(Model):
    """Non-ordinary state-based model of a classical stress (Silling et al. 2007).

    Attributes
    ----------
    strain
        ``small``, or ``finite``: the bodies of :mod:`pdhe.materials.finite_strain`.
    zero_energy
        Which of :data:`CONTROLS` resists displacements that no gradient sees.
    zero_energy_strength
        Factor on that.
    orthotropic
        Constants in the axes of the material; then Young's modulus and Poisson's ratio are not regarded.
    angle
        Of the material axis 1 from x, rad: one number, or one for each node (n,). In the plane.
    frame
        Material axes 1, 2 and 3 in space as unit vectors, one a row: (3, 3), or of each node (n, 3, 3); None if they
        are x, y and z.
    """

    body = CorrespondenceBody
    solid_body = SolidCorrespondenceBody
    strain: str = "small"
    zero_energy: str = "wan"
    zero_energy_strength: float = 1.0
    orthotropic: constants.Orthotropic | None = None
    angle: float | np.ndarray = field(default=0.0, compare=False)
    frame: np.ndarray | None = field(default=None, compare=False)

    def tensor(self) -> np.ndarray:
        """Stiffness for the strains xx, yy and engineering xy, Pa (1, 3, 3) or of each node (n, 3, 3).

        Of an orthotropic material in space (..., 6, 6), for xx, yy, zz and engineering yz, xz, xy.
        """
        if self.plane is None:
            frame = np.eye(3) if self.frame is None else self.frame
            return constants.turned_in_space(self.orthotropic.in_space(), frame.reshape(-1, 3, 3))
        if self.orthotropic is None:
            return constants.stiffness_tensor(self.youngs_modulus, self.poissons_ratio, self.plane)[None]
        return constants.turned(self.orthotropic.stiffness(self.plane), np.atleast_1d(self.angle))

    def stiffness(self) -> np.ndarray:
        """Its upper triangle, xx-xx, xx-yy, xx-xy, yy-yy, yy-xy, xy-xy, Pa (1, 6) or (n, 6); in space (..., 21)."""
        tensor = self.tensor()
        rows, columns = np.triu_indices(tensor.shape[-1])
        return tensor[:, rows, columns]

    @property
    def normal(self) -> float:
        """Micromodulus of the bonds that have the energy of an isotropic extension, N/m^6, in whatever axes."""
        if self.orthotropic is None:
            return super().normal
        if self.plane is None:
            return 2.0 * float(self.orthotropic.in_space()[:3, :3].sum()) / (np.pi * self.horizon**4)
        tensor = self.orthotropic.stiffness(self.plane)
        return 3.0 * float(tensor[:2, :2].sum()) / (np.pi * self.thickness * self.horizon**3)
