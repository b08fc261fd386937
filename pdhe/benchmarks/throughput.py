"""Directed bonds a second and core: the kernels, the same loops in C, and what memory could feed."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.benchmarks.compiled import Library, compile_source
from pdhe.benchmarks.problems import Sweep, bare_sweep
from pdhe.benchmarks.timing import counted, in_turns, ratio, sample_table, shown
from pdhe.materials import MODELS, make_body
from pdhe.solid_bonds import build_solid_bonds
from pdhe.verification.drawing import COLOURS, MARKERS, label, panels
from pdhe.verification.plates import plate_body, square_plate
from pdhe.verification.report import Report, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OPTIONS = {"C -O2": ["-O2"], "C -O3 -march=native": ["-O3", "-march=native"]}
TITLE = "Throughput of the kernels"
TEXT = """
Directed bonds a second of processor time, on one thread. A force sweep is both of its loops, rotations and forces; a
bond counts once for the two. "Lattice" kernels serve regular nodes, "gather" kernels any nodes. The same loops in C
(`benchmarks/sweeps.c`) run on the same arrays, in turns with the kernels; the ratio is against the faster of two ways
to compile them. The ceiling is the measured speed of reading an array as large as the weights (and node numbers) of
the sweep, over the bytes that a bond streams: {bytes}. What a node needs is read again and again and comes from
caches.

The lines by model are force sweeps of whole bodies, in turns on one square lattice, one lattice with displaced nodes
and one of cubes in space, with all that a solver calls: arrays for results and, for models of two sweeps, what happens
at the nodes between them.

Goals: 0.9 of C; {diffusion:.1g} directed bonds a second for diffusion and {force:.1g} for forces, in cache;
{correspondence:.1g} for the correspondence model.
"""
GOALS = {"diffusion": 1.2e9, "force": 4e8, "correspondence": 5e7}


def run(
    nodes: Sequence[int] = (10_000, 100_000, 1_000_000),
    ratios: Sequence[int] = (3, 5),
    rounds: int = 5,
    least: float = 0.05,
    largest: float = 1e8,
    model_nodes: int = 10_000,
) -> Report:
    """Measure every sweep; problems of more than ``largest`` directed bonds are left out, for the sake of memory.

    ``model_nodes`` is the size of the bodies on which the elastic models are compared.
    """
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(1)
    rows: list[Row] = []
    points: list[dict[str, Any]] = []
    groups: dict[str, dict[str, list[float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: compile_source("sweeps.c", options, folder) for name, options in OPTIONS.items()}
        libraries = {name: Library(path) for name, path in paths.items() if path is not None}
        for count in nodes:
            for reach in ratios:
                if count * np.pi * reach**2 > largest:
                    rows.append(shown(f"{count} nodes, m = {reach}: more bonds than the setting `largest`", 0.0))
                    continue
                for what in ("diffusion", "force"):
                    for layout in ("lattice", "gather"):
                        title = f"{what}, {layout}, {count} nodes, m = {reach}"
                        point, samples = _measure(what, layout, count, reach, libraries, rounds, least)
                        groups[title] = samples
                        points.append(point)
                        rows += _rows(title, point)
    for nodes_are, jitter in (("lattice", 0.0), ("displaced nodes", 0.1), ("in space", None)):
        samples, bonds = _models(model_nodes, jitter, rounds, least)
        groups[f"force by model, {nodes_are}"] = samples
        rows += [
            shown(f"force, {model}, {nodes_are}", bonds / median(times), "bonds/s", GOALS.get(model, np.nan))
            for model, times in samples.items()
        ]
    numba.set_num_threads(before)
    if not libraries:
        rows.append(shown("C loops: no compiler or no sources, left out", 0.0))
    text = TEXT.format(
        bytes="8 on a lattice and 12 in a gather for diffusion, twice that for forces",
        diffusion=GOALS["diffusion"], force=GOALS["force"], correspondence=GOALS["correspondence"],
    )  # fmt: skip
    tables = {"samples": sample_table(groups), "points": points}
    return Report("throughput", TITLE, text, rows, partial(_draw, points), tables)


def _measure(
    what: str, layout: str, count: int, reach: int, libraries: dict[str, Library], rounds: int, least: float
) -> tuple[dict[str, Any], dict[str, list[float]]]:
    """One sweep in turns with its twins in C and with reading an array of the same size."""
    sweep = bare_sweep(what, layout, count, reach)
    parts = {"here": sweep.run}
    for name, library in libraries.items():
        parts[name] = partial(_call_all, [library.bind(c, *arguments) for c, arguments in sweep.c_names])
    streamed = sweep.bonds * (8 if layout == "lattice" else 12)
    if libraries:
        array = np.ones(max(streamed // 8, 1024))
        parts["read"] = list(libraries.values())[-1].bind("read_all", array.size, array)
    samples = in_turns(parts, rounds, least)
    rate = {name: sweep.bonds / median(times) for name, times in samples.items()}
    point = {
        "sweep": what, "layout": layout, "nodes": count, "ratio": reach, "bonds": sweep.bonds,
        "here": rate["here"], "streamed_bytes_per_bond": sweep.streamed,
    }  # fmt: skip
    if libraries:
        point |= {name: rate[name] for name in libraries}
        point["over C"] = min(ratio(samples, name, "here") for name in libraries)
        point["bandwidth"] = 8 * array.size / median(samples["read"])
        point["of ceiling"] = rate["here"] * sweep.streamed / point["bandwidth"]
        point["difference"] = _difference(sweep, next(iter(libraries.values())))
    return point, samples


def _models(nodes: int, jitter: float | None, rounds: int, least: float) -> tuple[dict[str, list[float]], int]:
    """Times of a force sweep by elastic model, in turns on the same nodes, s, and the number of directed bonds.

    ``jitter`` is the displacement of nodes of a plate over their spacing; None stands for a cube of nodes.
    """
    if jitter is None:
        return _solid_models(nodes, rounds, least)
    side = max(8, round(np.sqrt(nodes)))
    plate, parts, bonds = square_plate(side, side, jitter=jitter), {}, 0
    u = np.random.default_rng(1).normal(size=plate.coordinates.shape) * 1e-7
    for model in MODELS:
        body = plate_body(plate, 3.015e-3, model=model, partial="ramp" if jitter else "full")
        parts[model], bonds = partial(body.force, u, np.empty_like(u)), body.bonds.length.size
    return in_turns(parts, rounds, least), bonds


def _solid_models(nodes: int, rounds: int, least: float) -> tuple[dict[str, list[float]], int]:
    side, parts = max(5, round(np.cbrt(nodes))), {}
    line = (np.arange(side) + 0.5) * 1e-3
    coordinates = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    volume, spacing = np.full(side**3, 1e-9), np.full(side**3, 1e-3)
    # What corrections make of the weights does not matter to speed.
    bonds = build_solid_bonds(coordinates, volume, spacing, 3.015e-3, surface="none")
    u = np.random.default_rng(1).normal(size=coordinates.shape) * 1e-7
    for model, kind in MODELS.items():
        body = make_body(bonds, kind(207e9, 0.25, 1e-3 * side, 3.015e-3, None), coordinates, volume)
        parts[model] = partial(body.force, u, np.empty_like(u))
    return in_turns(parts, rounds, least), bonds.length.size


def _call_all(calls: Sequence) -> None:
    for call in calls:
        call()


def _difference(sweep: Sweep, library: Library) -> float:
    """Largest difference between what the kernels and the C loops write, relative to the largest value."""
    result = sweep.calls[-1][1][-1] if sweep.calls[-1][0].__name__ == "internal_force" else sweep.calls[-1][1][-2]
    sweep.run()
    ours = result.copy()
    result[:] = 0.0
    _call_all([library.bind(name, *arguments) for name, arguments in sweep.c_names])
    return float(np.abs(result - ours).max() / np.abs(ours).max())


def _rows(title: str, point: dict[str, Any]) -> list[Row]:
    in_cache = point["nodes"] <= 10_000 and point["layout"] == "lattice"
    rows = [shown(title, point["here"], "bonds/s", GOALS[point["sweep"]] if in_cache else np.nan)]
    if "over C" in point:
        rows += [
            shown(f"{title}: over C", point["over C"], "1", 0.9),
            shown(f"{title}: share of what memory could feed", point["of ceiling"]),
            counted(f"{title}: difference from C", point["difference"], 1e-11, "at most"),
        ]
    return rows


def _draw(points: list[dict[str, Any]], figure: Figure) -> None:
    axes = panels(figure, 2, sharey=True)
    for ax, what in zip(axes, ("diffusion", "force"), strict=True):
        chosen = [point for point in points if point["sweep"] == what]
        kinds = list(dict.fromkeys((point["layout"], point["ratio"]) for point in chosen))
        for index, (layout, reach) in enumerate(kinds):
            some = [point for point in chosen if (point["layout"], point["ratio"]) == (layout, reach)]
            x = [point["bonds"] for point in some]
            ax.plot(
                x, [point["here"] for point in some], MARKERS[index] + "-", color=COLOURS[index], markersize=4,
                label=f"{layout}, m = {reach}",
            )  # fmt: skip
            if "bandwidth" in some[0]:
                fastest = [max(point[name] for name in OPTIONS) for point in some]
                ceiling = [point["bandwidth"] / point["streamed_bytes_per_bond"] for point in some]
                ax.plot(x, fastest, MARKERS[index], color=COLOURS[index], markersize=6, markerfacecolor="none")
                ax.plot(x, ceiling, ":", color=COLOURS[index], linewidth=1)
        ax.set_xscale("log")
        ax.set_yscale("log")
        label(ax, "directed bonds", "directed bonds a second" if what == "diffusion" else "", what)
    axes[0].legend(frameon=False, fontsize=7, title="hollow: C; dotted: memory", title_fontsize=7)
