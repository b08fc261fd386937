"""Bodies in space: a bar under tension, a penny-shaped crack, hydrogen through a face."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.case import build_case
from pdhe.scene import Scene
from pdhe.simulation import simulate
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.report import Report, Row
from pdhe.verification.slabs import DIFFUSIVITY, nodes_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

YOUNG, SPACING = 207e9, 1e-3
#: Cells of the bar along x, y and z; its middle half, away from the grips, is looked at.
BAR, MIDDLE = (24, 10, 8), 0.25
#: Radius of the penny-shaped crack in spacings.
RADIUS = 5
#: Models, cell kinds and Poisson's ratios of the bars, and how far Young's modulus and the ratio may be off: measured
#: 0.6 and 1.1 % on cubes at 0.2, 1.3 and 1.3 % at 0.29, 1.8 and 5.6 % on tetrahedra at 0.2, 6.4 and 10.3 % at 0.29.
#: Tetrahedra are irregular, and a face cuts nearly every family of so thin a bar. At 0.29, state-based 0.8 and 0.8 % on
#: cubes, 0.7 and 6.5 % on tetrahedra; correspondence 0.1 and 0.5 %, 0.05 and 0.9 %.
BARS = (
    ("condensed rotation", "hexahedron", 0.2, 0.015, 0.03), ("condensed rotation", "hexahedron", 0.29, 0.025, 0.035),
    ("condensed rotation", "tetrahedron", 0.2, 0.03, 0.08), ("condensed rotation", "tetrahedron", 0.29, 0.09, 0.14),
    ("state-based", "hexahedron", 0.29, 0.015, 0.02), ("state-based", "tetrahedron", 0.29, 0.015, 0.09),
    ("correspondence", "hexahedron", 0.29, 0.005, 0.01), ("correspondence", "tetrahedron", 0.29, 0.005, 0.02),
)  # fmt: skip

TEXT = """\
Bars of 24 by 10 by 8 cells are drawn out along x by rollers and contract freely, with bonds of two parameters and with
the models that take any Poisson's ratio; Young's modulus is the reaction over the strain of their middle half,
Poisson's ratio the contraction there, the mean of both directions. A penny-shaped crack of radius a in a block under
the stress s opens by 8 (1-nu^2) s sqrt(a^2-r^2)/(pi E) at the distance r from its centre (Sneddon 1946); on cubes its
rim is a staircase, which belongs to the disc of the same area. The elastic opening of the cells on either side is taken
off, and what the block lacks of an endless one is left in. Hydrogen enters a block through its front while all other
faces are sealed; the profile is that of one dimension, of second order in the spacing."""


def run(
    kinds: tuple[str, ...] = ("hexahedron", "tetrahedron"), penny: int = 28, layers: tuple[int, ...] = (6, 12, 24)
) -> Report:
    """Run the topic: cells of the bars, cells along the sides of the block with the crack, and across the slabs."""
    rows = [row for model, kind, nu, *allowed in BARS if kind in kinds for row in _bar(model, kind, nu, *allowed)]
    distance, opening, exact = _penny(penny)
    inner = distance < 0.7
    rows.append(
        Row(
            "opening of a penny-shaped crack, mean inside 0.7 radii over the closed form", 1.0,
            float((opening[inner] / exact[inner]).mean()), 0.05 * (28 / penny) ** 3,
            reason=f"block of {penny} spacings, crack of radius {RADIUS}: measured 2.6 % more at 28, 6.5 % at 20: what "
            "a block lacks of an endless body falls with the cube of its size",
        )
    )  # fmt: skip
    errors = [_slab(count) for count in layers]
    rows.append(
        Row(
            f"coverage of a block of {layers[-1]} layers, root mean square error", 1e-3 * (24 / layers[-1]) ** 2,
            errors[-1], kind="at most", reason="second order in the spacing",
        )
    )  # fmt: skip
    order = -np.polyfit(np.log(layers), np.log(errors), 1)[0]
    rows.append(Row("order of that error", 1.7, float(order), kind="at least", reason="2 for fine meshes"))
    return Report(
        "three_dimensions", "Three dimensions", TEXT, rows,
        lambda figure: _draw(figure, distance, opening, exact, np.array(layers), np.array(errors)),
    )  # fmt: skip


def _scene(cells: tuple[int, int, int], kind: str, nu: float, **blocks: Any) -> Scene:
    """A block with a spacing of 1 mm; ``blocks`` in SI."""
    plate = dict(zip(("width", "height", "thickness"), (SPACING * count for count in cells), strict=True))
    geometry = {"plate": plate, "cracks": blocks.pop("cracks", [])}
    material = {"youngs_modulus": YOUNG, "poissons_ratio": nu, "diffusivity": DIFFUSIVITY}
    content = {
        "geometry": geometry, "mesh": {"spacing": SPACING, "cells": kind}, "horizon": {"ratio": 3.015},
        "material": material, "time": {"end": 0.0}, "solver": {"tolerance": 1e-6},
    }  # fmt: skip
    return Scene.from_resolved(content | blocks)


def _pulled(axis: str, low: str, high: str, amount: float) -> list[dict[str, Any]]:
    """Loads that draw two opposite faces apart."""
    ends = ((low, 0.0), (high, amount))
    return [{"on": on, "displacement": {axis: {"times": [0.0], "values": [value]}}} for on, value in ends]


def _bar(model: str, kind: str, nu: float, stiffness: float, ratio: float) -> list[Row]:
    scene = _scene(BAR, kind, nu, loads=_pulled("x", "left", "right", 1e-5), mechanics={"model": model})
    result = simulate(build_case(scene, nodes_of(scene)))
    x = np.column_stack([result[f"node_{axis}"].values for axis in "xyz"])
    u = result["displacement"].values[-1]
    middle = np.abs(x[:, 0] / (SPACING * BAR[0]) - 0.5) < MIDDLE
    basis = np.column_stack([np.ones(int(middle.sum())), x[middle]])
    slope = np.linalg.lstsq(basis, u[middle], rcond=None)[0][1:]
    stress = float(result["reaction_right_x"].values[-1]) / (SPACING**2 * BAR[1] * BAR[2])
    young, contraction = stress / slope[0, 0], -0.5 * (slope[1, 1] + slope[2, 2]) / slope[0, 0]
    what = f"bar of {'cubes' if kind == 'hexahedron' else 'tetrahedra'}, {model}, nu = {nu:g}"
    reason = "nodes near faces share corrected bonds with inner ones (theory, section 3)"
    return [
        Row(f"Young's modulus, {what}", YOUNG, float(young), stiffness, "Pa", reason=reason),
        Row(f"Poisson's ratio, {what}", nu, float(contraction), ratio, reason=reason),
    ]


def _penny(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance of pairs of nodes across the crack over its radius, and their opening as it is and in closed form, m."""
    nu, middle = 0.25, 0.5 * count * SPACING
    disc = {"centre": [middle] * 3, "normal": [0.0, 1.0, 0.0], "radius": RADIUS * SPACING}
    loads = _pulled("y", "bottom", "top", 1e-3 * count * SPACING)
    scene = _scene((count,) * 3, "hexahedron", nu, loads=loads, cracks=[{"name": "penny", "disc": disc}])
    nodes = nodes_of(scene)
    result = simulate(build_case(scene, nodes))
    stress = float(result["reaction_top_y"].values[-1]) / (count * SPACING) ** 2
    # Cubes are numbered layer by layer along z, in each row by row along y.
    u = result["displacement"].values[-1][:, 1].reshape(count, count, count)
    x = nodes.coordinates.reshape(count, count, count, 3)
    above = count // 2
    away = np.hypot(x[:, above, :, 0] - middle, x[:, above, :, 2] - middle)
    inside = away < RADIUS * SPACING
    radius = SPACING * math.sqrt(inside.sum() / math.pi)
    opening = (u[:, above] - u[:, above - 1])[inside] - stress / YOUNG * SPACING
    exact = 8.0 * (1.0 - nu**2) * stress / (math.pi * YOUNG) * np.sqrt(np.maximum(radius**2 - away[inside] ** 2, 0.0))
    order = np.argsort(away[inside], kind="stable")
    return away[inside][order] / radius, opening[order], exact[order]


def _slab(layers: int) -> float:
    """Root mean square error of the coverage of a block that hydrogen entered through its front."""
    thickness = layers * SPACING
    tau = 0.1
    front = {"times": [0.0], "values": [1.0]}
    scene = _scene(
        (4, 4, layers), "hexahedron", 0.25, hydrogen={"boundary": [{"on": "front", "coverage": front}]},
        time={"end": tau * thickness**2 / DIFFUSIVITY},
    )  # fmt: skip
    result = simulate(build_case(scene, nodes_of(scene)))
    z = result["node_z"].values / thickness
    modes = (np.arange(80) + 0.5) * np.pi
    exact = 1.0 - (2.0 / modes * np.sin(np.outer(z, modes)) * np.exp(-(modes**2) * tau)).sum(axis=1)
    return float(np.sqrt(np.mean((result["coverage"].values[-1] - exact) ** 2)))


def _draw(figure: Figure, distance, opening, exact, layers, errors) -> None:
    crack, slab = panels(figure, 2)
    crack.plot(distance, 1e6 * exact, color="black", linewidth=1.0, label="closed form")
    crack.plot(distance, 1e6 * opening, ".", color=COLOURS[0], label="pairs of nodes")
    label(crack, "distance from the centre over the radius", "opening (µm)")
    crack.legend(frameon=False)
    slab.loglog(1.0 / layers, errors, "o-", color=COLOURS[0], label="hydrogen through the front")
    slab.loglog(1.0 / layers, errors[-1] * (layers[-1] / layers) ** 2, "--", color="0.5", label="second order")
    label(slab, "spacing over thickness", "root mean square error of the coverage")
    slab.legend(frameon=False)
