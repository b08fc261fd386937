"""How iterations, time and memory of an equilibrium grow with the nodes, and what a second thread is worth."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.benchmarks.machine import cores, peak_memory
from pdhe.benchmarks.problems import mode_i
from pdhe.benchmarks.timing import answer_of, counted, ratio, sample_table, shown, threads_against_copies
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.report import Report, Row, fitted_order

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Iterations from rest, whatever the size; 9 to 14 measured.
MOST_ITERATIONS = 40
TITLE = "Cost of an equilibrium against size"
TEXT = """
The notched plate of the main scene under its full load, from rest to a relative residual of {tolerance:g}, each size
in a process of its own: building the case (families, weights, diffusion rates), then the equilibrium with its
preconditioner, {threads} thread(s). The slope is that of log time against log nodes by least squares; 1 is
proportional. Peak memory is that of the whole process.

A second thread is compared with a second process of one thread that runs at the same time, since shared machines do
not always have a second core to give.
"""


def run(
    nodes: Sequence[int] = (5_000, 20_000, 100_000, 300_000),
    rounds: int = 5,
    threads: int = 1,
    thread_nodes: Sequence[int] = (20_000, 100_000),
) -> Report:
    """Measure each size, and two threads against two copies at ``thread_nodes``; a million nodes take 4 GB."""
    results = [answer_of(_serve, count, rounds, threads) for count in nodes]
    rows: list[Row] = []
    groups = {}
    for r in results:
        name = f"{r['nodes']} nodes"
        groups[name] = {"build": [r["build"]], "equilibrium": r["solve"]}
        rows += [
            counted(f"{name}: iterations", r["iterations"], MOST_ITERATIONS, "at most"),
            shown(f"{name}: equilibrium", median(r["solve"]), "s"),
            shown(f"{name}: of that, preconditioner", median(r["preconditioner"]), "s"),
            shown(f"{name}: families", r["families"], "s", 2.0 if r["nodes"] > 9e5 else math.nan),
            shown(f"{name}: building the case", r["build"], "s"),
            shown(f"{name}: peak memory", r["peak"] / 1e9, "GB", 4.0 if r["nodes"] > 9e5 else math.nan),
        ]
    if len(results) > 1:
        sizes = [r["nodes"] for r in results]
        first, last = results[0], results[-1]
        rows += [
            shown("slope of time against nodes", fitted_order(sizes, [median(r["solve"]) for r in results]), "1", 1.1),
            shown("slope of building against nodes", fitted_order(sizes, [r["build"] for r in results])),
            shown("memory a further node", (last["peak"] - first["peak"]) / (last["nodes"] - first["nodes"]), "B"),
        ]
    if cores() > 1:
        for count in thread_nodes:
            for what in ("force", "diffusion"):
                samples = threads_against_copies("pdhe.benchmarks.problems", f"{what}_sweep", {"nodes": count}, rounds)
                title = f"{what} sweep, {count} nodes"
                groups[title] = samples
                worth = ratio(samples, "two copies", "two threads")
                rows += [
                    shown(f"{title}: two threads over one", ratio(samples, "one thread", "two threads")),
                    shown(f"{title}: two copies over one", ratio(samples, "one thread", "two copies")),
                    shown(f"{title}: two threads over two copies", worth, "1", 0.85),
                ]
    text = TEXT.format(tolerance=results[0]["tolerance"], threads=threads)
    tables = {"samples": sample_table(groups)}
    return Report("scaling", TITLE, text, rows, partial(_draw, results), tables)


def _serve(end: Any, nodes: int, rounds: int, threads: int) -> None:
    import numba

    numba.set_num_threads(min(threads, numba.get_num_threads()))
    end.send(measure(nodes, rounds))


def measure(nodes: int, rounds: int) -> dict[str, Any]:
    """Build the plate and bring it into equilibrium some times, in this process."""
    from pdhe.kernels.families import find_families
    from pdhe.solvers import Preconditioner

    _solve(mode_i(800))  # compiles, or loads what is compiled
    start = time.perf_counter()
    case = mode_i(nodes)
    build = time.perf_counter() - start
    d = case.discretization
    start = time.perf_counter()
    find_families(d.coordinates, np.full(d.volume.size, case.bonds.horizon))
    families = time.perf_counter() - start
    solve, preconditioner, iterations = [], [], 0
    for _ in range(rounds):
        seconds, iterations = _solve(case)
        solve.append(seconds)
        start = time.perf_counter()
        Preconditioner(case.body, ~case.conditions.fixed, d.coordinates, d.spacing)
        preconditioner.append(time.perf_counter() - start)
    return {
        "nodes": d.volume.size, "build": build, "families": families, "solve": solve, "iterations": iterations,
        "preconditioner": preconditioner, "peak": peak_memory(), "tolerance": case.scene.solver.tolerance,
    }  # fmt: skip


def _solve(case: Any) -> tuple[float, int]:
    """Seconds and iterations to the equilibrium at full load, from rest, with a preconditioner made for it."""
    from pdhe.solvers import Equilibrium

    d, settings = case.discretization, case.scene.solver
    equilibrium = Equilibrium(
        case.body, case.conditions.fixed, d.coordinates, d.spacing, settings.tolerance, settings.max_iterations
    )
    prescribed = case.conditions.values(case.scene.time.end)
    start = time.perf_counter()
    equilibrium.solve(np.zeros_like(d.coordinates), prescribed)
    return time.perf_counter() - start, equilibrium.work.equilibrium_iterations


def _draw(results: list[dict[str, Any]], figure: Figure) -> None:
    left, right = panels(figure, 2)
    n = np.array([r["nodes"] for r in results], float)
    for index, (name, values) in enumerate(
        {
            "equilibrium": [median(r["solve"]) for r in results],
            "of that, preconditioner": [median(r["preconditioner"]) for r in results],
            "building the case": [r["build"] for r in results],
        }.items()
    ):
        left.plot(n, values, "o-", color=COLOURS[index], markersize=4, label=name)
    left.plot(n, median(results[0]["solve"]) * n / n[0], ":", color="0.4", label="proportional")
    left.set_xscale("log")
    left.set_yscale("log")
    left.legend(frameon=False, fontsize=7)
    label(left, "nodes", "seconds")
    right.plot(n, [r["iterations"] for r in results], "s-", color=COLOURS[3], markersize=4, label="iterations")
    right.plot(n, [r["peak"] / 1e8 for r in results], "^-", color=COLOURS[4], markersize=4, label="peak memory, 100 MB")
    right.set_xscale("log")
    right.set_ylim(bottom=0)
    right.legend(frameon=False, fontsize=7)
    label(right, "nodes", "")
