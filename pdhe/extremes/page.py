"""All extremes on one page: the map of outcomes, and every case with what shows its outcome."""

from __future__ import annotations

import base64
import csv
import html
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pdhe.stamps import table_of
from pdhe.verification.page import STYLE, cells, read_reports
from pdhe.wholefile import moved_when_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Colours of the outcomes, apart also in grey and for colour-blind readers: right is darkest but for failed.
COLOURS = {"right": "#9fd3b8", "refused": "#dfe5ee", "failed": "#b00020"}
COLUMNS = ("case", "outcome", "what", "expected", "measured", "error", "allowed", "reason")
INTRODUCTION = """\
Scenes at and beyond the edge of what makes sense, each run to a stated outcome: **right** within a bound, or
**refused** before it runs, with a reason. A case *fails* if its outcome is any other: a number that is not finite, a
bound that does not hold, an exception, a warning about arithmetic, no answer in time. Made by
`snakemake --cores 2 extremes`; the verdict fails the run when any case fails.

Every run of a case is held to the same promises besides its own comparisons: all numbers finite, coverage within the
bounds of its data, hydrogen that entered accounted for, damage from 0 to 1 and never healed, no energy from nowhere.
`pdhe/extremes/` holds the cases, one line each; `tests/extremes/test_fuzz.py` holds random scenes to the same promises
(250 with the tests, thousands with `--slow`)."""


def gather(folders: Sequence[str | Path]) -> list[dict[str, Any]]:
    """Reports of groups, each with its ``outcomes``: one dictionary a case, as written by ``Report.write``."""
    reports = read_reports(folders)
    for report, folder in zip(reports, folders, strict=True):
        outcomes = table_of(Path(folder, "outcomes.csv"))
        rows = iter(report["rows"])
        report["outcomes"] = [{**o, "rows": [next(rows) for _ in range(int(o["rows"]))]} for o in outcomes]
    return reports


def summary(reports: Sequence[dict[str, Any]]) -> str:
    """One sentence: how many cases ended how."""
    outcomes = [outcome for report in reports for outcome in report["outcomes"]]
    count = {name: sum(o["outcome"] == name for o in outcomes) for name in COLOURS}
    families = len({o["family"] for o in outcomes})
    return (
        f"{len(outcomes)} cases in {families} families: {count['right']} right, {count['refused']} refused, "
        f"{count['failed']} failed."
    )


def draw_map(figure: Figure, reports: Sequence[dict[str, Any]]) -> None:
    """Matrix of outcomes: a row is a family, from mild or small on the left to extreme or large on the right."""
    families: dict[str, list[dict[str, Any]]] = {}
    for report in reports:
        for outcome in report["outcomes"]:
            families.setdefault(outcome["family"], []).append(outcome)
    widest = max(map(len, families.values()))
    figure.set_size_inches(0.78 * widest + 3.2, 0.36 * len(families) + 0.9)
    ax = figure.add_subplot()
    for row, (_, outcomes) in enumerate(families.items()):
        for column, outcome in enumerate(outcomes):
            box = (column - 0.47, row - 0.42)
            ax.add_patch(_rectangle(box, COLOURS[outcome["outcome"]]))
            text = _wrapped(outcome["level"])
            colour = "white" if outcome["outcome"] == "failed" else "0.1"
            size = 6.5 if max(map(len, text.split("\n"))) <= 9 else 5.2
            ax.text(column, row, text, ha="center", va="center", fontsize=size, color=colour, linespacing=0.95)
    for name, colour in COLOURS.items():
        ax.plot([], [], "s", color=colour, markersize=9, label=name)
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, fontsize=8)
    ax.set_yticks(range(len(families)), list(families), fontsize=8)
    ax.set_xticks([])
    ax.set_xlim(-0.55, widest - 0.45)
    ax.set_ylim(len(families) - 0.5, -0.5)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)


def _rectangle(corner: tuple[float, float], colour: str) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle(corner, 0.94, 0.84, facecolor=colour, edgecolor="0.6", linewidth=0.5)


def _wrapped(text: str, width: int = 10) -> str:
    """Break a text at spaces into lines of about ``width`` characters."""
    lines: list[str] = []
    for word in text.split():
        if lines and len(lines[-1]) + 1 + len(word) <= width:
            lines[-1] += " " + word
        else:
            lines.append(word)
    return "\n".join(lines)


def write_map(reports: Sequence[dict[str, Any]], path: str | Path) -> None:
    """Write the map as a picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained")
    FigureCanvasAgg(figure)
    draw_map(figure, reports)
    with moved_when_whole(path) as place:
        figure.savefig(place, dpi=160, format=Path(path).suffix[1:])


def table(reports: Sequence[dict[str, Any]]) -> list[dict[str, str]]:
    """Every comparison of every case as text, one dictionary a line."""
    lines = []
    for report in reports:
        for outcome in report["outcomes"]:
            case = f"{outcome['family']}, {outcome['level']}"
            for row in outcome["rows"]:
                what, expected, measured, error, allowed, _, reason = map(str, cells(row))
                what = what.removeprefix(f"{case}: ")
                if outcome["stated"] == "refused" and outcome["outcome"] == "refused":
                    what = expected = measured = error = allowed = ""
                values = (case, outcome["outcome"], what, expected, measured, error, allowed, reason)
                lines.append(dict(zip(COLUMNS, values, strict=True)))
    return lines


def write_table(reports: Sequence[dict[str, Any]], path: str | Path) -> None:
    """Write the table as CSV."""
    with moved_when_whole(path) as place, place.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=COLUMNS)
        writer.writeheader()
        writer.writerows(table(reports))


def as_html(reports: Sequence[dict[str, Any]], picture: str | Path) -> str:
    """The page as one HTML file with its map inside."""
    data = base64.b64encode(Path(picture).read_bytes()).decode()
    parts = [f"<!doctype html><meta charset='utf-8'><title>Extremes</title><style>{STYLE}</style><h1>Extremes</h1>"]
    plain = INTRODUCTION.replace("*", "").replace("`", "")
    parts += [f"<p>{html.escape(text)}</p>" for text in (*plain.split("\n\n"), summary(reports))]
    parts.append(f"<img alt='map of outcomes' src='data:image/png;base64,{data}'>")
    parts.append("<table><tr>" + "".join(f"<th>{name}</th>" for name in COLUMNS) + "</tr>")
    for line in table(reports):
        state = "bad" if line["outcome"] == "failed" else "ok"
        values = [
            f"<td class='{state if name == 'outcome' else ''}'>{html.escape(line[name])}</td>" for name in COLUMNS
        ]
        parts.append("<tr>" + "".join(values) + "</tr>")
    return "\n".join([*parts, "</table>"])


def as_markdown(reports: Sequence[dict[str, Any]], picture: str) -> str:
    """The page in Markdown, the map linked, each case with what shows its outcome."""
    lines = ["# Extremes", "", INTRODUCTION, "", summary(reports), "", f"![Map of outcomes]({picture})", ""]
    lines += ["| " + " | ".join(COLUMNS) + " |", "|---|---|---|---:|---:|---:|---:|---|"]
    last = ""
    for line in table(reports):
        shown = {**line, "case": "" if line["case"] == last else line["case"]}
        last = line["case"]
        lines.append("| " + " | ".join(shown[name].replace("|", "\\|").replace("\n", " ") for name in COLUMNS) + " |")
    return "\n".join([*lines, ""])
