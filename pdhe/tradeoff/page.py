"""All scenes of the design together: one picture, one table, one file of numbers, and a page."""

from __future__ import annotations

import base64
import csv
import html
import io
import math
from collections.abc import Sequence
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
#: Errors below this are drawn at it: a logarithmic axis has no zero.
LEAST_DRAWN = 1e-6
_FIDELITY: dict[str, Any] = {"linewidths": 0.8, "label": "fidelities: draft, standard, fine, reference"}

_COLUMNS = ("run", "error", "work", "time", "memory", "excess")


def gather(folders: Sequence[str | Path]) -> dict[str, dict[str, Any]]:
    """Read what every scene left in its folder: its report, and its table of runs with numbers as numbers."""
    found = {}
    for folder in map(Path, folders):
        report, runs = folder / "report.json", folder / "runs.csv"
        if not (report.is_file() and runs.is_file()):
            raise PdheError(f"{folder}: no measured scene; run `pdhe trade` first")
        tables = {"runs": _table(runs), "limits": _table(folder / "limits.csv")}
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
        orders = {f"{name}: {row['quantity']}": row["order"] for row in scene["limits"]}
        known = (kind for quantity, kind in _KIND_BY_QUANTITY.items() if f"{name}: {quantity}" in orders)
        kind = next(known, "diffusion")
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
    FigureCanvasAgg(figure)
    axes = panels(figure, columns, rows)
    for ax, scene in zip(axes, scenes.values(), strict=False):
        front_panel(ax, scene["runs"], uncertainty_of(scene))
        label(ax, "work (bonds visited)", "error (%)", scene["title"])
    for ax in axes[len(scenes) :]:
        ax.remove()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    with moved_when_whole(path) as place:
        figure.savefig(place, dpi=160, format=Path(path).suffix[1:])


def front_panel(ax: Axes, table: Sequence[dict[str, Any]], uncertainty: float) -> None:
    """Error against work: every run, the front, the defaults, and what the reference cannot tell apart."""
    rows = [row for row in table if not row["problem"]]
    points = [(row["work"], 100.0 * max(row["error"], LEAST_DRAWN)) for row in rows]

    def of(*groups: str) -> list[tuple[float, float]]:
        return [point for point, row in zip(points, rows, strict=True) if row["group"] in groups]

    ordinary = {str(row["group"]) for row in rows} - {"default", "reference", "fidelity"}
    ax.scatter(*_columns(of(*ordinary)), s=12, color="0.72", linewidths=0, label="a setting changed, or several")
    ax.scatter(
        *_columns(of("reference")), s=16, marker="s", facecolors="none", edgecolors="0.45", label="tight settings"
    )
    line = front_of(points)
    ax.plot(*_columns(line), color=COLOURS[1], lw=1.6, label="front: nothing is cheaper and as accurate", zorder=2)
    default = [row for row in rows if row["group"] == "default"]
    ax.plot(*_columns(of("default")), "-o", ms=5, lw=0.8, color=COLOURS[0], zorder=3, label="defaults, by spacing")
    for row, (work, error) in zip(default, of("default"), strict=True):
        if row in (default[0], default[-1]):
            ax.annotate(row["run"], (work, error), (4, 4), textcoords="offset points", fontsize=7, color=COLOURS[0])
    ax.scatter(*_columns(of("fidelity")), s=46, marker="D", color=COLOURS[2], edgecolors="white", zorder=4, **_FIDELITY)
    for row, (work, error) in zip([r for r in rows if r["group"] == "fidelity"], of("fidelity"), strict=True):
        place = {"xytext": (-4, -5), "ha": "right", "va": "top", "fontsize": 7, "color": COLOURS[2]}
        ax.annotate(row["run"], (work, error), textcoords="offset points", **place)
    ax.set_xscale("log")
    ax.set_yscale("log")
    low, high = (f(error for _, error in points) for f in (min, max))
    low, high = 0.5 * low, 1.5 * high
    if 100.0 * uncertainty > low:
        ax.axhspan(low, 100.0 * uncertainty, color="0.92", lw=0, zorder=0, label="within the reference's uncertainty")
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1, 2, 5) if math.log10(high / low) < 2.5 else (1,)
    ticks = [step * 10.0**decade for decade in decades for step in steps]
    ax.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_yticks([], minor=True)
    ax.set_ylim(low, high)


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
            note = "on the front" if row["front"] is True else f"excess {row['excess']:.2g}"
            cells.append((item["spacing"], item["setting"], error, *times, note))
        lines += _markdown(("spacing", "setting", "error", "work ×", "time ×", ""), cells)
        lines.append("")
    return "\n".join(lines)


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
        excess = "front" if row["front"] is True else f"{row['excess']:.2g}"
        cost = (f"{row['work']:.2g}", f"{row['seconds']:.2g} s", f"{row['peak memory [B]'] / 1e6:.0f} MB")
        name = row["run"] + (" (default)" if row["group"] == "default" else "")
        cells.append((name, _percent(row["error"]), *cost, excess))
    return cells


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %"


def _markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(columns) + " |", "|---" * len(columns) + "|"]
    return lines + ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]


def as_html(scenes: dict[str, dict[str, Any]], picture: str | Path) -> str:
    """The page: the picture, and the tables of every scene."""
    data = base64.b64encode(Path(picture).read_bytes()).decode()
    parts = [f"<!doctype html><meta charset='utf-8'><title>Speed against accuracy</title><style>{STYLE}</style>"]
    parts += ["<h1>Speed against accuracy</h1>", f"<img alt='fronts' src='data:image/png;base64,{data}'>"]
    for scene in scenes.values():
        parts += [f"<h2>{html.escape(scene['title'])}</h2>", f"<p>{html.escape(scene['text'])}</p>"]
        parts.append("<table><tr>" + "".join(f"<th>{name}</th>" for name in _COLUMNS) + "</tr>")
        good = [row for row in scene["runs"] if not row["problem"]]
        for cells in _cost_rows(good):
            parts.append("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>")
        parts.append("</table>")
    return "\n".join(parts)
