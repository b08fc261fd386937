"""Convergence of displacements: to elasticity as the horizon shrinks, to the nonlocal solution as it fills."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.materials import Body
from pdhe.verification.drawing import COLOURS, MARKERS, label, panels
from pdhe.verification.moduli import bulk_moduli
from pdhe.verification.plates import (
    POISSON,
    YOUNG,
    Plate,
    loaded,
    plate_body,
    square_plate,
    triangle_plate,
)
from pdhe.verification.report import Report, Row, fitted_order

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Side of the square in which displacements are compared, m.
SIDE = 0.1
HORIZON_RATIO = 3.015
WAVE = 2.0 * np.pi / SIDE
SHEAR = YOUNG / (2.0 * (1.0 + POISSON))
AXIAL = YOUNG / (1.0 - POISSON**2)

TEXT = """A square is surrounded by a layer of two horizons in which the displacements are prescribed to be the
exact ones, so that no surface is involved. Two solutions of plane stress elasticity are used: standing waves of
pressure and shear with the body forces that they need, and the field beside a circular hole under tension (Kirsch),
which needs none. A third series is the free strip of the patch tests, where the surface layers are the whole error.

With a fixed horizon ratio on square cells the error of the waves falls with the square of the spacing: it is the
nonlocal error, (k delta)^2 times a small number. Kirsch's field is biharmonic and its dilatation harmonic, so that
the leading nonlocal error vanishes, and what is left is six orders below the displacements. On triangles irregular
families make an error of the first order with a much larger constant: moment-matched weights are symmetrised
between both ends of a bond, after which a uniform strain is no longer exact. At a fixed horizon ratio the waves
then stop improving at 0.4 %; filling the horizon with more nodes helps.

With a fixed horizon, more nodes in it lead to the nonlocal solution: the same waves with amplitudes divided by the
ratios of nonlocal to local stiffness for their wave length, which integrals over the disc give. The difference
between both solutions, 0.8 % for waves twelve horizons long, is what the horizon itself costs."""


def waves(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pressure and shear part of the standing waves, each (n, 2); unit amplitude."""
    a, b = np.sin(WAVE * x) * np.sin(WAVE * y), np.cos(WAVE * x) * np.cos(WAVE * y)
    return np.column_stack([0.25 * a, -0.25 * b]), np.column_stack([0.75 * a, 0.75 * b])


def kirsch(x: np.ndarray, y: np.ndarray, radius: float = 0.03, stress: float = 1e8) -> np.ndarray:
    """Displacements beside a hole at the origin under tension along y in plane stress, m (n, 2)."""
    r, angle = np.hypot(x, y), np.arctan2(-x, y)
    q, kappa = radius / r, (3.0 - POISSON) / (1.0 + POISSON)
    scale = stress * radius / (8.0 * SHEAR)
    c, s = np.cos(2.0 * angle), np.sin(2.0 * angle)
    radial = scale * ((kappa - 1.0 + 2.0 * c) / q + 2.0 * q * (1.0 + (kappa + 1.0 - q**2) * c))
    hoop = -2.0 * scale * (1.0 / q + q * (kappa - 1.0 + q**2)) * s
    along = radial * np.cos(angle) - hoop * np.sin(angle)
    across = radial * np.sin(angle) + hoop * np.cos(angle)
    return np.column_stack([-across, along])


def stiffness_ratios(k_delta: float, points: int = 200) -> tuple[float, float]:
    """Nonlocal over local stiffness of the continuum for pressure and shear waves of wave number times horizon."""
    node, weight = np.polynomial.legendre.leggauss(points)
    phi = 2.0 * np.pi * (np.arange(2 * points) + 0.5) / (2 * points)
    r, c, s = 0.5 * (node + 1.0)[None, :], np.cos(phi)[:, None], np.sin(phi)[:, None]
    area = 0.5 * weight[None, :] * r * (np.pi / points)
    tangential = (1.0 - 3.0 * POISSON) / (1.0 + POISSON)
    ratios = []
    for along, across, local in ((c, -s, AXIAL), (s, c, SHEAR)):
        stretch = np.sum(area * (along**2 + tangential * across**2) * (1.0 - np.cos(k_delta * r * c)) / r)
        turn = np.sum(area * across * np.sin(k_delta * r * c))
        nonlocal_ = stretch - 0.5 * tangential * turn**2 * 3.0 / (2.0 * np.pi)
        ratios.append(nonlocal_ / (local / YOUNG * np.pi * (1.0 - POISSON) / 6.0 * k_delta**2))
    return float(ratios[0]), float(ratios[1])


@lru_cache(maxsize=1)
def _patch(cells: str, count: int, ratio: float) -> tuple[Plate, Body, float]:
    """The square with its layer, its bonds, and the thickness of the layer, m."""
    spacing = SIDE / count
    layers = int(np.ceil(2.0 * ratio))
    depth = layers * spacing
    if cells == "squares":
        plate = square_plate(count + 2 * layers, count + 2 * layers, spacing)
    else:
        plate = triangle_plate(SIDE + 2.0 * depth, SIDE + 2.0 * depth, spacing)
    return plate, plate_body(plate, ratio * spacing, partial="full" if cells == "squares" else "ramp"), depth


def patch_error(cells: str, count: int, ratio: float, field: str, nonlocal_: bool = False) -> tuple[float, int]:
    """Relative L2 error of the displacements in the square, and the number of nodes in it.

    ``count`` cells along a side; ``nonlocal_`` prescribes and compares with the nonlocal solution of the waves.
    """
    plate, body, depth = _patch(cells, count, ratio)
    horizon = ratio * SIDE / count
    x, y = (plate.coordinates - depth).T
    if field == "waves":
        pressure, shear = waves(x, y)
        force = 2.0 * WAVE**2 * (AXIAL * pressure + SHEAR * shear)
        p, s = stiffness_ratios(np.sqrt(2.0) * WAVE * horizon) if nonlocal_ else (1.0, 1.0)
        exact = pressure / p + shear / s
    else:
        exact = kirsch(x + 0.6 * SIDE, y - 0.5 * SIDE)
        force = np.zeros_like(exact)
    inside = (x > 0.0) & (x < SIDE) & (y > 0.0) & (y < SIDE)
    fixed = np.repeat(~inside[:, None], 2, axis=1)
    u = loaded(body, plate, force * plate.volume[:, None], fixed, exact)
    volume = plate.volume[inside]
    square = volume @ np.sum((u - exact)[inside] ** 2, axis=1) / (volume @ np.sum(exact[inside] ** 2, axis=1))
    return float(np.sqrt(square)), int(inside.sum())


def strip_error(cells: str, columns: int) -> tuple[float, int]:
    """Relative L2 error of a free strip under tension, twice as long as wide, and its number of nodes."""
    spacing = 0.5 * SIDE / columns
    if cells == "squares":
        plate = square_plate(columns, 2 * columns, spacing)
    else:
        plate = triangle_plate(0.5 * SIDE, SIDE, spacing)
    body = plate_body(plate, HORIZON_RATIO * spacing, partial="full" if cells == "squares" else "ramp")
    return bulk_moduli(body, plate)["error"], len(plate.volume)


#: Smallest order of convergence and largest error at the finest settings of a series, and what was measured.
BOUNDS = {
    ("waves", "squares"): (1.8, 1e-3, "2.04 and 4.6e-4 at 25600 nodes"),
    ("waves", "triangles"): (0.7, 8e-3, "0.84 and 4.1e-3 at 25700 nodes, where it stops"),
    ("Kirsch", "squares"): (1.0, 1e-6, "1.66 and 1.8e-7 at 25600 nodes"),
    ("Kirsch", "triangles"): (0.8, 2e-3, "0.99 and 6.5e-4 at 25700 nodes"),
    ("strip", "squares"): (0.8, 5e-3, "1.34 and 1.8e-3 at 20000 nodes: surface layers and loaded rows"),
    ("strip", "triangles"): (0.8, 1e-2, "1.30, with ups and downs, and 4.2e-3 at 20100 nodes: irregular loaded rows"),
}


def run(
    counts: tuple[int, ...] = (45, 64, 110, 160),
    columns: tuple[int, ...] = (32, 45, 78, 100),
    ratios: tuple[int, ...] = (2, 3, 4, 6, 8, 10),
    waves_per_horizon: int = 12,
    kinds: tuple[str, ...] = ("squares", "triangles"),
) -> Report:
    """Run the series: ``counts`` cells per side, ``columns`` of the strips, ``ratios`` at a fixed horizon."""
    series: dict[tuple[str, str], list[tuple[float, float, int]]] = {}
    rows, table = [], []
    for cells in kinds:
        for field in ("waves", "Kirsch", "strip"):
            solve: Callable[[int], tuple[float, int]] = (
                (lambda n, cells=cells: strip_error(cells, n))
                if field == "strip"
                else (lambda n, cells=cells, field=field: patch_error(cells, n, HORIZON_RATIO, field))
            )
            points = []
            for n in columns if field == "strip" else counts:
                error, nodes = solve(n)
                points.append((1.0 / n, error, nodes))
                table.append(
                    {"series": field, "cells": cells, "horizon_ratio": HORIZON_RATIO, "nodes": nodes, "error": error}
                )
            series[field, cells] = points
            order = fitted_order([p[0] for p in points], [p[1] for p in points])
            least, most, measured = BOUNDS[field, cells]
            what = f"{field}, {cells}, {points[0][2]} to {points[-1][2]} nodes"
            rows.append(
                Row(f"order of convergence, {what}", least, order, 0.0, "1", "at least", f"measured {measured}")
            )
            # The bound belongs to the finest full settings; it is carried to coarser ones with the smallest order.
            finest = (columns if field == "strip" else counts)[-1]
            bound = most * ((100 if field == "strip" else 160) / finest) ** least
            rows.append(
                Row(
                    f"error with the most nodes, {what}",
                    bound,
                    points[-1][1],
                    0.0,
                    "1",
                    "at most",
                    f"measured {measured}",
                )
            )
    filling = _filling(rows, table, ratios, waves_per_horizon, kinds)
    report = Report("convergence_mechanics", "Convergence of displacements", TEXT, rows, _drawing(series, filling))
    report.tables["errors"] = table
    return report


def _filling(
    rows: list[Row], table: list[dict[str, Any]], ratios: tuple[int, ...], parts: int, kinds: tuple[str, ...]
) -> dict[str, list[tuple[int, float, float]]]:
    """The series at a fixed horizon of ``SIDE / parts``: errors against the nonlocal and the local solution."""
    found: dict[str, list[tuple[int, float, float]]] = {}
    for cells in kinds:
        found[cells] = []
        for m in ratios:
            # A horizon half a per cent larger than m spacings keeps the bonds of length m clear of round-off.
            against = patch_error(cells, parts * m, 1.005 * m, "waves", nonlocal_=True)
            local = patch_error(cells, parts * m, 1.005 * m, "waves")
            found[cells].append((m, against[0], local[0]))
            table.append(
                {
                    "series": "waves, fixed horizon",
                    "cells": cells,
                    "horizon_ratio": m,
                    "nodes": local[1],
                    "error": local[0],
                }
            )
        first, last = found[cells][0], found[cells][-1]
        why = "measured 0.11 (squares) and 0.02 (triangles) from m = 2 to m = 10"
        rows.append(
            Row(f"error against the nonlocal solution, {cells}, m = {last[0]} over m = {first[0]}", 0.6,
                last[1] / first[1], 0.0, "1", "at most", why)
        )  # fmt: skip
        rate = fitted_order([1.0 / m for m, _, _ in found[cells]], [error for _, error, _ in found[cells]])
        why = "measured 1.19 (squares) and 2.29 (triangles) from m = 2 to 10: the disc fills by steps, up and down"
        rows.append(
            Row(f"rate in the nodes per horizon, against the nonlocal solution, {cells}", 0.9, rate, 0.0, "1",
                "at least", why)
        )  # fmt: skip
    p, s = stiffness_ratios(np.sqrt(2.0) * 2.0 * np.pi / parts * 1.005)
    gap = float(np.hypot(0.25 * (1.0 / p - 1.0), 0.75 * (1.0 / s - 1.0)) / np.hypot(0.25, 0.75))
    measured = found[kinds[0]][-1][2]
    why = "the gap in an infinite body; the local displacements around the square change it: measured +9 % to +15 %"
    rows.append(Row("error at a fixed horizon against the nonlocal gap", gap, measured, 0.25, "1", "relative", why))
    return found


def _drawing(series: dict, filling: dict):
    def draw(figure: Figure) -> None:
        left, right = panels(figure, 2)
        for k, field in enumerate(("waves", "Kirsch", "strip")):
            for cells, style in (("squares", "-"), ("triangles", "--")):
                if (field, cells) in series:
                    _, error, nodes = (np.array(v) for v in zip(*series[field, cells], strict=True))
                    left.loglog(
                        nodes, error, style, marker=MARKERS[k], color=COLOURS[k], markersize=4, linewidth=1,
                        markerfacecolor=COLOURS[k] if cells == "squares" else "white", label=f"{field}, {cells}",
                    )  # fmt: skip
        n = np.array([3e3, 2.5e4])
        left.loglog(n, 1.5e-2 * (n[0] / n) ** 0.5, color="0.6", linewidth=0.8)
        left.loglog(n, 3e-5 * (n[0] / n), color="0.6", linewidth=0.8)
        left.text(n[1], 1.5e-2 * (n[0] / n[1]) ** 0.5, " order 1", fontsize=7, color="0.4", va="bottom", ha="right")
        left.text(n[1], 3e-5 * n[0] / n[1], " order 2", fontsize=7, color="0.4", va="bottom", ha="right")
        ticks = (1000, 2000, 5000, 10000, 20000)
        left.set_xticks(ticks, [f"{tick:,}".replace(",", " ") for tick in ticks])
        left.set_xticks([], minor=True)
        label(left, "nodes", "relative error of displacements", "fixed horizon ratio 3.015")
        left.legend(fontsize=6.5, frameon=False)
        for k, (cells, points) in enumerate(filling.items()):
            m, against, local = (np.array(v) for v in zip(*points, strict=True))
            look = {"marker": MARKERS[k], "color": COLOURS[k], "markersize": 4, "linewidth": 1}
            right.semilogy(m, local, "-", label=f"{cells}, local", **look)
            right.semilogy(m, against, "--", markerfacecolor="white", label=f"{cells}, nonlocal", **look)
        label(right, "horizon / spacing", "relative error of displacements", "fixed horizon")
        right.legend(fontsize=7, frameon=False)

    return draw
