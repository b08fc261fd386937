"""Paths of four cracks, dry under a growing load and in hydrogen under a held one, in pictures and in a few numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe import post
from pdhe.plotting.picture import Panel, Picture
from pdhe.plotting.style import Style
from pdhe.simulation import simulate
from pdhe.verification.notched import Segment, plate_with_cracks
from pdhe.verification.report import Report, Row
from pdhe.verification.slabs import HORIZON_RATIO, case_of

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

SIDE = 0.1
#: Displacement of either edge, m: largest of the dry ramp, and held in hydrogen, which is reached after a time, s.
DRY_PULL, HELD_PULL, RAMP = 120e-6, 40e-6, 1e4


@dataclass(frozen=True)
class Layout:
    """Cracks and holes of a plate of :data:`SIDE`, and how long it is held in hydrogen, s."""

    title: str
    cracks: dict[str, Segment]
    end: float
    holes: tuple[dict[str, Any], ...] = ()


LAYOUTS = {
    "straight": Layout("straight", {"notch": ((0.0, 0.05), (0.03, 0.05))}, 2e6),
    "inclined": Layout("inclined", {"notch": ((0.0, 0.03), (0.03, 0.06))}, 2e6),
    "offset": Layout(
        "offset", {"left_notch": ((0.0, 0.043), (0.03, 0.043)), "right_notch": ((0.1, 0.057), (0.07, 0.057))}, 2e6
    ),
    "hole": Layout(
        "near a hole", {"notch": ((0.0, 0.05), (0.03, 0.05))}, 4e6,
        ({"name": "hole", "centre": (0.055, 0.063), "radius": 0.01},),
    ),
}  # fmt: skip

TEXT = """\
Plates of 100 mm by 100 mm on triangles, pulled by edges that slide: a straight edge crack, one at 45 degrees, two
offset ones that grow towards each other, and one that passes near a hole. Each is loaded dry until it breaks, and
held at four fifths or less of the load at which the first dry bond fails while hydrogen enters from the crack faces.
Nothing is said about the path beforehand.

The straight crack stays straight within a cell. The inclined one turns at once across the load; its dry kink is
compared with that of the maximum tangential stress for the ratio of sliding to opening that the model itself shows
behind the tip. The offset cracks overlap and hook; in hydrogen one of them ends on the other. The crack near
the hole runs into it, and goes on from its far side.

In hydrogen the paths are those of the dry plates on the whole, but the inclined crack kinks more sharply: 66 to 86
degrees on four meshes against 42 to 64 dry. Around the tip of a saturated crack coverage is higher to the sides than
ahead, so that weaker bonds wait at larger angles than stress alone would choose. The kink depends on the mesh as
well (see the topic on the kink, where lattices of several orientations are compared), so that a path is known to a
few cells, no better."""


def run(spacing: float = 2e-3, layouts: Sequence[str] = tuple(LAYOUTS), criterion: str = "energy") -> Report:
    """Run scenes dry and in hydrogen; ``spacing`` in m, ``layouts`` by name."""
    results = {(name, wet): solve(name, wet, spacing, criterion) for name in layouts for wet in (False, True)}
    rows = []
    for (name, wet), result in results.items():
        state = "in hydrogen" if wet else "dry"
        title = LAYOUTS[name].title
        rows.append(
            Row(f"{title}, {state}: crack growth", 0.02, float(result["crack_extension"].values[-1]), unit="m",
                kind="at least", reason="there is a path to look at")
        )  # fmt: skip
        if wet:
            first = post.growth(results[name, False])[0] * DRY_PULL
            rows.append(
                Row(f"{title}: load of the first dry failure over that held in hydrogen", 1.2, first / HELD_PULL,
                    kind="at least", reason="the held plate would not break dry; measured 1.28 to 1.48")
            )  # fmt: skip
        rows += _path_rows(name, wet, result, results[name, False], spacing)
    return Report("crack_scenes", "Paths of cracks", TEXT, rows, _drawing(results, list(layouts)))


def solve(name: str, wet: bool, spacing: float, criterion: str) -> xr.Dataset:
    """Run one plate."""
    layout = LAYOUTS[name]
    held: dict[str, Any] = {"pull": HELD_PULL, "ramp": RAMP, "wet": tuple(layout.cracks)}
    dry: dict[str, Any] = {"pull": DRY_PULL, "ramp": 1.0, "wet": None}
    scene = plate_with_cracks(
        spacing, layout.end if wet else 1.0, size=(SIDE, SIDE), cracks=layout.cracks, holes=layout.holes,
        cells="triangle", criterion=criterion, outputs={"count": 40}, **(held if wet else dry),
    )  # fmt: skip
    result = simulate(case_of(scene))
    result.attrs["scene"] = json.dumps(scene.resolved())
    return result


def _path_rows(name: str, wet: bool, result: xr.Dataset, dry: xr.Dataset, spacing: float) -> list[Row]:
    title, state, middles = LAYOUTS[name].title, "in hydrogen" if wet else "dry", broken_middles(result)
    cell = 1.52 * spacing
    if name == "straight":
        away = float(np.abs(path(result)[:, 1] - SIDE / 2).max())
        return [
            Row(f"{title}, {state}: largest distance of the path from the plane of the notch", 1.0 * cell, away,
                unit="m", kind="at most", reason="the side of a triangle; measured a quarter of it")
        ]  # fmt: skip
    if name == "inclined":
        start, tip = (np.array(p) for p in LAYOUTS[name].cracks["notch"])
        turns = [kink(broken_middles(one), start, tip, HORIZON_RATIO * spacing) for one in (dry, result)]
        if wet:
            return [
                Row(f"{title}: kink in hydrogen over that of the dry crack", 1.0, turns[1] / turns[0], kind="at least",
                    reason="coverage is higher beside the tip than ahead of it; measured 1.15, 1.42, 1.52 and 1.99 at "
                    "spacings of 3, 2.5, 2 and 1.75 mm"),
                Row(f"{title}, {state}: kink", math.nan, turns[1], unit="degrees", kind="shown",
                    reason="no closed form is known for this case"),
            ]  # fmt: skip
        return [
            Row(f"{title}, {state}: kink", expected_kink(dry, start, tip), turns[0], 25.0, "degrees", "absolute",
                "maximum tangential stress, from sliding over opening; measured -4 to +24 at spacings of 4 to "
                "1.75 mm: one mesh tells little, see the topic on the kink")
        ]  # fmt: skip
    if name == "offset":
        left, right = (grown(middles, LAYOUTS[name].cracks[key][1]) for key in LAYOUTS[name].cracks)
        return [
            Row(f"{title}, {state}: smaller one of the growths of the two cracks", 0.01, min(left, right), unit="m",
                kind="at least", reason="both cracks grow; measured 19 mm dry, 24 mm in hydrogen, 40 mm lie between"),
        ]  # fmt: skip
    (hole,) = LAYOUTS[name].holes
    gap = np.hypot(*(path(result) - hole["centre"]).T).min() - hole["radius"]
    return [
        Row(f"{title}, {state}: gap between crack and hole", 1.0 * cell, float(gap), unit="m", kind="at most",
            reason="the crack is drawn into the hole, whose rim is 3 mm above its plane; measured a third of a side")
    ]  # fmt: skip


def path(result: xr.Dataset) -> np.ndarray:
    """Middles of the facets between cells along which the crack grew, m (k, 2)."""
    facets = post.facets_of(result)
    rows = post.open_facets(result, facets)[-1]
    rows = rows[facets.broken[rows] > post.PRE_CRACKED]
    return result["vertices"].values[facets.vertices[rows]].mean(axis=1)


def broken_middles(result: xr.Dataset) -> np.ndarray:
    """Middles of the bonds broken in the run, m (k, 2)."""
    place = np.column_stack([result["node_x"].values, result["node_y"].values])
    return 0.5 * (place[result["broken_i"].values] + place[result["broken_j"].values])


def grown(middles: np.ndarray, tip: tuple[float, float]) -> float:
    """Farthest broken bond from a tip on the side of its own crack's half of the height, m."""
    own = (middles[:, 1] < SIDE / 2) == (tip[1] < SIDE / 2)
    return float(np.hypot(*(middles[own] - tip).T).max()) if own.any() else 0.0


def kink(middles: np.ndarray, start: np.ndarray, tip: np.ndarray, horizon: float) -> float:
    """Turn of the path at a tip, degrees, from the bonds broken half a horizon to one and a half from it."""
    ahead = (tip - start) / np.hypot(*(tip - start))
    away = middles - tip
    distance = np.hypot(*away.T)
    mean = away[(distance > 0.5 * horizon) & (distance < 1.5 * horizon)].mean(axis=0)
    return float(math.degrees(math.atan2(mean @ [ahead[1], -ahead[0]], mean @ ahead)))


def expected_kink(result: xr.Dataset, start: np.ndarray, tip: np.ndarray) -> float:
    """Kink of the maximum tangential stress, degrees, from the jump of the displacement behind a tip before it grows.

    K_II over K_I is the sliding over the opening, both summed over the faces one to three horizons behind the tip.
    """
    ahead = (tip - start) / np.hypot(*(tip - start))
    normal = np.array([-ahead[1], ahead[0]])
    place = np.column_stack([result["node_x"].values, result["node_y"].values])
    behind, above = (tip - place) @ ahead, (place - tip) @ normal
    spacing = math.sqrt(SIDE**2 / len(place))
    last = max(int(np.searchsorted(result["time"].values, post.growth(result)[0])) - 1, 1)
    u = result["displacement"].values[last]
    near = (behind > 3.0 * spacing) & (behind < 9.0 * spacing) & (np.abs(above) < spacing)
    jump = u[near & (above > 0.0)].mean(axis=0) - u[near & (above < 0.0)].mean(axis=0)
    opening, sliding = float(jump @ normal), float(jump @ ahead)
    t = -np.linspace(0.0, 0.5 * math.pi, 20001)
    ratio = abs(sliding) / opening
    stress = np.cos(t / 2.0) * (np.cos(t / 2.0) ** 2 - 1.5 * ratio * np.sin(t))
    return float(-np.degrees(t[int(np.argmax(stress))]))


def _drawing(results: dict[tuple[str, bool], xr.Dataset], layouts: list[str]):
    def draw(figure: Figure) -> None:
        figure.set_size_inches(1.9 * len(layouts) + 1.0, 4.6)
        grid = figure.add_gridspec(2, len(layouts) + 1, width_ratios=[1.0] * len(layouts) + [0.05])
        letters = iter("abcdefgh")
        for row, wet in enumerate((False, True)):
            for column, name in enumerate(layouts):
                result = results[name, wet]
                ax = figure.add_subplot(grid[row, column])
                panel = Panel(ax, Picture(result, "damage", Style()), (300, 300))
                panel.show(result.sizes["time"] - 1)
                ax.set_aspect("equal")
                ax.set_xticks((0, 50, 100))
                ax.set_yticks((0, 50, 100))
                ax.tick_params(labelsize=7, labelleft=column == 0, labelbottom=row == 1, direction="in", length=2)
                ax.set_title(f"({next(letters)}) {LAYOUTS[name].title}", loc="left", fontsize=8, pad=3)
                first, last = post.growth(result)
                if wet:
                    note = f"{first / 86400:.1f} to {last / 86400:.1f} days"
                else:
                    note = f"±{1e6 * DRY_PULL * first:.0f} to {1e6 * DRY_PULL * last:.0f} µm"
                ax.text(0.97, 0.04, note, transform=ax.transAxes, ha="right", fontsize=7, color="0.3")
                if column == 0:
                    state = f"hydrogen, held at ±{1e6 * HELD_PULL:.0f} µm" if wet else "dry, growing load"
                    ax.set_ylabel(f"{state}\n$y$ (mm)", fontsize=8)
                if row == 1:
                    ax.set_xlabel("$x$ (mm)", fontsize=8, labelpad=1)
        bar = figure.colorbar(panel.image, cax=figure.add_subplot(grid[:, -1]))
        bar.set_label("damage $\\phi$", fontsize=8)
        bar.ax.tick_params(labelsize=7, length=2)

    return draw
