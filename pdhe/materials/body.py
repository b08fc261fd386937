"""What every elastic model and its body are asked for, and what they share: bonds, their breakage, their short part.

A solver asks a body for forces and for a stand-in of its stiffness, the search for failures for the loads of bonds, and
whoever breaks bonds says so. A new model is a :class:`Model` with its constants, a :class:`Body` with its forces, and
one line in :data:`pdhe.materials.MODELS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from pdhe.bonds import Bonds
from pdhe.errors import PdheError
from pdhe.kernels import mechanics, mechanics3d
from pdhe.kernels.jit import as_float
from pdhe.materials.constants import micromodulus


@dataclass(frozen=True)
class Model:
    """Elastic constants of a bonded body, and the kind of body that has them."""

    youngs_modulus: float = field(metadata={"unit": "Pa"})
    poissons_ratio: float = field(metadata={"unit": "1"})
    thickness: float = field(metadata={"unit": "m"})
    horizon: float = field(metadata={"unit": "m"})
    #: ``stress`` or ``strain``: which of the two vanishes across the plate; None in three dimensions.
    plane: str | None = "stress"
    #: What is made of this model and a set of bonds in the plane, and of bonds in space; None where there is none.
    body: ClassVar[type[Body]]
    solid_body: ClassVar[type[Body] | None] = None
    #: Whether rigid rotations are free.
    objective: ClassVar[bool] = True
    #: Tangential over normal micromodulus of a bond; only the ``energy`` correction of bonds asks for it.
    tangential_ratio: ClassVar[float] = 0.0

    @property
    def normal(self) -> float:
        """Normal micromodulus, N/m^6: that of the bonds that have the energy of an isotropic extension (eq. 2.2).

        The energy of a bond counts as a stretch through it, whatever the model.
        """
        return micromodulus(self.youngs_modulus, self.poissons_ratio, self.plane, self.thickness, self.horizon)


@dataclass(frozen=True)
class BondLoad:
    """What of a bond is compared with its critical stretch.

    Attributes
    ----------
    by_energy
        The stretch of a bond that has the same energy without shear, in place of the stretch.
    tension_only
        Bonds that are shortened have no load; otherwise they are loaded like stretched ones.
    split
        What the dilatational and the deviatoric part of the energy count; None where the energy counts as a whole. By
        energy, for the state-based model and isotropic correspondence.
    """

    by_energy: bool
    tension_only: bool = True
    split: tuple[float, float] | None = None

    @property
    def above(self) -> float:
        """Bonds with this stretch and less have no load."""
        return 0.0 if self.tension_only else -np.inf


#: The loads of the criteria ``stretch`` and ``energy``, of stretched bonds alone.
BY_STRETCH, BY_ENERGY = BondLoad(by_energy=False), BondLoad(by_energy=True)


@dataclass(frozen=True)
class Measure:
    """How the energy of some bonds follows from their parts, see :meth:`Body.bond_parts`.

    Attributes
    ----------
    stiffness
        Of each bond, J (k,): its energy is half of this times ``square``.
    square
        Function of the parts (p, k): square of the stretch that has the same energy, (k,). Quadratic.
    split
        Function of the parts: the dilatational and the deviatoric share of ``square``, (2, k); None where the model
        knows none.
    """

    stiffness: np.ndarray
    square: Callable[[np.ndarray], np.ndarray]
    split: Callable[[np.ndarray], np.ndarray] | None = None


class Body(ABC):
    """Bonds with a model and their present state of breakage: forces, energies and bond loads for given displacements.

    Forces are linear in the displacements and minus the derivative of the energy. Subclasses say what they are; they
    may also do faster what is done here for all of them.

    Parameters
    ----------
    bonds
        The families. Bonds that a pre-crack cuts are broken from the start.
    model
        The constants.
    coordinates, volume
        Node positions, m (n, dim), and volumes, m^3 (n,).
    precision
        In which the weights of the bonds are stored. Both directions of a bond are rounded alike: with single precision
        forces still cancel to the last digit of a double, and the stiffness of each bond is off by at most 6e-8.
    relative
        Stiffness of each directed bond over that in the material of ``model``, (b,), alike in both directions; None
        where all bonds are of that material.

    Attributes
    ----------
    intact
        Whether each directed bond is unbroken, bool (b,).
    broken
        Directed bonds that were broken, call by call.
    broken_weight
        Sum of ``beta lambda V_i V_j r`` over the broken bonds, each once, m^7, times their fineness if that differs.
    cubed
        ``beta lambda V_i V_j / r^3`` of each directed bond, m^3 (b,), times ``relative``; zero where it is broken.
    normal
        Micromodulus that the energy of a bond is made a stretch with, N/m^6.
    sees_images
        Whether nodes may be bonded to images of nodes: the plate may then be a part of a symmetric body.
    """

    sees_images: ClassVar[bool] = False

    def __init__(
        self,
        bonds: Bonds,
        model: Model,
        coordinates: np.ndarray,
        volume: np.ndarray,
        precision: type = np.float64,
        relative: np.ndarray | None = None,
    ) -> None:
        self.bonds, self.model, self.volume, self.relative = bonds, model, volume, relative
        self.coordinates = as_float(coordinates, (bonds.node_count, np.shape(coordinates)[-1]))
        # As far as neighbours go: behind the nodes of the body, those images of nodes that they are bonded to.
        images = bonds.images
        self._x = self.coordinates if images is None else images.positions
        self._volumes = volume if images is None else images.extend(volume)
        self._moved = None if images is None else np.zeros_like(self._x)
        self.normal = model.normal
        self.intact = ~bonds.cut
        self.broken: list[np.ndarray] = []
        self._found_open: tuple[np.ndarray | None, np.ndarray | None, int] = (None, None, -1)
        cubed = np.where(self.intact, bonds.weight / bonds.length**3, 0.0)
        if relative is not None:
            cubed *= relative
        self.cubed = cubed.astype(precision, copy=False)
        self._phi = np.zeros(bonds.node_count)
        self._count_broken(np.arange(bonds.node_count, dtype=np.int32))
        self.broken_weight = self._weight_of(np.flatnonzero(bonds.cut))

    def stored_by_bond(self) -> dict[str, int]:
        """Bytes of what is kept bond by bond, beside the bonds themselves, by name."""
        stored = {"weight over length cubed": self.cubed.nbytes, "intact": self.intact.nbytes}
        return stored if self.relative is None else stored | {"relative stiffness": self.relative.nbytes}

    @property
    def can_be_indefinite(self) -> bool:
        """Whether some deformation might release energy, with these constants."""
        return False

    def softness(self) -> np.ndarray | None:
        """Stiffest bond of all over the stiffest of each node, 1 or more (n,), broken or not; None where all are alike.

        Only that of the material counts, not the length of a bond or its weight.
        """
        if self.relative is None:
            return None
        offsets, own = self.bonds.offsets, np.ones(self.bonds.node_count)
        some = np.diff(offsets) > 0
        own[some] = np.maximum.reduceat(self.relative, offsets[:-1][some]) / self.relative.max()
        return 1.0 / own

    def unsupported(self) -> np.ndarray:
        """Nodes with bonds that this model can make nothing of, (k,)."""
        return np.zeros(0, np.int64)

    @abstractmethod
    def force(self, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Internal force on each node, N (n, dim): minus the derivative of the energy."""

    @property
    def columns(self) -> bool:
        """Whether fields in Fortran order, one component after the other, suit the sweeps."""
        return False

    def force_and_ratios(
        self, u: np.ndarray, load: BondLoad, weakness: np.ndarray, out: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Internal force, and how near bonds are to failure: what a step of a motion asks for.

        Parameters
        ----------
        u, out
            Displacements, m, and forces, N, both (n, dim), in Fortran order where :attr:`columns` says so.
        load
            What decides, as in :meth:`bond_loads`.
        weakness
            One over the square of the resistance of each node's bonds (n,), zero where none of them may break.

        Returns
        -------
        square, nodes
            Square of the largest load over resistance among the bonds of each node, the lesser resistance of both ends
            counting, (n,), and :meth:`node_parts`.
        """
        self.force(u, out)
        resistance = 1.0 / np.sqrt(np.where(weakness > 0.0, weakness, 1.0))
        top, nodes = self.largest_ratios(u, load, self._open(weakness), resistance)
        return top**2, nodes

    def _open(self, weakness: np.ndarray) -> np.ndarray:
        """Unbroken directed bonds both ends of which may lose bonds, bool (b,)."""
        # The same from step to step but where bonds break: to find it takes several times as long as a force sweep.
        found, of, breaks = self._found_open
        if of is not weakness or breaks != len(self.broken):
            owner, other = self.bonds.owners(), self.bonds.far()
            found = self.intact & (weakness[owner] > 0.0) & (weakness[other] > 0.0)
            self._found_open = found, weakness, len(self.broken)
        return found

    @abstractmethod
    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy of each node, J (n,)."""

    @abstractmethod
    def diagonal(self) -> np.ndarray:
        """Diagonal of the stiffness, or something of its size, N/m (n, dim): for preconditioning."""

    @abstractmethod
    def stiffness_rows(self) -> np.ndarray:
        """Upper bound of the sum of the magnitudes in each row of the stiffness, N/m (n, dim): for stable steps."""

    def stiffest_rows(self) -> np.ndarray:
        """The same, whatever breaks later, N/m (n, dim): bonds that are gone only make this body softer."""
        return self.stiffness_rows()

    @abstractmethod
    def node_parts(self, u: np.ndarray) -> np.ndarray:
        """What the loads of bonds need of their two ends, (n,) or (n, q); linear in the displacements."""

    @abstractmethod
    def bond_parts(
        self, u: np.ndarray, bond: np.ndarray, owner: np.ndarray, nodes: np.ndarray | None = None
    ) -> np.ndarray:
        """What decides on the failure of some directed bonds, (p, k); linear in the displacements, the stretch first.

        ``nodes`` is what :meth:`node_parts` gives for ``u``, if known.
        """

    @abstractmethod
    def measure(self, bond: np.ndarray, owner: np.ndarray) -> Measure:
        """Energy of some directed bonds as a function of their parts, as long as nothing breaks."""

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
        nodes = np.unique(self.bonds.far(both))
        self._count_broken(nodes)
        self._without(both, nodes)

    def _without(self, both: np.ndarray, nodes: np.ndarray) -> None:  # noqa: B027
        """Bring what else depends on broken bonds up to date: directed ``both`` broke, at the ends ``nodes``."""

    def _count_broken(self, nodes: np.ndarray) -> None:
        b = self.bonds
        mechanics.damage(nodes, b.offsets, b.neighbours, self._volumes, self.intact, self._phi)

    def _with_images(self, u: np.ndarray) -> np.ndarray:
        """Displacements of nodes, and behind them those of their images."""
        images = self.bonds.images
        if images is None:
            return u
        self._moved[: images.nodes] = u
        self._moved[images.nodes :] = images.sign * u[images.source]
        return self._moved

    def _weight_of(self, bond: np.ndarray) -> float:
        weight = self.bonds.weight[bond] * self.bonds.length[bond]
        if self.bonds.fineness is not None:
            weight *= self.bonds.fineness[bond]
        return 0.5 * float(np.sum(weight))

    def damage(self) -> np.ndarray:
        """Volume-weighted share of broken bonds, (n,); bonds cut by a pre-crack count as broken (theory, eq. 5.1)."""
        return self._phi.copy()

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
            Columns beyond n are of images. In space blocks are 3 by 3.
        """
        b, n, axes = self.bonds, self.bonds.node_count, self.bonds.dimension
        if b.images is not None:
            reach, free = b.images.extend(reach), b.images.extend(free)
        count, sums = np.empty(n, np.int32), np.empty((n, 2))
        mechanics.count_short(b.offsets, b.neighbours, self.cubed, reach, b.weight, b.length, count, sums)
        short, whole = sums.sum(axis=0)
        scale = self.normal * whole / max(short, np.finfo(float).tiny)
        starts = np.concatenate([[0], np.cumsum(count + 1)]).astype(np.int32)
        column, value = np.empty(starts[-1], np.int32), np.empty((starts[-1], axes, axes))
        own = np.empty(n, np.int32)
        (mechanics if axes == 2 else mechanics3d).fill_short(
            b.offsets, b.neighbours, self._x, self.cubed, reach, b.length, free, scale, starts, column, value, own
        )  # fmt: skip
        # A fixed degree of freedom, or one across a row of nodes, resists nothing: it gets an entry of the usual size.
        for axis in range(axes):
            diagonal = value[own, axis, axis]
            typical = float(diagonal.max(initial=0.0)) or 1.0
            value[own, axis, axis] = np.where(diagonal > 1e-9 * typical, diagonal, typical)
        return starts, column, value

    def bond_loads(self, u: np.ndarray, load: BondLoad) -> np.ndarray:
        """Load of every directed bond, broken ones included, (b,): what is compared with the critical stretch.

        See :class:`BondLoad` and theory, eq. 5.2.
        """
        bond, owner = np.arange(self.bonds.length.size), self.bonds.owners()
        return load_of(self.bond_parts(u, bond, owner), self.measure(bond, owner), load)

    def largest_ratios(
        self, u: np.ndarray, load: BondLoad, breakable: np.ndarray, resistance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What a search for failures starts with.

        Parameters
        ----------
        u
            Displacements, m (n, dim).
        load
            What decides, as in :meth:`bond_loads`.
        breakable
            Directed bonds to look at, bool (b,).
        resistance
            Load that a bond can bear, by its ends (n,): the lesser one counts.

        Returns
        -------
        top, nodes
            Largest load over resistance among the bonds that each node owns, (n,), and its :meth:`node_parts`.
        """
        nodes, bond = self.node_parts(u), np.flatnonzero(breakable)
        owner = self.bonds.owners()[bond]
        loads = load_of(self.bond_parts(u, bond, owner, nodes), self.measure(bond, owner), load)
        top = np.zeros(self.bonds.node_count)
        np.maximum.at(top, owner, loads / np.minimum(resistance[owner], resistance[self.bonds.far(bond)]))
        return top, nodes


def load_of(parts: np.ndarray, measure: Measure, load: BondLoad) -> np.ndarray:
    """Load of some bonds, given their parts, (k,) (theory, eqs. 5.2 and 5.16)."""
    stretch = parts[0]
    if not load.by_energy:
        size = np.abs(stretch)
    elif load.split is None:
        size = np.sqrt(np.maximum(measure.square(parts), 0.0))
    elif measure.split is None:
        raise PdheError("the energies of these bonds are not known in two parts")
    else:
        dilatational, deviatoric = measure.split(parts)
        size = np.sqrt(np.maximum(load.split[0] * dilatational + load.split[1] * deviatoric, 0.0))
    return np.where(stretch > load.above, size, 0.0)
