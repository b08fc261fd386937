"""One page of all topics: what was checked, expected, measured, allowed, and the figures."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pdhe.errors import PdheError
from pdhe.wholefile import read_json

COLUMNS = ("what", "expected", "measured", "error", "allowed", "", "reason")
STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;width:100%;font-size:13px;margin:1rem 0}
td,th{border-bottom:1px solid #ddd;padding:.3rem .5rem;text-align:left;vertical-align:top}
td.n{text-align:right;white-space:nowrap}.ok{color:#17753a}.bad{color:#b00020;font-weight:bold}
img{max-width:100%}code{background:#f3f3f3}"""


def read_reports(folders: Sequence[str | Path]) -> list[dict[str, Any]]:
    """Read what :meth:`pdhe.verification.report.Report.write` left in each folder."""
    reports = []
    for folder in folders:
        path = Path(folder, "report.json")
        if not path.is_file():
            raise PdheError(f"{path}: no such report; run the check first")
        content = read_json(path)
        figure = path.with_name("figure.png")
        reports.append({**content, "figure": figure if figure.is_file() else None})
    return reports


def failures(reports: Sequence[dict[str, Any]]) -> list[str]:
    """One line for every row that does not hold."""
    return [
        f"{report['topic']}: {row['what']}: expected {row['expected']:.6g}, "
        f"measured {row['measured']:.6g} {row['unit']}"
        for report in reports
        for row in report["rows"]
        if not row["passed"]
    ]


def as_markdown(reports: Sequence[dict[str, Any]], figures: str) -> str:
    """The page in Markdown; figures are linked as ``{figures}/{topic}.png``."""
    lines = ["# Verification", "", _summary(reports), ""]
    for report in reports:
        lines += [f"## {report['title']}", "", report["text"].strip(), ""]
        if report["figure"]:
            lines += [f"![{report['title']}]({figures}/{report['topic']}.png)", ""]
        lines += ["| " + " | ".join(COLUMNS) + " |", "|---|---:|---:|---:|---:|---|---|"]
        for row in report["rows"]:
            texts = [str(cell).replace("|", "\\|").replace("\n", " ") for cell in cells(row)]
            lines.append("| " + " | ".join(texts) + " |")
        lines.append("")
    return "\n".join(lines)


def as_html(reports: Sequence[dict[str, Any]]) -> str:
    """The page as one HTML file with its figures inside."""
    parts = [f"<!doctype html><meta charset='utf-8'><title>Verification</title><style>{STYLE}</style>"]
    parts += ["<h1>Verification</h1>", f"<p>{html.escape(_summary(reports))}</p>"]
    for report in reports:
        parts.append(f"<h2 id='{report['topic']}'>{html.escape(report['title'])}</h2>")
        parts += [f"<p>{html.escape(text)}</p>" for text in report["text"].strip().split("\n\n")]
        if report["figure"]:
            data = base64.b64encode(report["figure"].read_bytes()).decode()
            parts.append(f"<img alt='{html.escape(report['title'])}' src='data:image/png;base64,{data}'>")
        parts.append("<table><tr>" + "".join(f"<th>{name}</th>" for name in COLUMNS) + "</tr>")
        for row in report["rows"]:
            what, expected, measured, error, allowed, verdict, reason = (html.escape(str(c)) for c in cells(row))
            numbers = "".join(f"<td class='n'>{cell}</td>" for cell in (expected, measured, error, allowed))
            state = "ok" if row["passed"] else "bad"
            parts.append(f"<tr><td>{what}</td>{numbers}<td class='{state}'>{verdict}</td><td>{reason}</td></tr>")
        parts.append("</table>")
    return "\n".join(parts)


def _summary(reports: Sequence[dict[str, Any]]) -> str:
    rows = [row for report in reports for row in report["rows"]]
    judged = [row for row in rows if row["kind"] != "shown"]
    passed = sum(row["passed"] for row in judged)
    return (
        f"{len(reports)} topics, {len(judged)} comparisons, {passed} hold. Made by `snakemake --cores 2 verification`; "
        "`shown` marks numbers that are reported without a verdict."
    )


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """A row as text: what, expected, measured, error, allowed, verdict, reason."""
    unit = "" if row["unit"] == "1" else f" {row['unit']}"
    kind, relative = row["kind"], row["kind"] == "relative"
    bound = {"at most": "<= ", "at least": ">= "}.get(kind, "")
    error = "" if row["error"] is None or not math.isfinite(row["error"]) or kind == "shown" else row["error"]
    error = error if error == "" else (f"{100 * error:.3g} %" if relative else f"{error:.3g}")
    judged = kind in ("relative", "absolute")
    allowed = "" if not judged else (f"{100 * row['tolerance']:.3g} %" if relative else f"{row['tolerance']:.3g}")
    verdict = "shown" if kind == "shown" else ("holds" if row["passed"] else "FAILS")
    expected = f"{bound}{row['expected']:.6g}{unit}" if math.isfinite(row["expected"]) else ""
    return row["what"], expected, f"{row['measured']:.6g}{unit}", error, allowed, verdict, row["reason"]
