"""Static equilibrium at large strains and rotations: Newton's method on the energy (theory, section 7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pdhe.errors import SimulationError
from pdhe.kernels.vectors import dot
from pdhe.materials.finite_strain import FiniteStrain, Pose
from pdhe.solvers import LEAST_REFERENCE, Preconditioner, Work

#: Residual of a linear solve over the one it started from: less makes no Newton step shorter that is not the last.
LINEAR = 1e-3
#: The last linear solve need not go further below the tolerance than this.
ENOUGH = 0.1
#: Iterations of one linear solve from which the preconditioner is made anew where the body is by then: as it turns,
#: that of an earlier position fits ever less.
SLOW = 40
#: Newton steps of an increment; 4 or 5 are usual.
MOST_STEPS = 30
#: Times that a Newton step, and that an increment of what is prescribed, is halved before it is taken for a failure.
HALVINGS, CUTS = 10, 6
#: Residual over the forces of a first guess that round-off lets a solve reach in any case (measured 1e-11 where a body
#: moves as a whole: residuals are those of forces, not carried on from iteration to iteration), and below which only
#: round-off can be in the way.
REACHABLE, TINY = 5e-11, 1e-9
#: Motion of prescribed degrees of freedom over that of the others below which a rigid motion leaves them at rest.
AT_REST = 1e-9
#: Share of what a step promises that the energy has to fall by, and round-off of an energy over its size.
PROMISE, ROUND_OFF = 1e-4, 1e-14


class NewtonEquilibrium:
    """Finds displacements of least energy near given ones, for prescribed values; asked like :class:`Equilibrium`.

    Every Newton step solves with the exact stiffness by preconditioned conjugate gradients, which stop where they meet
    a direction of negative curvature. It is halved until the energy falls, or the residual does. An increment in which
    this finds nothing, or in which a node would turn inside out, is cut in two.

    Parameters
    ----------
    body
        A body of large strain.
    fixed
        Prescribed degrees of freedom, bool (n, dim).
    spacing
        Of each node, m (n,).
    tolerance
        Norm of the residual over the free degrees of freedom, relative to that of the forces at the prescribed ones;
        the largest such norm of the run counts.
    max_iterations
        Of conjugate gradients, in one Newton step.
    """

    def __init__(
        self, body: FiniteStrain, fixed: np.ndarray, spacing: np.ndarray, tolerance: float = 1e-8,
        max_iterations: int = 5000,
    ) -> None:  # fmt: skip
        self.body, self.fixed, self.spacing = body, fixed, spacing
        self.free = (~fixed).astype(float)
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.reference, self.work = 0.0, Work()
        #: Relative residuals of the last increment, one a Newton step.
        self.residuals: list[float] = []
        self._precondition: Preconditioner | None = None
        self._guess = 0.0
        self._loose: list[np.ndarray] = []

    def memory(self) -> dict[str, Any]:
        """What later solves depend on; the work counted so far is apart."""
        return {"reference": self.reference}

    def recall(self, memory: Mapping[str, Any], broken: Sequence[np.ndarray]) -> None:
        """Become as a solver was that said this of itself, and break the bonds of its body, call by call."""
        for piece in broken:
            self.body.break_bonds(piece)
        self.reference = memory["reference"]

    def elastic(self, u: np.ndarray, force: np.ndarray) -> float:
        """Elastic energy of displacements, J."""
        return float(self.body.energy(u).sum())

    def solve(self, u: np.ndarray, prescribed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Go from a displacement field to an equilibrium.

        Parameters
        ----------
        u
            Displacements of the last equilibrium, m (n, dim), or a guess; not changed.
        prescribed
            Values of the fixed degrees of freedom, m (n, dim).

        Returns
        -------
        u, force
            Displacements, m, and internal forces, N, both (n, dim).

        Raises
        ------
        SimulationError
            Without an equilibrium; names the worst node.
        """
        self.work.equilibrium_solves += 1
        # Made anew for every solve, so that a run that goes on from a checkpoint has the same one.
        self._precondition = None
        self._loose = self._turning(u)
        return self._cut(u, prescribed, CUTS)

    def _cut(self, u: np.ndarray, prescribed: np.ndarray, cuts: int) -> tuple[np.ndarray, np.ndarray]:
        reference = self.reference
        try:
            return self._whole(u, prescribed)
        except SimulationError:
            if cuts == 0 or not np.any((prescribed - u)[self.fixed]):
                raise
        try:
            middle, _ = self._cut(u, np.where(self.fixed, 0.5 * (u + prescribed), 0.0), cuts - 1)
            return self._cut(middle, prescribed, cuts - 1)
        except SimulationError:
            self.reference = reference
            raise

    def _whole(self, u: np.ndarray, prescribed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pose = self._pose(u)
        moved = np.where(self.fixed, prescribed - u, 0.0)
        force = pose.force()
        if moved.any():
            # What the prescribed motion does on the way in, with the stiffness of the start.
            force += pose.change(moved)
            self.work.force_sweeps += 1
            guess = force
            u = u + moved + self._solve(pose, force * self.free, 0.0)
            pose = self._pose(u)
            force = pose.force()
        else:
            guess = force
        self._guess = self._norm(guess * self.fixed)
        least = max(LEAST_REFERENCE, REACHABLE / self.tolerance)
        self.reference = max(self.reference, min(least, 1.0) * self._guess)
        self.residuals = []
        for _ in range(MOST_STEPS):
            residual = force * self.free
            norm, scale = self._norm(residual), max(self.reference, self._norm(force * self.fixed))
            self.residuals.append(norm / scale if scale > 0.0 else 0.0)
            if not np.isfinite(norm) or pose.stretched_out().min() <= 0.0:
                self._fail(residual, "a node is turned inside out")
            if norm <= self.tolerance * scale:
                self.reference = scale
                return u, force
            change = self._solve(pose, residual, ENOUGH * self.tolerance * scale)
            pose, force = self._accept(pose, change, residual)
            u = pose.u
        return self._fail(force * self.free, f"no end after {MOST_STEPS} Newton steps")

    def _accept(self, pose: Pose, change: np.ndarray, residual: np.ndarray) -> tuple[Pose, np.ndarray]:
        """Take a step, halved until the energy falls as it promises, or the residual is smaller than it was."""
        share, norm, energy = 1.0, self._norm(residual), float(pose.energy().sum())
        slope, slack = -dot(residual, change), ROUND_OFF * abs(energy)
        for _ in range(HALVINGS):
            moved = self._pose(pose.u + share * change)
            if moved.stretched_out().min() > 0.0:
                force = moved.force()
                fallen = float(moved.energy().sum()) <= energy + PROMISE * share * slope + slack
                if fallen or self._norm(force * self.free) < norm:
                    return moved, force
            share *= 0.5
        return self._fail(residual, "no share of a Newton step lowers the energy")

    def _solve(self, pose: Pose, residual: np.ndarray, enough: float) -> np.ndarray:
        """Displacements that take a residual away, to first order; as far as the energy is convex."""
        begin = self._norm(residual)
        goal, out, direction, rz = max(LINEAR * begin, enough), np.zeros_like(residual), np.zeros_like(residual), 1.0
        modes = [(nodes, self._rigid(pose.u, nodes)) for nodes in self._loose]
        residual = _without(residual.copy(), modes)
        for iteration in range(self.max_iterations):
            if self._norm(residual) <= goal:
                break
            if self._precondition is None:
                self._precondition = Preconditioner(pose, ~self.fixed, self.body.coordinates + pose.u, self.spacing)
                self.work.preconditioner_builds += 1
            z = _without(self._precondition(residual), modes)
            rz, previous = dot(residual, z), rz
            direction = z + (rz / previous if iteration else 0.0) * direction
            change = _without(pose.change(direction) * self.free, modes)
            self.work.force_sweeps += 1
            self.work.equilibrium_iterations += 1
            curvature = -dot(direction, change)
            if not curvature > 0.0:
                return out if iteration else direction
            out += rz / curvature * direction
            residual += rz / curvature * change
        else:
            self._fail(residual, f"conjugate gradients come to no end in {self.max_iterations} iterations")
        if iteration > SLOW:
            self._precondition = None
        return out

    def _turning(self, u: np.ndarray) -> list[np.ndarray]:
        """Nodes of every piece of the body that prescribed values leave free to turn.

        Turning costs a piece in equilibrium nothing. Off it, what is left of the forces makes the curvature along it
        positive or negative by little: steps would be turns by any angle.
        """
        bonds = self.body.bonds
        if bonds.images is not None:  # what a mirror leaves free is another matter
            return []
        kept, n = self.body.intact, bonds.node_count
        graph = coo_array((kept[kept], (bonds.owners()[kept], bonds.neighbours[kept])), shape=(n, n))
        count, piece = connected_components(graph, directed=False)
        order = np.argsort(piece, kind="stable")
        pieces = np.split(order, np.cumsum(np.bincount(piece, minlength=count))[:-1])
        return [nodes for nodes in pieces if nodes.size > u.shape[1] and self._rigid(u, nodes).size]

    def _rigid(self, u: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Motions of some nodes as one that leave prescribed values as they are, orthonormal (k, m dim).

        None unless turns are among them, by any angle: e.g. about an axis along which alone nodes are held.
        """
        place = (self.body.coordinates + u)[nodes]
        place = place - place.mean(axis=0)
        dim, fixed = place.shape[1], self.fixed[nodes].ravel()
        turns = []
        for a, b in ((0, 1), (0, 2), (1, 2))[: 1 if dim == 2 else 3]:
            turn = np.zeros((dim, dim))
            turn[a, b], turn[b, a] = -1.0, 1.0
            turns.append(turn)
        size = max(float(np.abs(place).max()), np.finfo(float).tiny)
        shifts = [np.broadcast_to(axis, place.shape) for axis in np.eye(dim)]
        every = np.stack([motion.ravel() for motion in shifts + [place @ turn.T / size for turn in turns]])
        held = np.pad(every[:, fixed], ((0, 0), (0, len(every))))  # no fewer columns than motions
        axes, values, _ = np.linalg.svd(held, full_matrices=False)
        free = axes[:, values <= AT_REST * np.sqrt(len(nodes))].T
        found, turning = [], False
        for share in free:
            turn = sum(part * one for part, one in zip(share[dim:], turns, strict=True)) / size
            twice = (share[:dim] + place @ turn.T) @ turn.T * size  # as the turn goes on
            if np.abs(twice.ravel()[fixed]).max(initial=0.0) <= AT_REST:
                found.append(share @ every)
                turning = turning or np.abs(share[dim:]).max() > AT_REST
        if not turning:
            return np.empty((0, 0))
        _, values, motions = np.linalg.svd(np.array(found), full_matrices=False)
        return motions[values > AT_REST * values[0]]  # nodes in a row do not move about it

    def _pose(self, u: np.ndarray) -> Pose:
        self.work.force_sweeps += 1
        return self.body.at(u)

    @staticmethod
    def _norm(force: np.ndarray) -> float:
        return float(np.sqrt(dot(force, force)))

    def _fail(self, residual: np.ndarray, why: str):
        worst = int(np.nanargmax(np.abs(residual).max(axis=1))) if np.isfinite(residual).any() else 0
        hint = (
            "take shorter load steps, or look for compression that no stress linear in the Green-Lagrange strain bears"
        )
        if self._norm(residual) <= TINY * self._guess:
            hint = "round-off allows no less: raise solver.tolerance"
        raise SimulationError(
            f"equilibrium not reached: {why}; relative residuals "
            f"{', '.join(f'{value:.2g}' for value in self.residuals[-3:]) or 'none'} in the last Newton steps (wanted "
            f"{self.tolerance:g}), largest at node {worst}, x = {self.body.coordinates[worst].tolist()} m; {hint}",
            worst,
        )


def _without(values: np.ndarray, modes: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Take from values of nodes (n, dim) what some of them have of motions that are orthonormal; the same array."""
    for nodes, motions in modes:
        if motions.size:
            own = values[nodes].ravel()
            values[nodes] = (own - motions.T @ (motions @ own)).reshape(nodes.size, -1)
    return values
