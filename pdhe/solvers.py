"""Static equilibrium: preconditioned conjugate gradients on the matrix-free stiffness (theory, section 7)."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from pdhe.errors import SimulationError
from pdhe.kernels.vectors import dot
from pdhe.materials import Body

#: Bonds up to this many spacings make up the coarse operator: on a square lattice, the eight nearest nodes.
SHORT_REACH = 1.6
#: Relative diagonal shift of the coarse operator. Free fragments make it singular; the shift only bounds how much of a
#: rigid motion the preconditioner may propose, it does not enter the equations that are solved.
COARSE_SHIFT = 1e-9
#: Unknowns up to which the coarse operator is factorised; beyond, one multigrid cycle stands for its inverse. A factor
#: costs more than linearly; at this size both take about as long.
FACTORISE_UP_TO = 60_000
#: The coarse operator is rebuilt once the solves since the last time took so many iterations more, in all, than the
#: shortest of them: about what building costs.
REBUILD_AFTER = 80


class Preconditioner:
    """Two-level additive preconditioner: a coarse operator for long waves plus the inverse diagonal for short ones.

    The stiffness of a horizon-wide family behaves like that of the nearest neighbours for long waves and like a
    constant for waves shorter than the horizon, so that its inverse is close to the *sum* of a coarse-grid inverse and
    the inverse diagonal. The coarse space is smoothed aggregation over the short bonds (same cuts and broken bonds),
    with the rigid motions as near-null space; the coarse matrix is factorised.
    """

    def __init__(self, body: Body, free: np.ndarray, coordinates: np.ndarray, spacing: np.ndarray) -> None:
        import pyamg

        n = coordinates.shape[0]
        self.free = free.astype(float)
        diagonal = body.diagonal()
        self.inverse_diagonal = np.where(free & (diagonal > 0.0), 1.0 / np.where(diagonal > 0.0, diagonal, 1.0), 0.0)
        matrix = short_bond_matrix(body, self.free, spacing)
        centred = coordinates - coordinates.mean(axis=0)
        modes = np.zeros((n, 2, 3))
        modes[:, 0, 0] = modes[:, 1, 1] = 1.0
        modes[:, 0, 2], modes[:, 1, 2] = -centred[:, 1], centred[:, 0]
        modes = (modes * self.free[:, :, None]).reshape(2 * n, 3)
        smooth = ("jacobi", {"weighting": "local"})  # the default would estimate a spectral radius from random vectors
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # Rigid motions need no improving sweeps: with and without, iterations are the same (5e3 to 3e5 nodes).
            hierarchy = pyamg.smoothed_aggregation_solver(
                matrix, B=modes, smooth=smooth, improve_candidates=None, max_levels=2, max_coarse=50
            )
        if len(hierarchy.levels) == 1:
            self.prolongate, coarse = sp.identity(2 * n, format="csr"), matrix.tocsc()
        else:
            self.prolongate, coarse = hierarchy.levels[0].P.tocsr(), hierarchy.levels[1].A.tocsc()
        self.restrict = self.prolongate.T.tocsr()
        scale = coarse.diagonal()
        shift = COARSE_SHIFT * float(scale.max(initial=0.0)) + np.where(scale > 0.0, 0.0, 1.0)
        coarse = (coarse + sp.diags(shift)).tocsc()
        if coarse.shape[0] <= FACTORISE_UP_TO:
            options = {"SymmetricMode": True}
            self._solve_coarse = splu(coarse, permc_spec="MMD_AT_PLUS_A", options=options).solve
        else:
            blocks = coarse.tobsr((3, 3))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                cycle = pyamg.smoothed_aggregation_solver(
                    blocks, B=hierarchy.levels[1].B, smooth=smooth, improve_candidates=None, max_coarse=1000,
                    coarse_solver="splu",
                )  # fmt: skip
            self._solve_coarse = cycle.aspreconditioner(cycle="V").matvec

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Apply to a residual, N (n, 2); gives a displacement, m (n, 2)."""
        coarse = self._solve_coarse(self.restrict @ residual.reshape(-1))
        return ((self.prolongate @ coarse).reshape(residual.shape) + self.inverse_diagonal * residual) * self.free


def short_bond_matrix(body: Body, free: np.ndarray, spacing: np.ndarray) -> sp.bsr_matrix:
    """Stiffness of the short bonds alone, scaled to the energy that all bonds have under a uniform strain, N/m.

    Fixed degrees of freedom keep a diagonal entry only.
    """
    b = body.bonds
    n = b.node_count
    owner = b.owners()
    short = b.length <= SHORT_REACH * 0.5 * (spacing[owner] + spacing[b.neighbours])
    stiffness = b.weight * b.length
    scale = body.normal * stiffness.sum() / max(stiffness[short].sum(), np.finfo(float).tiny)
    rows = np.flatnonzero(short & body.intact)
    i, j = owner[rows], b.neighbours[rows]
    c = scale * b.weight[rows] / b.length[rows]
    nx, ny = b.nx[rows], b.ny[rows]
    block = np.empty((rows.size, 2, 2))
    block[:, 0, 0], block[:, 1, 1] = c * nx * nx, c * ny * ny
    block[:, 0, 1] = block[:, 1, 0] = c * nx * ny
    own = np.zeros((n, 2, 2))
    for a in range(2):
        for d in range(2):
            own[:, a, d] = np.bincount(i, block[:, a, d], n)
    block *= -free[i][:, :, None] * free[j][:, None, :]
    own *= free[:, :, None] * free[:, None, :]
    typical = float(own[:, 0, 0].max(initial=0.0)) or 1.0
    for a in range(2):
        own[:, a, a] = np.where(own[:, a, a] > 1e-9 * typical, own[:, a, a], typical)
    # Bonds stand row by row with ascending neighbours; the diagonal block goes between the lower and the higher ones.
    number = np.arange(n)
    starts = np.concatenate([[0], np.cumsum(np.bincount(i, minlength=n))]) + np.arange(n + 1)
    diagonal = starts[:-1] + np.bincount(i, j < i, n).astype(np.int64)
    column, value = np.empty(starts[-1], np.int32), np.empty((starts[-1], 2, 2))
    place = np.arange(rows.size) + i + (j > i)
    column[diagonal], column[place] = number, j
    value[diagonal], value[place] = own, block
    return sp.bsr_matrix((value, column, starts), shape=(2 * n, 2 * n))


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
        the largest such norm of the run counts, so that a plate that has come apart still has a scale.
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
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.reference = 0.0
        self.work = Work()
        self._preconditioner: Preconditioner | None = None
        self._baseline, self._excess = max_iterations, 0

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
        norm = np.sqrt(dot(residual, residual))
        self._raise_reference(force)
        if norm <= self.tolerance * self.reference:
            return u, force
        if self._preconditioner is None:
            self._build()
        iterations, direction, rz = 0, np.zeros_like(u), 1.0
        while norm > self.tolerance * self.reference:
            if iterations == self.max_iterations or not np.isfinite(norm):
                self._fail(residual, norm, iterations)
            z = self._preconditioner(residual)
            rz, previous = dot(residual, z), rz
            direction *= rz / previous
            direction += z
            change = self._force(direction)
            step = rz / -dot(direction, change * self.free)
            u += step * direction
            force += step * change
            residual = force * self.free
            norm = np.sqrt(dot(residual, residual))
            iterations += 1
        self.work.equilibrium_iterations += iterations
        self._raise_reference(force)
        self._baseline = min(self._baseline, iterations)
        self._excess += iterations - self._baseline
        if self._excess > REBUILD_AFTER:
            self._preconditioner = None
        return u, force

    def _force(self, u: np.ndarray) -> np.ndarray:
        self.work.force_sweeps += 1
        return self.body.force(u)

    def _raise_reference(self, force: np.ndarray) -> None:
        held = force * self.fixed
        self.reference = max(self.reference, float(np.sqrt(dot(held, held))))

    def _build(self) -> None:
        self._preconditioner = Preconditioner(self.body, ~self.fixed, self.coordinates, self.spacing)
        self._baseline, self._excess = self.max_iterations, 0
        self.work.preconditioner_builds += 1

    def _fail(self, residual: np.ndarray, norm: float, iterations: int) -> None:
        worst = int(np.nanargmax(np.abs(residual).max(axis=1))) if np.isfinite(residual).any() else 0
        raise SimulationError(
            f"equilibrium not reached: relative residual {norm / max(self.reference, 1e-300):.3g} after {iterations} "
            f"iterations (wanted {self.tolerance:g}); largest at node {worst}, "
            f"x = {self.coordinates[worst].tolist()} m; raise solver.max_iterations or solver.tolerance"
        )
