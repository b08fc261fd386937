"""What the plan of each scene foretells, over what its run takes: counted work, seconds, memory."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from pdhe.benchmarks.machine import peak_memory
from pdhe.benchmarks.problems import SCENE
from pdhe.benchmarks.timing import answer_of, counted, shown
from pdhe.case import build_case
from pdhe.discretization import discretize, read_discretization, write_discretization
from pdhe.forecast import make_forecast
from pdhe.mesh import make_mesh
from pdhe.scene import Scene, load_scene
from pdhe.simulation import fly_pilot, simulate, solve_case
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.report import Report, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Scenes of ``config/scenes`` whose work a pilot foretells: all but motions with inertia, which are foretold step by
#: step, user materials and large strains.
SCENES = (
    "crack_near_hole", "diffusion", "elastic", "inclined_crack", "mode_i", "mode_i_fast", "mode_i_graded",
    "mode_i_half", "mode_i_solid", "offset_cracks", "smoke",
)  # fmt: skip
COUNTS = ("force_sweeps", "diffusion_sweeps", "failure_rounds")
#: Work is to be foretold within this factor. Counts of a handful are chance.
FACTOR, FEW = 2.0, 20.0
TITLE = "What is foretold, and what is found"
TEXT = """
The plan of every scene of `config/scenes` that a pilot is flown for, over its run: counted work, which has to be within
a factor of two, and time and memory of a process of its own, from its start to the written result, on one thread.
"""


def run(scenes: Sequence[str] = SCENES, overrides: Mapping[str, Any] | None = None) -> Report:
    """Compare the plans of some scenes, with changes, with their runs."""
    rows: list[Row] = []
    ratios: dict[str, dict[str, float]] = {}
    for name in scenes:
        path = SCENE.with_name(f"{name}.yaml")
        found = ratios[name] = foretold_over_found(load_scene(path, dict(overrides or {})), alone=True)
        for what in COUNTS:
            if what in found:
                off = max(found[what], 1.0 / found[what])
                text = f"{name}: {what.replace('_', ' ')}, foretold over found"
                rows += [shown(text, found[what]), counted(f"{text}, off by a factor of", off, FACTOR, "at most")]
        rows += [
            shown(f"{name}: {what}, foretold over measured", found[what], "1", 1.0, reason)
            for what, reason in (("seconds", "0.5 to 2"), ("memory", "0.8 to 1.2"))
            if what in found
        ]
    return Report("foretold", TITLE, TEXT, rows, partial(_draw, ratios))


def foretold_over_found(scene: Scene, alone: bool = False) -> dict[str, float]:
    """Foretold over found counts of a scene, by name; ``alone`` with seconds and memory of a process of its own.

    Counts below :data:`FEW` are left out.
    """
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(1)
    with TemporaryDirectory() as folder:
        make_mesh(scene.geometry, scene.mesh, Path(folder, "scene.msh"))
        nodes = discretize(Path(folder, "scene.msh"), scene.geometry, scene.mesh)
        case = build_case(scene, nodes)
        expected = make_forecast(case, fly_pilot(scene, nodes.volume.size))
        if alone:
            # The pilot has compiled what the other process needs.
            write_discretization(nodes, Path(folder, "nodes.nc"))
            found = answer_of(_serve, json.dumps(scene.resolved()), folder)
        else:
            found = _counts(simulate(case))
    numba.set_num_threads(before)
    told = {name: getattr(expected, name, None) for name in found}
    return {
        name: told[name] / value for name, value in found.items() if told[name] is not None and _counts_for(name, value)
    }


def _counts_for(name: str, value: float) -> bool:
    return value > 0.0 and (name not in COUNTS or value >= FEW)


def _counts(result: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(result[name].values[-1]) for name in COUNTS if name in result}


def _serve(end: Any, scene: str, folder: str) -> None:
    import numba

    from pdhe.results import open_result

    numba.set_num_threads(1)
    result = Path(folder, "result.nc")
    solve_case(Scene.from_resolved(json.loads(scene)), read_discretization(Path(folder, "nodes.nc")), result)
    taken = {"seconds": time.process_time(), "memory": peak_memory()}
    with open_result(result) as found:
        end.send(_counts(found) | taken)


def _draw(ratios: Mapping[str, Mapping[str, float]], figure: Figure) -> None:
    (ax,) = panels(figure, 1)
    for index, what in enumerate((*COUNTS, "seconds", "memory")):
        some = [(name, found[what]) for name, found in ratios.items() if what in found]
        marks = {"color": COLOURS[index % len(COLOURS)], "label": what.replace("_", " ")}
        ax.plot([value for _, value in some], [name for name, _ in some], "o", markersize=4, **marks)
    for factor in (1.0 / FACTOR, FACTOR):
        ax.axvline(factor, color="0.4", linestyle="--", linewidth=0.8)
    ax.set_xscale("log")
    ax.set_xlim(math.exp(-1.2), math.exp(1.2))
    ax.legend(frameon=False, fontsize=6)
    label(ax, "foretold over found", "")
