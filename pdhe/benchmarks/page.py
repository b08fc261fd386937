"""All benchmarks as one JSON file, one page and, for the documentation, tables in Markdown; and two runs compared."""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from pdhe.benchmarks.machine import one_line
from pdhe.benchmarks.registry import BENCHMARKS
from pdhe.errors import PdheError
from pdhe.verification.page import STYLE
from pdhe.wholefile import read_json

#: Units in which more is better; ratios of the others are inverted in a comparison.
RATES = ("bonds/s",)


def gather(folders: Sequence[str | Path]) -> dict[str, Any]:
    """Read what :func:`pdhe.benchmarks.registry.write_benchmark` left in each folder."""
    found = {}
    for folder in map(Path, folders):
        try:
            report = read_json(folder / "report.json")
            around = read_json(folder / "machine.json")
        except OSError as error:
            raise PdheError(f"{folder}: no such report; run the benchmark first ({error})") from error
        rows = [
            {
                "what": row["what"],
                "measured": row["measured"],
                "unit": row["unit"],
                "goal": row["expected"] if math.isfinite(row["expected"]) else None,
                "judged": row["kind"] if row["kind"] != "shown" else None,
                "holds": row["passed"],
            }
            for row in report["rows"]
        ]
        found[report["topic"]] = {"title": report["title"], "text": report["text"], **around, "rows": rows}
    return {"benchmarks": {name: found[name] for name in BENCHMARKS if name in found}}


def as_html(content: dict[str, Any], folders: Sequence[str | Path]) -> str:
    """The page as one HTML file with its figures inside."""
    figures = {Path(folder).name: Path(folder, "figure.png") for folder in folders}
    parts = [f"<!doctype html><meta charset='utf-8'><title>Benchmarks</title><style>{STYLE}</style><h1>Benchmarks</h1>"]
    parts.append(
        "<p>Made by <code>snakemake --cores 2 benchmarks</code>. Medians; times and rates are shown without a verdict, "
        "counts are judged.</p>"
    )
    for name, block in content["benchmarks"].items():
        parts.append(f"<h2 id='{name}'>{html.escape(block['title'])}</h2>")
        parts += [f"<p>{html.escape(text)}</p>" for text in block["text"].strip().split("\n\n")]
        parts.append(f"<p><small>{html.escape(one_line(block['machine']))}</small></p>")
        if name in figures and figures[name].is_file():
            data = base64.b64encode(figures[name].read_bytes()).decode()
            parts.append(f"<img alt='{html.escape(block['title'])}' src='data:image/png;base64,{data}'>")
        parts.append("<table><tr><th>what</th><th>measured</th><th>goal or bound</th><th></th></tr>")
        for row in block["rows"]:
            what, measured, goal, verdict = map(html.escape, cells(row))
            state = "" if row["judged"] is None else ("ok" if row["holds"] else "bad")
            numbers = f"<td class='n'>{measured}</td><td class='n'>{goal}</td>"
            parts.append(f"<tr><td>{what}</td>{numbers}<td class='{state}'>{verdict}</td></tr>")
        parts.append("</table>")
    return "\n".join(parts)


def as_markdown(content: dict[str, Any]) -> str:
    """Tables of all benchmarks in Markdown."""
    lines = ["# Measured performance", "", "Written by `snakemake --cores 2 benchmarks`; medians.", ""]
    for block in content["benchmarks"].values():
        lines += [f"## {block['title']}", "", f"{one_line(block['machine'])}.", ""]
        lines += ["| what | measured | goal or bound | |", "|---|---:|---:|---|"]
        lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in cells(row)) + " |" for row in block["rows"]]
        lines.append("")
    return "\n".join(lines)


def cells(row: dict[str, Any]) -> tuple[str, str, str, str]:
    """A row as text: what, measured, goal or bound, verdict."""
    unit = "" if row["unit"] == "1" else f" {row['unit']}"
    goal = "" if row["goal"] is None else f"{row['goal']:.4g}{unit}"
    if row["judged"] is None:
        return row["what"], f"{row['measured']:.4g}{unit}", goal, ""
    sign = {"at most": "<= ", "at least": ">= "}.get(row["judged"], "")
    return row["what"], f"{row['measured']:.4g}{unit}", sign + goal, "holds" if row["holds"] else "FAILS"


def compare(old: dict[str, Any], new: dict[str, Any]) -> Iterable[str]:
    """Lines of a comparison of two contents of ``benchmarks.json``: new over old, or for rates as they are.

    A number above 1 means that the new run has more of what is measured; an arrow tells better from worse where times
    or rates differ by more than a tenth, and counts at all.
    """
    for name in BENCHMARKS:
        before, after = (content["benchmarks"].get(name) for content in (old, new))
        if before is None or after is None:
            if before is not after:
                yield f"{name}: only in the {'new' if before is None else 'old'} run"
            continue
        yield f"{name}"
        if before["machine"]["processor"] != after["machine"]["processor"]:
            yield f"  processors differ: {before['machine']['processor']}; {after['machine']['processor']}"
        if before["settings"] != after["settings"]:
            yield f"  settings differ: {json.dumps(before['settings'])}; {json.dumps(after['settings'])}"
        known = {row["what"]: row for row in before["rows"]}
        for row in after["rows"]:
            was = known.pop(row["what"], None)
            if was is None:
                yield f"  {row['what']}: {row['measured']:.4g} {row['unit']}, new"
            elif was["measured"] != row["measured"] or was["measured"]:
                yield "  " + _change(was, row)
        for what in known:
            yield f"  {what}: gone"


def _change(was: dict[str, Any], row: dict[str, Any]) -> str:
    ratio = row["measured"] / was["measured"] if was["measured"] else math.inf
    mark = ""
    if row["unit"] in ("s", *RATES) and not 0.9 <= ratio <= 1.1:
        mark = "  better" if (ratio > 1.0) == (row["unit"] in RATES) else "  worse"
    elif row["judged"] and ratio != 1.0:
        mark = "  changed"
    unit = "" if row["unit"] == "1" else f" {row['unit']}"
    return f"{row['what']}: {was['measured']:.4g} -> {row['measured']:.4g}{unit}, x {ratio:.3g}{mark}"
