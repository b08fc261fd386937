"""Plates that the mechanics topics share: node sets without a scene around them, bodies, and one static solve."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg

from pdhe.bonds import Grading, build_bonds
from pdhe.discretization import discretize
from pdhe.errors import SimulationError
from pdhe.materials import MODELS, Body, make_body
from pdhe.mesh import make_mesh
from pdhe.scene import Geometry, Mesh
from pdhe.sizing import SizeField
from pdhe.solvers import Equilibrium, Preconditioner

#: Steel of the thesis (table 4): Young's modulus in Pa and Poisson's ratio.
YOUNG, POISSON = 207e9, 0.29
THICKNESS = 4e-3


@dataclass(frozen=True)
class Plate:
    """Nodes of a rectangle with its lower-left corner at the origin.

    Attributes
    ----------
    coordinates, volume, spacing
        m (n, 2), m^3 (n,), m (n,).
    width, height
        m.
    bottom, top, left, right
        Nodes of the outermost cells at each edge.
    """

    coordinates: np.ndarray
    volume: np.ndarray
    spacing: np.ndarray
    width: float
    height: float
    bottom: np.ndarray
    top: np.ndarray
    left: np.ndarray
    right: np.ndarray

    @property
    def central(self) -> np.ndarray:
        """Nodes of the central half of the plate in either direction, bool (n,)."""
        x, y = self.coordinates.T
        return (np.abs(x / self.width - 0.5) < 0.25) & (np.abs(y / self.height - 0.5) < 0.25)


def square_plate(columns: int, rows: int, spacing: float = 1e-3, jitter: float = 0.0) -> Plate:
    """Centroids of square cells; ``jitter`` displaces them at random by up to that share of the spacing."""
    x, y = np.meshgrid((np.arange(columns) + 0.5) * spacing, (np.arange(rows) + 0.5) * spacing)
    coordinates = np.column_stack([x.ravel(), y.ravel()])
    number = np.arange(len(coordinates)).reshape(rows, columns)
    if jitter:
        coordinates = coordinates + np.random.default_rng(0).uniform(-jitter, jitter, coordinates.shape) * spacing
    volume = np.full(len(coordinates), spacing**2 * THICKNESS)
    edges = (number[0], number[-1], number[:, 0], number[:, -1])
    return Plate(
        coordinates, volume, np.full(len(coordinates), spacing), columns * spacing, rows * spacing, *edges
    )  # fmt: skip


def rotated_plate(columns: int, rows: int, spacing: float, degrees: float) -> Plate:
    """Nodes of a turned square lattice that lie inside the plate; those within a spacing of an edge make up its set."""
    reach = columns + rows
    i, j = np.meshgrid(np.arange(-reach, reach) + 0.5, np.arange(-reach, reach) + 0.5)
    cosine, sine = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    width, height = columns * spacing, rows * spacing
    x = 0.5 * width + spacing * (cosine * i - sine * j).ravel()
    y = 0.5 * height + spacing * (sine * i + cosine * j).ravel()
    inside = (x >= 0.0) & (x < width) & (y >= 0.0) & (y < height)
    x, y = x[inside], y[inside]
    edges = (np.flatnonzero(near) for near in (y < spacing, y > height - spacing, x < spacing, x > width - spacing))
    sizes = np.full(x.size, spacing)
    return Plate(np.column_stack([x, y]), sizes**2 * THICKNESS, sizes, width, height, *edges)


def triangle_plate(width: float, height: float, spacing: float) -> Plate:
    """Centroids of the triangles of a Gmsh mesh."""
    geometry = Geometry.model_validate(
        {"plate": {"width": width, "height": height, "thickness": THICKNESS}}, context={"si": True}
    )
    mesh = Mesh.model_validate({"spacing": spacing, "cells": "triangle"}, context={"si": True})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plate.msh"
        make_mesh(geometry, mesh, path)
        d = discretize(path, geometry, mesh)
    edges = (d.node_sets[name] for name in ("bottom", "top", "left", "right"))
    return Plate(d.coordinates, d.volume, d.spacing, width, height, *edges)


def graded_plate(width: float, height: float, ratio: float, mesh: dict[str, Any]) -> tuple[Plate, float, Grading]:
    """Centroids of the triangles of a graded mesh (resolved block ``mesh``), reference horizon, m, and its grading."""
    geometry = Geometry.model_validate(
        {"plate": {"width": width, "height": height, "thickness": THICKNESS}}, context={"si": True}
    )
    spec = Mesh.model_validate({"cells": "triangle", **mesh}, context={"si": True})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plate.msh"
        make_mesh(geometry, spec, path)
        d = discretize(path, geometry, spec)
    edges = (d.node_sets[name] for name in ("bottom", "top", "left", "right"))
    size = SizeField(geometry, spec)
    plate = Plate(d.coordinates, d.volume, d.spacing, width, height, *edges)
    return plate, ratio * spec.spacing, Grading(ratio * size(d.coordinates), size.depth(d.coordinates))


def plate_body(
    plate: Plate,
    horizon: float,
    *,
    weights: str = "moment matched",
    partial: str = "full",
    young: float = YOUNG,
    nu: float = POISSON,
    model: str = "condensed rotation",
    plane: str = "stress",
    cracks=(),
    grading: Grading | None = None,
) -> Body:
    """Bonds and bond model on the nodes of a plate; where ``grading`` is given, ``horizon`` is the reference one."""
    law = MODELS[model](young, nu, THICKNESS, horizon, plane)
    bonds = build_bonds(
        plate.coordinates, plate.volume, plate.spacing, THICKNESS, horizon,
        partial=partial, surface=weights, tangential_ratio=law.tangential_ratio, cracks=cracks,
        grading=grading,
    )  # fmt: skip
    return make_body(bonds, law, plate.coordinates, plate.volume)


def equilibrium(body: Body, plate: Plate, fixed: np.ndarray, tolerance: float = 1e-9) -> Equilibrium:
    """Solver for prescribed degrees of freedom ``fixed``, bool (n, 2)."""
    return Equilibrium(body, fixed, plate.coordinates, plate.spacing, tolerance, 5000)


def pull(body: Body, plate: Plate, strain: float = 1e-3) -> tuple[np.ndarray, float]:
    """Stretch a plate along y between its lower and upper edge, sides free: displacements (n, 2) m, and the force, N.

    The outermost nodes get the displacement that the strain has at their place.
    """
    fixed = np.zeros(plate.coordinates.shape, bool)
    fixed[plate.bottom, 1] = fixed[plate.top, 1] = True
    middle = np.argmin(np.hypot(*(plate.coordinates - [0.5 * plate.width, 0.5 * plate.height]).T))
    fixed[middle, 0] = True  # only stops the plate from drifting: it carries no force
    prescribed = np.zeros(plate.coordinates.shape)
    prescribed[:, 1] = strain * plate.coordinates[:, 1]
    u, force = equilibrium(body, plate, fixed).solve(prescribed, prescribed)
    return u, -float(force[plate.top, 1].sum())


def edge_traction(plate: Plate, normal: float = 0.0, shear: float = 0.0) -> np.ndarray:
    """Forces on the outermost nodes, N (n, 2), for a stress ``normal`` along y or ``shear`` on all four edges, Pa.

    The nodes lie inside the edge by part of a cell; shear forces are those of the rectangle between them, so that they
    balance. What irregular nodes leave unbalanced is taken off as a rigid motion of the loaded nodes.
    """
    x, y = plate.coordinates.T
    width = float(x[plate.right].mean() - x[plate.left].mean())
    height = float(y[plate.top].mean() - y[plate.bottom].mean())
    load = np.zeros(plate.coordinates.shape)
    for nodes, sign, total in (
        (plate.top, 1.0, (shear * width, normal * plate.width)),
        (plate.bottom, -1.0, (shear * width, normal * plate.width)),
        (plate.right, 1.0, (0.0, shear * height)),
        (plate.left, -1.0, (0.0, shear * height)),
    ):
        load[nodes] += sign * THICKNESS / nodes.size * np.asarray(total)
    used = np.flatnonzero(load.any(axis=1))
    centred = plate.coordinates[used] - plate.coordinates.mean(axis=0)
    rigid = np.zeros((used.size, 2, 3))
    rigid[:, 0, 0] = rigid[:, 1, 1] = plate.width
    rigid[:, 0, 2], rigid[:, 1, 2] = -centred[:, 1], centred[:, 0]
    rigid = rigid.reshape(-1, 3)
    excess = rigid @ np.linalg.lstsq(rigid, load[used].ravel(), rcond=None)[0]
    load[used] -= excess.reshape(-1, 2)
    return load


def loaded(
    body: Body,
    plate: Plate,
    load: np.ndarray,
    fixed: np.ndarray | None = None,
    prescribed: np.ndarray | None = None,
) -> np.ndarray:
    """Displacements of a plate under forces on its nodes, N (n, 2), and prescribed values where ``fixed``, m (n, 2).

    Without ``fixed`` the plate is free and the forces must balance: three degrees of freedom near the middle are held,
    which takes no force.
    """
    if fixed is None:
        middle = np.array([0.5 * plate.width, 0.5 * plate.height])
        first, second = (
            np.argmin(np.hypot(*(plate.coordinates - middle - [offset, 0.0]).T)) for offset in (0.0, 0.25 * plate.width)
        )
        fixed = np.zeros(load.shape, bool)
        fixed[first], fixed[second, 1] = True, True
    shape, free = load.shape, (~fixed).astype(float)
    values = np.zeros(shape) if prescribed is None else prescribed * fixed
    coarse = Preconditioner(body, ~fixed, plate.coordinates, plate.spacing)

    def stiffness(v: np.ndarray) -> np.ndarray:
        v = v.reshape(shape)
        return (-body.force(v * free) * free + fixed * v).ravel()

    operator = LinearOperator((load.size, load.size), matvec=stiffness, dtype=float)
    inverse = LinearOperator((load.size, load.size), matvec=lambda v: coarse(v.reshape(shape)).ravel(), dtype=float)
    right = ((load + body.force(values)) * free).ravel()
    u, failed = cg(operator, right, rtol=1e-9, maxiter=2000, M=inverse)
    if failed:
        raise SimulationError(f"equilibrium under forces not reached in {failed} iterations")
    return np.where(fixed, values, u.reshape(shape))


def slope(x: np.ndarray, values: np.ndarray) -> float:
    """Least-squares slope of values over a coordinate."""
    centred = x - x.mean()
    return float(centred @ values / (centred @ centred))
