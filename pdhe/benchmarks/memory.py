"""Bytes a bond of each array that a run holds, and the measured peak."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.benchmarks.machine import peak_memory
from pdhe.benchmarks.problems import mode_i
from pdhe.benchmarks.timing import answer_of, counted, shown
from pdhe.forecast import make_forecast
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.report import Report, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Bytes that the arrays of a case hold per directed bond.
MOST_BYTES = 110.0
TITLE = "Memory"
TEXT = """
Arrays with one entry a directed bond that the main scene holds on {nodes} nodes with {family:.1f} neighbours each, in
bytes a directed bond; a bond counts from both its ends. On a lattice some quantities exist twice, by node for the
gather kernels and by offset for the lattice kernels. Peaks are those of a process of its own, less what it had before
the case was built.
"""


def run(nodes: int = 100_000) -> Report:
    """Weigh every array of the main scene at one size."""
    r = answer_of(_serve, nodes)
    bonds = r["bonds"]
    rows: list[Row] = [shown(name, size / bonds, "B") for name, size in r["arrays"].items()]
    total = sum(r["arrays"].values())
    rows += [
        counted("all arrays of bonds", total / bonds, MOST_BYTES, "at most", "B"),
        shown("peak while the case is built", r["built"] / bonds, "B"),
        shown("peak with one equilibrium", r["solved"] / bonds, "B"),
        shown("peak of the process", r["peak"] / 1e6, "MB"),
        shown("peak of the process, foretold", r["foretold"] / 1e6, "MB"),
        shown("foretold over measured", r["foretold"] / r["peak"], "1", 1.0, "0.8 to 1.2 for whole runs (tests)"),
    ]
    text = TEXT.format(nodes=r["nodes"], family=bonds / r["nodes"])
    return Report("memory", TITLE, text, rows, partial(_draw, {k: v / bonds for k, v in r["arrays"].items()}))


def _serve(end: Any, nodes: int) -> None:
    end.send(weigh(nodes))


def weigh(nodes: int) -> dict[str, Any]:
    """Build the main scene and bring it into equilibrium, in this process; bytes."""
    small = mode_i(800)
    small.equilibrium.solve(np.zeros_like(small.discretization.coordinates), small.conditions.values(1e30))
    before = peak_memory()
    case = mode_i(nodes, {"outputs": {"count": 1}})
    built = peak_memory()
    case.diffusion.step(*_coverage(case))
    case.equilibrium.solve(np.zeros_like(case.discretization.coordinates), case.conditions.values(1e30))
    solved = peak_memory()
    bonds = case.bonds.neighbours.size
    gc.collect()
    arrays = {}
    for name, array in arrays_of(case):
        if array.size >= 0.9 * bonds:
            arrays[name] = array.nbytes
    return {
        "nodes": case.discretization.volume.size, "bonds": bonds, "arrays": arrays, "built": built - before,
        "solved": solved - before, "peak": solved,
        "foretold": make_forecast(case, None).memory,
    }  # fmt: skip


def _coverage(case: Any) -> tuple:
    n = case.discretization.volume.size
    return np.zeros(n), 1.0, np.zeros(n, bool), np.zeros(n), np.empty(n), np.zeros(n)


def arrays_of(case: Any) -> Iterator[tuple[str, np.ndarray]]:
    """All arrays that a case holds, each once, with the way to them."""
    return _arrays(case, "", set(), 4)


def _arrays(thing: Any, name: str, seen: set[int], depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """All arrays that an object holds in its attributes, each once, with the way to them."""
    if id(thing) in seen or depth == 0:
        return
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        yield name, thing
        return
    if type(thing) is tuple:
        for k, part in enumerate(thing):
            yield from _arrays(part, f"{name}.{k}", seen, depth)
        return
    module = type(thing).__module__
    if not module.startswith("pdhe"):
        return
    items = dict(getattr(thing, "__dict__", {}))
    if is_dataclass(thing):
        items |= {field.name: getattr(thing, field.name) for field in fields(thing)}
    for key, value in items.items():
        yield from _arrays(value, f"{name}.{key}" if name else key, seen, depth if name else depth + 1)


def _draw(sizes: dict[str, float], figure: Figure) -> None:
    (ax,) = panels(figure, 1)
    names = sorted(sizes, key=sizes.get)
    ax.barh(names, [sizes[name] for name in names], color=COLOURS[0])
    label(ax, "bytes a directed bond", "")
