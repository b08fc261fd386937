"""Plates that the benchmarks share: the mode I scene at any size without a mesh file, and bare arrays for kernels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pdhe.case import Case, build_case
from pdhe.discretization import Discretization
from pdhe.kernels import diffusion, lattice, mechanics
from pdhe.provenance import PACKAGE
from pdhe.scene import Scene, load_scene
from pdhe.solvers import Equilibrium

SCENE = PACKAGE.parent / "config" / "scenes" / "mode_i.yaml"


def mode_i(nodes: int, overrides: dict[str, Any] | None = None) -> Case:
    """The main scene on a square lattice with about so many nodes."""
    rows = 2 * max(4, round(np.sqrt(nodes / 8.0)))
    scene = load_scene(SCENE, {"mesh.spacing": f"{100.0 / rows!r} mm", **(overrides or {})})
    return build_case(scene, lattice_nodes(scene))


def solved_by(solver: type[Equilibrium], case: Case) -> Case:
    """A case, nothing broken yet, with another solver of equilibria."""
    d, settings = case.discretization, case.scene.solver
    arguments = case.body, case.conditions.fixed, d.coordinates, d.spacing, settings.tolerance, settings.max_iterations
    return replace(case, equilibrium=solver(*arguments))


def lattice_nodes(scene: Scene) -> Discretization:
    """What meshing a plate with one horizontal notch from its left edge into square cells gives, without a mesh."""
    g, spacing = scene.geometry, scene.mesh.spacing
    columns, rows = round(g.width / spacing), round(g.height / spacing)
    dx, dy = g.width / columns, g.height / rows
    x, y = np.meshgrid((np.arange(columns) + 0.5) * dx, (np.arange(rows) + 0.5) * dy)
    number = np.arange(columns * rows, dtype=np.int32).reshape(rows, columns)
    vx, vy = np.meshgrid(np.arange(columns + 1) * dx, np.arange(rows + 1) * dy)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    cells = np.stack([corner, corner + 1, corner + columns + 2, corner + columns + 1], axis=1).astype(np.int32)
    sets = {"left": number[:, 0], "right": number[:, -1], "bottom": number[0], "top": number[-1]}
    for crack in g.cracks:
        row = round(crack.start[1] / dy)
        length = round(crack.end[0] / dx)
        sets[crack.name] = number[max(row - 1, 0) : row + 1, :length].ravel()
    sets["all"] = number.ravel()
    n = number.size
    return Discretization(
        coordinates=np.column_stack([x.ravel(), y.ravel()]),
        volume=np.full(n, dx * dy * g.thickness),
        spacing=np.full(n, np.sqrt(dx * dy)),
        vertices=np.column_stack([vx.ravel(), vy.ravel()]),
        cells=cells,
        node_sets={name: np.sort(nodes) for name, nodes in sets.items()},
        regular=True,
        thickness=g.thickness,
    )


def force_sweep(nodes: int) -> Callable[[], None]:
    """One force sweep of the mode I plate, ready to be timed."""
    case = mode_i(nodes)
    u = np.random.default_rng(1).normal(size=case.discretization.coordinates.shape) * 1e-7
    out = np.empty_like(u)
    return lambda: case.body.force(u, out)


def diffusion_sweep(nodes: int) -> Callable[[], None]:
    """One diffusion sweep of the mode I plate, ready to be timed."""
    case = mode_i(nodes)
    n = case.discretization.volume.size
    psi, new, supply, held = np.linspace(0.0, 1.0, n), np.empty(n), np.zeros(n), np.zeros(n, bool)
    dt, source = case.diffusion.stable_step(held), np.zeros(n)
    return lambda: case.diffusion.step(psi, dt, held, source, new, supply)


@dataclass(frozen=True)
class Sweep:
    """A sweep as kernels see it: the calls that make it up, and what one of them moves.

    Attributes
    ----------
    calls
        Kernel and arguments, in order.
    c_names
        Functions of ``benchmarks/sweeps.c`` that do the same, with the number of leading arguments they need.
    bonds
        Directed bonds.
    streamed
        Bytes read per directed bond and sweep that are used once: weights and, for gathers, node numbers.
    """

    calls: list[tuple[Callable[..., None], tuple]]
    c_names: list[tuple[str, tuple]]
    bonds: int
    streamed: int

    def run(self) -> None:
        """Do the sweep."""
        for kernel, arguments in self.calls:
            kernel(*arguments)


def bare_sweep(what: str, layout: str, nodes: int, ratio: int) -> Sweep:
    """A ``force`` or ``diffusion`` sweep over a square lattice in ``lattice`` or ``gather`` layout, on bare arrays.

    No scene and no bond arrays stand behind it, so that a million nodes with eighty neighbours fit into memory.
    """
    columns = max(2 * ratio + 2, round(np.sqrt(2.0 * nodes)))
    rows = max(2 * ratio + 2, round(nodes / columns))
    n = columns * rows
    reach = np.arange(-ratio, ratio + 1)
    ox, oy = (offset.ravel() for offset in np.meshgrid(reach, reach))
    keep = (ox**2 + oy**2 <= (ratio + 0.015) ** 2) & ((ox != 0) | (oy != 0))
    ox, oy = ox[keep], oy[keep]
    step = (oy * columns + ox).astype(np.int64)
    there = np.zeros((step.size, rows, columns), bool)
    for o in range(step.size):
        there[o, max(0, -oy[o]) : rows - max(0, oy[o]), max(0, -ox[o]) : columns - max(0, ox[o])] = True
    there = there.reshape(step.size, n)
    bonds = int(there.sum())
    random = np.random.default_rng(0)
    node = {name: random.uniform(0.5, 1.0, n) for name in ("psi", "inverse", "share", "volume", "ux", "uy")}
    zeros, held = np.zeros(n), np.zeros(n, bool)
    value, dt, kn, kt = 1e-3, 0.5, 1.0, 0.1
    if layout == "lattice":
        weight = np.where(there, value, 0.0)
        del there
        dx, dy = ox.astype(float), oy.astype(float)
        if what == "diffusion":
            rest = (weight, zeros, zeros, held, node["volume"], dt, node["psi"], np.empty(n), np.zeros(n))
            return Sweep(
                [(lattice.diffuse, (step, *rest))], [("lattice_diffuse", (n, step.size, step, *rest))], bonds, 8
            )
        theta, turning, fx, fy = np.empty((4, n))
        turn = (step, dx, dy, weight, node["inverse"], node["share"], node["ux"], node["uy"], theta, turning)
        push = (step, dx, dy, weight, node["share"], kn, kt, node["ux"], node["uy"], turning, fx, fy)
        size = (n, step.size)
        return Sweep(
            [(lattice.node_rotation, turn), (lattice.internal_force, push)],
            [("lattice_rotation", size + turn), ("lattice_force", size + push)], bonds, 16,
        )  # fmt: skip
    count = there.sum(axis=0)
    offsets = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    neighbours = np.empty(bonds, np.int32)
    fill = offsets[:-1].copy()
    for o in np.argsort(step):
        nodes_here = np.flatnonzero(there[o])
        neighbours[fill[nodes_here]] = nodes_here + step[o]
        fill[nodes_here] += 1
    del there
    weight = np.full(bonds, value)
    x = np.stack([np.arange(n) % columns, np.arange(n) // columns], axis=1).astype(float)
    if what == "diffusion":
        rest = (offsets, neighbours, weight, zeros, zeros, held, node["volume"], dt, node["psi"], np.empty(n))
        rest = (*rest, np.zeros(n))
        return Sweep([(diffusion.diffuse, rest)], [("gather_diffuse", (n, *rest))], bonds, 12)
    u, spin, force = np.column_stack([node["ux"], node["uy"]]), np.empty((n, 2)), np.empty((n, 2))
    turn = (offsets, neighbours, x, weight, node["inverse"], node["share"], u, spin)
    push = (offsets, neighbours, x, weight, node["share"], kn, kt, u, spin, force)
    return Sweep(
        [(mechanics.node_rotation, turn), (mechanics.internal_force, push)],
        [("gather_rotation", (n, *turn)), ("gather_force", (n, *push))], bonds, 24,
    )  # fmt: skip
