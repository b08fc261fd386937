"""Long diffusion steps for stretches of time in which no bond can break (theory, eqs. 4.8 to 4.10 and 4.15)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdhe.errors import SimulationError
from pdhe.implicit import GAMMA, ImplicitStepper
from pdhe.transport import STEP_SAFETY, Diffusion, DiffusionStep, steady_flux

#: Largest local error of the coverage in one step. With 1e-4 the filled slab of ``config/scenes/diffusion.yaml`` is
#: within 8e-5 of the answer of short steps at a twelfth of their sweeps; the error of the mesh is ten times larger.
TOLERANCE = 1e-4
#: Most stages of a step. A slab filled up to 3 L^2 / D takes, with 99, 199, 499 and 999: 8883, 6655, 6517 and 6517
#: sweeps with 200 columns, 189 000, 96 000, 44 000 and 33 000 with 1000; errors at the end are 2e-6 to 3e-5. The scene
#: above never asks for more than 49. Round-off is no limit: a uniform field keeps to 4e-14 in any number of stages.
MOST_STAGES = 499
#: Work of an iteration of an implicit step in stages: measured 1.9 with 20 000 nodes, 1.3 with 80 000. It holds a
#: sweep, the preconditioner (1.4 sweeps) and sums of vectors; a stage holds a sweep and sums of vectors.
STAGES_PER_ITERATION = 2.0
#: Iterations of an implicit step, both solves, before one is known: 24 to 49 measured, growing slowly with the length.
USUAL_ITERATIONS = 40
#: Work of making the preconditioner, in stages: measured 130 with 20 000 nodes, 60 with 80 000.
BUILDING = 200.0
#: Shortest step of several stages, in plain stable steps: five sweeps for six of them, instead of fourteen.
SHORTEST = 6.0
#: Change of the coverage in one plain stable step, over :data:`TOLERANCE`, at which nothing is left to follow. What
#: still changes then is as much for every plain step of a time constant: 2e-5 in all across a thousand cells. The
#: round-off of hundreds of stages keeps the change between 4e-13 and 9e-12, so that less might never be reached.
SETTLED = 3e-7
#: By how much a coverage may leave the bounds of the data before a step is taken back: round-off.
BOUND_SLACK = 1e-12


def stages_for(ratio: float) -> int:
    """Fewest stages that carry ``ratio`` plain stable steps far (eq. 4.8); odd numbers damp the shortest waves best."""
    stages = max(3, math.ceil(0.5 * (math.sqrt(9.0 + 16.0 * ratio) - 1.0)))
    return stages + 1 - stages % 2


def implicit_from(short: float) -> float:
    """Length of a step, s, from which implicit ones usually take less work, ``short`` being the plain stable step."""
    stages = STAGES_PER_ITERATION * USUAL_ITERATIONS
    return 0.25 * (stages**2 + stages - 2.0) * short


def within(psi: np.ndarray, low: float, high: float) -> bool:
    """Whether a coverage keeps within bounds, but for round-off."""
    return bool(psi.min() >= low - BOUND_SLACK and psi.max() <= high + BOUND_SLACK)


def growth_of(error: float) -> float:
    """Factor by which a step may grow, or has to shrink, after a local error in shares of the allowed one."""
    return 0.8 * max(error, 1e-300) ** (-1.0 / 3.0)


@dataclass(frozen=True)
class LongStep:
    """A step by its two ends, with the coverage at any instant inside it: the cubic that has the rates of both ends.

    Attributes
    ----------
    start, start_rate, start_flux, end, end_rate, end_flux
        Coverage, its rate, 1/s, and the flow in through each node, m^3/s, all (n,).
    entered
        What entered through each node, m^3 (n,).
    length
        s.
    """

    start: np.ndarray
    start_rate: np.ndarray
    start_flux: np.ndarray
    end: np.ndarray
    end_rate: np.ndarray
    end_flux: np.ndarray
    entered: np.ndarray
    length: float

    @cached_property
    def error(self) -> float:
        """Largest estimate of the local error of the coverage."""
        return float(np.abs(self._errors).max())

    def error_between(self, i: np.ndarray, j: np.ndarray) -> float:
        """The same for the mean coverage of pairs of nodes."""
        return 0.5 * float(np.abs(self._errors[i] + self._errors[j]).max())

    @cached_property
    def _errors(self) -> np.ndarray:
        return 0.8 * (self.start - self.end) + 0.4 * self.length * (self.start_rate + self.end_rate)

    def coverage(self, share: float, nodes: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Coverage of some nodes after a share of the step."""
        come, first, last = _cubic(share)
        turn = self.length * (first * self.start_rate[nodes] + last * self.end_rate[nodes])
        return self.start[nodes] + come * (self.end[nodes] - self.start[nodes]) + turn

    def supply(self, share: float) -> np.ndarray:
        """What entered through each node from outside during a share of the step, m^3 (n,)."""
        come, first, last = _cubic(share)
        return come * self.entered + self.length * (first * self.start_flux + last * self.end_flux)


def _cubic(share: float) -> tuple[float, float, float]:
    """Weights of the change and of the rates at start and end; 1, 0 and 0 at the end."""
    rest = 1.0 - share
    return share**2 * (3.0 - 2.0 * share), share * rest**2, -(share**2) * rest


@dataclass
class Stretch:
    """A stretch of time that is covered with long steps, under way.

    Attributes
    ----------
    psi
        Coverage (n,).
    left, step
        What is left of it, and the length that the next step should try, s.
    low, high
        Least and largest coverage that may come of it.
    rate, flux
        What :meth:`SuperStepper.rates` says of the coverage.
    """

    psi: np.ndarray
    left: float
    step: float
    low: float
    high: float
    rate: np.ndarray
    flux: np.ndarray

    def memory(self) -> np.ndarray:
        """What the rest of it depends on, beside the coverage."""
        return np.array([self.left, self.step, self.low, self.high])


class SuperStepper:
    """Second-order Runge-Kutta-Legendre steps: s sweeps carry (s^2 + s - 2) / 4 times as far as one (eq. 4.8).

    Steps are as long as the estimated local error and the bounds of the data allow. Where they would be too short to
    pay, as after a jump at an edge, a few plain steps take their place; where they are so long that an implicit step
    takes less work, that does.

    Parameters
    ----------
    diffusion, held, source
        As in :meth:`pdhe.transport.Diffusion.step`; constant during the stretch.

    Attributes
    ----------
    sweeps, iterations
        Work so far: sweeps over all bonds; iterations of implicit steps, whose sweeps are among them.
    """

    def __init__(self, diffusion: Diffusion, held: np.ndarray, source: np.ndarray) -> None:
        self.diffusion, self.held, self.source = diffusion, held, source
        self.short = diffusion.stable_step(held)
        self.shortest = SHORTEST * self.short
        self.longest = 0.25 * (MOST_STAGES**2 + MOST_STAGES - 2) * self.short
        self.implicit: ImplicitStepper | None = None
        self.iterations_per_step = USUAL_ITERATIONS
        self.forgone = 0.0
        self.sweeps = self.iterations = 0

    def advance(self, psi: np.ndarray, span: float, first: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Go on for ``span`` seconds, starting with a step of ``first``.

        Returns
        -------
        psi, supply
            Coverage (n,) and what entered through each node, m^3 (n,).
        step
            Length to start the next stretch with, s.
        """
        supply, stretch = np.zeros_like(psi), self.begin(psi, span, first)
        while stretch.left > 0.0:
            supply += self.go_on(stretch)
        return stretch.psi, supply, stretch.step

    def begin(self, psi: np.ndarray, span: float, first: float) -> Stretch:
        """Begin to cover ``span`` seconds, with a step of ``first``."""
        return Stretch(psi, span, max(first, self.shortest), *self.bounds(psi), *self.rates(psi))

    def go_on_from(self, psi: np.ndarray, memory: np.ndarray) -> Stretch:
        """Return the stretch that said this of itself, with its coverage."""
        sweeps = self.sweeps
        stretch = Stretch(psi, *memory.tolist(), *self.rates(psi))
        self.sweeps = sweeps  # these rates were counted when they were found first
        return stretch

    def go_on(self, stretch: Stretch) -> np.ndarray:
        """Take one step of a stretch, whatever length it can have; gives what entered through each node, m^3 (n,).

        Raises
        ------
        SimulationError
            If the coverage is not finite any more.
        """
        psi, left = stretch.psi, stretch.left
        if float(np.abs(stretch.rate).max()) * self.short <= SETTLED * TOLERANCE:
            stretch.left = 0.0
            return left * steady_flux(stretch.flux)
        while True:
            step = stretch.step
            taken = self.take(psi, stretch.rate, stretch.flux, min(step, left), left)
            length = taken.length
            if not math.isfinite(taken.error):
                node = int(np.flatnonzero(~np.isfinite(taken.end + taken.end_rate))[:1].sum())
                raise SimulationError(f"the coverage of node {node} is not finite after a step of {length:.3g} s", node)
            growth = growth_of(taken.error / TOLERANCE)
            if taken.error <= TOLERANCE and within(taken.end, stretch.low, stretch.high):
                # A step that the end of the stretch cut off says nothing against longer ones.
                stretch.step = max(length * min(3.0, growth), step if length < step else 0.0)
                new, entered, stretch.rate, stretch.flux = taken.end, taken.entered, taken.end_rate, taken.end_flux
                break
            if length <= self.shortest:
                new, entered, length = self._plain(psi, min(left, self.shortest))
                stretch.rate, stretch.flux = self.rates(new)
                stretch.step = self.shortest
                break
            stretch.step = max(length * min(0.5, max(0.2, growth)), self.shortest)
        stretch.psi, stretch.left = new, 0.0 if length >= left else left - length
        return entered

    def take(self, psi: np.ndarray, rate: np.ndarray, flux: np.ndarray, length: float, left: float) -> LongStep:
        """One step from a coverage and what :meth:`rates` says of it, ``left`` seconds before the end of the stretch.

        At most ``length`` seconds long, whatever its error is.
        """
        if self._implicit_pays(length, left):
            end, entered, end_rate, end_flux = self._implicit(psi, rate, length)
        else:
            length = min(length, self.longest)
            end, entered = self.step(psi, rate, flux, length, stages_for(length / self.short))
            end_rate, end_flux = self.rates(end)
        return LongStep(psi, rate, flux, end, end_rate, end_flux, entered, length)

    def fits(self, held: np.ndarray, source: np.ndarray) -> bool:
        """Whether this is the stepper for these nodes and edges."""
        return np.array_equal(held, self.held) and np.array_equal(source, self.source)

    def memory(self) -> dict[str, float | int | None]:
        """What later steps depend on, beside held nodes and edges."""
        implicit = None if self.implicit is None else self.implicit.factored
        return {
            "iterations_per_step": self.iterations_per_step,
            "forgone": self.forgone,
            "sweeps": self.sweeps,
            "iterations": self.iterations,
            "implicit": implicit,
        }

    def recall(self, memory: Mapping[str, float | int | None]) -> None:
        """Become as a stepper was that said this of itself."""
        rest = dict(memory)
        factored = rest.pop("implicit")
        vars(self).update(rest)
        if factored is not None:
            self.implicit = ImplicitStepper(self.diffusion, self.held, self.source)
            self.implicit.prepare(factored)

    def _implicit_pays(self, length: float, left: float) -> bool:
        """Whether an implicit step of this length takes less work.

        For the first, its preconditioner has to be made: that must be saved by the steps of this length that are left,
        together with what earlier ones would have saved.
        """
        saved = stages_for(length / self.short) - STAGES_PER_ITERATION * self.iterations_per_step
        if saved <= 0.0 or self.implicit is not None:
            return saved > 0.0
        self.forgone += saved
        return self.forgone + saved * (left / length - 1.0) > BUILDING

    def _implicit(
        self, psi: np.ndarray, rate: np.ndarray, length: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """One implicit step: coverage, what entered, and the rates at its end."""
        if self.implicit is None:
            self.implicit = ImplicitStepper(self.diffusion, self.held, self.source)
        before = self.implicit.iterations
        first, new = self.implicit.step(psi, rate, length)
        self.iterations_per_step = self.implicit.iterations - before
        self.iterations += self.iterations_per_step
        self.sweeps += self.iterations_per_step
        _, first_flux = self.rates(first)
        new_rate, new_flux = self.rates(new)
        return new, length * ((1.0 - GAMMA) * first_flux + GAMMA * new_flux), new_rate, new_flux

    def _plain(self, psi: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Cover a length in plain second-order steps."""
        count, entered = math.ceil(length / (STEP_SAFETY * self.short)), np.zeros_like(psi)
        for _ in range(count):
            step = DiffusionStep(self.diffusion, psi, length / count, self.held, self.source)
            psi = step.coverage(1.0)
            entered += step.supply(1.0)
            self.sweeps += step.sweeps
        return psi, entered, length

    def bounds(self, psi: np.ndarray) -> tuple[float, float]:
        """Least and largest coverage that the present values and the edges allow."""
        sink = self.diffusion.sink()
        edge = self.source[sink > 0.0] / sink[sink > 0.0]
        values = np.concatenate([psi, edge])
        return float(values.min()), float(values.max())

    def rates(self, psi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rate of change of the coverage, 1/s, and flow in through each node, m^3/s."""
        new, flux = np.empty_like(psi), np.zeros_like(psi)
        # Over so long a time that the change keeps its digits beside the coverage.
        self.diffusion.step(psi, self.longest, self.held, self.source, new, flux)
        self.sweeps += 1
        return (new - psi) / self.longest, flux / self.longest

    def step(
        self, psi: np.ndarray, rate: np.ndarray, flux: np.ndarray, length: float, stages: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """One step of a length, s, in some stages, from a coverage and what :meth:`rates` says of it (eq. 4.10).

        Gives the coverage at the end and what entered through each node, m^3. The latter obeys the same recursion as
        the coverage, so that the balance closes.
        """
        weight = [1.0 / 3.0] * 3 + [(j * j + j - 2.0) / (2.0 * j * (j + 1.0)) for j in range(3, stages + 1)]
        unit = 4.0 * length / (stages * stages + stages - 2.0)
        before, here = psi, psi + weight[1] * unit * rate
        entered_before, entered = np.zeros_like(psi), weight[1] * unit * flux
        for j in range(2, stages + 1):
            mu = (2.0 * j - 1.0) / j * weight[j] / weight[j - 1]
            nu = -(j - 1.0) / j * weight[j] / weight[j - 2]
            now, now_flux = self.rates(here)
            back = (1.0 - weight[j - 1]) * mu * unit
            following = mu * here + nu * before + (1.0 - mu - nu) * psi + (mu * unit) * now - back * rate
            entering = mu * entered + nu * entered_before + (mu * unit) * now_flux - back * flux
            before, here, entered_before, entered = here, following, entered, entering
        # The recursion keeps held nodes to round-off only.
        return np.where(self.held, psi, here), entered
