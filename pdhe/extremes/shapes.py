"""Extremes of shape: horizons, plates of few nodes, cracks in every place, meshes of slivers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import Delaunay

from pdhe.discretization import Discretization
from pdhe.extremes.elasticity import SUPPORT, moduli, pulled_plate, stiffness
from pdhe.extremes.outcome import Extreme
from pdhe.extremes.scenes import HORIZON_RATIO, SPACING, THICKNESS, Run, crack, promises, pulled, run, wet
from pdhe.fidelity import SHORT_RATIO
from pdhe.verification.plates import POISSON, YOUNG
from pdhe.verification.report import Row

Point = tuple[float, float]


def plate(columns: float, rows: float, **changes: Any) -> dict[str, Any]:
    """Changes that give the plate a size in spacings."""
    size = {"geometry.plate.width": columns * SPACING, "geometry.plate.height": rows * SPACING}
    return size | changes


def horizon_rows(ratio: float) -> list[Row]:
    """A pulled plate and a slab with a horizon of so many spacings."""
    done = pulled_plate(POISSON, side=max(24, round(8 * ratio)), **{"horizon.ratio": ratio})
    modulus, nu = moduli(done)
    return [
        *promises(done),
        Row("Young's modulus over the one asked for", 1.0, modulus, 0.02, reason="central half"),
        Row("Poisson's ratio", POISSON, nu, 0.03, kind="absolute", reason="the grips hold the edges"),
        *diffusion_rows(ratio),
    ]


def diffusion_rows(ratio: float) -> list[Row]:
    """A straight profile between two edges, which every horizon keeps: exact, as the images continue it."""
    columns = max(12, math.ceil(2 * ratio))
    boundary = [*wet("left", 1.0)["boundary"], *wet("right", 0.0)["boundary"]]
    changes = {"horizon.ratio": ratio, "hydrogen": {"boundary": boundary}, "time": {"end": 1e9}}
    done = run(plate(columns, columns) | changes)
    wanted = 1.0 - done.case.discretization.coordinates[:, 0] / done.case.scene.geometry.width
    error = float(np.abs(done.last("coverage") - wanted).max())
    return [
        *promises(done),
        Row("deviation from a straight profile", 0.02, error, kind="at most",
            reason="steady state after 1e9 s; cells beside the edges"),
    ]  # fmt: skip


def few_nodes_rows(columns: int, rows: int, ratio: float) -> list[Row]:
    """A plate of a few nodes, pulled and wet: its equations solved again with a dense matrix."""
    strain = 1e-4
    changes = {
        "horizon.ratio": ratio,
        "loads": [*pulled(0.5 * strain * rows * SPACING), SUPPORT],
        "hydrogen": wet("left"),
        "solver": {"tolerance": 1e-10},
    }
    done = run(plate(columns, rows) | changes)
    body, fixed = done.case.body, done.case.conditions.fixed.ravel()
    u, values = done.last("displacement").ravel(), done.case.conditions.values(1.0).ravel()
    dense = stiffness(body)
    wanted = values.copy()
    inner = dense[np.ix_(~fixed, ~fixed)]
    wanted[~fixed] = np.linalg.lstsq(inner, -dense[np.ix_(~fixed, fixed)] @ values[fixed], rcond=1e-12)[0]
    apparent = done.last("reaction_top_y") / (strain * YOUNG * columns * SPACING * THICKNESS)
    return [
        *promises(done),
        Row("deviation from the dense solution", 1e-8, float(np.abs(u - wanted).max() / np.abs(wanted).max()),
            kind="at most", reason="Householder's least squares on the same forces"),
        Row("force on the grips over that of the continuum", math.nan, apparent, kind="shown",
            reason="a plate of less than a few horizons is not the continuum's (docs/limits.md)"),
    ]  # fmt: skip


def cut_by_fractions(done: Run) -> np.ndarray:
    """Bonds that cracks cut, from exact rational arithmetic in units of a hundredth of the spacing."""
    bonds, x = done.case.bonds, done.case.discretization.coordinates
    unit = SPACING / 100.0

    def exactly(point: Sequence[float]) -> tuple[Fraction, Fraction]:
        return tuple(Fraction(round(c / unit * 1000), 1000) for c in point)  # type: ignore[return-value]

    places = [exactly(point) for point in x]
    segments = [(exactly(c.start), exactly(c.end)) for c in done.case.scene.geometry.cracks]
    cut = [
        any(_crosses(places[i], places[j], k, segments) for k in range(len(segments)))
        for i, j in zip(bonds.owners(), bonds.neighbours, strict=True)
    ]
    return np.array(cut)


def _turn(a, b, c) -> Fraction:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _on(point, segment) -> bool:
    a, b = segment
    inside = all(min(a[d], b[d]) <= point[d] <= max(a[d], b[d]) for d in (0, 1))
    return _turn(a, b, point) == 0 and inside


def _crosses(p, q, index: int, segments) -> bool:
    """A node on a crack counts as on its left; a crack's tip is no part of it unless another crack goes on there."""
    a, b = segments[index]
    if (_turn(a, b, p) >= 0) == (_turn(a, b, q) >= 0):
        return False
    at_a, at_b = _turn(p, q, a), _turn(p, q, b)
    if at_a * at_b < 0:
        return True
    others = [segment for k, segment in enumerate(segments) if k != index]
    return (at_a == 0 and at_b != 0 and any(_on(a, other) for other in others)) or (
        at_b == 0 and at_a != 0 and any(_on(b, other) for other in others)
    )


def crack_rows(
    *cracks: dict[str, Any], columns: int = 12, rows: int = 12, pull: float = 2e-5, breaks: bool = True
) -> list[Row]:
    """A wet plate with cracks, pulled until it breaks or not; the bonds cut at the start, by exact arithmetic.

    Unless it ``breaks``, with the horizon that is then usual: nodes have eight neighbours, or what cracks leave.
    """
    changes = {
        "geometry.cracks": list(cracks),
        "loads": [*pulled(pull), SUPPORT],
        "hydrogen": wet(cracks[0]["name"]),
        **({"damage": {"criterion": "energy"}} if breaks else {"horizon": None}),
    }
    done = run(plate(columns, rows) | changes)
    wrong = int(np.sum(cut_by_fractions(done) != done.case.bonds.cut))
    return [
        *promises(done),
        Row("bonds cut at the start that should not be, or the other way", 0, wrong, kind="absolute",
            reason=f"of {done.case.bonds.cut.size}, by rational arithmetic"),
        Row("bonds broken in the end", math.nan, done.last("broken_bonds") if breaks else 0, kind="shown"),
    ]  # fmt: skip


def angle_rows(degrees: float, **how: Any) -> list[Row]:
    """A crack of seven spacings through the middle of the plate, at an angle to the x axis."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    # Off the nodes by an odd bit, and to the hundredth of a spacing.
    ends = [(round(6.13 + sign * 3.5 * c, 2), round(5.89 + sign * 3.5 * s, 2)) for sign in (-1.0, 1.0)]
    return crack_rows(crack(*ends), **how)


def parted_rows(start: Point, end: Point, columns: int = 12, rows: int = 12) -> list[Row]:
    """A crack from edge to edge: the halves come apart without a force."""
    changes = {
        "geometry.cracks": [crack(start, end)],
        "loads": pulled(1e-5),
        "damage": {"criterion": "energy"},
    }
    done = run(plate(columns, rows) | changes)
    pull = YOUNG * 1e-5 / (0.5 * rows * SPACING) * columns * SPACING * THICKNESS
    force = float(np.abs(done.result["reaction_top_y"].values).max())
    return [
        *promises(done),
        Row("force between the halves over that of a whole plate", 1e-6, force / pull, kind="at most",
            reason="no bond is left across: the solver's tolerance, measured 4e-7"),
        Row("bonds broken", 0, done.last("broken_bonds"), kind="absolute"),
    ]  # fmt: skip


def overlapping_rows() -> list[Row]:
    """Two collinear cracks that overlap are one."""
    changes = {"loads": pulled(1e-5), "damage": {"criterion": "energy"}}
    one = run(plate(12, 12) | changes | {"geometry.cracks": [crack((0, 6), (9, 6))]})
    two = run(plate(12, 12) | changes | {"geometry.cracks": [crack((0, 6), (6, 6)), crack((3, 6), (9, 6), name="b")]})
    return [
        *promises(two),
        Row("bonds cut otherwise than by the one crack", 0, int(np.sum(one.case.bonds.cut != two.case.bonds.cut)),
            kind="absolute", reason="the union of both"),
        Row("force over that with one crack", 1.0, two.last("reaction_top_y") / one.last("reaction_top_y"), 1e-5,
            reason="the same body"),
    ]  # fmt: skip


def triangles(points: np.ndarray, width: float, height: float) -> Discretization:
    """Nodes from the Delaunay triangles of some points in a rectangle, whatever their shape; lengths in m."""
    mesh = Delaunay(points)
    cells = mesh.simplices.astype(np.int32)
    corners = points[cells]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    cells[area < 0] = cells[area < 0][:, [0, 2, 1]]
    area = np.abs(area)
    # Along straight edges triangulation may leave triangles without area.
    cells, area = cells[area > 1e-12 * width * height], area[area > 1e-12 * width * height]
    centres = points[cells].mean(axis=1)
    on = {"left": (0, 0.0), "right": (0, width), "bottom": (1, 0.0), "top": (1, height)}
    sets = {
        name: np.flatnonzero((np.abs(points[cells][:, :, axis] - place) < 1e-12).any(axis=1)).astype(np.int32)
        for name, (axis, place) in on.items()
    }
    sets["all"] = np.arange(len(cells), dtype=np.int32)
    return Discretization(centres, area * THICKNESS, np.sqrt(area), points, cells, sets, False, THICKNESS)


def mesh_points(kind: str, count: int = 12) -> np.ndarray:
    """Points of the unit square: ``graded`` (sizes 1 to 8), ``slivers`` or ``random``."""
    rng = np.random.default_rng(0)
    along = np.linspace(0.0, 1.0, count + 1)
    if kind == "graded":
        along = (np.exp(along * math.log(8.0)) - 1.0) / 7.0
    x, y = np.meshgrid(along, np.linspace(0.0, 1.0, count + 1))
    points = np.column_stack([x.ravel(), y.ravel()])
    inner = ((points > 0.0) & (points < 1.0)).all(axis=1)
    if kind == "slivers":
        # A third of the points moved next to a neighbour: triangles of a hundredth of their height.
        chosen = np.flatnonzero(inner)[::3]
        points[chosen] += rng.choice([-0.97, 0.97], (chosen.size, 1)) / count * np.array([1.0, 0.02])
    elif kind == "random":
        points[inner] = rng.uniform(0.01, 0.99, (int(inner.sum()), 2))
    return points


def mesh_rows(kind: str, error: float) -> list[Row]:
    """A plate of triangles no mesh generator would make: pulled, wet, and broken."""
    side = 16 * SPACING
    nodes = triangles(mesh_points(kind) * side, side, side)
    spacing = float(np.sqrt(side * side / nodes.volume.size))
    changes = {"mesh": {"spacing": spacing, "cells": "triangle"}, "horizon": {"length": 3.5 * SPACING}}
    base = plate(16, 16) | changes
    elastic = run(base | {"loads": [*pulled(8e-6), SUPPORT], "solver": {"tolerance": 1e-9}}, nodes)
    modulus, nu = moduli(elastic)
    broken = run(base | {"loads": [*pulled(3.5e-5), SUPPORT], "damage": {}, "hydrogen": wet("left")}, nodes)
    return [
        *promises(elastic),
        Row("Young's modulus over the one asked for", 1.0, modulus, error, reason="central half"),
        Row("Poisson's ratio", POISSON, nu, 0.05, kind="absolute"),
        *promises(broken),
        Row("smallest over largest cell", math.nan, float(nodes.volume.min() / nodes.volume.max()), kind="shown"),
        Row("bonds broken in the end", 1, broken.last("broken_bonds"), kind="at least"),
    ]


def gmsh_rows(cells: str, **changes: Any) -> list[Row]:
    """A plate with a hole or cracks on a mesh of gmsh."""
    done = run(
        plate(16, 16)
        | {"mesh": {"spacing": SPACING, "cells": cells}, "loads": [*pulled(3e-5), SUPPORT], "damage": {}}
        | {"hydrogen": wet("left"), **changes}
    )
    return [*promises(done), Row("bonds broken in the end", math.nan, done.last("broken_bonds"), kind="shown")]


def hole(x: float, y: float, radius: float) -> list[dict[str, Any]]:
    """One hole, lengths in spacings."""
    return [{"name": "bore", "centre": [x * SPACING, y * SPACING], "radius": radius * SPACING}]


RATIOS = (1.42, 1.5, SHORT_RATIO, 2.0, HORIZON_RATIO, 4.0, 6.0, 10.0)
CASES = [
    Extreme("horizon over spacing", "1.1", partial(pulled_plate, 0.29, **{"horizon.ratio": 1.1}),
            refused="horizon.ratio"),
    Extreme("horizon over spacing", "1.2, elastic", partial(pulled_plate, 0.29, **{"horizon.ratio": 1.2}),
            refused="horizon.ratio"),
    Extreme("horizon over spacing", "1.2, hydrogen", partial(diffusion_rows, 1.2)),
    *(
        Extreme("horizon over spacing", f"{ratio:g}", partial(horizon_rows, ratio), quick=ratio < 5.0)
        for ratio in RATIOS
    ),
    *(
        Extreme("plates of few nodes", f"{columns} x {rows}", partial(few_nodes_rows, columns, rows, ratio),
                refused="" if min(columns, rows) > 1 else "horizon.ratio")
        for columns, rows, ratio in ((1, 1, 1.42), (1, 12, 1.42), (2, 2, 1.5), (2, 12, 1.9), (12, 2, 1.9), (3, 3, 2.9))
    ),
    *(
        Extreme("horizon over the plate", f"{share:g}", partial(few_nodes_rows, 8, 8, 8 * share),
                refused="horizon.ratio" if share >= 1.0 else "")
        for share in (0.5, 0.9, 0.99, 1.0, 1.5, 100.0)
    ),
    *(
        Extreme("crack at an angle", f"{degrees}°", partial(angle_rows, degrees), quick=degrees % 45 == 0)
        for degrees in (0, 1, 15, 30, 45, 60, 75, 89, 90, 120, 135, 150, 180)
    ),
    Extreme("cracks", "at the edge", partial(crack_rows, crack((0, 6), (4, 6)))),
    Extreme("cracks", "crossing", partial(crack_rows, crack((3, 3), (9, 9)), crack((3, 9), (9, 3), name="b"))),
    Extreme("cracks", "touching", partial(crack_rows, crack((2, 6), (10, 6)), crack((6, 6), (6, 10), name="b"))),
    Extreme("cracks", "tip to tip", partial(crack_rows, crack((2, 6), (6, 6)), crack((6, 6), (10, 4), name="b"))),
    Extreme("cracks", "overlapping", overlapping_rows),
    Extreme("cracks", "along nodes", partial(crack_rows, crack((2, 5.5), (9, 5.5)))),
    Extreme("cracks", "through nodes", partial(crack_rows, crack((2.5, 2.5), (8.5, 8.5)))),
    Extreme("cracks", "node to node", partial(crack_rows, crack((3.5, 4.5), (8.5, 6.5)))),
    Extreme("cracks", "closed box", partial(
        crack_rows, crack((4, 4), (8, 4), name="a"), crack((8, 4), (8, 8), name="b"), crack((8, 8), (4, 8), name="c"),
        crack((4, 8), (4, 4), name="d"))),
    Extreme("cracks", "around one node", partial(
        crack_rows, crack((5, 5), (6, 5), name="a"), crack((6, 5), (6, 6), name="b"), crack((6, 6), (5, 6), name="c"),
        crack((5, 6), (5, 5), name="d"))),
    Extreme("cracks", "along the edge", partial(crack_rows, crack((2, 0), (8, 0))), refused="geometry.cracks.0.to"),
    Extreme("cracks", "twice", partial(crack_rows, crack((2, 6), (8, 6)), crack((8, 6), (2, 6), name="b")),
            refused="geometry.cracks.1.to"),
    Extreme("cracks", "outside", partial(crack_rows, crack((2, 6), (14, 6))), refused="geometry.cracks.0.to"),
    Extreme("cracks", "a point", partial(crack_rows, crack((2, 6), (2, 6))), refused="geometry.cracks.0.to"),
    *(
        Extreme("cracks, short horizon", f"{degrees}°", partial(angle_rows, degrees, breaks=False))
        for degrees in (0, 15, 45, 90, 135)
    ),
    Extreme("cracks, short horizon", "through nodes", partial(crack_rows, crack((2.5, 2.5), (8.5, 8.5)), breaks=False)),
    Extreme("cracks, short horizon", "around one node", partial(
        crack_rows, crack((5, 5), (6, 5), name="a"), crack((6, 5), (6, 6), name="b"), crack((6, 6), (5, 6), name="c"),
        crack((5, 6), (5, 5), name="d"), breaks=False)),
    *(
        Extreme("plate cut in two", text, partial(parted_rows, *ends, columns=8))
        for text, ends in {
            "straight": ((0, 6), (8, 6)), "along nodes": ((0, 5.5), (8, 5.5)), "45°": ((0, 2.3), (8, 10.3)),
            "through nodes": ((0, 2), (8, 10)), "inclined": ((0, 3), (8, 8.5)), "next to the grip": ((0, 1), (8, 1)),
        }.items()
    ),
    Extreme("meshes", "graded 1:8", partial(mesh_rows, "graded", 0.05), quick=False),
    Extreme("meshes", "random", partial(mesh_rows, "random", 0.05), quick=False),
    Extreme("meshes", "slivers", partial(mesh_rows, "slivers", 0.05), quick=False),
    Extreme("meshes", "triangles, cracks cross", partial(gmsh_rows, "triangle", **{"geometry.cracks": [
        crack((3, 8), (12, 8)), crack((8, 3), (8, 12), name="b")]})),
    Extreme("meshes", "triangles, cracks overlap", partial(gmsh_rows, "triangle", **{"geometry.cracks": [
        crack((0, 8), (8, 8)), crack((4, 8), (11, 8), name="b")]})),
    Extreme("meshes", "refined 1:8", partial(gmsh_rows, "triangle", **{
        "geometry.cracks": [crack((0, 8), (8, 8))],
        "mesh.refine": [{"around": "notch", "spacing": SPACING / 8, "within": SPACING / 2}]}), quick=False),
    Extreme("meshes", "hole", partial(gmsh_rows, "quadrilateral", **{"geometry.holes": hole(8, 8, 3)})),
    *(
        Extreme("hole near an edge", f"{gap:g} spacings", partial(
            gmsh_rows, "triangle", **{"geometry.holes": hole(8, 3 + gap, 3)}),
            refused="" if gap >= 1.0 else "geometry.holes.0.radius")
        for gap in (2.0, 1.0, 0.5, 0.01, 0.0)
    ),
]  # fmt: skip
