"""The same crack twice: by the method of the thesis carried to equilibrium, and from event to event."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from pdhe.benchmarks.problems import mode_i, solved_by
from pdhe.benchmarks.timing import counted, sample_table, shown
from pdhe.forecast import make_forecast
from pdhe.relaxation import DynamicRelaxation
from pdhe.simulation import fly_pilot, simulate
from pdhe.solvers import Equilibrium
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.report import Report, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COUNTS = {"force sweeps": "force_sweeps", "diffusion sweeps": "diffusion_sweeps", "equilibria": "equilibrium_solves"}
#: Work of the main scene may not grow beyond this without notice: force and diffusion sweeps at 20,000 nodes.
MOST_SWEEPS = {"force sweeps": 8_000, "diffusion sweeps": 25_000}
TITLE = "The same crack, two ways"
TEXT = """
The main scene (`config/scenes/mode_i.yaml`) on {nodes} nodes, once as the thesis would: {steps} load steps of equal
length with {substeps} explicit diffusion sub-steps each, and dynamic relaxation, here carried on until the residual
is that of the other run ({tolerance:g}). And once from event to event with conjugate gradients, which is the default.
Both use the same kernels, on one thread; a step costs the same in both, and what differs is how many there are.
Sweeps are counts and the same on every machine.{less}

Below, the default alone on the mesh of the main job.
"""


def run(
    nodes: int = 1800,
    load_steps: int = 1000,
    substeps: int = 20,
    own_nodes: int = 20_000,
    rounds: int = 5,
    own_rounds: int = 5,
    overrides: dict[str, Any] | None = None,
    full_steps: int = 3000,
) -> Report:
    """Run both ways on ``nodes``, and the default alone on ``own_nodes`` (0: not at all)."""
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(1)
    slow_settings = {
        "stepping": {"mode": "fixed", "load_steps": load_steps, "diffusion_substeps": substeps},
        "solver.max_iterations": 100_000,
    }
    slow, slow_time = _solve(nodes, {**(overrides or {}), **slow_settings}, DynamicRelaxation)
    fast, samples = None, {"event to event": [], "method of the thesis": [slow_time]}
    for _ in range(rounds):
        fast, seconds = _solve(nodes, overrides)
        samples["event to event"].append(seconds)
    numba.set_num_threads(before)
    rows = _comparison(slow, fast, slow_time, median(samples["event to event"]), full_steps / load_steps)
    groups = {f"{nodes} nodes, one thread": samples}
    if own_nodes:
        own, own_rows, own_samples = _alone(own_nodes, own_rounds, overrides)
        rows += own_rows
        groups[f"{own} nodes"] = own_samples
    less = ""
    if load_steps < full_steps:
        less = f" Of {full_steps} load steps only {load_steps} were made; one row scales their time up."
    text = TEXT.format(
        nodes=fast.sizes["node"], steps=load_steps, substeps=substeps, less=less,
        tolerance=mode_i(800, overrides).scene.solver.tolerance,
    )  # fmt: skip
    curves = {"method of the thesis": slow, "event to event": fast}
    return Report("same_answer", TITLE, text, rows, partial(_draw, curves), {"samples": sample_table(groups)})


def _solve(
    nodes: int, overrides: dict[str, Any] | None, solver: type[Equilibrium] = Equilibrium
) -> tuple[xr.Dataset, float]:
    case = solved_by(solver, mode_i(nodes, overrides))
    start = time.perf_counter()
    result = simulate(case)
    return result, time.perf_counter() - start


def _last(result: xr.Dataset, name: str) -> float:
    return float(result[name][-1])


def _comparison(slow: xr.Dataset, fast: xr.Dataset, slow_time: float, fast_time: float, scale: float) -> list[Row]:
    rows = [
        shown("crack extension at the end, method of the thesis", 1e3 * _last(slow, "crack_extension"), "mm"),
        shown("crack extension at the end, event to event", 1e3 * _last(fast, "crack_extension"), "mm"),
        shown(
            "largest difference of crack extension at any time", 1e3 * _distance(slow, fast), "mm",
            reason="one cell is the least by which a crack can differ; fixed steps find failures up to a step late",
        ),
    ]  # fmt: skip
    for name, variable in COUNTS.items():
        rows += [
            shown(f"{name}, method of the thesis", _last(slow, variable)),
            shown(f"{name}, event to event", _last(fast, variable)),
        ]
    force = _last(slow, "force_sweeps") / _last(fast, "force_sweeps")
    diffusion = _last(slow, "diffusion_sweeps") / _last(fast, "diffusion_sweeps")
    rows += [
        counted("force sweeps, method of the thesis over event to event", force, 20.0, "at least"),
        shown("diffusion sweeps, method of the thesis over event to event", diffusion),
        shown("time, method of the thesis", slow_time, "s"),
        shown("time, event to event", fast_time, "s"),
        shown("time, method of the thesis over event to event", slow_time / fast_time, "1", 200.0),
    ]
    if scale > 1.0:
        rows.append(
            shown("the same for all load steps, scaled up by their number", scale * slow_time / fast_time, "1", 200.0)
        )
    return rows


def _distance(a: xr.Dataset, b: xr.Dataset) -> float:
    """Largest difference of the crack extensions of two runs at the outputs, m."""
    times = a["time"].values
    values = []
    for result in (a, b):
        at = np.searchsorted(result["history_time"].values, times * (1 + 1e-12), side="right") - 1
        values.append(result["crack_extension"].values[at])
    return float(np.abs(values[0] - values[1]).max())


def _alone(nodes: int, rounds: int, overrides: dict[str, Any] | None) -> tuple[int, list[Row], dict[str, list[float]]]:
    """The default on the mesh of the main job, on as many threads as the run was given, and on one."""
    import numba

    before = numba.get_num_threads()
    samples: dict[str, list[float]] = {}
    counts: Sequence[int] = dict.fromkeys((before, 1))
    for _ in range(rounds):
        for threads in counts:
            numba.set_num_threads(threads)
            result, seconds = _solve(nodes, overrides)
            samples.setdefault(f"{threads} threads" if threads > 1 else "1 thread", []).append(seconds)
    numba.set_num_threads(before)
    size = result.sizes["node"]
    rows = [
        shown(f"{size} nodes, {name}", median(times), "s", 10.0 if nodes == 20_000 and name.startswith("2") else np.nan)
        for name, times in samples.items()
    ]
    foretold = _foretold(nodes, overrides)
    if foretold is not None:
        alone = median(samples["1 thread"])
        rows.append(shown(f"{size} nodes, 1 thread: foretold over measured", foretold / alone, "1", 1.0, "0.5 to 2"))
    for name in ("force sweeps", "diffusion sweeps"):
        measured, title = _last(result, COUNTS[name]), f"{size} nodes, {name}"
        judged = nodes == 20_000 and not overrides
        rows.append(counted(title, measured, MOST_SWEEPS[name], "at most") if judged else shown(title, measured))
    rows.append(shown(f"{size} nodes, crack extension at the end", 1e3 * _last(result, "crack_extension"), "mm"))
    return size, rows, samples


def _foretold(nodes: int, overrides: dict[str, Any] | None) -> float | None:
    """Seconds that the plan expects, on one thread; None where it has no pilot."""
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(1)
    case = mode_i(nodes, overrides)
    seconds = make_forecast(case, fly_pilot(case.scene, nodes)).seconds
    numba.set_num_threads(before)
    return seconds


def _draw(curves: dict[str, xr.Dataset], figure: Figure) -> None:
    left, right = panels(figure, 2)
    for index, (name, result) in enumerate(curves.items()):
        days = result["history_time"].values / 86400.0
        left.step(days, 1e3 * result["crack_extension"].values, where="post", color=COLOURS[index], label=name)
        right.plot(days, result["force_sweeps"].values, color=COLOURS[index], label=f"forces, {name}")
        right.plot(days, result["diffusion_sweeps"].values, "--", color=COLOURS[index], label=f"diffusion, {name}")
    right.set_yscale("log")
    left.legend(frameon=False, fontsize=7)
    right.legend(frameon=False, fontsize=7)
    label(left, "time, days", "crack extension, mm")
    label(right, "time, days", "sweeps so far")
