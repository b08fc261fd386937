"""Elastic models side by side: constants of plates in either plane, toughness, and figures of other codes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.bonds import build_bonds
from pdhe.boundary import DisplacementConditions
from pdhe.dynamics import Verlet
from pdhe.materials import Body, Correspondence, StateBased, make_body
from pdhe.materials.constants import Orthotropic
from pdhe.solid_bonds import build_solid_bonds
from pdhe.verification.drawing import COLOURS, MARKERS, band, label, panels
from pdhe.verification.moduli import bulk_moduli, bulk_shear
from pdhe.verification.plates import POISSON, Plate, plate_body, square_plate, triangle_plate
from pdhe.verification.report import Report, Row
from pdhe.verification.toughness import follow, strip

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODELS = ("condensed rotation", "state-based", "correspondence")
HORIZON = 3.015e-3
#: Young's modulus and Poisson's ratio that a strip pulled in its plane shows.
SHOWN = {"stress": (1.0, POISSON), "strain": (1.0 / (1.0 - POISSON**2), POISSON / (1.0 - POISSON))}
#: Displacement, m, velocity, m/s, and dilatation of a pair of nodes after five steps, by another code.
PAIR = (4.704698051e-5, 0.8180661902, -1.411409415e-4)
#: Stress after five increments of strain, Pa: 200 GPa times the sum of 2e-4 / (1 + 2e-4 k), k = 1 to 5.
RATES = 199880088.0

TEXT = """\
*Constants.* A free strip of steel is pulled by forces on its ends and sheared by forces on its four edges, as in the
topic `moduli`, with every model that takes any Poisson's ratio, in plane stress and in plane strain (where the
strip shows E/(1-nu^2) and nu/(1-nu)). The gradient of an affine displacement is exact at every node of the
correspondence model, at edges and with a third of the bonds broken.

*Figures of other codes.* Two nodes 2 m apart, of 2 m^3 each, fly at each other at 1 m/s: a linear peridynamic solid in
three dimensions with bulk and shear modulus 130 and 78 GPa and density 7800 kg/m^3, five steps of velocity Verlet of
1e-5 s. A body of E = 200 GPa and nu = 0, a plate or a block, is stretched to 1e-3 in five increments, with a stress
that adds up the rate of deformation, from the gradients at the end of each increment.

*Toughness.* A crack is led through a strip as in the topic `toughness`, with the energy criterion. The energy of the
broken bonds is what the calibration sets. The strip loses more than that with the state-based model, as with
two-parameter bonds, and less with the correspondence model, whose shape tensor follows the bonds that are left; there
the crack also runs with hardly any trapping."""


def pair_of_nodes() -> tuple[float, float, float]:
    """Displacement, m, velocity, m/s, and dilatation of the left one of two nodes that fly at each other."""
    bulk, shear, density, dt = 130e9, 78e9, 7800.0, 1e-5
    young = 9.0 * bulk * shear / (3.0 * bulk + shear)
    model = StateBased(young, young / (2.0 * shear) - 1.0, 1.0, 3.0, None)
    x, volume = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.full(2, 2.0)
    body = make_body(build_solid_bonds(x, volume, np.ones(2), 3.0, partial="full", surface="none"), model, x, volume)
    nothing = DisplacementConditions([], {}, x, (1.0, 1.0, 1.0))
    motion = Verlet(body, density * volume, nothing, [], np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]))
    motion.sweep(0.0)
    for step in range(1, 6):
        motion.step(step * dt, dt)
        motion.end(dt)
    return float(motion.u[0, 0]), float(motion.v[0, 0]), float(body.dilatation(np.ascontiguousarray(motion.u))[0])


def _block() -> Body:
    """A block of 5 by 5 by 5 cubes without contraction, a correspondence model."""
    line = (np.arange(5) + 0.5) * 1e-3
    x, volume = np.stack(np.meshgrid(line, line, line), axis=-1).reshape(-1, 3), np.full(125, 1e-9)
    bonds = build_solid_bonds(x, volume, np.full(125, 1e-3), HORIZON)
    return make_body(bonds, Correspondence(200e9, 0.0, 5e-3, HORIZON, None), x, volume)


def added_rates(body: Body) -> tuple[float, float]:
    """Least and largest axial stress over the nodes of a body stretched in five increments, Pa."""
    x, one = body.coordinates, np.eye(body.coordinates.shape[1])
    stress, before = np.zeros((len(x), *one.shape)), one
    for step in range(1, 6):
        after = one + body.displacement_gradient(2e-4 * step * x * one[0])
        rate = (after - before) @ np.linalg.inv(after)
        stress, before = stress + 200e9 * 0.5 * (rate + rate.transpose(0, 2, 1)), after
    return float(stress[:, 0, 0].min()), float(stress[:, 0, 0].max())


def gradient_error(plate: Plate, volumes: str, broken: float) -> float:
    """Largest error of the gradient of an affine displacement at any node, over the gradient."""
    body = plate_body(plate, HORIZON, model="correspondence", partial=volumes)
    once = np.flatnonzero(body.bonds.owners() < body.bonds.neighbours)
    body.break_bonds(np.random.default_rng(0).choice(once, int(broken * once.size), replace=False))
    wanted = np.array([[0.3, -0.2], [0.7, 0.1]])
    found = body.displacement_gradient(plate.coordinates @ wanted.T)
    found = np.delete(found, body.unsupported(), axis=0)
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


def turned_error(columns: int) -> float:
    """Largest difference between the forces in a ply and in the same ply, turned by 30 degrees with its axes."""
    plate, turn = square_plate(columns, columns, jitter=0.2), np.deg2rad(30.0)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    angle = np.where(plate.coordinates[:, 1] < 0.5 * plate.height, 0.3, -1.1)
    ply = Orthotropic(140e9, 10e9, 0.3, 5e9)
    u, forces = np.random.default_rng(0).normal(size=plate.coordinates.shape), []
    for matrix, more in ((np.eye(2), 0.0), (rotation, turn)):
        x = plate.coordinates @ matrix.T
        bonds = build_bonds(x, plate.volume, plate.spacing, 1e-3, HORIZON)
        model = Correspondence(140e9, 0.3, 1e-3, HORIZON, orthotropic=ply, angle=angle + more)
        forces.append(make_body(bonds, model, x, plate.volume).force(u @ matrix.T) @ matrix)
    return float(np.abs(forces[1] - forces[0]).max() / np.abs(forces[0]).max())


def turned_error_in_space(side: int) -> float:
    """The same in space: a cube of displaced nodes in two halves, turned with its axes about a diagonal."""
    random, spacing = np.random.default_rng(0), 1e-3
    x = spacing * (np.stack(np.meshgrid(*[np.arange(side) + 0.5] * 3, indexing="ij"), axis=-1).reshape(-1, 3))
    x += 0.2 * spacing * random.uniform(-1.0, 1.0, x.shape)
    c, s = np.cos(0.7), np.sin(0.7)
    lower = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    axes = np.where((x[:, 1] < 0.5 * spacing * side)[:, None, None], lower, lower[[1, 2, 0]])
    # The turn by 120 degrees about (1, 1, 1), and one about z after it.
    rotation = lower @ np.roll(np.eye(3), 1, axis=0)
    ply = Orthotropic(140e9, 10e9, 0.3, 5e9, 12e9, 0.25, 0.4, 4e9, 3e9)
    u, forces = random.normal(size=x.shape), []
    for matrix in (np.eye(3), rotation):
        place, volume = x @ matrix.T, np.full(len(x), spacing**3)
        bonds = build_solid_bonds(place, volume, np.full(len(x), spacing), HORIZON, surface="volume")
        model = Correspondence(140e9, 0.3, 1e-3, HORIZON, None, orthotropic=ply, frame=axes @ matrix.T)
        forces.append(make_body(bonds, model, place, volume).force(u @ matrix.T) @ matrix)
    return float(np.abs(forces[1] - forces[0]).max() / np.abs(forces[0]).max())


def run(columns: int = 40, tough: tuple[str, ...] = MODELS, cells: int = 14) -> Report:
    """Compare the models on strips ``columns`` cells wide; ``tough`` are those whose toughness is measured."""
    rows: list[Row] = []
    table: list[dict[str, Any]] = []
    plates = {
        "squares": (square_plate(columns, 2 * columns), "full"),
        "triangles": (triangle_plate(columns * 1e-3, 2 * columns * 1e-3, 1e-3), "ramp"),
    }
    for plane, (young, nu) in SHOWN.items():
        for model in MODELS:
            for cells_are, (plate, volumes) in plates.items():
                body = plate_body(plate, HORIZON, model=model, plane=plane, partial=volumes)
                bulk = bulk_moduli(body, plate)
                found = {"E": bulk["E"] / young, "nu": bulk["nu"] / nu, "G": bulk_shear(body, plate)}
                table.append({"model": model, "plane": plane, "cells": cells_are, **found})
                allowed = 0.03 if cells_are == "triangles" else 0.01
                rows += [
                    Row(
                        f"{name}, {model}, plane {plane}, {cells_are}", 1.0, value, allowed,
                        reason="over that asked for; measured at worst 0.6 % on squares and 2.1 % on triangles",
                    )
                    for name, value in found.items()
                ]  # fmt: skip
    for name, (plate, volumes) in plates.items():
        for broken in (0.0, 0.3):
            rows.append(
                Row(
                    f"gradient of an affine displacement, {name}, {broken:g} of the bonds broken: largest error", 1e-12,
                    gradient_error(plate, volumes, broken), kind="at most", reason="exact; measured 6e-15",
                )
            )  # fmt: skip
    rows.append(
        Row(
            "forces in a laminate turned by 30 degrees: largest difference", 1e-10, turned_error(20), kind="at most",
            reason="the same in turned axes; measured 2e-15",
        )
    )  # fmt: skip
    rows.append(
        Row(
            "forces in a cube of two plies turned about a diagonal: largest difference", 1e-10,
            turned_error_in_space(8), kind="at most", reason="the same in turned axes; measured 1e-15",
        )
    )  # fmt: skip
    for name, expected, found in zip(("displacement", "velocity", "dilatation"), PAIR, pair_of_nodes(), strict=True):
        rows.append(Row(f"pair of nodes: {name}", expected, found, 1e-9, reason="all digits given"))
    flat = plate_body(square_plate(6, 6), HORIZON, young=200e9, nu=0.0, model="correspondence")
    for where, body in (("in the plane", flat), ("in space", _block())):
        for name, found in zip(("least", "largest"), added_rates(body), strict=True):
            what = f"added rates of deformation {where}, {name} stress"
            rows.append(Row(what, RATES, found, 3e-9, "Pa", reason="digits given"))
    for model in tough:
        path = follow(strip("0", 60, 40), 3.015, 28e-3, "energy", cells, "moment matched", "full", model=model)
        why = "measured 1.02, 1.09 and 0.99 for two-parameter, state-based and correspondence models"
        rows += [
            Row(f"energy of the broken bonds, {model}", 1.0, path.bonds, 0.15, reason=why),
            Row(f"energy that the strip loses, {model}", 1.0, path.lost, kind="shown"),
            Row(f"energy release rate at which the crack runs, {model}", 1.0, path.runs, kind="shown"),
        ]
    drawing = partial(_draw, table)
    return Report("elastic_models", "Elastic models", TEXT, rows, drawing, {"moduli": table})


def _draw(table: list[dict[str, Any]], figure: Figure) -> None:
    for ax, plane in zip(panels(figure, 2, sharey=True), SHOWN, strict=True):
        band(ax, 1.0, 0.01)
        for k, model in enumerate(MODELS):
            for cells_are, fill in (("squares", "full"), ("triangles", "none")):
                line = next(
                    row for row in table if (row["model"], row["plane"], row["cells"]) == (model, plane, cells_are)
                )
                ax.plot(
                    np.arange(3) + 0.15 * (k - 1), [line[name] for name in ("E", "nu", "G")], MARKERS[k],
                    color=COLOURS[k], fillstyle=fill, markersize=6, label=f"{model}, {cells_are}",
                )  # fmt: skip
        ax.set_xticks(range(3), ["E", "nu", "G"])
        label(ax, f"plane {plane}", "measured / asked for" if plane == "stress" else "")
        if plane == "strain":
            ax.legend(fontsize=6, frameon=False)
