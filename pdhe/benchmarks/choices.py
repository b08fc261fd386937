"""Choices inside the sweeps against what else could have been chosen: node order, stored weights, precision."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
import scipy.sparse as sp
from numba import prange
from numpy import uint32, uint64
from scipy.sparse.csgraph import reverse_cuthill_mckee

from pdhe.benchmarks.problems import mode_i, solved_by
from pdhe.benchmarks.timing import counted, in_turns, ratio, sample_table, shown
from pdhe.bonds import build_bonds
from pdhe.kernels.jit import kernel
from pdhe.materials import make_body
from pdhe.simulation import simulate
from pdhe.solvers import Equilibrium
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.notched import plate_with_cracks
from pdhe.verification.report import Report, Row
from pdhe.verification.slabs import case_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE = "Choices inside the sweeps"
TEXT = """
Force sweeps by gathers on a triangle mesh of {nodes} nodes, one thread, processor time, in turns.

*Node order*: the strips that nodes are numbered in, against reverse Cuthill-McKee, a space-filling curve (Morton) and
no order at all. *Stored weights*: five numbers a bond instead of recomputation from positions, {stored} instead of 12
bytes a bond; and the assembled matrix, whose rows reach two horizons far because rotations are condensed. *Precision*:
weights stored in single precision, on the main scene's lattice; the error is that of the displacements at its end,
relative to the largest. *Idle nodes*: share of the nodes of the main scene whose coverage is held or still below
1e-12, over its outputs: what skipping them could save at most. *Preconditioner*: the inverse diagonal alone instead of
the diagonal and a coarse operator, in the first equilibrium at full load and over the whole main scene; the diagonal
costs nothing to make, an application of both terms about as much as a force sweep.
"""


def run(spacing: float = 1e-3, rounds: int = 5, least: float = 0.05, nodes: int = 20_000) -> Report:
    """Measure all of them; ``spacing`` of the triangles, m, and ``nodes`` of the lattice."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    case = case_of(plate_with_cracks(spacing, 6e6, cells="triangle"))
    u = np.random.default_rng(1).normal(size=case.discretization.coordinates.shape) * 1e-7
    orders = {name: _sweep(case, order, u) for name, order in node_orders(case).items()}
    groups = {"node order": in_turns(orders, rounds, least)}
    stored, difference, sizes = _stored(case, u)
    groups["weights"] = in_turns({"recomputed": orders["strips"], **stored}, rounds, least)
    sweeps, error = _precision(nodes, min(nodes, 1800))
    for name, parts in sweeps.items():
        groups[f"precision, {name}"] = in_turns(parts, rounds, least)
    numba.set_num_threads(before)
    rows: list[Row] = []
    for name in ("reverse Cuthill-McKee", "Morton curve", "random"):
        rows.append(shown(f"order of nodes: {name} over strips", ratio(groups["node order"], name, "strips")))
    for name in stored:
        rows.append(shown(f"{name} over recomputed", ratio(groups["weights"], name, "recomputed")))
        rows.append(shown(f"{name}: bytes a directed bond", sizes[name], "B"))
        rows.append(counted(f"{name}: difference of the forces", difference[name], 1e-10, "at most",
                            reason="the same sums in another order"))  # fmt: skip
    for name in sweeps:
        rows.append(
            shown(f"{name}: double over single precision", ratio(groups[f"precision, {name}"], "double", "single"))
        )
    rows.append(counted("displacements of the main scene, single precision: error", error, 1e-6, "at most",
                        reason="weights are off by 6e-8 at most; measured 1.7e-8"))  # fmt: skip
    rows.append(shown("idle nodes, share", _idle(min(nodes, 1800))))
    rows += preconditioner_rows(nodes, min(nodes, 1800))
    text = TEXT.format(nodes=u.shape[0], stored=sizes["stored weights"])
    return Report("choices", TITLE, text, rows, partial(_draw, groups), {"samples": sample_table(groups)})


def node_orders(case: Any) -> dict[str, np.ndarray]:
    """Numberings of the nodes by name; strips are how a discretization numbers them."""
    b, x = case.bonds, case.discretization.coordinates
    graph = sp.csr_matrix((np.ones(b.neighbours.size, np.int8), b.neighbours, b.offsets))
    cell = np.floor((x - x.min(axis=0)) / np.ptp(x, axis=0).max() * 1023.0).astype(np.int64)
    code = np.zeros(len(x), np.int64)
    for bit in range(10):
        for axis in range(2):
            code |= ((cell[:, axis] >> bit) & 1) << (2 * bit + axis)
    return {
        "strips": np.arange(len(x)),
        "reverse Cuthill-McKee": reverse_cuthill_mckee(graph, symmetric_mode=True),
        "Morton curve": np.argsort(code, kind="stable"),
        "random": np.random.default_rng(0).permutation(len(x)),
    }


def _sweep(case: Any, order: np.ndarray, u: np.ndarray) -> Callable[[], Any]:
    """A force sweep on the same plate with its nodes numbered in another order."""
    d, model = case.discretization, case.body.model
    x, volume = d.coordinates[order], d.volume[order]
    bonds = build_bonds(x, volume, d.spacing[order], d.thickness, case.bonds.horizon, partial="ramp", surface="none")
    body, moved = make_body(bonds, model, x, volume), np.ascontiguousarray(u[order])
    return partial(body.force, moved, np.empty_like(moved))


@kernel
def _stored_force(offsets, neighbours, block, lever, u, spin, force):
    for i in prange(offsets.size - 1):
        fx = 0.0
        fy = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            j = uint32(neighbours[k])
            ex = u[j, 0] - u[i, 0]
            ey = u[j, 1] - u[i, 1]
            turn = spin[i, 1] + spin[j, 1]
            fx += block[k, 0] * ex + block[k, 1] * ey + lever[k, 0] * turn
            fy += block[k, 1] * ex + block[k, 2] * ey + lever[k, 1] * turn
        force[i, 0] = fx
        force[i, 1] = fy


def _stored(case: Any, u: np.ndarray) -> tuple[dict[str, Callable[[], Any]], dict[str, float], dict[str, float]]:
    """Sweeps with stored weights and with an assembled matrix, what they differ by, and their bytes a bond."""
    d = case.discretization
    bonds = build_bonds(d.coordinates, d.volume, d.spacing, d.thickness, case.bonds.horizon, partial="ramp",
                        surface="none")  # fmt: skip
    body = make_body(bonds, case.body.model, d.coordinates, d.volume)
    i, j, half = bonds.owners(), bonds.neighbours, 0.5 * body.tangential
    dx, dy = bonds.length * bonds.nx, bonds.length * bonds.ny
    normal, across = body.cubed * body.normal, body.cubed * half * (body.share[i] + body.share[j])
    block = np.column_stack(
        [normal * dx**2 + across * dy**2, (normal - across) * dx * dy, normal * dy**2 + across * dx**2]
    )
    lever = (body.cubed * half * bonds.length**2)[:, None] * np.column_stack([dy, -dx])
    force = np.empty_like(u)

    def stored() -> np.ndarray:
        _stored_force(bonds.offsets, bonds.neighbours, block, lever, u, body._rotate(u), force)
        return force

    n = len(u)
    # K = local part + (levers on rotations), rotations = W u: the product of two sparse matrices.
    arm = (body.cubed * bonds.length**2 * body.inverse[i])[:, None] * np.column_stack([-dy, dx])
    column, row = np.concatenate([2 * j, 2 * j + 1]), np.concatenate([i, i])
    turning = sp.csr_matrix((arm.T.ravel(), (row, column)), (n, 2 * n))
    turning -= sp.csr_matrix((arm.T.ravel(), (row, np.concatenate([2 * i, 2 * i + 1]))), (n, 2 * n))
    turning = sp.diags(body.share) @ turning
    push = sp.csr_matrix((lever.T.ravel(), (np.concatenate([2 * i, 2 * i + 1]), np.concatenate([j, j]))), (2 * n, n))
    push += sp.csr_matrix((lever.T.ravel(), (np.concatenate([2 * i, 2 * i + 1]), np.concatenate([i, i]))), (2 * n, n))
    entries, place = block[:, [0, 1, 1, 2]].T.ravel(), [(0, 0), (0, 1), (1, 0), (1, 1)]
    rows = np.concatenate([2 * i + a for a, _ in place])
    local = sp.csr_matrix((entries, (rows, np.concatenate([2 * j + c for _, c in place]))), (2 * n, 2 * n))
    local -= sp.csr_matrix((entries, (rows, np.concatenate([2 * i + c for _, c in place]))), (2 * n, 2 * n))
    matrix, flat = (local + push @ turning).tocsr(), u.reshape(-1)
    expected = body.force(u)
    scale = float(np.abs(expected).max())
    difference = {
        "stored weights": float(np.abs(stored() - expected).max()) / scale,
        "assembled matrix": float(np.abs((matrix @ flat).reshape(n, 2) - expected).max()) / scale,
    }
    size = bonds.neighbours.size
    bytes_a_bond = {"stored weights": 44.0, "assembled matrix": 12.0 * matrix.nnz / size}
    return {"stored weights": stored, "assembled matrix": partial(matrix.__matmul__, flat)}, difference, bytes_a_bond


def _precision(nodes: int, small: int) -> tuple[dict[str, dict[str, Callable[[], Any]]], float]:
    """Lattice sweeps in both precisions, and the error of the main scene's displacements."""
    sweeps: dict[str, dict[str, Callable[[], Any]]] = {"force": {}, "diffusion": {}}
    ends = {}
    for name in ("double", "single"):
        case = mode_i(nodes, {"solver.precision": name})
        n, body, diffusion = case.discretization.volume.size, case.body, case.diffusion
        u, psi = np.random.default_rng(1).normal(size=(n, 2)), np.linspace(0.0, 1.0, n)
        held, zeros = np.zeros(n, bool), np.zeros(n)
        arguments = psi, diffusion.stable_step(held), held, zeros, np.empty(n), zeros.copy()
        sweeps["force"][name] = partial(body.force, u, np.empty_like(u))
        sweeps["diffusion"][name] = partial(diffusion.step, *arguments)
        ends[name] = simulate(mode_i(small, {"solver.precision": name}))["displacement"].values[-1]
    error = float(np.abs(ends["single"] - ends["double"]).max() / np.abs(ends["double"]).max())
    return sweeps, error


def _idle(nodes: int) -> float:
    """Share of node outputs of the main scene whose coverage is held by the notch or has not risen yet."""
    coverage = simulate(mode_i(nodes))["coverage"].values
    return float(np.mean((coverage < 1e-12) | (coverage == 1.0)))


class DiagonalOnly(Equilibrium):
    """Conjugate gradients with the inverse diagonal of the stiffness alone (Jacobi)."""

    def _build(self) -> None:
        super()._build()
        inverse = self._preconditioner.inverse_diagonal
        self._preconditioner = partial(np.multiply, inverse)


def preconditioner_rows(nodes: int, small: int) -> list[Row]:
    """What equilibria cost with the diagonal alone: iterations from rest on ``nodes`` nodes, a run on ``small``."""
    iterations, runs = {}, {}
    for name, solver in (("both", Equilibrium), ("diagonal", DiagonalOnly)):
        case = solved_by(solver, mode_i(nodes))
        d, prescribed = case.discretization, case.conditions.values(case.scene.time.end)
        case.equilibrium.solve(np.zeros_like(d.coordinates), prescribed)
        iterations[name] = case.equilibrium.work.equilibrium_iterations
        case = solved_by(solver, mode_i(small))
        start = time.process_time()
        sweeps = simulate(case)["force_sweeps"].values[-1]
        runs[name] = sweeps, time.process_time() - start
    (both, both_seconds), (diagonal, diagonal_seconds) = runs["both"], runs["diagonal"]
    return [
        shown("equilibrium from rest: iterations", iterations["both"]),
        counted("the diagonal alone over both terms: iterations from rest", iterations["diagonal"] / iterations["both"],
                2.0, "at least", reason="as nodes along a side; measured: 10 on 5000, 23 on 20000 nodes"),
        counted("the diagonal alone over both terms: force sweeps of the main scene", diagonal / both, 2.0, "at least",
                reason="measured: 3.2 on 800 nodes, 4.4 on 1800"),
        shown("the diagonal alone over both terms: time of the main scene", diagonal_seconds / both_seconds),
    ]  # fmt: skip


def _draw(groups: dict[str, dict[str, list[float]]], figure: Figure) -> None:
    axes = panels(figure, 2)
    for ax, (title, names) in zip(
        axes, (("node order", ("node order",)), ("storage", [name for name in groups if name != "node order"])),
        strict=True,
    ):  # fmt: skip
        bars = {
            f"{part}" if len(names) == 1 else f"{name.removeprefix('precision, ')}: {part}":
                median(samples) / median(next(iter(groups[name].values())))
            for name in names for part, samples in groups[name].items()
        }  # fmt: skip
        ax.barh(list(bars)[::-1], list(bars.values())[::-1], color=COLOURS[0])
        ax.axvline(1.0, color="0.4", linewidth=0.8)
        label(ax, "time over that of the first", "", title)
