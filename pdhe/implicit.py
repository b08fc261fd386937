"""Implicit diffusion steps, where explicit ones would need too many stages (theory, eq. 4.15)."""

from __future__ import annotations

import math
import warnings

import numpy as np
import scipy.sparse as sp

from pdhe.errors import SimulationError
from pdhe.kernels.vectors import dot
from pdhe.solvers import SHORT_REACH, SMOOTH, coarse_inverse
from pdhe.transport import Diffusion

#: The coefficient that makes two equal stages of second order and damp the shortest waves completely.
GAMMA = 1.0 - math.sqrt(0.5)
#: Root mean square of the residual, in coverage, to which a stage is solved: a tenth of what may be out of bounds.
RESIDUAL = 1e-13
#: The coarse matrix is factorised again once the step is this much longer or shorter: measured, 1.5 costs one or two
#: iterations of twenty, a factor about twenty.
REFACTOR = 1.5
#: Iterations after which a solve is given up; 10 to 25 are usual, whatever the mesh and the length of the step.
MOST_ITERATIONS = 300


class ImplicitStepper:
    """Diagonally implicit Runge-Kutta steps of two stages: second order, L-stable, stiffly accurate (eq. 4.15).

    The systems ``V (I - gamma dt K)`` are symmetric, positive definite and solved by conjugate gradients with the
    matrix as sweeps. The preconditioner is that of the equilibrium with one unknown a node: a coarse operator from the
    short bonds for long waves plus the inverse diagonal for short ones.

    Parameters
    ----------
    diffusion, held, source
        As in :meth:`pdhe.transport.Diffusion.step`; constant.
    """

    def __init__(self, diffusion: Diffusion, held: np.ndarray, source: np.ndarray) -> None:
        import pyamg

        self.diffusion, self.held, self.source = diffusion, held, source
        self.iterations = 0
        self._free = (~held).astype(float)
        self._outflow = diffusion.bonds.sum_by_node(diffusion.rate) + diffusion.sink()
        self._nothing, self._unused = np.zeros_like(source), np.zeros_like(source)
        self.factored = 0.0
        short = short_bond_matrix(diffusion, self._free)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            hierarchy = pyamg.smoothed_aggregation_solver(
                short, B=self._free[:, None].copy(), smooth=SMOOTH, improve_candidates=None, max_levels=2, max_coarse=50
            )
        whole = sp.identity(held.size, format="csr")
        self._prolongate = hierarchy.levels[0].P.tocsr() if len(hierarchy.levels) > 1 else whole
        self._restrict = self._prolongate.T.tocsr()
        self._modes = hierarchy.levels[-1].B
        self._mass = self._restrict @ sp.diags(diffusion.volume * self._free) @ self._prolongate
        self._flow = self._restrict @ sp.diags(self._free) @ short @ self._prolongate

    def step(self, psi: np.ndarray, rate: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
        """Coverage after the first stage, at ``GAMMA`` of a step of a length, s, and at its end.

        ``rate`` is the rate of change at ``psi``. What enters during the step is the length times
        ``1 - GAMMA`` and ``GAMMA`` times the flow at these two coverages.

        Raises
        ------
        SimulationError
            If the equations cannot be solved.
        """
        dt, volume = GAMMA * length, self.diffusion.volume
        self.prepare(dt)
        first, rest = self._solve(psi, volume * dt * rate * self._free, dt)
        # What the second stage has on its right beyond the first, whose own residual goes on in it.
        ahead = (1.0 - GAMMA) / GAMMA * (first - psi)
        second, _ = self._solve(first, volume * ahead * self._free + rest, dt)
        return first, second

    def prepare(self, dt: float) -> None:
        """Make ready for solves over ``dt`` seconds times the coefficient; factors that are near enough stay."""
        self._inverse_diagonal = self._free / (self.diffusion.volume * (1.0 + dt * self._outflow))
        if self.factored / REFACTOR <= dt <= self.factored * REFACTOR:
            return
        coarse = self._mass + dt * self._flow
        scale = coarse.diagonal()
        coarse = coarse + sp.diags(np.where(scale > 0.0, 0.0, 1.0))
        self._solve_coarse = coarse_inverse(coarse, self._modes)
        self.factored = dt

    def _solve(self, psi: np.ndarray, residual: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Take its known residual, m^3, off a coverage; gives that and what is left of the residual."""
        volume = self.diffusion.volume
        goal = RESIDUAL * math.sqrt(dot(volume, volume))
        psi, residual, applied = psi.copy(), residual.copy(), np.empty_like(psi)
        direction, rz, count = np.zeros_like(psi), 1.0, 0
        while (norm := math.sqrt(dot(residual, residual))) > goal:
            if count == MOST_ITERATIONS or not np.isfinite(norm):
                raise SimulationError(
                    f"implicit diffusion step of {dt / GAMMA:.3g} s not solved: residual {norm:.3g} m^3 after {count} "
                    f"iterations (wanted {goal:.3g})"
                )
            z = self._prolongate @ self._solve_coarse(self._restrict @ residual) + self._inverse_diagonal * residual
            rz, previous = dot(residual, z), rz
            direction *= rz / previous
            direction += z
            self.diffusion.step(direction, dt, self.held, self._nothing, applied, self._unused)
            change = volume * (2.0 * direction - applied) * self._free
            share = rz / dot(direction, change)
            psi += share * direction
            residual -= share * change
            count += 1
        self.iterations += count
        return psi, residual


def short_bond_matrix(diffusion: Diffusion, free: np.ndarray) -> sp.csr_matrix:
    """Flow between nodes through the short bonds alone, scaled to the second moment of all bonds, m^3/s (n, n).

    Short is up to 1.6 distances to the nearest node. Nodes that are not free keep a diagonal entry only.
    """
    bonds, volume = diffusion.bonds, diffusion.volume
    n, owner = volume.size, bonds.owners()
    nearest = np.full(n, np.inf)
    np.minimum.at(nearest, owner, bonds.length)
    short = bonds.length <= SHORT_REACH * 0.5 * (nearest[owner] + nearest[bonds.neighbours])
    flow = volume[owner] * diffusion.rate
    moment = flow * bonds.length**2
    scale = float(moment.sum() / max(moment[short].sum(), np.finfo(float).tiny))
    rows = np.flatnonzero(short)
    i, j = owner[rows], bonds.neighbours[rows]
    value = scale * flow[rows] * free[i]
    own = np.bincount(i, value, n) + volume * diffusion.sink() * free
    typical = float(own.max(initial=0.0)) or 1.0
    return sp.csr_matrix((-value * free[j], (i, j)), shape=(n, n)) + sp.diags(np.where(own > 0.0, own, typical))
