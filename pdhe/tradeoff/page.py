"""All scenes of the design together: a picture of work and one of time and memory, tables, numbers, and a page."""

from __future__ import annotations

import base64
import csv
import html
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median_low
from typing import TYPE_CHECKING, Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pdhe.errors import PdheError
from pdhe.stamps import table_of
from pdhe.tradeoff.front import front_of
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.page import STYLE
from pdhe.wholefile import moved_when_whole, read_json

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Quantity -> kind of the scenes that have it.
_KIND_BY_QUANTITY = {"crack": "fracture", "reaction": "elastic"}
#: Axes of a smaller range than this have ticks at twice and five times powers of ten too.
FEW_DECADES = 300.0
#: Errors below this are drawn at it: a logarithmic axis has no zero.
LEAST_DRAWN = 1e-6
_FRONT = "front: nothing cheaper is as accurate in all"
_FIDELITY: dict[str, Any] = {"linewidths": 0.8, "label": "fidelities: draft, standard, fine, reference"}


@dataclass(frozen=True)
class Cost:
    """A cost that errors are drawn against: column of the table of runs, factor to what is shown, label of the axis."""

    column: str
    label: str
    scale: float = 1.0


WORK = Cost("work", "work (bonds visited)")
OTHER_COSTS = (
    Cost("seconds", "processor time (s)"),
    Cost("peak memory [B]", "memory (MB)", 1e-6),
)

_COLUMNS = ("run", "error", "work", "time", "memory", "excess")


def gather(folders: Sequence[str | Path]) -> dict[str, dict[str, Any]]:
    """Read what every scene left in its folder: its report, and its table of runs with numbers as numbers."""
    found = {}
    for folder in map(Path, folders):
        report, runs = folder / "report.json", folder / "runs.csv"
        if not (report.is_file() and runs.is_file()):
            raise PdheError(f"{folder}: no measured scene; run `pdhe trade` first")
        tables = {"runs": _table(runs), **{name: _table(folder / f"{name}.csv") for name in ("limits", "estimates")}}
        found[folder.name] = {**read_json(report), **tables}
    return found


def _table(path: Path) -> list[dict[str, Any]]:
    return [{key: _number(value) for key, value in row.items()} for row in table_of(path)]


def _number(text: str) -> Any:
    if text in ("True", "False"):
        return text == "True"
    try:
        return float(text)
    except ValueError:
        return text


def uncertainty_of(scene: dict[str, Any]) -> float:
    """Uncertainty of the reference of a scene: the largest of its quantities that count."""
    return next(row["measured"] for row in scene["rows"] if row["what"] == "reference: uncertainty")


def models_of(scenes: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """How errors fall with the spacing in each kind of scene: what :mod:`pdhe.tradeoff.choose` starts from.

    The order of a kind is the median of those of its quantities; of two in the middle, the slower.
    """
    kinds: dict[str, dict[str, float]] = {}
    for name, scene in scenes.items():
        orders = {
            f"{name}{row['version'] and ', '}{row['version']}: {row['quantity']}": row["order"]
            for row in scene["limits"]
        }
        quantities = {row["quantity"] for row in scene["limits"]}
        kind = next((kind for quantity, kind in _KIND_BY_QUANTITY.items() if quantity in quantities), "diffusion")
        kinds.setdefault(kind, {}).update(orders)
    models = {
        kind: {
            "order": round(median_low(orders.values()), 2),
            "orders": {name: round(o, 2) for name, o in orders.items()},
        }
        for kind, orders in kinds.items()
    }
    return {"version": 1, "source": "pdhe tradeoff-page --models (docs/tradeoff.md)", "kinds": models}


def as_csv(scenes: dict[str, dict[str, Any]]) -> str:
    """All runs of all scenes in one table."""
    rows = [{"scene": name, **row} for name, scene in scenes.items() for row in scene["runs"]]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def draw(scenes: dict[str, dict[str, Any]], path: str | Path) -> None:
    """One panel a scene: error against work."""
    columns = 2 if len(scenes) > 1 else 1
    rows = math.ceil(len(scenes) / columns)
    figure = Figure(figsize=(8.0, 3.0 * rows + 0.5), layout="constrained")
    axes = panels(figure, columns, rows)
    for ax, scene in zip(axes, scenes.values(), strict=False):
        front_panel(ax, scene["runs"], uncertainty_of(scene), WORK)
        label(ax, WORK.label, "error (%)", scene["title"])
    for ax in axes[len(scenes) :]:
        ax.remove()
    _finish(figure, axes[0], path)


def draw_costs(scenes: dict[str, dict[str, Any]], path: str | Path) -> None:
    """One column a scene: error against processor time above, against memory below."""
    figure = Figure(figsize=(3.0 * len(scenes) + 0.5, 5.6), layout="constrained")
    axes = panels(figure, len(scenes), len(OTHER_COSTS))
    for k, cost in enumerate(OTHER_COSTS):
        for column, scene in enumerate(scenes.values()):
            ax = axes[k * len(scenes) + column]
            front_panel(ax, scene["runs"], uncertainty_of(scene), cost, named=False)
            label(ax, cost.label, "" if column else "error (%)", "" if k else scene["title"])
    _finish(figure, axes[0], path)


def _finish(figure: Figure, ax: Axes, path: str | Path) -> None:
    FigureCanvasAgg(figure)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    with moved_when_whole(path) as place:
        figure.savefig(place, dpi=160, format=Path(path).suffix[1:])


def front_panel(ax: Axes, table: Sequence[dict[str, Any]], uncertainty: float, cost: Cost, named: bool = True) -> None:
    """Error against a cost: every run, the front, the defaults, and what the reference cannot tell apart.

    Runs are named along the defaults and at the fidelities, unless there is no room to.
    """
    rows = [row for row in table if not row["problem"] and row[cost.column] > 0.0]
    points = [(cost.scale * row[cost.column], 100.0 * max(row["error"], LEAST_DRAWN)) for row in rows]

    def of(*groups: str) -> list[tuple[float, float]]:
        return [point for point, row in zip(points, rows, strict=True) if row["group"] in groups]

    ordinary = [
        (point, row["barred"] is True)
        for point, row in zip(points, rows, strict=True)
        if row["group"] not in ("default", "reference", "fidelity")
    ]
    plain, barred = ([point for point, out in ordinary if out is which] for which in (False, True))
    ax.scatter(*_columns(barred), s=14, marker="x", color="0.72", linewidths=0.9, label="lopsided in a symmetric scene")
    ax.scatter(*_columns(plain), s=12, color="0.62", linewidths=0, label="a setting changed, or several")
    ax.scatter(
        *_columns(of("reference")), s=16, marker="s", facecolors="none", edgecolors="0.45", label="tight settings"
    )
    line = front_of([point for point, row in zip(points, rows, strict=True) if row["barred"] is not True])
    ax.plot(*_columns(line), color=COLOURS[1], lw=1.2, label="least error for the cost", zorder=2)
    best = [point for point, row in zip(points, rows, strict=True) if row["front"] is True]
    ax.scatter(*_columns(best), s=16, color=COLOURS[1], linewidths=0, zorder=2.5, label=_FRONT)
    default = [row for row in rows if row["group"] == "default"]
    ax.plot(*_columns(of("default")), "-o", ms=5, lw=0.8, color=COLOURS[0], zorder=3, label="defaults, by spacing")
    for row, (work, error) in zip(default, of("default"), strict=True):
        if named and row in (default[0], default[-1]):
            place = {"xytext": (0, 7), "ha": "center", "fontsize": 7, "color": COLOURS[0]}
            ax.annotate(row["run"], (work, error), textcoords="offset points", **place)
    ax.scatter(*_columns(of("fidelity")), s=46, marker="D", color=COLOURS[2], edgecolors="white", zorder=4, **_FIDELITY)
    fidelities = [row for row in rows if row["group"] == "fidelity"]
    for row, (work, error) in zip(fidelities if named else (), of("fidelity") if named else (), strict=True):
        place = {"xytext": (-4, -5), "ha": "right", "va": "top", "fontsize": 7, "color": COLOURS[2]}
        ax.annotate(row["run"], (work, error), textcoords="offset points", **place)
    ax.set_xscale("log")
    ax.set_yscale("log")
    low, high = (f(error for _, error in points) for f in (min, max))
    low, high = 0.5 * low, 1.5 * high
    if 100.0 * uncertainty > low:
        ax.axhspan(low, 100.0 * uncertainty, color="0.92", lw=0, zorder=0, label="within the reference's uncertainty")
    ticks = _ticks(low, high)
    ax.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_yticks([], minor=True)
    ax.set_ylim(low, high)
    low, high = ax.get_xlim()
    if high < FEW_DECADES * low:
        ticks = [tick for tick in _ticks(low, high) if low <= tick <= high]
        ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        ax.set_xticks([], minor=True)


def _ticks(low: float, high: float) -> list[float]:
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1, 2, 5) if high < FEW_DECADES * low else (1,)
    return [step * 10.0**decade for decade in decades for step in steps]


def _columns(points: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return [x for x, _ in points], [y for _, y in points]


def knob_table(scene: dict[str, Any]) -> list[dict[str, Any]]:
    """Each setting by itself against the defaults at the same spacing: factors of cost, change of error."""
    default = {row["run"]: row for row in scene["runs"] if row["group"] == "default"}
    rows = []
    for row in scene["runs"]:
        if row["group"] in ("default", "fidelity", "reference", "together"):
            continue
        spacing, _, setting = row["run"].partition(", ")
        base = default[spacing]
        rows.append({"spacing": spacing, "setting": setting, "row": row, "base": base})
    return rows


def as_markdown(scenes: dict[str, dict[str, Any]]) -> str:
    """Tables for the documentation: the fidelities, the front of every scene, and what each knob does by itself."""
    lines = ["## Fidelities", "", *_markdown(_FIDELITY_COLUMNS, fidelity_rows(scenes)), ""]
    lines += ["## What results tell of their own error", "", ESTIMATES, ""]
    lines += [*_markdown(_ESTIMATE_COLUMNS, estimate_rows(scenes)), ""]
    for scene in scenes.values():
        lines += [f"## {scene['title']}", "", scene["text"].strip(), "", "Front, fidelities and defaults:", ""]
        chosen = [row for row in scene["runs"] if row["front"] is True or row["group"] in ("default", "fidelity")]
        lines += _markdown(("run", "error", "work", "time", "memory", "excess"), _cost_rows(chosen))
        lines += ["", "Each setting by itself, against the defaults at the same spacing:", ""]
        cells = []
        for item in knob_table(scene):
            row, base = item["row"], item["base"]
            if row["problem"]:
                cells.append((item["spacing"], item["setting"], "refused", "", "", row["problem"][:90]))
                continue
            times = (f"{row[key] / base[key]:.2f}" if base[key] else "" for key in ("work", "seconds"))
            error = f"{_percent(base['error'])} → {_percent(row['error'])}"
            cells.append((item["spacing"], item["setting"], error, *times, _standing(row)))
        lines += _markdown(("spacing", "setting", "error", "work ×", "time ×", "excess"), cells)
        lines.append("")
    return "\n".join(lines)


ESTIMATES = """\
Every pair of runs with the defaults and of the fidelities whose meshes differ by 1.45 to 3.4 times the spacing: the
error that the finer one would tell of itself from the coarser one, over its distance from the limit; without runs that
are as near to the limit as twice what it is known to."""
_ESTIMATE_COLUMNS = ("scene", "pairs", "told over found", "within a factor of 2", "within 3", "below half")


def estimate_rows(scenes: dict[str, dict[str, Any]]) -> list[tuple[str, ...]]:
    """How far estimates can be trusted in every scene."""
    rows = []
    for scene in scenes.values():
        ratios = sorted(row["told"] / row["found"] for row in scene["estimates"] if row["found"] > 0.0)
        if not ratios:
            continue

        def share(low: float, high: float, ratios: list[float] = ratios) -> str:
            return f"{100.0 * sum(low <= ratio <= high for ratio in ratios) / len(ratios):.0f} %"

        spread = f"{ratios[0]:.2f} to {ratios[-1]:.2g}"
        rows.append((scene["title"], str(len(ratios)), spread, share(0.5, 2.0), share(1 / 3, 3.0), share(0.0, 0.5)))
    return rows


_FIDELITY_COLUMNS = (
    "scene",
    "fidelity",
    "spacing",
    "nodes",
    "error",
    "work",
    "time",
    "memory",
    "over standard",
    "excess",
)


def fidelity_rows(scenes: dict[str, dict[str, Any]]) -> list[tuple[str, ...]]:
    """Error and cost of every fidelity in every scene."""
    cells = []
    for scene in scenes.values():
        rows = [row for row in scene["runs"] if row["group"] == "fidelity"]
        standard = next((row["work"] for row in rows if row["run"] == "standard"), math.nan)
        for row in rows:
            size = (f"{1e3 * row['spacing [m]']:.3g} mm", f"{row['nodes']:.0f}")
            _, error, *cost, excess = _cost_rows([row])[0]
            cells.append((scene["title"], row["run"], *size, error, *cost, f"{row['work'] / standard:.2g}", excess))
    return cells


def _cost_rows(rows: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    cells = []
    for row in sorted(rows, key=lambda row: row["work"]):
        cost = (f"{row['work']:.2g}", f"{row['seconds']:.2g} s", f"{row['peak memory [B]'] / 1e6:.0f} MB")
        name = row["run"] + (" (default)" if row["group"] == "default" else "")
        cells.append((name, _percent(row["error"]), *cost, _standing(row)))
    return cells


def _standing(row: dict[str, Any]) -> str:
    """Where a run is: on the front, left out of it, or by which factor of work away from it."""
    if row["front"] is True:
        return "front"
    return "asymmetric" if row["barred"] is True else f"{row['excess']:.2g}"


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %"


def _markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(columns) + " |", "|---" * len(columns) + "|"]
    return lines + ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]


def as_html(scenes: dict[str, dict[str, Any]], pictures: Sequence[str | Path]) -> str:
    """The page: the pictures, and the tables of every scene."""
    parts = [f"<!doctype html><meta charset='utf-8'><title>Speed against accuracy</title><style>{STYLE}</style>"]
    parts.append("<h1>Speed against accuracy</h1>")
    for picture in map(Path, pictures):
        data = base64.b64encode(picture.read_bytes()).decode()
        parts.append(f"<img alt='{picture.stem}' src='data:image/png;base64,{data}'>")
    for scene in scenes.values():
        parts += [f"<h2>{html.escape(scene['title'])}</h2>", f"<p>{html.escape(scene['text'])}</p>"]
        parts.append("<table><tr>" + "".join(f"<th>{name}</th>" for name in _COLUMNS) + "</tr>")
        good = [row for row in scene["runs"] if not row["problem"]]
        for cells in _cost_rows(good):
            parts.append("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>")
        parts.append("</table>")
    return "\n".join(parts)
