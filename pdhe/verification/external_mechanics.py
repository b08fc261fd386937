"""Mechanics figures from outside: the force sum of another code, single bonds at failure, plate and hole in tension."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pdhe.bonds import build_bonds
from pdhe.damage import Candidates, FailureRule
from pdhe.discretization import discretize
from pdhe.materials import MODELS, BondLoad, make_body
from pdhe.mesh import make_mesh
from pdhe.scene import Geometry, Mesh
from pdhe.verification.drawing import COLOURS, MARKERS, label, panels
from pdhe.verification.moduli import bulk_moduli, grip_modulus
from pdhe.verification.plates import (
    POISSON,
    THICKNESS,
    YOUNG,
    Plate,
    edge_traction,
    loaded,
    plate_body,
    square_plate,
)
from pdhe.verification.report import Report, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HORIZON_RATIO = 3.015
#: Sum of the forces along y on the upper part of a stretched strip, N: a regression figure of a bond-based code.
FORCE_SUM = -66755830.817
#: Heywood's stress concentration at a hole of a fifth of the plate's width, over the stress far away.
HEYWOOD = (2.0 + (1.0 - 0.2) ** 3) / (1.0 - 0.2)
STRESS = 1e8

TEXT = """*Force sum.* Four by 24 nodes, spacing 0.25, volume 0.015625 and horizon 0.751 with the one-parameter
micromodulus 12 K / (pi h delta^3), K = 200 GPa, h = 0.25, are stretched by u = (0, 0.001 y); bond-based
peridynamics is the case nu = 1/3 in plane stress, where the tangential micromodulus vanishes and K = 3 E / 4. No
corrections. The forces along y on the nodes above y = 1.5 sum to -66755830.817 N with finite kinematics, that is,
with the change of the bond's length over its length as stretch and the force along the deformed bond; where the
coordinates start does not matter. The linear bond of this package gives 1.8e-4 less, a term of second order in the
strain.

*Pairs of nodes* break at the critical load to round-off and are whole 0.005 % below it, in stretch and in shear. In
shear of a diagonal bond by gamma the stretch is gamma / 2; attached to fixed axes, as in the thesis, the bond has
the transverse strain gamma / 2 as well, which the energy criterion counts.

*Plate and hole.* A plate in tension has the displacements of plane stress elasticity. At a hole of a fifth of the
width the stress on the ligament, divided by Kirsch's solution for an infinite plate, is continued linearly from a
horizon away from the hole to its edge; three times that is the stress concentration factor, against Heywood's 3.14.
The stress at the outermost node is lower by a tenth, mostly because its centre lies half a cell inside the
material, where the stress has already fallen. The extrapolated value falls to Heywood's as the horizon becomes
small against the radius."""


def force_sum() -> tuple[float, float, int, int]:
    """Force sums with linear and with finite kinematics, N, and the smallest and the largest family."""
    spacing, bulk = 0.25, 200e9
    x, y = np.meshgrid(spacing * np.arange(4), spacing * np.arange(24))
    coordinates = np.column_stack([x.ravel(), y.ravel()])
    volume = np.full(96, 0.015625)
    model = MODELS["condensed rotation"](4.0 * bulk / 3.0, 1.0 / 3.0, spacing, 0.751)
    bonds = build_bonds(coordinates, volume, np.full(96, spacing), spacing, 0.751, partial="full", surface="none")
    body = make_body(bonds, model, coordinates, volume)
    u = np.column_stack([np.zeros(96), 1e-3 * coordinates[:, 1]])
    upper = coordinates[:, 1] > 1.5
    family = np.diff(bonds.offsets)
    # The same bonds with finite kinematics.
    owner = bonds.owners()
    vector = bonds.length[:, None] * np.column_stack([bonds.nx, bonds.ny]) + u[bonds.neighbours] - u[owner]
    length = np.hypot(*vector.T)
    along = vector[:, 1] / length
    finite = bonds.sum_by_node(bonds.weight * model.normal * (length / bonds.length - 1.0) * along)
    return float(body.force(u)[upper, 1].sum()), float(finite[upper].sum()), int(family.min()), int(family.max())


def pair_failure(model: str, by_energy: bool, direction: tuple[float, float], u_end: tuple[float, float]) -> float:
    """Largest multiple of ``u_end``, at the far node, at which a pair is whole, by bisection."""
    x = np.array([(0.0, 0.0), direction])
    horizon, critical = 3.0, 1e-3
    bonds = build_bonds(x, np.ones(2), np.ones(2), 1.0, horizon, surface="none")
    body = make_body(bonds, MODELS[model](YOUNG, POISSON, 1.0, horizon), x, np.ones(2))
    rule = FailureRule(critical, 1.0, BondLoad(by_energy), None, bonds.owners() < bonds.neighbours)
    rest, end = np.zeros((2, 2)), critical * np.array([(0.0, 0.0), u_end])

    def breaks(amount: float) -> bool:
        candidates = Candidates(body, rule, rest, amount * end)
        return bool(candidates.bond.size) and bool(candidates.ratio(1.0, None).max() >= 1.0)

    low, high = 0.0, 4.0
    if not breaks(high):
        return math.inf
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if breaks(middle) else (middle, high)
    return high


def pair_rows() -> list[Row]:
    """Failure of single bonds."""
    ratio = (1.0 - 3.0 * POISSON) / (1.0 + POISSON)
    diagonal = (1.0, 1.0)
    cases = (
        ("stretch, critical stretch", "condensed rotation", False, (1.0, 0.0), (1.0, 0.0), 1.0),
        ("stretch, energy criterion", "condensed rotation", True, (1.0, 0.0), (1.0, 0.0), 1.0),
        ("shear, critical stretch", "condensed rotation", False, diagonal, (1.0, 0.0), 2.0),
        ("shear, energy criterion", "condensed rotation", True, diagonal, (1.0, 0.0), 2.0),
        (
            "shear, energy criterion, fixed axes",
            "thesis spring",
            True,
            diagonal,
            (1.0, 0.0),
            2.0 / math.sqrt(1.0 + ratio),
        ),
    )
    rows = []
    for name, model, by_energy, direction, u_end, expected in cases:
        measured = pair_failure(model, by_energy, direction, u_end)
        why = "closed form; 0.005 % below is whole, hence a tolerance below 5e-5; measured 4e-16"
        rows.append(Row(f"pair breaks in {name}", expected, measured, 1e-12, "s_c", "relative", why))
    turned = pair_failure("condensed rotation", True, (1.0, 0.0), (0.0, 1.0))
    rows.append(
        Row("a pair that turns breaks (0: never)", 0.0, float(math.isfinite(turned)), 0.0, "1", "absolute",
            "a rotation is no strain")
    )  # fmt: skip
    return rows


def plate_rows(columns: int) -> list[Row]:
    """A plate in tension, twice as long as wide."""
    plate = square_plate(columns, 2 * columns)
    body = plate_body(plate, HORIZON_RATIO * 1e-3)
    bulk = bulk_moduli(body, plate)
    sides = bulk["u"][plate.right, 0].mean() - bulk["u"][plate.left, 0].mean()
    x = plate.coordinates[:, 0]
    nodes_apart = x[plate.right].mean() - x[plate.left].mean()
    contraction = POISSON * 2e8 / YOUNG * nodes_apart
    why = "measured 0.6 % at 40 cells across: the loaded rows; falls with the number of cells"
    return [
        Row("relative error of the displacements, plate under forces", 0.02, bulk["error"], 0.0, "1", "at most", why),
        Row("contraction of the plate", contraction, float(-sides), 0.02, "m", "relative", why),
        Row("force over area and strain, plate in grips", 1.0, grip_modulus(body, plate), 0.02, "E", "relative",
            "measured +0.7 % at 40 cells across, surface layers; falls with the number of cells"),
    ]  # fmt: skip


def plate_with_hole(width: float, height: float, radius: float, spacing: float, cells: str) -> Plate:
    """Square cells whose centre is outside the hole, or triangles of a mesh around it."""
    if cells == "squares":
        plate = square_plate(round(width / spacing), round(height / spacing), spacing)
        centred = plate.coordinates - [0.5 * width, 0.5 * height]
        kept = np.hypot(*centred.T) > radius
        number = np.cumsum(kept) - 1
        edges = (number[nodes] for nodes in (plate.bottom, plate.top, plate.left, plate.right))
        return Plate(plate.coordinates[kept], plate.volume[kept], plate.spacing[kept], width, height, *edges)
    hole = {"name": "bore", "centre": [0.5 * width, 0.5 * height], "radius": radius}
    geometry = Geometry.model_validate(
        {"plate": {"width": width, "height": height, "thickness": THICKNESS}, "holes": [hole]}, context={"si": True}
    )
    mesh = Mesh.model_validate({"spacing": spacing, "cells": "triangle"}, context={"si": True})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plate.msh"
        make_mesh(geometry, mesh, path)
        d = discretize(path, geometry, mesh)
    edges = (d.node_sets[name] for name in ("bottom", "top", "left", "right"))
    return Plate(d.coordinates, d.volume, d.spacing, width, height, *edges)


def kirsch(relative_radius: np.ndarray) -> np.ndarray:
    """Stress along the pull on the ligament of an infinite plate, over that far away; distance in radii."""
    k = relative_radius**-2.0
    return 1.0 + 0.5 * k + 1.5 * k**2


def ligament_stress(plate: Plate, u: np.ndarray, distance: np.ndarray, reach: float) -> np.ndarray:
    """Stress along y on the ligament, Pa, at distances from the hole's centre, by local quadratic fits."""
    x, y = (plate.coordinates - [0.5 * plate.width, 0.5 * plate.height]).T
    stress = []
    for r in distance:
        near = np.hypot(x - r, y) < reach
        dx, dy = x[near] - r, y[near]
        basis = np.column_stack([np.ones(dx.size), dx, dy, dx * dx, dx * dy, dy * dy])
        fit = np.linalg.lstsq(basis, u[near], rcond=None)[0]
        stress.append((fit[2, 1] + POISSON * fit[1, 0]) * YOUNG / (1.0 - POISSON**2))
    return np.array(stress)


def hole_case(spacing: float, cells: str, radius: float = 10e-3) -> dict:
    """Stress concentration at a hole of a fifth of the width."""
    plate = plate_with_hole(10.0 * radius, 15.0 * radius, radius, spacing, cells)
    horizon = HORIZON_RATIO * spacing
    body = plate_body(plate, horizon, partial="full" if cells == "squares" else "ramp")
    u = loaded(body, plate, edge_traction(plate, normal=STRESS))
    outer = np.linspace(radius + horizon, 3.0 * radius, 40)
    profile = ligament_stress(plate, u, outer, 2.6 * spacing) / STRESS
    line = np.polyfit(outer - radius, profile / kirsch(outer / radius), 1)
    inner = np.linspace(radius + 0.5 * spacing, radius + horizon, 8)
    near = ligament_stress(plate, u, inner, 2.6 * spacing) / STRESS
    return {
        "factor": 3.0 * float(line[1]),
        "first": float(near[0]),
        "r": np.concatenate([inner, outer[1:]]) / radius,
        "stress": np.concatenate([near, profile[1:]]),
    }


def run(
    columns: int = 40,
    holes: tuple[tuple[float, str], ...] = ((1e-3, "squares"), (0.5e-3, "squares"), (1e-3, "triangles")),
) -> Report:
    """All of the above; ``holes`` lists spacings, m, and kinds of cells around a hole of 10 mm radius."""
    linear, finite, smallest, largest = force_sum()
    rows = [
        Row("smallest family of the strip", 10, smallest, 0.0, "1", "absolute", "counted: a corner"),
        Row("largest family of the strip", 21, largest, 0.0, "1", "absolute", "counted: the inner columns"),
        Row("force sum, finite kinematics on the same bonds", FORCE_SUM, finite, 1e-10, "N", "relative",
            "digits of the given figure; measured 7e-12"),
        Row("force sum, linear bonds", FORCE_SUM, linear, 1e-3, "N", "relative",
            "second order in the strain of 1e-3: measured 1.8e-4"),
    ]  # fmt: skip
    rows += pair_rows() + plate_rows(columns)
    cases = {}
    for spacing, cells in holes:
        case = cases[spacing, cells] = hole_case(spacing, cells)
        where = f"{cells}, horizon / radius {HORIZON_RATIO * spacing / 10e-3:.2f}"
        allowed = 0.06 if spacing >= 1e-3 else 0.04
        why = "measured +3.8 % (squares) and +3.5 % (triangles) at a horizon of 0.3 radii, +2.0 % at 0.15: see the text"
        rows.append(
            Row(f"stress concentration at a hole, {where}", HEYWOOD, case["factor"], allowed, "1", "relative", why)
        )
        why = "not judged: half a cell inside the material"
        rows.append(
            Row(f"stress at the outermost node of the hole, {where}", HEYWOOD, case["first"], 0.0, "1", "shown", why)
        )
    return Report("external_mechanics", "Figures from outside: mechanics", TEXT, rows, _drawing(cases))


def _drawing(cases: dict):
    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, 1)
        r = np.linspace(1.0, 3.0, 200)
        ax.plot(r, kirsch(r), color="0.3", linewidth=1.2, label="Kirsch, infinite plate")
        ax.plot(1.0, HEYWOOD, "*", color="0.3", markersize=10, label="Heywood, hole of a fifth of the width")
        for k, ((spacing, cells), case) in enumerate(cases.items()):
            ratio = HORIZON_RATIO * spacing / 10e-3
            ax.plot(
                case["r"], case["stress"], MARKERS[k], color=COLOURS[k], markersize=3.5,
                label=f"{cells}, horizon / radius = {ratio:.2f}",
            )  # fmt: skip
            ax.plot(0.99, case["factor"], "_", color=COLOURS[k], markersize=12, markeredgewidth=2)
        label(ax, "distance from the centre / radius", "axial stress on the ligament / applied stress")
        ax.legend(fontsize=8, frameon=False)

    return draw
