"""Other peridynamics programs on the nearest equal problem, in the same run, where they are installed."""

from __future__ import annotations

import json
import subprocess
import sys
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

from pdhe.benchmarks.compiled import SOURCES
from pdhe.benchmarks.problems import bare_sweep
from pdhe.benchmarks.timing import in_turns, sample_table, shown
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.report import Report

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Peer -> module to import, script of ``benchmarks/`` that runs it (None: its own loop is not driven from here).
PEERS = {"LAMMPS": "peer_lammps.py"}
TITLE = "Peers"
TEXT = """
One layer of {nodes} nodes with {family:.0f} neighbours each, one thread. The peers take explicit steps with a
bond-based material; each step visits every bond once, computes its present length with a square root and checks for
failure. Here: one force sweep of linear bonds (rotations and forces) on the kernels for any nodes and on those for
regular ones. The problem is the nearest equal one, not the same: small displacements need no square roots, and that
is part of the difference. Programs that are absent are named.
"""


def run(nodes: int = 10_000, reach: int = 5, steps: int = 100, rounds: int = 5, python: str = sys.executable) -> Report:
    """Compare; ``python`` is the interpreter that has the peers, which need not be that of this project."""
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(1)
    sweeps = {layout: bare_sweep("force", layout, nodes, reach) for layout in ("lattice", "gather")}
    bonds = sweeps["gather"].bonds
    samples: dict[str, list[float]] = {layout: [] for layout in sweeps}
    rates: dict[str, list[float]] = {}
    absent = []
    columns = max(2 * reach + 2, round((2.0 * nodes) ** 0.5))
    problem = {"columns": columns, "rows": max(2 * reach + 2, round(nodes / columns)), "reach": reach, "steps": steps}
    for name, script in PEERS.items():
        first = _peer(python, script, problem)
        if first is None:
            absent.append(shown(f"{name}: absent", 0.0))
            continue
        for _ in range(rounds):
            for layout, times in in_turns({layout: s.run for layout, s in sweeps.items()}, 1).items():
                samples[layout] += times
            rates.setdefault(name, []).append(_peer(python, script, problem)["rate"])
    if not rates:
        samples = in_turns({layout: s.run for layout, s in sweeps.items()}, rounds)
    numba.set_num_threads(before)
    for layout, times in samples.items():
        rates[f"here, {layout}"] = [bonds / t for t in times]
    rows = [shown(f"{name}, bonds a second and core", median(values), "bonds/s") for name, values in rates.items()]
    for peer in [name for name in rates if not name.startswith("here")]:
        for layout in sweeps:
            measured = median(a / b for a, b in zip(rates[f"here, {layout}"], rates[peer], strict=True))
            rows.append(shown(f"here, {layout}, over {peer}", measured))
    text = TEXT.format(nodes=problem["columns"] * problem["rows"], family=bonds / (columns * problem["rows"]))
    tables = {"samples": sample_table({"bonds a second": rates})}
    return Report("peers", TITLE, text, rows + absent, partial(_draw, rates), tables)


def _peer(python: str, script: str, problem: dict[str, Any]) -> dict[str, float] | None:
    """Run a peer's script; None if its program is not there."""
    path = SOURCES / script
    if not path.is_file():
        return None
    done = subprocess.run([python, str(path), json.dumps(problem)], capture_output=True, text=True, check=False)
    return json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 and done.stdout.strip() else None


def _draw(rates: dict[str, list[float]], figure: Figure) -> None:
    (ax,) = panels(figure, 1)
    names = list(rates)[::-1]
    ax.barh(names, [median(rates[name]) / 1e6 for name in names], color=COLOURS[0])
    label(ax, "directed bonds a second and core, 1e6", "")
