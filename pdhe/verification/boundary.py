"""Prescribed displacements and coverages hold node by node at every output; contradictory conditions are refused."""

from __future__ import annotations

import copy
import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.case import build_case
from pdhe.discretization import Discretization, discretize
from pdhe.errors import SceneError
from pdhe.mesh import make_mesh
from pdhe.scene import Scene
from pdhe.simulation import simulate
from pdhe.verification.drawing import COLOURS, MARKERS, label, panels
from pdhe.verification.plates import POISSON, THICKNESS, YOUNG
from pdhe.verification.report import Report, Row

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 0.04, 0.02
END = 3e6
#: Displacement of the top, and coverage of the notch, in time: both with a corner inside the run.
TOP = {"times": [0.0, 1e6, 2e6], "values": [0.0, 2e-5, 1e-5]}
NOTCH = {"times": [0.0, 1.5e6, 3e6], "values": [0.2, 1.0, 0.6]}
#: Fraction of the diffusion time of the plate after which a profile between two edges counts as steady.
STEADY = 4.0

TEXT = """A notched plate is pulled at its top along a broken line in time, held at its bottom at another value,
moved sideways at its right edge, and charged through its notch along a third line. At every output each node of a
prescribed set is compared with what the scene asks for. Edges belong to the plate, nodes lie half a cell inside:
between two edges that prescribe the same component the nodes take the linear interpolation between both; an edge
without a partner passes its value on to its nodes. The table `nodes` lists each of them at each output.

Coverage prescribed on an edge is not that of a node but that of the surface. It is checked in a steady state
between two edges, where the nodes have to lie on the straight line between both values.

Scenes that prescribe one quantity twice on nodes that two sets share are refused when they are read, before
anything is computed, unless both values agree at all times; the table `refusals` lists the messages."""


def _history(value: float) -> dict[str, list[float]]:
    return {"times": [0.0], "values": [value]}


def base_scene(spacing: float, cells: str = "quadrilateral") -> dict[str, Any]:
    """The scene of this topic, resolved."""
    return {
        "title": "boundary conditions",
        "geometry": {
            "plate": {"width": WIDTH, "height": HEIGHT, "thickness": THICKNESS},
            "holes": [],
            "cracks": [{"name": "notch", "from": [0.0, HEIGHT / 2], "to": [WIDTH / 4, HEIGHT / 2]}],
        },
        "mesh": {"spacing": spacing, "cells": cells},
        "horizon": {"ratio": 3.015},
        "material": {
            "youngs_modulus": YOUNG, "poissons_ratio": POISSON, "fracture_toughness": 58.4e6, "diffusivity": 0.84e-9,
        },
        "loads": [
            {"on": "top", "displacement": {"y": TOP}},
            {"on": "bottom", "displacement": {"y": _history(-1e-6)}},
            {"on": "right", "displacement": {"x": _history(3e-6)}},
        ],
        "hydrogen": {"boundary": [{"on": "notch", "coverage": NOTCH}]},
        "time": {"end": END},
        "outputs": {"times": [0.3e6, 1.0e6, 1.3e6, 2.2e6, END]},
    }  # fmt: skip


def _nodes(scene: Scene) -> Discretization:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plate.msh"
        make_mesh(scene.geometry, scene.mesh, path)
        return discretize(path, scene.geometry, scene.mesh)


def prescribed_errors(spacing: float, cells: str) -> tuple[dict[str, float], list[dict[str, float | str]], xr.Dataset]:
    """Largest deviation of each prescribed quantity over nodes and outputs, every value by node, and the result."""
    scene = Scene.from_resolved(base_scene(spacing, cells))
    d = _nodes(scene)
    result = simulate(build_case(scene, d))
    y = d.coordinates[:, 1] / HEIGHT
    errors = {"top y": 0.0, "bottom y": 0.0, "right x": 0.0, "notch coverage": 0.0}
    checked: list[dict[str, float | str]] = []
    for k, t in enumerate(result["time"].values):
        u, psi = result["displacement"].values[k], result["coverage"].values[k]
        top, notch = np.interp(t, **_line(TOP)), np.interp(t, **_line(NOTCH))
        between = -1e-6 + (top + 1e-6) * y
        wanted = {
            "top y": (u[:, 1], between, "top"),
            "bottom y": (u[:, 1], between, "bottom"),
            "right x": (u[:, 0], np.full(y.size, 3e-6), "right"),
            "notch coverage": (psi, np.full(y.size, notch), "notch"),
        }
        for name, (found, expected, where) in wanted.items():
            nodes = d.node_sets[where]
            errors[name] = max(errors[name], float(np.abs(found[nodes] - expected[nodes]).max()))
            checked += [
                {
                    "cells": cells, "quantity": name, "time_s": float(t), "node": int(i),
                    "x_m": float(d.coordinates[i, 0]), "y_m": float(d.coordinates[i, 1]),
                    "prescribed": float(expected[i]), "found": float(found[i]),
                }
                for i in nodes
            ]  # fmt: skip
    return errors, checked, result


def _line(history: dict[str, list[float]]) -> dict[str, list[float]]:
    return {"xp": history["times"], "fp": history["values"]}


def steady_profile(spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Coverage over x/width between edges at 0.2 and 0.8, after four diffusion times."""
    content = base_scene(spacing)
    del content["loads"]
    content["geometry"]["cracks"] = []
    content["hydrogen"]["boundary"] = [
        {"on": "left", "coverage": _history(0.2)}, {"on": "right", "coverage": _history(0.8)},
    ]  # fmt: skip
    end = STEADY * WIDTH**2 / 0.84e-9
    content |= {"time": {"end": end}, "outputs": {"times": [end]}}
    scene = Scene.from_resolved(content)
    d = _nodes(scene)
    result = simulate(build_case(scene, d))
    return d.coordinates[:, 0] / WIDTH, result["coverage"].values[-1]


def contradictory_scenes(spacing: float) -> dict[str, dict[str, Any]]:
    """Scenes that must be refused, by what is wrong with them."""
    base = base_scene(spacing)

    def changed(**blocks: Any) -> dict[str, Any]:
        scene = copy.deepcopy(base)
        for name, value in blocks.items():
            if name in ("loads", "boundary"):
                target = scene["hydrogen"]["boundary"] if name == "boundary" else scene["loads"]
                target += value
            else:
                scene["geometry"][name] += value
        return scene

    def load(on: str, **components: float) -> list[dict]:
        return [{"on": on, "displacement": {c: _history(v) for c, v in components.items()}}]

    def coverage(on: str, value: float) -> list[dict]:
        return [{"on": on, "coverage": _history(value)}]

    hole = [{"name": "bore", "centre": [0.03, HEIGHT / 2], "radius": 4e-3}]
    second = [{"name": "branch", "from": [WIDTH / 4, HEIGHT / 2], "to": [WIDTH / 2, 0.75 * HEIGHT]}]
    beside = HEIGHT / 2 + 1.2 * spacing
    near = [{"name": "scratch", "from": [0.0, beside], "to": [WIDTH / 4, beside]}]
    return {
        "one set twice, different values": changed(loads=load("top", y=1e-6)),
        "one set twice, same value": changed(loads=load("right", x=3e-6)),
        "corner of top and left, y": changed(loads=load("left", y=0.0)),
        "corner of right and bottom, x": changed(loads=load("bottom", x=0.0)),
        "all nodes and an edge": changed(loads=load("all", x=0.0)),
        "an edge that does not exist": changed(loads=load("middle", y=0.0)),
        "coverage twice on the notch": changed(boundary=coverage("notch", 1.0)),
        "coverage of the notch and of the edge it starts from": changed(boundary=coverage("left", 0.0)),
        "coverage of a crack and of another that starts at its tip": changed(
            cracks=second, boundary=coverage("branch", 0.0)
        ),
        "coverage of two cracks 1.2 cells apart, which share a row of nodes": changed(
            cracks=near, boundary=coverage("scratch", 0.0)
        ),
        "coverage of all nodes and of the notch": changed(boundary=coverage("all", 0.0)),
        "displacement of a hole and of all nodes": changed(
            holes=hole, loads=[*load("bore", y=0.0), *load("all", y=1e-6)]
        ),
    }


def agreeing_scenes(spacing: float) -> dict[str, dict[str, Any]]:
    """Scenes with shared nodes that must be accepted."""
    base = base_scene(spacing)
    same = copy.deepcopy(base)
    same["loads"].append({"on": "bottom", "displacement": {"x": _history(3e-6)}})
    apart = copy.deepcopy(base)
    apart["hydrogen"]["boundary"].append({"on": "right", "coverage": _history(0.0)})
    return {"shared corner, same value at all times": same, "sets that do not touch, different values": apart}


def run(spacing: float = 0.5e-3, kinds: tuple[str, ...] = ("quadrilateral", "triangle")) -> Report:
    """Check enforcement and refusals on a plate of 40 mm by 20 mm."""
    rows: list[Row] = []
    results, nodes = {}, []
    for cells in kinds:
        errors, checked, result = prescribed_errors(spacing, cells)
        results[cells] = result
        nodes += checked
        why = "prescribed, not solved for: round-off of the interpolation only; measured 3e-21 m and 2e-16"
        for name, error in errors.items():
            unit, allowed = ("1", 1e-14) if "coverage" in name else ("m", 1e-18)
            rows.append(Row(f"largest deviation, {name}, {cells} cells", 0.0, error, allowed, unit, "absolute", why))
        rows.append(
            Row(
                f"node values compared, {cells} cells",
                100,
                len(checked),
                0.0,
                "1",
                "at least",
                "so that the test tests",
            )
        )
        moved = float(np.abs(result["displacement"].values[-1]).max())
        rows.append(Row(f"the plate moves, {cells} cells", 5e-6, moved, 0.0, "m", "at least", "so that the test tests"))
    place, coverage = steady_profile(spacing)
    why = "what is left of the transient, and long steps accurate to 1e-4 each: measured 8e-11 to 6e-7 by their choice"
    rows.append(
        Row("largest deviation from the line between two edges", 0.0, float(np.abs(coverage - 0.2 - 0.6 * place).max()),
            1e-5, "1", "absolute", why)
    )  # fmt: skip
    refused = _refusals(contradictory_scenes(spacing))
    accepted = _refusals(agreeing_scenes(spacing))
    count = len(refused)
    why = "each of them is a contradiction or names a set that does not exist"
    rows.append(
        Row("contradictory scenes refused", count, sum(bool(r["message"]) for r in refused), 0.0, "1", "absolute", why)
    )
    rows.append(
        Row("agreeing scenes accepted", len(accepted), sum(not r["message"] for r in accepted), 0.0, "1", "absolute",
            "same value on shared nodes, or no shared nodes")
    )  # fmt: skip
    return Report(
        "boundary",
        "Boundary conditions",
        TEXT,
        rows,
        _drawing(results, place, coverage),
        {"refusals": refused, "nodes": nodes},
    )


def _refusals(scenes: dict[str, dict[str, Any]]) -> list[dict[str, str]]:
    found = []
    for name, content in scenes.items():
        message = ""
        try:
            Scene.from_resolved(content)
        except SceneError as error:
            message = str(error)
        found.append({"case": name, "message": message})
    return found


def _drawing(results: dict, place: np.ndarray, coverage: np.ndarray):
    def draw(figure: Figure) -> None:
        left, middle, right = panels(figure, 3)
        t = np.linspace(0.0, END, 200)
        left.plot(t / 1e6, np.interp(t, **_line(TOP)) * 1e6, color="0.3", linewidth=1, label="prescribed at the edge")
        middle.plot(t / 1e6, np.interp(t, **_line(NOTCH)), color="0.3", linewidth=1, label="prescribed")
        for k, (cells, result) in enumerate(results.items()):
            time, u, y = result["time"].values / 1e6, result["displacement"].values, result["node_y"].values
            sets = _sets(result)
            # The value at the edge that the nodes' values continue to.
            low, high = u[:, sets["bottom"], 1].mean(axis=1), u[:, sets["top"], 1].mean(axis=1)
            depth = y[sets["bottom"]].mean(), y[sets["top"]].mean()
            edge = low + (high - low) * (HEIGHT - depth[0]) / (depth[1] - depth[0])
            style = {"linestyle": "none", "color": COLOURS[k], "marker": MARKERS[k], "markersize": 5 - 1.5 * k}
            left.plot(time, edge * 1e6, label=f"nodes, {cells}", **style)
            middle.plot(time, result["coverage"].values[:, sets["notch"]].mean(axis=1), label=cells, **style)
        label(left, "time (10$^6$ s)", "displacement of the top (µm)")
        label(middle, "time (10$^6$ s)", "coverage of the notch")
        right.plot([0.0, 1.0], [0.2, 0.8], color="0.3", linewidth=1, label="between 0.2 and 0.8")
        right.plot(place[::7], coverage[::7], ".", color=COLOURS[0], markersize=3, label="nodes")
        label(right, "x / width", "steady coverage")
        for ax in (left, middle, right):
            ax.legend(fontsize=6.5, frameon=False)

    return draw


def _sets(result: xr.Dataset) -> dict[str, list[int]]:
    return json.loads(result.attrs["node_sets"])
