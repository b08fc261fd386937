"""The part of a run that changes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass
class State:
    """Present state of a run; arrays of absent physics are None.

    Attributes
    ----------
    time
        s.
    displacement, force
        m and N, (n, dim).
    velocity
        m/s (n, dim); None without inertia.
    coverage
        Hydrogen coverage (n,).
    held
        Nodes whose coverage is prescribed, bool (n,).
    saturated
        Held nodes that became so by damage, bool (n,).
    supply
        Hydrogen that entered through each node, m^3 (n,).
    long_step
        Length that the next long diffusion step should try, s.
    external_work, fracture_energy, broken_bonds
        J, J and a number, of the whole body where only a part of it is computed.
    stepper
        What takes long diffusion steps, kept while held nodes and edges stay as they are.
    began, allowed, resume, far
        Of a stretch of diffusion under way: when it began; the length that its next plain step may have; when long
        steps are tried again, all s; and, of those while nothing can break, what a ``Stretch`` of supersteps keeps.
        None between stretches.
    """

    time: float = 0.0
    displacement: np.ndarray | None = None
    force: np.ndarray | None = None
    velocity: np.ndarray | None = None
    coverage: np.ndarray | None = None
    held: np.ndarray | None = None
    saturated: np.ndarray | None = None
    supply: np.ndarray | None = None
    long_step: float = 0.0
    stepper: Any = None
    began: float | None = None
    allowed: float | None = None
    resume: float | None = None
    far: np.ndarray | None = None
    external_work: float = 0.0
    damping_loss: float = 0.0
    fracture_energy: float = 0.0
    broken_bonds: int = 0
    failure_rounds: int = 0
    diffusion_sweeps: int = 0
    diffusion_iterations: int = 0
    crack_extension: float = 0.0
    crack_tip: np.ndarray = field(default_factory=lambda: np.full(2, np.nan))


@dataclass
class Motion:
    """Displacements between two times with prescribed values linear in between: linear too, while nothing breaks.

    Attributes
    ----------
    t0, t1
        s.
    u0, u1, force0, force1
        Displacements, m, and internal forces, N, at the two times, (n, 2).
    """

    t0: float
    t1: float
    u0: np.ndarray
    u1: np.ndarray
    force0: np.ndarray
    force1: np.ndarray

    def fraction(self, t: float) -> float:
        """Share of the way from ``t0`` to ``t1`` at time t."""
        return 1.0 if self.t1 <= self.t0 else min(max((t - self.t0) / (self.t1 - self.t0), 0.0), 1.0)

    @property
    def moving(self) -> bool:
        """Whether the displacements change at all."""
        return self.u1 is not self.u0

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Displacements and forces at time t."""
        if not self.moving:
            return self.u0, self.force0
        f = self.fraction(t)
        return self.u0 + f * (self.u1 - self.u0), self.force0 + f * (self.force1 - self.force0)
