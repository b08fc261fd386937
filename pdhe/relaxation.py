"""Static equilibrium by adaptive dynamic relaxation: the thesis' solver, with a stop that looks at the residual."""

from __future__ import annotations

import numpy as np

from pdhe.kernels.vectors import dot
from pdhe.materials import Body
from pdhe.solvers import STAGNATION, Equilibrium

#: Fictitious mass over the least that Gershgorin's theorem proves stable for a unit time step.
MASS_SAFETY = 1.05
#: Largest damping times time step: beyond 2 the scheme would no longer damp.
LARGEST_DAMPING = 1.9


class DynamicRelaxation(Equilibrium):
    """Relaxes a fictitious damped motion until the forces balance (theory, eqs. 7.3 to 7.6).

    Same interface, same stop and same result as conjugate gradients, at many more force sweeps: kept to compare with
    the thesis, and because it needs nothing but forces. An iteration is one force sweep.
    """

    def solve(self, u: np.ndarray, prescribed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bring a displacement field into equilibrium: see :meth:`pdhe.solvers.Equilibrium.solve`."""
        u = np.where(self.fixed, prescribed, u)
        force = self._force(u)
        self.work.equilibrium_solves += 1
        self.reference = max(self.reference, self._least_reference(force))
        residual = force * self.free
        norm = np.sqrt(dot(residual, residual))
        mass = fictitious_mass(self.body)
        inverse_mass = np.where(mass > 0.0, 1.0 / np.where(mass > 0.0, mass, 1.0), 0.0)
        start, first, velocity, iterations = u.copy(), force.copy(), np.zeros_like(u), 0
        best = norm
        while norm > self.tolerance * self._scale(force):
            best = min(best, norm)
            if iterations == self.max_iterations or not norm <= STAGNATION * best:
                self._fail(residual, norm, self._scale(force), iterations)
            damping = self._damping(u - start, (first - force) * self.free, mass)
            push = inverse_mass * residual
            # The first half step starts from rest.
            velocity = ((2.0 - damping) * velocity + 2.0 * push) / (2.0 + damping) if iterations else 0.5 * push
            u += velocity
            force = self._force(u)
            residual = force * self.free
            norm = np.sqrt(dot(residual, residual))
            iterations += 1
        self.work.equilibrium_iterations += iterations
        self.reference = self._scale(force)
        return u, force

    @staticmethod
    def _damping(moved: np.ndarray, resisted: np.ndarray, mass: np.ndarray) -> float:
        """Critical damping of the motion so far: twice the root of its Rayleigh quotient.

        For a linear body the change of force is exactly the stiffness times the way moved, so that no diagonal has to
        be guessed from increments.
        """
        weight = dot(moved, mass * moved)
        if weight <= 0.0:
            return 0.0
        return min(2.0 * np.sqrt(max(dot(moved, resisted), 0.0) / weight), LARGEST_DAMPING)


def fictitious_mass(body: Body) -> np.ndarray:
    """Mass that keeps a unit step stable, N/m (n, 2): a quarter of Gershgorin's bound on each row (theory, eq. 7.5)."""
    return 0.25 * MASS_SAFETY * body.stiffness_rows()
