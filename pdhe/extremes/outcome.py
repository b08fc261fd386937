"""One extreme case, how it is run, and what counts as its outcome."""

from __future__ import annotations

import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from pdhe.errors import SceneError
from pdhe.extremes.registry import cases_of
from pdhe.verification.report import Report, Row

#: Longest time that a case may take, s. The slowest takes a tenth of it; what takes longer hangs.
TIME_LIMIT = 100.0
OUTCOMES = ("right", "refused", "failed")


@dataclass(frozen=True)
class Extreme:
    """One extreme case.

    Attributes
    ----------
    family, level
        What is taken to the extreme, and how far: the row of the map and the text of the cell.
    check
        Runs the case and returns the comparisons that make it right; of a case that is refused, anything.
    refused
        Key of the :class:`~pdhe.errors.SceneError` by which the case is refused before it runs; empty if it is to run.
    quick
        Whether the tests run it too, if it is the mildest or the most extreme of its family.
    """

    family: str
    level: str
    check: Callable[[], Any]
    refused: str = ""
    quick: bool = True


@dataclass(frozen=True)
class Outcome:
    """How a case ended: ``right``, ``refused`` (as stated) or ``failed`` (anything else), with what shows it."""

    case: Extreme
    outcome: str
    rows: tuple[Row, ...]
    message: str
    seconds: float


class _OutOfTimeError(Exception):
    """A case took longer than it may."""


@contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    """Stop what runs too long, where the platform and the thread have an alarm."""
    if not hasattr(signal, "SIGALRM") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_: Any) -> None:
        raise _OutOfTimeError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def judge(case: Extreme, limit: float = TIME_LIMIT) -> Outcome:
    """Run a case and compare its outcome with the stated one.

    Any exception but the stated refusal, any warning about arithmetic and any time beyond ``limit`` seconds is a
    failure, as is a comparison that does not hold.
    """
    begin = time.perf_counter()
    rows: list[Row] = []
    key = message = ""
    try:
        with warnings.catch_warnings(), _time_limit(limit):
            warnings.simplefilter("error", RuntimeWarning)
            found = case.check()
            rows = found if isinstance(found, list) else []
    except SceneError as error:
        key, message = error.key, f"key '{error.key}': {error.problem}"
    except _OutOfTimeError:
        message = f"no answer within {limit:g} s"
    except Exception as error:  # whatever it is, the case has failed and the others go on
        message = f"{type(error).__name__}: {error}"
    if case.refused:
        outcome = "refused" if key == case.refused else "failed"
        message = message or "accepted"
    else:
        outcome = "right" if rows and not message and all(row.passed for row in rows) else "failed"
    return Outcome(case, outcome, tuple(rows), message, time.perf_counter() - begin)


def run_group(group: str) -> Report:
    """Run every case of a group to its outcome; the report's rows fail where an outcome is not the stated one."""
    return report_of(group, cases_of(group))


def report_of(group: str, cases: Sequence[Extreme]) -> Report:
    """Run cases and report every comparison and every refusal as a row; ``outcomes`` tells how each case ended."""
    found = [judge(case) for case in cases]
    rows = [row for outcome in found for row in _rows(outcome)]
    table = [
        {
            "family": outcome.case.family,
            "level": outcome.case.level,
            "stated": "refused" if outcome.case.refused else "right",
            "outcome": outcome.outcome,
            "rows": len(_rows(outcome)),
            "message": outcome.message,
            "seconds": round(outcome.seconds, 2),
        }
        for outcome in found
    ]
    ended = {name: sum(outcome.outcome == name for outcome in found) for name in OUTCOMES}
    text = ", ".join(f"{count} {name}" for name, count in ended.items())
    return Report(group, group.capitalize(), f"{len(found)} cases: {text}.", rows, tables={"outcomes": table})


def _rows(outcome: Outcome) -> list[Row]:
    """Comparisons of a case under its own name; a refusal, or what went wrong, is one more."""
    case, where = outcome.case, f"{outcome.case.family}, {outcome.case.level}"
    rows = [replace(row, what=f"{where}: {row.what}") for row in outcome.rows]
    if case.refused:
        refused = 1.0 if outcome.outcome == "refused" else 0.0
        return [Row(f"{where}: refused", 1.0, refused, kind="absolute", reason=outcome.message)]
    if outcome.message or not rows:
        rows.append(Row(f"{where}: runs", 1.0, 0.0, kind="absolute", reason=outcome.message or "nothing compared"))
    return rows
