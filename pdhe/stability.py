"""Whether the stiffness of a body is positive, which a negative tangential stiffness can undo (theory, section 2)."""

from __future__ import annotations

import numpy as np

from pdhe.kernels.vectors import dot
from pdhe.materials import Body

#: Lanczos steps. They find a least eigenvalue of -1e-3 of the largest; weaker ones, which take longer, show up as
#: directions of negative curvature in conjugate gradients.
STEPS = 120
#: What counts as negative, over the largest eigenvalue: far above round-off, which gives -2e-15.
NEGATIVE = -1e-9


def least_eigenvalue(body: Body, free: np.ndarray, steps: int = STEPS) -> float:
    """Least eigenvalue of the stiffness over the largest, as far as Lanczos steps from a random field see it.

    Never below the true one. Costs ``steps`` force sweeps and three fields of memory.

    Parameters
    ----------
    body
        The bonds as they are now.
    free
        Degrees of freedom that are not prescribed, bool (n, 2).
    """
    mask = free.astype(float)
    here = np.random.default_rng(0).standard_normal(free.shape) * mask
    length = np.sqrt(dot(here, here))
    if length == 0.0:
        return 0.0
    here, before, beside = here / length, np.zeros_like(here), 0.0
    diagonal, side = [], []
    for _ in range(min(steps, int(free.sum()))):
        there = -body.force(here) * mask - beside * before
        along = dot(there, here)
        there -= along * here
        diagonal.append(along)
        beside = float(np.sqrt(dot(there, there)))
        if beside <= 1e-14 * max(abs(d) for d in diagonal):
            break
        side.append(beside)
        before, here = here, there / beside
    side = side[: len(diagonal) - 1]
    values = np.linalg.eigvalsh(np.diag(diagonal) + np.diag(side, 1) + np.diag(side, -1))
    largest = float(np.abs(values).max())
    return float(values[0]) / largest if largest > 0.0 else 0.0
