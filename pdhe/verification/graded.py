"""Graded meshes: a patch at rest, the toughness of a strip, and the notched plate with a fine tip in a coarse plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.bonds import Grading
from pdhe.damage import CRITERIA, critical_stretch, crossing_sum, stretch_squares
from pdhe.materials import Body
from pdhe.simulation import simulate
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.notched import HEIGHT, NOTCH, arrival, plate_with_cracks
from pdhe.verification.plates import POISSON, THICKNESS, Plate, equilibrium, graded_plate, plate_body, triangle_plate
from pdhe.verification.report import Report, Row
from pdhe.verification.slabs import case_of
from pdhe.verification.toughness import SPACING, TOUGHNESS, CrackPath, follow, strip

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

RATIO = 3.015
#: Homogeneous strains of the patch: pulled along x with its contraction, sheared, stretched along y alone.
STRAINS = (((1.0, 0.0), (0.0, -POISSON)), ((0.0, 1.0), (1.0, 0.0)), ((0.0, 0.0), (0.0, 1.0)))
#: Coarsest spacing of the strip, in units of the finest.
COARSE_STRIP = 2.5
#: Loads of the plate, s: pulled up to this time, then held.
RAMP = 2e6
#: Up to which share of the time other meshes are followed.
EARLY = 0.8

TEXT = """The spacing of a graded mesh is a function of place, and the horizon of every node is the same multiple
of it.

*Patch.* The outer nodes of a square, 1.5 horizons deep, are given a homogeneous strain; the strains of the bonds
inside should be the same. On uniform triangles, whose bonds are corrected node by node, they differ by 4 %; on graded
triangles, whose bonds are corrected together (theory, eq. 3.9), by 0.6 % to 1.4 %, the more the faster the spacing
grows. Force and torque balance to round-off.

*Strip.* A crack is driven through a stretched strip as in the topic `toughness`, with cells of the same size within
two horizons of its path and larger ones elsewhere, up to two and a half times; each number is the mean over twelve
strips of 36 to 47 rows of cells. What a strip takes is a matter of chance, by how its triangles happen to lie about
the path: with m = 3.015 six of the uniform ones lose 11 % to 13 % more energy than was put in, the other six 20 % to
25 %. Single strips scatter by 5 % on uniform and 3 % on graded triangles, with m = 4 by 1 % and 3 %. In the mean
graded strips lose as much as uniform ones within that chance: 1.019 times as much with m = 3.015 and 0.986 times with
m = 4, of which 0.016 and 0.008 are the standard errors. Their broken bonds take the fracture energy that was put in
within 1 % and 5 %. The latter goes back to the middle of these strips, where triangles that gmsh began on either side
meet: straight cuts within 1.5 cells of it take 0.96 of the fracture energy, those within seven cells 0.99.

The size of the fine cells matters: 8 % more area, and so 2.9 spacings instead of 3 to a horizon, make the ratio 1.048
with m = 3.015. Each part of one spacing therefore has its own mean area, and what lies between them another. Cells
must not be larger still in a strip so low: with horizons of 12 mm and more in 40 mm of height the coarse part breaks
before the crack, since its critical stretch goes with one over the root of the horizon. Nor must the fine part be
narrower: with one horizon the broken bonds take up to 13 % too little.

*Plate.* The notched plate of the thesis in hydrogen, in triangles: uniform, and with the same spacing around the
first 15 mm of the path and up to five times as much elsewhere. The time at which the crack has grown by a cell is
compared, in the mean over three meshes of either kind, with spacings of 0.98 mm, 1 mm and 1.02 mm: it scatters by 5 %
on either. Later ones are only shown: whether the next cell holds the crack for a while depends on how its bonds happen
to lie. Uniform triangles of 1 mm and 1.02 mm differ by 7 % in the first and by 18 % in the second of these times. The
graded mesh takes a fourteenth of the bonds, and a seventh of the work, counted as bonds times sweeps (of forces and of
diffusion); with other spacings the work is between 0.03 and 0.16 of the uniform one, by how the crack jumps.

The last mesh resolves the tip five times finer than the uniform one, with a tenth of its bonds and nine tenths of
its work (half as much until the first bond breaks, and up to 1.2 times as much in between). A lattice of squares of
1 mm has fewer bonds and needs less than uniform triangles: over that the work is 1.4 times as much at the end. In plain
steps as long as the finest cells allow the work was nine times as much, nearly all of it diffusion; long steps between
failures (theory, section 4) leave the sequence of the failures as it was, and their times to 17 s."""


@dataclass(frozen=True)
class Run:
    """A run of the plate: its result, bonds, and bonds times sweeps until each step of its history."""

    result: xr.Dataset
    bonds: int
    work: np.ndarray

    def until(self, time: float) -> float:
        """Bonds times sweeps until a time, s."""
        return float(self.work[np.searchsorted(self.result["history_time"].values, time)])


def bond_strain_error(body: Body, plate: Plate, grading: Grading | None = None) -> float:
    """Largest over three homogeneous strains of the rms error of the bonds' strains inside a patch, relative."""
    horizons = np.full(len(plate.volume), body.bonds.horizon) if grading is None else grading.horizons
    x, y = plate.coordinates.T
    depth = np.minimum(np.minimum(x, plate.width - x), np.minimum(y, plate.height - y))
    outer = depth < 1.5 * horizons
    fixed = np.repeat(outer[:, None], 2, axis=1)
    b, owner = body.bonds, body.bonds.owners()
    inside = ~(outer[owner] | outer[b.neighbours])
    errors = []
    for strain in STRAINS:
        exact = 1e-3 * plate.coordinates @ np.array(strain).T
        u, _ = equilibrium(body, plate, fixed, 1e-9).solve(exact, exact)
        change = (u - exact)[b.neighbours] - (u - exact)[owner]
        stretch = (b.nx * change[:, 0] + b.ny * change[:, 1]) / b.length / 1e-3
        errors.append(np.sqrt(np.average(stretch[inside] ** 2, weights=(b.weight * b.length)[inside])))
    return float(max(errors))


def unbalance(body: Body) -> float:
    """Largest of net force and net torque of random displacements, relative to the sum of their magnitudes."""
    force, x = body.force(np.random.default_rng(0).normal(size=body.coordinates.shape)), body.coordinates
    torque = x[:, 0] * force[:, 1] - x[:, 1] * force[:, 0]
    return float(max(np.abs(force.sum(axis=0)).max() / np.abs(force).sum(), abs(torque.sum()) / np.abs(torque).sum()))


def patch_rows(side: float, growths: tuple[float, ...], coarse: float) -> tuple[list[Row], list[dict[str, Any]]]:
    """Compare patches of ``side`` m: uniform triangles, and graded ones that are fine in the middle."""
    uniform = triangle_plate(side, side, SPACING)
    usual = bond_strain_error(plate_body(uniform, RATIO * SPACING, partial="ramp"), uniform)
    rows = [Row("strains of a patch, uniform triangles", 0.0, usual, kind="shown", reason="rms over bonds")]
    table = [{"growth": 0.0, "nodes": len(uniform.volume), "strain_error": usual}]
    for growth in growths:
        middle = {"from": [side / 2, side / 2], "to": [side / 2, side / 2]}
        mesh = {
            "spacing": coarse * SPACING,
            "growth": growth,
            "refine": [middle | {"spacing": SPACING, "within": 0.08 * side}],
        }
        plate, reference, grading = graded_plate(side, side, RATIO, mesh)
        body = plate_body(plate, reference, partial="ramp", grading=grading)
        error = bond_strain_error(body, plate, grading)
        why = "no worse than uniform triangles; measured 0.6 % for a growth of 0.1, 0.8 % for 0.15, 1.4 % for 0.2"
        rows.append(Row(f"strains of a patch, spacing grows by {growth:g}", usual, error, kind="at most", reason=why))
        rows.append(
            Row(f"net force and torque, spacing grows by {growth:g}", 1e-13, unbalance(body), kind="at most",
                reason="equal and opposite bond by bond, no torque by eq. 2.6: round-off, measured 1e-17")
        )  # fmt: skip
        table.append({"growth": growth, "nodes": len(plate.volume), "strain_error": error})
    return rows, table


def toughness_rows(
    ratios: tuple[float, ...], coarse: float, columns: int, heights: tuple[int, ...], cells: int
) -> tuple[list[Row], dict[tuple[float, str], list[CrackPath]]]:
    """Follow a crack through strips of uniform and of graded triangles; ``heights`` are in cells."""
    rows, paths = [], {}
    for ratio in ratios:
        cuts: dict[str, list[tuple[float, float]]] = {}
        for kind in ("uniform", "graded"):
            paths[ratio, kind], cuts[kind] = [], []
            for height in heights:
                notch, middle = 0.7 * height * SPACING, 0.5 * height * SPACING
                if kind == "uniform":
                    plate, graded = strip("triangles", columns, height), None
                else:
                    # Up to a cell wider than two horizons: other meshes.
                    path = {"from": [notch, middle], "to": [notch + cells * SPACING, middle], "spacing": SPACING,
                            "within": (2.0 * ratio + 0.5 * (height % 3)) * SPACING}  # fmt: skip
                    plate, *graded = graded_plate(
                        columns * SPACING, height * SPACING, ratio, {"spacing": coarse * SPACING, "refine": [path]}
                    )
                common = (ratio, notch, "energy", cells, "moment matched", "ramp")
                paths[ratio, kind].append(follow(plate, *common, graded))
                cuts[kind].append(straight_cut(plate, ratio, cells * SPACING, graded))
            rows += _strip_rows(kind, ratio, paths[ratio, kind], np.mean(cuts[kind], axis=0))
        rows += _compared(ratio, *(paths[ratio, kind] for kind in ("graded", "uniform")))
    return rows, paths


def _strip_rows(kind: str, ratio: float, paths: list[CrackPath], cut: np.ndarray) -> list[Row]:
    """What the strips of one kind took, in the mean."""
    where = f"{kind} triangles, m = {ratio:g}"
    bonds, lost = (float(np.mean([getattr(p, name) for p in paths])) for name in ("bonds", "lost"))
    return [
        Row(f"energy of the broken bonds, {where}", 1.0, bonds, 0.10, "G_c", "relative",
            "as in the topic `toughness`; measured +0 % and -2 % on uniform, +1 % and -5 % on graded ones"),
        Row(f"energy lost, {where}", 1.0, lost, 0.25, "G_c", "relative",
            "as in the topic `toughness`; measured +17 % and +8 % on uniform, +20 % and +6 % on graded ones"),
        Row(f"energy of bonds across a straight cut, {where}", 1.0, float(cut[0]), 0.06, "G_c", "relative",
            "for the weakest direction; measured -1.5 % and -2 %, -1.3 % and -4.3 %; see the text"),
        Row(f"area of the cells on the path, {where}", 1.0, float(cut[1]), 0.03, "1", "relative",
            "over the square of the spacing; measured within 1.5 %, of single meshes within 5 %"),
    ]  # fmt: skip


def _compared(ratio: float, graded: list[CrackPath], uniform: list[CrackPath]) -> list[Row]:
    """Graded strips against uniform ones: means, and how far chance moves their ratio."""
    rows = []
    for what, name, allowed, kind, why in (
        ("energy of the broken bonds", "bonds", 0.05, "relative", "measured +1 % and -2 %"),
        ("energy lost", "lost", 0.0, "at most", "measured 1.019 and 0.986, and 1.048 with fine cells 8 % too large"),
    ):
        values = [np.array([getattr(p, name) for p in kind]) for kind in (graded, uniform)]
        means = [float(each.mean()) for each in values]
        bound = 1.0 if kind == "relative" else 1.04
        rows.append(
            Row(f"{what}, graded over uniform, m = {ratio:g}", bound, means[0] / means[1], allowed, "1", kind, why)
        )
        if len(graded) > 1:
            chance = float(np.sqrt(sum(each.var(ddof=1) / each.mean() ** 2 / each.size for each in values)))
            rows.append(
                Row(f"standard error of that ratio, m = {ratio:g}", 0.0, chance * means[0] / means[1], kind="shown",
                    reason="from the scatter over the strips")
            )  # fmt: skip
    return rows


def straight_cut(
    plate: Plate, ratio: float, length: float, graded: tuple[float, Grading] | None
) -> tuple[float, float]:
    """What a straight cut through the bonds at mid-height takes, and the size of the cells there.

    Of ``length`` m, from a horizon beyond the notch on; the mean over 31 heights within 1.5 spacings.

    Returns
    -------
    energy, area
        Energy of the bonds, each just at breaking, over the fracture energy put in; mean area of the cells within three
        spacings over :data:`SPACING` squared.
    """
    reference, grading = graded or (ratio * SPACING, None)
    body = plate_body(plate, reference, partial="ramp", grading=grading)
    bonds, rule = body.bonds, CRITERIA["energy"]
    squares = stretch_squares(bonds, rule)
    critical = critical_stretch(body.model, crossing_sum(bonds, plate.volume, squares), TOUGHNESS, "discrete", rule)
    energy = 0.5 * body.normal * bonds.weight * bonds.length * critical**2 * (1.0 if squares is None else squares)
    owner, far = bonds.owners(), bonds.neighbours
    (x0, y0), (x1, y1) = plate.coordinates[owner].T, plate.coordinates[far].T
    begin, end, middle = 0.7 * plate.height + ratio * SPACING, 0.7 * plate.height + length, 0.5 * plate.height
    taken = []
    for y in middle + SPACING * np.linspace(-1.5, 1.5, 31):
        crosses = (y0 < y) & (y1 > y)  # either bond of a pair, once
        x = x0[crosses] + (y - y0[crosses]) / (y1 - y0)[crosses] * (x1 - x0)[crosses]
        taken.append(energy[crosses][(x > begin) & (x < end)].sum())
    x, y = plate.coordinates.T
    near = (np.abs(y - middle) < 3.0 * SPACING) & (x > begin) & (x < end)
    return (
        float(np.mean(taken)) / ((end - begin) * THICKNESS * TOUGHNESS),
        float(plate.volume[near].mean()) / THICKNESS / SPACING**2,
    )


def fine_tip(fine: float, length: float, within: float, coarse: float) -> dict[str, Any]:
    """Resolved mesh of the plate with a spacing of ``fine`` around the first ``length`` of the path, all m."""
    start = [NOTCH, HEIGHT / 2]
    region = {"from": start, "to": [NOTCH + length, HEIGHT / 2], "spacing": fine, "within": within}
    return {"spacing": coarse, "cells": "triangle", "refine": [region]}


def both(spacing: float) -> dict[str, dict[str, Any]]:
    """Resolved meshes of the plate in uniform triangles, and in graded ones that are as fine around the path."""
    return {
        "uniform": {"spacing": spacing, "cells": "triangle"},
        "graded": fine_tip(spacing, 15.0 * spacing, 4.0 * spacing, 5.0 * spacing),
    }


def plate_run(mesh: dict[str, Any], end: float) -> Run:
    """The plate pulled within :data:`RAMP`, energy criterion, on a mesh."""
    blocks = {"mesh": mesh, "outputs": {"count": 24}}
    case = case_of(plate_with_cracks(mesh["spacing"], end, criterion="energy", ramp=RAMP, **blocks))
    result, bonds = simulate(case), case.bonds.length.size // 2
    return Run(result, bonds, bonds * (result["force_sweeps"].values + result["diffusion_sweeps"].values))


def run(
    side: float = 0.1,
    growths: tuple[float, ...] = (0.1, 0.15, 0.2),
    coarse: float = 5.0,
    ratios: tuple[float, ...] = (3.015, 4.0),
    strip_cells: tuple[int, int] = (60, 20),
    heights: tuple[int, ...] = tuple(range(36, 48)),
    spacing: float = 1e-3,
    end: float = 2.4e6,
    lengths: tuple[float, ...] = (1e-3, 2e-3),
    others: tuple[float, ...] = (0.98, 1.02),
    finer: float | None = 5.0,
) -> Report:
    """Compare graded meshes with uniform ones.

    Parameters
    ----------
    side, growths, coarse
        Side of the patch, m, growths of its spacing, and the coarsest spacing in units of the finest.
    ratios, strip_cells, heights
        Horizon ratios of the strips; their columns, and the cells that the crack is followed through; the rows of each.
    spacing, end, lengths, others
        Of the uniform plate, m; time until which it is followed, s; growths of the crack whose times are compared, m,
        the first of them on other meshes too, whose spacings are these multiples.
    finer
        How many times finer the tip of the last mesh is; None to leave it out.
    """
    rows, patches = patch_rows(side, growths, coarse)
    more, paths = toughness_rows(ratios, COARSE_STRIP, strip_cells[0], heights, strip_cells[1])
    rows += more
    runs = {kind: plate_run(mesh, end) for kind, mesh in both(spacing).items()}
    times = {kind: [arrival(item.result, lengths)] for kind, item in runs.items()}
    for factor in others:
        for kind, mesh in both(factor * spacing).items():
            times[kind].append(arrival(plate_run(mesh, EARLY * end).result, lengths))
    for k, length in enumerate(lengths):
        # Only what is judged is worth other meshes; later times may lie beyond their end.
        uniform, graded = (np.mean([each[k] for each in times[kind][: None if k == 0 else 1]]) for kind in runs)
        why = "one mesh: see the text" if k else "mean over three meshes, which scatter by 5 %; measured +2 %"
        rows.append(
            Row(f"time at which the crack has grown by {1e3 * length:g} mm, graded", float(uniform), float(graded),
                0.10, "s", "shown" if k else "relative", why)
        )  # fmt: skip
    ratio = runs["graded"].until(end) / runs["uniform"].until(end)
    rows.append(
        Row("work, graded over uniform of the same fineness", 0.2, ratio, kind="at most",
            reason="measured 0.14; see the text")
    )  # fmt: skip
    if finer is not None:
        runs["finer"] = plate_run(fine_tip(spacing / finer, 2.0 * spacing, 0.8 * spacing, 5.0 * spacing), end)
        ratio = runs["finer"].until(end) / runs["uniform"].until(end)
        rows.append(
            Row(f"work, tip {finer:g} times finer over uniform", 2.0, ratio, kind="at most", reason="measured 0.89")
        )  # fmt: skip
        rows.append(
            Row(f"bonds, tip {finer:g} times finer over uniform", 0.2, runs["finer"].bonds / runs["uniform"].bonds,
                kind="at most", reason="measured 0.10")
        )  # fmt: skip
        lattice = plate_run({"spacing": spacing}, end)
        rows.append(
            Row(f"work, tip {finer:g} times finer over a lattice", 2.0, runs["finer"].until(end) / lattice.until(end),
                kind="at most", reason="a lattice has fewer bonds; measured 1.41")
        )  # fmt: skip
    tables = {
        "patch": patches,
        "strip": [
            {"horizon_ratio": m, "mesh": kind, "rows": rows_of_cells, "runs": p.runs, "lost": p.lost,
             "broken_bonds": p.bonds}
            for (m, kind), each in paths.items() for rows_of_cells, p in zip(heights, each, strict=True)
        ],
        "plate": [
            {"mesh": name, "bonds": item.bonds, "work": item.until(end)} for name, item in runs.items()
        ],
    }  # fmt: skip
    return Report("graded", "Graded meshes", TEXT, rows, _drawing(patches, paths, runs), tables)


def _drawing(patches: list[dict[str, Any]], paths: dict[tuple[float, str], list[CrackPath]], runs: dict[str, Run]):
    def draw(figure: Figure) -> None:
        figure.set_size_inches(7.4, 3.0)
        first, second, third = panels(figure, 3)
        graded = patches[1:]
        first.plot([line["growth"] for line in graded], [100.0 * line["strain_error"] for line in graded], "o-")
        first.axhline(100.0 * patches[0]["strain_error"], color="0.4", linestyle="--", label="uniform triangles")
        first.set_ylim(bottom=0.0)
        first.legend(fontsize=7, frameon=False)
        label(first, "growth of the spacing", "strain error (%)")
        for k, ((_, kind), each) in enumerate(paths.items()):
            lost, colour = np.array([path.lost for path in each]), COLOURS[kind == "graded"]
            second.plot(k + np.linspace(-0.25, 0.25, lost.size), lost, "o", ms=3, color=colour, alpha=0.6)
            second.plot([k - 0.35, k + 0.35], [lost.mean()] * 2, color=colour, linewidth=1.6)
        second.axhline(1.0, color="0.3", linewidth=0.8)
        second.set_xticks(range(len(paths)), [f"{kind}\n{ratio:g}" for ratio, kind in paths], fontsize=7)
        label(second, "strips and their mean, by horizon ratio", "energy lost ($G_c$)")
        for k, (name, item) in enumerate(runs.items()):
            r = item.result
            third.step(
                r["history_time"].values / 1e6, 1e3 * r["crack_extension"].values, where="post", color=COLOURS[k],
                linewidth=1.0, label=f"{name}, {item.bonds / 1e3:.0f} 000 bonds",
            )  # fmt: skip
        third.legend(fontsize=6, frameon=False)
        label(third, "time ($10^6$ s)", "growth (mm)")

    return draw
