"""Static equilibrium of bodies with a history, increment by increment: Newton's method (theory, section 7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pdhe.errors import SimulationError
from pdhe.fields import FIELDS
from pdhe.kernels.vectors import dot
from pdhe.materials.user import SolidUserBody, UserBody
from pdhe.netcdf import Variable, write_netcdf
from pdhe.solvers import Preconditioner, Work

#: Residual of a linear solve over the one it started from: less makes no Newton step shorter that is not the last.
LINEAR = 1e-4
#: Linear iterations after which a solve is given up, unless another number is asked for.
MOST_LINEAR = 2000
#: Times that a step is halved before it is taken for a failure.
HALVINGS = 8


class Increments:
    """Brings a body with a history from one equilibrium to the next.

    Every Newton step solves with the tangent of the last trial by conjugate gradients; a step that does not lower the
    residual is halved. The history is committed once the equilibrium is there.

    Parameters
    ----------
    body
        The body; its history is advanced.
    fixed
        Prescribed degrees of freedom, bool (n, dim).
    spacing
        Of each node, m (n,).
    tolerance
        Norm of the residual over the free degrees of freedom, relative to that of the forces at the prescribed ones,
        the largest of the history counting.
    most_iterations
        Newton steps of an increment.
    cuts
        Times that an increment is halved where it has no equilibrium or the user material asks for a shorter one.
    max_iterations
        Linear iterations after which a solve is given up.
    length
        Time of the increments that :meth:`solve` goes forward by, s.
    """

    def __init__(
        self,
        body: UserBody | SolidUserBody,
        fixed: np.ndarray,
        spacing: np.ndarray,
        tolerance: float = 1e-8,
        most_iterations: int = 30,
        cuts: int = 6,
        max_iterations: int = MOST_LINEAR,
        length: float = 1.0,
    ) -> None:
        self.body, self.fixed, self.free = body, fixed, (~fixed).astype(float)
        self.tolerance, self.most_iterations, self.cuts = tolerance, most_iterations, cuts
        self.max_iterations, self.length = max_iterations, length
        self.reference, self.work = 0.0, Work()
        #: Relative residuals of the last increment, one a Newton step.
        self.residuals: list[float] = []
        self._spacing = spacing
        self._precondition: Preconditioner | None = None

    def memory(self) -> dict[str, Any]:
        """What later increments depend on, beside :meth:`arrays`; the work counted so far is apart."""
        points = self.body.points
        return {"reference": self.reference, "time": points.time, "increments": points.increments}

    def arrays(self) -> dict[str, np.ndarray]:
        """The history of the points, as it was committed last."""
        points = self.body.points
        return {name: getattr(points, name) for name in ("gradient", "stress", "state", "energy", "field")}

    def recall(
        self, memory: Mapping[str, Any], broken: Sequence[np.ndarray], arrays: Mapping[str, np.ndarray] | None = None
    ) -> None:
        """Become as one was that said this of itself, with a body of which nothing has broken."""
        if any(piece.size for piece in broken) or arrays is None:
            raise ValueError("a body with a history has broken bonds, or no history")
        self.reference = memory["reference"]
        history = (arrays[name] for name in ("gradient", "stress", "state", "energy", "field"))
        self.body.points.recall((*history, memory["time"], memory["increments"]))

    def solve(self, u: np.ndarray, prescribed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Advance by one increment of the usual length, as :meth:`step`."""
        return self.step(u, prescribed, self.length)

    def step(self, u: np.ndarray, prescribed: np.ndarray, length: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Advance by one increment, or by parts of it, between which prescribed values are on a straight line.

        Parameters
        ----------
        u
            Displacements of the last equilibrium, m (n, dim); not changed.
        prescribed
            Values of the fixed degrees of freedom at the end of the increment, m (n, dim).
        length
            Time of the increment, s.

        Returns
        -------
        u, force
            Displacements, m, and internal forces, N, both (n, dim).

        Raises
        ------
        SimulationError
            Without an equilibrium, or when the user material refuses; the history stays as it was.
        """
        return self._cut(u, prescribed, length, self.cuts)

    def _cut(self, u: np.ndarray, prescribed: np.ndarray, length: float, cuts: int) -> tuple[np.ndarray, np.ndarray]:
        points = self.body.points
        history, reference, target = points.history(), self.reference, points.target
        try:
            return self._whole(u, prescribed, length)
        except SimulationError:
            if cuts == 0:
                raise
        try:
            points.target = 0.5 * (points.field + target)
            middle, _ = self._cut(u, np.where(self.fixed, 0.5 * (u + prescribed), 0.0), 0.5 * length, cuts - 1)
            points.target = target
            return self._cut(middle, prescribed, 0.5 * length, cuts - 1)
        except SimulationError:
            points.recall(history)
            points.target = target
            self.reference = reference
            raise

    def _whole(self, u: np.ndarray, prescribed: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
        self.body.increment = length
        force = self._force(u)
        # What the prescribed motion does on the way in, with the tangent of the start.
        moved = np.where(self.fixed, prescribed - u, 0.0)
        tangent = self.body.tangent()
        change = moved + self._solve(tangent, (force + tangent.force(moved)) * self.free)
        u, force = self._accept(u, change, np.inf)
        self.residuals = []
        for _ in range(self.most_iterations):
            residual = force * self.free
            norm = np.sqrt(dot(residual, residual))
            held = force * self.fixed
            scale = max(self.reference, float(np.sqrt(dot(held, held))))
            self.residuals.append(norm / scale if scale > 0.0 else 0.0)
            if norm <= self.tolerance * scale:
                self.reference = scale
                self.body.points.commit()
                self.work.equilibrium_solves += 1
                return u, force
            u, force = self._accept(u, self._solve(self.body.tangent(), residual), norm)
        last = ", ".join(f"{value:.2g}" for value in self.residuals[-3:])
        raise self._no_equilibrium(
            f"relative residuals {last} in the last Newton steps of {self.most_iterations} (wanted {self.tolerance:g})",
            force * self.free,
            "take shorter increments, or look at DDSDDE",
        )  # fmt: skip

    def _accept(self, u: np.ndarray, change: np.ndarray, norm: float) -> tuple[np.ndarray, np.ndarray]:
        """Take a step, halved until the residual is smaller than it was."""
        share = 1.0
        for _ in range(HALVINGS):
            moved = u + share * change
            force = self._force(moved)
            residual = force * self.free
            if np.sqrt(dot(residual, residual)) < norm:
                return moved, force
            share *= 0.5
        raise self._no_equilibrium(
            f"no share of a Newton step lowers the residual of {norm:.3g} N", residual,
            "take shorter increments, or look at DDSDDE",
        )  # fmt: skip

    def _solve(self, tangent, residual: np.ndarray) -> np.ndarray:
        """Displacements that take a residual away, to first order."""
        goal = LINEAR * np.sqrt(dot(residual, residual))
        out, direction, rz, residual = np.zeros_like(residual), np.zeros_like(residual), 1.0, residual.copy()
        if self._precondition is None:
            self._precondition = Preconditioner(self.body, ~self.fixed, self.body.coordinates, self._spacing)
        for _ in range(self.max_iterations):
            if np.sqrt(dot(residual, residual)) <= goal:
                return out
            z = self._precondition(residual)
            rz, previous = dot(residual, z), rz
            direction = z + rz / previous * direction
            change = tangent.force(direction) * self.free
            self.work.force_sweeps += 1
            self.work.equilibrium_iterations += 1
            curvature = -dot(direction, change)
            if not curvature > 0.0:
                raise self._no_equilibrium(
                    "DDSDDE of the user material is not positive (softening?), or the body is not held against moving "
                    "as a whole", direction, "take shorter increments, or hold more of it", "motion",
                )  # fmt: skip
            out += rz / curvature * direction
            residual += rz / curvature * change
        raise self._no_equilibrium(
            f"the tangent cannot be solved with in {self.max_iterations} iterations", residual,
            "raise solver.max_iterations, or take shorter increments",
        )  # fmt: skip

    def _no_equilibrium(self, why: str, values: np.ndarray, hint: str, what: str = "residual") -> SimulationError:
        """Say why, and at which node something (n, dim) is largest."""
        node = int(np.square(values).sum(axis=1).argmax())
        return SimulationError(
            f"equilibrium of increment {self.body.points.increments + 1} not reached: {why}; largest {what} at node "
            f"{node}, x = {self.body.coordinates[node].tolist()} m; {hint}",
            node,
        )

    def _force(self, u: np.ndarray) -> np.ndarray:
        self.work.force_sweeps += 1
        return self.body.force(u)


class Steps:
    """Collects what a body with a history was like after its increments, and writes it into one file."""

    def __init__(self, body: UserBody | SolidUserBody) -> None:
        self.body = body
        self._kept: dict[str, list[np.ndarray]] = {"time": [], "displacement": [], "stress": [], "state_variables": []}

    def note(self, u: np.ndarray) -> None:
        """Keep the displacements, m (n, dim), and the history at the last committed step."""
        points = self.body.points
        for name, value in (
            ("time", np.array(points.time)),
            ("displacement", u),
            ("stress", points.stress),
            ("state_variables", points.state),
        ):
            self._kept[name].append(value.copy())

    def write(self, path: str | Path) -> None:
        """Write a NetCDF file, whole or not at all, of the variables that :data:`pdhe.fields.FIELDS` declares."""
        points = self.body.points
        axes = zip(("node_x", "node_y", "node_z"), points.coordinates.T, strict=False)
        data = {**dict(axes), "volume": self.body.volume}
        data |= {name: np.array(values) for name, values in self._kept.items()}
        if not points.state.size:
            del data["state_variables"]
        variables = {
            name: Variable(FIELDS[name].dims, values, {"units": FIELDS[name].unit, "long_name": FIELDS[name].long_name})
            for name, values in data.items()
        }
        material = points.material
        attributes = {"user_material": material.name, "properties": list(material.properties) or [np.nan]}
        write_netcdf(path, variables, attributes, ("time", "node_x", "node_y"), ("displacement", "stress"))
