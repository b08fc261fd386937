"""Static equilibrium: preconditioned conjugate gradients on the matrix-free stiffness (theory, section 7)."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from pdhe.errors import SimulationError
from pdhe.kernels.vectors import dot
from pdhe.materials import Body
from pdhe.mirrors import Images

#: Bonds up to this many spacings make up the coarse operator: on a square lattice, the eight nearest nodes.
SHORT_REACH = 1.6
#: Relative diagonal shift of the coarse operator. Free fragments make it singular; the shift only bounds how much of a
#: rigid motion the preconditioner may propose, it does not enter the equations that are solved.
COARSE_SHIFT = 1e-9
#: Unknowns up to which the coarse operator is factorised; beyond, one multigrid cycle stands for its inverse. A factor
#: costs more than linearly; at this size, some 100,000 nodes, both take about as long.
FACTORISE_UP_TO = 35_000
#: How prolongation is smoothed: the default would estimate a spectral radius from random vectors.
SMOOTH = ("jacobi", {"weighting": "local"})
#: The coarse operator is rebuilt once the solves since the last time took so many iterations more, in all, than the
#: shortest of them: about what building costs.
REBUILD_AFTER = 30
#: Least reference of residuals, as a share of the forces that hold the first guess of a solve, which exceed those in
#: equilibrium by about a third of the plate's height in spacings.
LEAST_REFERENCE = 1e-3
#: Residual over the forces of a first guess that round-off lets a solve reach in any case.
REACHABLE = 1e-12
#: What may be wrong where the tangential stiffness is negative.
INDEFINITE = (
    "the stiffness is no longer positive: above 1/3 (1/4 in plane strain), Poisson's ratio asks for a negative "
    "tangential stiffness, which needs whole families around a node; lower material.poissons_ratio, raise "
    "horizon.ratio, or take a finer mesh"
)
#: A residual that has grown by this factor over the least one will not fall again.
STAGNATION = 1e6
#: Growth of a residual over the least one from which a solve starts again from where it is, with forces computed anew,
#: and how often; only where Young's modulus differs by place.
RESTART, MOST_RESTARTS = 10.0, 20
#: Relative residual below which only round-off keeps the iterations from going on.
ROUND_OFF = 1e-9


class Preconditioner:
    """Two-level additive preconditioner: a coarse operator for long waves plus the inverse diagonal for short ones.

    The stiffness of a horizon-wide family behaves like that of the nearest neighbours for long waves and like a
    constant for waves shorter than the horizon, so that its inverse is close to the *sum* of a coarse-grid inverse and
    the inverse diagonal. The coarse space is smoothed aggregation over the short bonds (same cuts and broken bonds),
    with the rigid motions as near-null space; the coarse matrix is factorised.
    """

    def __init__(self, body: Body, free: np.ndarray, coordinates: np.ndarray, spacing: np.ndarray) -> None:
        import pyamg

        n, axes = coordinates.shape
        self.free = free.astype(float)
        diagonal = body.diagonal()
        self.inverse_diagonal = np.where(free & (diagonal > 0.0), 1.0 / np.where(diagonal > 0.0, diagonal, 1.0), 0.0)
        starts, column, value = body.short_stiffness(0.5 * SHORT_REACH * spacing, self.free)
        images = body.bonds.images
        if images is None:
            matrix = sp.bsr_matrix((value, column, starts), shape=(axes * n, axes * n))
        else:
            # What an image's displacement does is done by that of its node.
            matrix = sp.bsr_matrix((value, column, starts), shape=(2 * n, 2 * len(images.positions)))
            matrix = matrix @ _continuation(images)
            matrix.sort_indices()
        del starts, column, value
        centred = coordinates - coordinates.mean(axis=0)
        modes = (_rigid_motions(centred) * self.free[:, :, None]).reshape(axes * n, -1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # Rigid motions need no improving sweeps: with and without, iterations are the same (5e3 to 3e5 nodes).
            hierarchy = pyamg.smoothed_aggregation_solver(
                matrix, B=modes, smooth=SMOOTH, improve_candidates=None, max_levels=2, max_coarse=50
            )
        if len(hierarchy.levels) == 1:
            self.prolongate, coarse = sp.identity(axes * n, format="csr"), matrix.tocsc()
        else:
            self.prolongate, coarse = hierarchy.levels[0].P.tocsr(), hierarchy.levels[1].A.tocsc()
        coarse_modes = hierarchy.levels[-1].B
        del hierarchy, matrix
        scale = coarse.diagonal()
        shift = COARSE_SHIFT * float(scale.max(initial=0.0)) + np.where(scale > 0.0, 0.0, 1.0)
        coarse = (coarse + sp.diags(shift)).tocsc()
        self._solve_coarse = coarse_inverse(coarse, coarse_modes)
        # A copy is 2 % faster than a view; where the coarse operator is large, the view saves memory.
        self.restrict = self.prolongate.T.tocsr() if coarse.shape[0] <= FACTORISE_UP_TO else self.prolongate.T

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Apply to a residual, N (n, 2); gives a displacement, m (n, 2)."""
        coarse = self._solve_coarse(self.restrict @ residual.reshape(-1))
        return ((self.prolongate @ coarse).reshape(residual.shape) + self.inverse_diagonal * residual) * self.free


def _rigid_motions(x: np.ndarray) -> np.ndarray:
    """Translations and rotations of positions: (n, 2) to (n, 2, 3), (n, 3) to (n, 3, 6)."""
    n, axes = x.shape
    turns = ((0, 1),) if axes == 2 else ((0, 1), (1, 2), (2, 0))
    modes = np.zeros((n, axes, axes + len(turns)))
    for axis in range(axes):
        modes[:, axis, axis] = 1.0
    for k, (a, b) in enumerate(turns, axes):
        modes[:, a, k], modes[:, b, k] = -x[:, b], x[:, a]
    return modes


def coarse_inverse(matrix: sp.spmatrix, modes: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return what solves with a coarse operator: its factors where it is small, else one multigrid cycle, symmetric.

    Parameters
    ----------
    matrix
        Symmetric and positive definite (m, m).
    modes
        Its near-null space (m, k); unknowns come in blocks of k.
    """
    if matrix.shape[0] <= FACTORISE_UP_TO:
        return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve
    import pyamg

    size = modes.shape[1]
    smoother = "gauss_seidel" if size == 1 else "block_gauss_seidel"
    # Forward sweeps before and backward ones after keep the cycle symmetric, at half the sweeps of the default.
    before, after = ((smoother, {"sweep": sweep}) for sweep in ("forward", "backward"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        hierarchy = pyamg.smoothed_aggregation_solver(
            matrix.tocsr() if size == 1 else matrix.tobsr((size, size)), B=modes, smooth=SMOOTH,
            improve_candidates=None, presmoother=before, postsmoother=after, max_coarse=1000, coarse_solver="splu",
        )  # fmt: skip
    return partial(_cycle, hierarchy)


def _continuation(images: Images) -> sp.bsr_matrix:
    """Displacements of nodes to those of nodes and images, in blocks of 2 by 2."""
    n, count = images.nodes, len(images.positions)
    value = np.zeros((count, 2, 2))
    value[:n] = np.eye(2)
    value[n:, [0, 1], [0, 1]] = images.sign
    nodes = images.fold(np.arange(count, dtype=np.int32))
    return sp.bsr_matrix((value, nodes, np.arange(count + 1, dtype=np.int32)), shape=(2 * count, 2 * n))


def _cycle(hierarchy: Any, b: np.ndarray, level: int = 0) -> np.ndarray:
    """One W-cycle from rest: 13 and 14 iterations at 3e5 and 1e6 nodes, where a V-cycle takes 15 and 20.

    pyamg's own cycle takes residual norms around it, which doubles its cost.
    """
    here = hierarchy.levels[level]
    if level == len(hierarchy.levels) - 1:
        return hierarchy.coarse_solver(here.A, b)
    x = np.zeros_like(b)
    here.presmoother(here.A, x, b)
    for _ in range(2):
        x += here.P @ _cycle(hierarchy, here.R @ (b - here.A @ x), level + 1)
    here.postsmoother(here.A, x, b)
    return x


@dataclass
class Work:
    """Counted work, equal on every machine."""

    equilibrium_solves: int = 0
    equilibrium_iterations: int = 0
    force_sweeps: int = 0
    preconditioner_builds: int = 0


class Equilibrium:
    """Finds displacements in static equilibrium for prescribed values, warm-started, to a stated residual.

    Parameters
    ----------
    body
        Bonds and their present breakage.
    fixed
        Prescribed degrees of freedom, bool (n, 2).
    tolerance
        Norm of the residual over the free degrees of freedom, relative to that of the forces at the prescribed ones;
        the largest such norm of the run counts, so that a plate that has come apart still has a scale. Where Young's
        modulus differs by place, the residual of each node counts as often as its bonds are softer than the stiffest.
    """

    def __init__(
        self,
        body: Body,
        fixed: np.ndarray,
        coordinates: np.ndarray,
        spacing: np.ndarray,
        tolerance: float,
        max_iterations: int,
    ) -> None:
        self.body, self.fixed, self.coordinates, self.spacing = body, fixed, coordinates, spacing
        self.free = (~fixed).astype(float)
        self._held_rows = np.nonzero(fixed)
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.reference = 0.0
        softness = body.softness()
        # Forces within a soft part are small beside those of a stiff one, and its residual has to be as small.
        self._weights = None if softness is None else softness[:, None]
        self._contrast = 1.0 if softness is None else float(softness.max(initial=1.0))
        self.work = Work()
        self._preconditioner: Preconditioner | None = None
        self._baseline, self._excess = max_iterations, 0
        self._built_after = 0

    def memory(self) -> dict[str, Any]:
        """What later solves depend on, beside the broken bonds; the work counted so far is apart."""
        built = None if self._preconditioner is None else self._built_after
        return {"reference": self.reference, "baseline": self._baseline, "excess": self._excess, "built_after": built}

    def recall(self, memory: Mapping[str, Any], broken: Sequence[np.ndarray]) -> None:
        """Become as a solver was that said this of itself, and break the bonds of its body, call by call."""
        built_after = memory["built_after"]
        for count in range(len(broken) + 1):
            if count == built_after:
                self._preconditioner = Preconditioner(self.body, ~self.fixed, self.coordinates, self.spacing)
                self._built_after = count
            if count < len(broken):
                self.body.break_bonds(broken[count])
        self.reference, self._baseline, self._excess = memory["reference"], memory["baseline"], memory["excess"]

    def solve(self, u: np.ndarray, prescribed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bring a displacement field into equilibrium.

        Parameters
        ----------
        u
            Starting guess, m (n, 2); not changed.
        prescribed
            Values of the fixed degrees of freedom, m (n, 2).

        Returns
        -------
        u, force
            Displacements, m, and internal forces, N, both (n, 2).

        Raises
        ------
        SimulationError
            If the residual is still too large after ``max_iterations``, or is not finite; names the worst node.
        """
        u = np.where(self.fixed, prescribed, u)
        force = self._force(u)
        self.work.equilibrium_solves += 1
        residual = force * self.free
        norm = self._norm(residual)
        # A plate in pieces needs no force at all: the reference is never less than a small share of a first guess'.
        self.reference = max(self.reference, self._least_reference(force))
        if norm <= self.tolerance * self._scale(force):
            self.reference = self._scale(force)
            return u, force
        if self._preconditioner is None:
            self._build()
        iterations, direction, rz, best, restarts = 0, np.zeros_like(u), 1.0, np.inf, 0
        while norm > self.tolerance * self._scale(force):
            if iterations == self.max_iterations or not np.isfinite(norm):
                self._fail(residual, norm, self._scale(force), iterations)
            if self._weights is not None and norm > RESTART * best and restarts < MOST_RESTARTS:
                # Round-off of a first guess in a stiff part, a million times the forces looked for, has summed up.
                force = self._force(u)
                residual, best, restarts = force * self.free, np.inf, restarts + 1
                norm = self._norm(residual)
                direction[:] = 0.0
            z = self._preconditioner(residual)
            rz, previous = dot(residual, z), rz
            direction *= rz / previous
            direction += z
            change = self._force(direction)
            curvature = -dot(direction, change * self.free)
            best = min(best, norm)
            if not curvature > 0.0 or norm > STAGNATION * max(best, np.finfo(float).tiny):
                # Round-off has the last word, or the stiffness is indefinite: going on would only lead away.
                self._fail(residual, best, self._scale(force), iterations)
            step = rz / curvature
            u += step * direction
            force += step * change
            residual = force * self.free
            norm = self._norm(residual)
            iterations += 1
        self.work.equilibrium_iterations += iterations
        self.reference = self._scale(force)
        self._baseline = min(self._baseline, iterations)
        self._excess += iterations - self._baseline
        if self._excess > REBUILD_AFTER:
            self._preconditioner = None
        return u, force

    @staticmethod
    def elastic(u: np.ndarray, force: np.ndarray) -> float:
        """Elastic energy in equilibrium, J: half the work of the forces that hold the body, without another sweep."""
        return -0.5 * float(np.sum(force * u))

    def meet(self, force: np.ndarray) -> None:
        """Take forces of an equilibrium, N (n, dim), into the reference of residuals."""
        self.reference = self._scale(force)

    def _force(self, u: np.ndarray) -> np.ndarray:
        self.work.force_sweeps += 1
        return self.body.force(u)

    def _scale(self, force: np.ndarray) -> float:
        """Force that a residual is compared with: the largest that equilibria needed so far, or the present one, N.

        Forces on the way to an equilibrium do not stay in the reference: those of a first guess are far too large.
        """
        return max(self.reference, self._held(force))

    def _norm(self, residual: np.ndarray) -> float:
        scaled = residual if self._weights is None else residual * self._weights
        return float(np.sqrt(dot(scaled, scaled)))

    def _least_reference(self, guess: np.ndarray) -> float:
        # Where a stiff part is moved against a soft one, the guess exceeds equilibrium by their ratio too.
        share = max(LEAST_REFERENCE / self._contrast, REACHABLE / self.tolerance)
        return min(share, 1.0) * self._held(guess)

    def _held(self, force: np.ndarray) -> float:
        held = force[self._held_rows]
        return float(np.sqrt(dot(held, held)))

    def _build(self) -> None:
        self._preconditioner = Preconditioner(self.body, ~self.fixed, self.coordinates, self.spacing)
        self._baseline, self._excess = self.max_iterations, 0
        self._built_after = len(self.body.broken)
        self.work.preconditioner_builds += 1

    def _fail(self, residual: np.ndarray, norm: float, scale: float, iterations: int) -> None:
        scale = max(scale, 1e-300)
        worst = int(np.nanargmax(np.abs(residual).max(axis=1))) if np.isfinite(residual).any() else 0
        raise SimulationError(
            f"equilibrium not reached: relative residual {norm / scale:.3g} after {iterations} "
            f"iterations (wanted {self.tolerance:g}); largest at node {worst}, "
            f"x = {self.coordinates[worst].tolist()} m; " + self._hint(norm > ROUND_OFF * scale, iterations),
            worst,
        )

    def _hint(self, far: bool, iterations: int) -> str:
        if far and iterations < self.max_iterations and self.body.can_be_indefinite:
            return INDEFINITE
        if far or iterations == self.max_iterations:
            return "raise solver.max_iterations or solver.tolerance"
        return "round-off allows no less: raise solver.tolerance"
