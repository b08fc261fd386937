"""The loop of the thesis in plain C++ against the same sweeps here, on the same nodes and bonds."""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from pdhe.benchmarks.compiled import compile_source
from pdhe.benchmarks.timing import counted, in_turns, ratio, sample_table, seconds, shown, threads_against_copies
from pdhe.bonds import build_bonds, partial_volume
from pdhe.damage import Candidates, FailureRule, critical_stretch, crossing_sum
from pdhe.embrittlement import LAWS, resistance
from pdhe.materials import BY_STRETCH, Body, ThesisSpring, make_body
from pdhe.transport import Diffusion
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.report import Report

if TYPE_CHECKING:
    from matplotlib.figure import Figure

YOUNG, POISSON, TOUGHNESS, DIFFUSIVITY, THICKNESS = 207e9, 0.29, 16476.0, 0.84e-9, 4e-3
WIDTH = 0.2
#: Tip displacement over plate size: small enough that no bond breaks, which keeps both programs at the same work.
STRAIN = 1e-4
TITLE = "The loop of the thesis"
TEXT = """
The same nodes, bonds and numbers go through the loop of the thesis, written down in plain C++
(`benchmarks/thesis_loop.cpp`: families as vectors of vectors, lengths and weights worked out anew for every bond,
compiled at -O2), and through the sweeps of this program: {substeps} diffusion sweeps and one force sweep with its
check of the bonds a load step. Neither is carried to equilibrium, as in the thesis. {nodes} nodes, {family:.1f}
neighbours each, on one thread; no bond breaks. "Lattice" are the kernels that regular nodes get, "gather" those for
any nodes. Times are processor times of that thread.

A second thread is compared with a second process of one thread, since that is what the machine has to give.
"""


@dataclass(frozen=True)
class Problem:
    """Nodes, bonds and numbers of the comparison."""

    body: Body
    diffusion: Diffusion
    rule: FailureRule
    spacing: float
    displacement: np.ndarray
    coverage: np.ndarray
    held: np.ndarray

    @property
    def dt(self) -> float:
        """Diffusion step, s."""
        return 0.5 * self.diffusion.stable_step(self.held)


def problem(columns: int, ratio_to_spacing: float, gather: bool) -> Problem:
    """A notched plate, twice as wide as high, with the bonds and the model of the thesis and no corrections."""
    rows, spacing = 2 * (columns // 4), WIDTH / columns
    x, y = np.meshgrid((np.arange(columns) + 0.5) * spacing, (np.arange(rows) + 0.5) * spacing)
    coordinates = np.column_stack([x.ravel(), y.ravel()])
    n, height, horizon = len(coordinates), rows * spacing, ratio_to_spacing * spacing
    volume = np.full(n, spacing**2 * THICKNESS)
    model = ThesisSpring(YOUNG, POISSON, THICKNESS, horizon)
    middle = 0.5 * height
    bonds = build_bonds(
        coordinates, volume, np.full(n, spacing), THICKNESS, horizon, partial="thesis", surface="none",
        tangential_ratio=model.tangential_ratio, cracks=[((0.0, middle), (0.25 * WIDTH, middle))],
    )  # fmt: skip
    if gather:
        bonds = replace(bonds, lattice=None)
    body = make_body(bonds, model, coordinates, volume)
    share = partial_volume(bonds.length, horizon, np.full(bonds.length.size, spacing), "thesis")
    rate = exchange_constant(horizon) * share * volume[bonds.neighbours] / bonds.length**2
    held = (np.abs(coordinates[:, 1] - middle) < spacing) & (coordinates[:, 0] < 0.25 * WIDTH)
    displacement = np.column_stack([np.zeros(n), STRAIN * coordinates[:, 1] * (1.0 + coordinates[:, 0] / WIDTH)])
    crossing = crossing_sum(bonds, volume)
    law = LAWS["serebrinsky"]
    rule = FailureRule(
        critical_stretch(model, crossing, TOUGHNESS, "discrete"),
        crossing,
        BY_STRETCH,
        lambda psi: resistance(law, "stretch", psi),
        bonds.owners() < bonds.neighbours,
    )
    return Problem(body, Diffusion(bonds, volume, rate, {}), rule, spacing, displacement, held.astype(float), held)


def exchange_constant(horizon: float) -> float:
    """Constant of the inverse-square kernel (theory, eq. 4.2)."""
    return 4.0 * DIFFUSIVITY / (np.pi * THICKNESS * horizon**2)


def write_problem(p: Problem, path: Path) -> None:
    """Write nodes and bonds for the C++ program."""
    b = p.body.bonds
    numbers = (
        p.spacing, b.horizon, p.body.normal, p.body.tangential, p.rule.critical, exchange_constant(b.horizon), p.dt,
    )  # fmt: skip
    with path.open("wb") as file:
        np.array([b.node_count], np.int64).tofile(file)
        np.array(numbers, np.float64).tofile(file)
        for values in (p.body.coordinates, p.displacement, p.body.volume, p.coverage):
            np.ascontiguousarray(values, np.float64).tofile(file)
        p.held.astype(np.uint8).tofile(file)
        for first, last in zip(b.offsets[:-1], b.offsets[1:], strict=True):
            np.array([last - first], np.int64).tofile(file)
            b.neighbours[first:last].astype(np.int32).tofile(file)
            p.body.intact[first:last].astype(np.uint8).tofile(file)


class Loop:
    """The sweeps of a load step with the kernels of this program; keeps coverage and force."""

    def __init__(self, p: Problem, substeps: int) -> None:
        self.p, self.substeps = p, substeps
        self.psi, self.new = p.coverage.copy(), np.empty_like(p.coverage)
        self.supply, self.source = np.zeros_like(p.coverage), np.zeros_like(p.coverage)
        self.force = np.empty_like(p.displacement)
        self.dt = p.dt

    def diffuse(self) -> None:
        """The diffusion sweeps of a load step."""
        for _ in range(self.substeps):
            self.p.diffusion.step(self.psi, self.dt, self.p.held, self.source, self.new, self.supply)
            self.psi, self.new = self.new, self.psi

    def forces(self) -> None:
        """One force sweep."""
        self.p.body.force(self.p.displacement, self.force)

    def failures(self) -> None:
        """One look at every bond: which could break."""
        u = self.p.displacement
        Candidates(self.p.body, self.p.rule, u, u, self.psi)

    def sweeps(self) -> None:
        """A load step without the look for failures."""
        self.diffuse()
        self.forces()


def sweeps_alone(columns: int, ratio_to_spacing: float, substeps: int, gather: bool) -> Callable[[], None]:
    """The sweeps of one load step without the look for failures, ready to be timed."""
    return Loop(problem(columns, ratio_to_spacing, gather), substeps).sweeps


def run(columns: int = 142, horizon: float = 3.525, substeps: int = 20, rounds: int = 5, least: float = 0.5) -> Report:
    """Compare the loops; the default is as large and has as many bonds a node as the scenes of the thesis."""
    import numba

    before = numba.get_num_threads()
    problems = {name: problem(columns, horizon, name == "gather") for name in ("lattice", "gather")}
    p = problems["lattice"]
    n, bonds = p.body.bonds.node_count, p.body.bonds.neighbours.size
    loops = {name: Loop(one, substeps) for name, one in problems.items()}
    rows, samples = [], {}
    numba.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        program = compile_source("thesis_loop.cpp", ["-O2"], folder)
        parts = {f"diffusion, {name}": loop.diffuse for name, loop in loops.items()}
        parts |= {f"forces, {name}": loop.forces for name, loop in loops.items()}
        parts |= {f"failures, {name}": loop.failures for name, loop in loops.items()}
        if program is None:
            samples = in_turns(parts, rounds, least / 2)
        else:
            write_problem(p, Path(folder, "problem"))
            other = partial(_run_program, program, substeps, Path(folder))
            rows += _same_numbers(problem(columns, horizon, False), other, substeps, Path(folder))
            samples = _in_turns_with_program(parts, other, rounds, least)
    for name in loops:
        samples[f"mechanics, {name}"] = _sum(samples, f"forces, {name}", f"failures, {name}")
        samples[name] = _sum(samples, f"diffusion, {name}", f"mechanics, {name}")
    if program is None:
        rows.append(shown("C++ program: no compiler or no sources, left out", 0.0))
    else:
        rows += [
            shown("a load step in C++", median(samples["C++"]), "s"),
            *(shown(f"C++ over {name} kernels, whole step", ratio(samples, "C++", name), "1", goal)
              for name, goal in (("lattice", 5.0), ("gather", np.nan))),
            *(shown(f"C++ over {name} kernels, {part}", ratio(samples, f"{part}, C++", f"{part}, {name}"))
              for part in ("diffusion", "mechanics") for name in loops),
        ]  # fmt: skip
    rows += [shown(f"a load step, {name} kernels", median(samples[name]), "s") for name in loops]
    rows += [
        shown(f"diffusion, {name} kernels", substeps * bonds / median(samples[f"diffusion, {name}"]), "bonds/s")
        for name in loops
    ]
    rows += [shown(f"forces, {name} kernels", bonds / median(samples[f"forces, {name}"]), "bonds/s") for name in loops]
    rows += [
        shown(f"look for failures, {name} kernels", bonds / median(samples[f"failures, {name}"]), "bonds/s")
        for name in loops
    ]
    numba.set_num_threads(before)
    groups = {"one thread": samples}
    if before > 1:
        arguments = {"columns": columns, "ratio_to_spacing": horizon, "substeps": substeps, "gather": False}
        shared = threads_against_copies(__name__, "sweeps_alone", arguments, rounds, least / 2)
        groups["second thread"] = shared
        rows += [
            shown("two threads over one, throughput", ratio(shared, "one thread", "two threads")),
            shown("two one-thread copies over one, throughput", ratio(shared, "one thread", "two copies")),
            shown("two threads over two copies, throughput", ratio(shared, "two copies", "two threads"), "1", 0.85),
        ]
    text = TEXT.format(substeps=substeps, nodes=n, family=bonds / n)
    return Report("thesis_loop", TITLE, text, rows, partial(_draw, samples), {"samples": sample_table(groups)})


def _sum(samples: dict[str, list[float]], first: str, second: str) -> list[float]:
    return [a + b for a, b in zip(samples[first], samples[second], strict=True)]


def _run_program(program: Path, substeps: int, folder: Path, steps: int = 1) -> dict[str, float]:
    """Run the C++ program on the problem in a folder; seconds a load step in its parts."""
    command = [str(program), str(folder / "problem"), str(steps), str(substeps), str(folder / "result")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return {name: value if name == "broken" else value / steps for name, value in json.loads(done.stdout).items()}


def _same_numbers(p: Problem, program: Callable[..., dict[str, float]], substeps: int, folder: Path) -> list:
    """Both programs do the same: coverage and forces after three load steps agree to round-off."""
    loop = Loop(p, substeps)
    for _ in range(3):
        loop.sweeps()
    broken = program(steps=3)["broken"]
    result = np.fromfile(folder / "result")
    n = p.coverage.size
    psi, force = result[:n], result[n : 3 * n].reshape(n, 2)
    return [
        counted("largest difference of coverage, C++ and here", np.abs(psi - loop.psi).max(), 1e-12, "at most"),
        counted(
            "largest difference of force over largest force, C++ and here",
            np.abs(force - loop.force).max() / np.abs(force).max(), 1e-10, "at most",
        ),
        counted("bonds broken", broken, 0, "at most", reason="both loops then see the same bonds in every step"),
    ]  # fmt: skip


def _in_turns_with_program(parts, program, rounds: int, least: float) -> dict[str, list[float]]:
    """Samples of the parts and of the C++ program, round by round."""
    samples: dict[str, list[float]] = {}
    once = program(steps=2)
    steps = max(2, round(least / (once["diffusion"] + once["mechanics"])))
    for _ in range(rounds):
        times = program(steps=steps)
        for part in ("diffusion", "mechanics"):
            samples.setdefault(f"{part}, C++", []).append(times[part])
        samples.setdefault("C++", []).append(times["diffusion"] + times["mechanics"])
        for name, part in parts.items():
            part()
            repeats = max(2, round(0.25 * least / max(seconds(part, 1, time.thread_time), 1e-9)))
            samples.setdefault(name, []).append(seconds(part, repeats, time.thread_time))
    return samples


def _draw(samples: dict[str, list[float]], figure: Figure) -> None:
    (ax,) = panels(figure, 1)
    names = [name for name in ("C++", "gather", "lattice") if name in samples]
    for index, part in enumerate(("diffusion", "mechanics")):
        height = [1e3 * median(samples[f"{part}, {name}"]) for name in names]
        below = [1e3 * median(samples[f"diffusion, {name}"]) if index else 0.0 for name in names]
        ax.bar(names, height, bottom=below, color=COLOURS[index], label=part, width=0.6)
    ax.legend(frameon=False, fontsize=8)
    label(ax, "", "a load step, ms")
