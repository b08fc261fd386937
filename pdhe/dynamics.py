"""Explicit dynamics: velocity Verlet, with held nodes, tractions, damping and failing bonds (theory, section 7)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pdhe.boundary import DisplacementConditions
from pdhe.damage import FailureRule, critical_bonds
from pdhe.kernels import verlet
from pdhe.kernels.vectors import dot
from pdhe.materials import Body

#: How far below 1 the squared load over resistance of a node is looked at bond by bond: far above its round-off.
NEAR = 1e-9


@dataclass(frozen=True)
class Traction:
    """Forces on nodes in proportion to a history.

    Attributes
    ----------
    on, component
        Edge or face, and 0 for x, 1 for y or 2 for z.
    value
        Force per area, Pa, as a function of time, s.
    corners
        Times at which the function has a corner, s.
    nodes, area
        The nodes that bear it, (m,), and the area of the edge or face that belongs to each, m^2 (m,).
    """

    on: str
    component: int
    value: Callable[[float], float]
    corners: tuple[float, ...]
    nodes: np.ndarray
    area: np.ndarray


@dataclass
class Work:
    """Counted work, equal on every machine."""

    time_steps: int = 0
    force_sweeps: int = 0


def stable_step(body: Body, mass: np.ndarray, free: np.ndarray, breaks: bool = False) -> float:
    """Longest step that Gershgorin's theorem proves stable, s; infinity where nothing is bonded.

    Parameters
    ----------
    mass
        kg (n,).
    free
        Degrees of freedom that move, bool (n, dim): rows of held ones do not matter.
    breaks
        Whether bonds may break later on, which stiffens some bodies.
    """
    rows = body.stiffest_rows() if breaks else body.stiffness_rows()
    largest = float(np.where(free, rows / mass[:, None], 0.0).max(initial=0.0))
    return 2.0 / math.sqrt(largest) if largest > 0.0 else math.inf


class Verlet:
    """Steps of the motion of a body (theory, eqs. 7.7 and 7.8), and what they cost and give away.

    Displacements, velocities and forces live in flat arrays in the order that suits the sweeps; :attr:`u`, :attr:`v`
    and :attr:`force` are views of them of shape (n, dim), with the forces of tractions on free nodes included.

    Parameters
    ----------
    body
        Bonds and their present breakage.
    mass
        Of each node, kg (n,).
    conditions, tractions
        What is prescribed.
    initial
        Velocity of each node at time zero, m/s (n, dim).
    damping
        Rate, 1/s: a force of that times mass and velocity acts against the motion.
    breaks
        Whether bonds may break: steps are then stable whatever does.
    """

    def __init__(
        self,
        body: Body,
        mass: np.ndarray,
        conditions: DisplacementConditions,
        tractions: Sequence[Traction],
        initial: np.ndarray,
        damping: float = 0.0,
        breaks: bool = False,
    ) -> None:
        self.body, self.mass, self.conditions, self.tractions, self.damping = body, mass, conditions, tractions, damping
        shape = body.coordinates.shape
        self.columns = body.columns
        self.u, self.v, self.force, masses = (self._flat(shape) for _ in range(4))
        masses[:] = mass[:, None]
        free = ~conditions.fixed
        self.limit = stable_step(body, mass, free, breaks)
        self._u, self._v, self._force, self._masses = map(self._line, (self.u, self.v, self.force, masses))
        inverse = self._flat(shape)
        inverse[free] = (1.0 / masses)[free]
        self._inverse = self._line(inverse)
        self._lost = np.zeros((masses.size + verlet.BLOCK - 1) // verlet.BLOCK)
        node, component, self._load, self._factor = conditions.sparse()
        self._held = self._at(node, component)
        self._pull = [
            (self._at(t.nodes[ok], np.full(ok.sum(), t.component)), t.area[ok])
            for t in tractions
            for ok in (free[t.nodes, t.component],)
        ]
        self._watched = np.concatenate([self._held, *(at for at, _ in self._pull)]).astype(np.int64)
        self._old_u, self._old_force = np.zeros((2, self._watched.size))
        self.v[free] = initial[free]
        self.rule: FailureRule | None = None
        self._psi: np.ndarray | None = None
        self._weakness: np.ndarray | None = None
        self._square = self._parts = None
        self.work = Work()

    def _flat(self, shape: tuple[int, int]) -> np.ndarray:
        return np.zeros(shape[::-1]).T if self.columns else np.zeros(shape)

    def _line(self, field: np.ndarray) -> np.ndarray:
        return (field.T if self.columns else field).reshape(-1)

    def _at(self, node: np.ndarray, component: np.ndarray) -> np.ndarray:
        """Places of degrees of freedom in the flat arrays."""
        nodes, axes = self.u.shape
        return (component * nodes + node if self.columns else axes * node + component).astype(np.int64)

    @property
    def held(self) -> np.ndarray:
        """Degrees of freedom with a prescribed motion, bool (n, dim)."""
        return self.conditions.fixed

    def adopt(self, u: np.ndarray, v: np.ndarray, force: np.ndarray) -> None:
        """Go on from a state."""
        self.u[:], self.v[:], self.force[:] = u, v, force

    def watch(self, rule: FailureRule | None, psi: np.ndarray | None) -> None:
        """From now on look for bonds that fail, at a coverage (n,) or without hydrogen."""
        self.rule, self._psi = rule, psi
        if rule is None:
            return
        b = self.body.bonds
        owner = b.owners()[rule.may_fail]
        open_ = np.zeros(self.mass.size, bool)
        open_[owner] = open_[b.far(rule.may_fail)] = True
        self._weakness = np.where(open_, rule.least(rule.resistance_at(psi), self.mass.size) ** -2.0, 0.0)

    def corners(self) -> list[float]:
        """Times at which something prescribed has a corner, s."""
        return sorted({*self.conditions.corners, *(t for pull in self.tractions for t in pull.corners)})

    def sweep(self, t: float) -> None:
        """Find the forces of the present displacements at time t, and how near bonds are to failure."""
        if self.rule is None:
            self.body.force(self.u, self.force)
        else:
            self._square, self._parts = self.body.force_and_ratios(self.u, self.rule.load, self._weakness, self.force)
        self.work.force_sweeps += 1
        self._add_tractions(t)

    def _add_tractions(self, t: float) -> None:
        for pull, (at, area) in zip(self.tractions, self._pull, strict=True):
            self._force[at] += pull.value(t) * area

    def steps(self, span: float, wanted: float) -> int:
        """Number of equal steps over a span of time, none longer than wanted, s."""
        return max(1, math.ceil(span / wanted * (1.0 - 1e-12)))

    def step(self, t: float, step: float, ended: bool = True) -> tuple[float, float]:
        """Go from one time to the next, but for the second half of the last kick: :meth:`end` gives it.

        Parameters
        ----------
        t
            Time at the end of the step, s.
        step
            Its length, s.
        ended
            Whether :meth:`end` was called after the step before. If not it is made up for here, to the same bits at
            half the cost; only without damping.

        Returns
        -------
        tuple
            Work of what is prescribed and energy lost by damping, J.
        """
        half, lost = 0.5 * step, 0.0
        verlet.remember(self._watched, self._u, self._force, self._old_u, self._old_force)
        if ended:
            keep = math.exp(-0.5 * self.damping * step)
            verlet.begin_step(
                self._u, self._v, self._force, half, self._inverse, step, keep, self._masses, self._lost
            )  # fmt: skip
            lost = self._taken()
        else:
            verlet.end_and_begin_step(self._u, self._v, self._force, half, self._inverse, step)
        held = self._held.size
        if held:
            amount = np.array([load.value(t) for load in self.conditions.prescribed])
            verlet.hold(self._held, self._load, self._factor, amount, self._u)
        self.sweep(t)
        self.work.time_steps += 1
        work, first = 0.0, held
        if held:
            work = verlet.work_of_held(self._held, self._u, self._force, self._old_u, self._old_force, self._v, step)
        for pull, (at, area) in zip(self.tractions, self._pull, strict=True):
            way = self._u[at] - self._old_u[first : first + at.size]
            work += 0.5 * (pull.value(t - step) + pull.value(t)) * float(area @ way)
            first += at.size
        return work, lost

    def end(self, step: float) -> float:
        """Give the second half of the kick of a step, for the velocities at its end; return what damping took, J."""
        keep = math.exp(-0.5 * self.damping * step)
        verlet.end_step(self._v, self._force, 0.5 * step, self._inverse, keep, self._masses, self._lost)
        return self._taken()

    def _taken(self) -> float:
        if self.damping == 0.0:
            return 0.0
        lost = float(self._lost.sum())
        self._lost[:] = 0.0
        return lost

    def critical(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Directed bonds that have reached their resistance, and both ends of each; None if there are none."""
        if self._square is None or not self._square.max() >= 1.0 - NEAR:
            return None
        nodes = np.flatnonzero(self._square >= 1.0 - NEAR)
        found = critical_bonds(self.body, self.rule, self.u, self._psi, nodes, self._parts)
        return found if found[0].size else None

    def break_bonds(self, bond: np.ndarray, t: float) -> float:
        """Break bonds, directed ones from either end, and find the forces without them.

        Returns
        -------
        float
            Elastic energy that the body gave away, J. The energy of a linear body is half of the work of minus its
            forces, so that the change of the forces is enough to know it.
        """
        before = dot(self._u, self._force)
        self.body.break_bonds(bond)
        self.sweep(t)
        return 0.5 * (dot(self._u, self._force) - before)

    def kinetic(self) -> tuple[float, float]:
        """Kinetic energy of all degrees of freedom, and of the held ones alone, J; after :meth:`end`."""
        held = self._held
        return (
            0.5 * float(np.sum(self._masses * self._v**2)),
            0.5 * float(np.sum(self._masses[held] * self._v[held] ** 2)),
        )

    def elastic(self) -> float:
        """Elastic energy, J."""
        return float(self.body.energy(np.ascontiguousarray(self.u)).sum())

    def ripple(self, step: float) -> float:
        """Part of the energy that swings with the steps of Verlet's method, at present, J (theory, eq. 7.10)."""
        return step**2 / 8.0 * float(np.sum(self._inverse * self._force**2))
