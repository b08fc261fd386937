"""Rows of a verification: expected, measured, allowed, and why that much is allowed."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pdhe.wholefile import moved_when_whole, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Kind = Literal["relative", "absolute", "at most", "at least", "shown"]


@dataclass(frozen=True)
class Row:
    """One comparison.

    Attributes
    ----------
    what
        What is compared, as a reader would say it.
    expected, measured
        Same unit.
    tolerance
        Largest allowed error: relative to ``expected``, absolute, or unused for ``at most`` and ``at least`` (where
        ``expected`` is the bound) and ``shown`` (no verdict: a number worth knowing).
    reason
        Where the tolerance comes from, or where the expected value does.
    """

    what: str
    expected: float
    measured: float
    tolerance: float = 0.0
    unit: str = "1"
    kind: Kind = "relative"
    reason: str = ""

    @property
    def error(self) -> float:
        """Error in the sense of the row's kind; not a number where the kind has none."""
        if self.kind == "relative":
            return abs(self.measured - self.expected) / abs(self.expected) if self.expected else math.inf
        if self.kind == "absolute":
            return abs(self.measured - self.expected)
        return math.nan

    @property
    def passed(self) -> bool:
        """Whether the comparison holds; a measurement that is not finite never does."""
        if not math.isfinite(self.measured):
            return False
        if self.kind == "at most":
            return bool(self.measured <= self.expected)
        if self.kind == "at least":
            return bool(self.measured >= self.expected)
        return self.kind == "shown" or bool(self.error <= self.tolerance)


@dataclass
class Report:
    """The outcome of one topic.

    Attributes
    ----------
    topic, title
        Short name (that of the file) and heading.
    text
        One or two paragraphs of Markdown: what is checked, how, and what a reader should know.
    rows
        The comparisons.
    draw
        Draws into an empty figure; None if there is nothing to see.
    tables
        Further tables by name, as lists of dictionaries, written as CSV beside the figure.
    """

    topic: str
    title: str
    text: str
    rows: list[Row]
    draw: Callable[[Figure], None] | None = None
    tables: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether every row holds."""
        return all(row.passed for row in self.rows)

    def write(self, folder: str | Path) -> None:
        """Write ``report.json``, ``table.csv``, further tables and ``figure.png`` into a folder."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        rows = [asdict(row) | {"error": row.error, "passed": row.passed} for row in self.rows]
        _write_csv(folder / "table.csv", rows)
        for name, table in self.tables.items():
            _write_csv(folder / f"{name}.csv", table)
        if self.draw is not None:
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure

            figure = Figure(figsize=(7.0, 4.2), layout="constrained")
            FigureCanvasAgg(figure)
            self.draw(figure)
            with moved_when_whole(folder / "figure.png") as place:
                figure.savefig(place, dpi=160, format="png")
        content = {"topic": self.topic, "title": self.title, "text": self.text, "rows": rows, "passed": self.passed}
        write_text(folder / "report.json", json.dumps(content, indent=1, allow_nan=True))


def _write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    with moved_when_whole(path) as place, place.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]) if rows else [])
        writer.writeheader()
        writer.writerows(rows)


def fitted_order(sizes: list[float], errors: list[float]) -> float:
    """Slope of log error against log size by least squares: the order of convergence."""
    x, y = [math.log(s) for s in sizes], [math.log(e) for e in errors]
    mx, my = sum(x) / len(x), sum(y) / len(y)
    return sum((a - mx) * (b - my) for a, b in zip(x, y, strict=True)) / sum((a - mx) ** 2 for a in x)
