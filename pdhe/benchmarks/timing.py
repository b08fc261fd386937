"""Measuring in turns, on one or several processes, and rows that tell what was measured."""

from __future__ import annotations

import math
import multiprocessing
import time
from collections.abc import Callable, Mapping
from importlib import import_module
from statistics import median
from typing import Any

from pdhe.verification.report import Kind, Row

#: A measurement repeats its call until it lasts about this long, s.
LEAST = 0.05


def in_turns(
    parts: Mapping[str, Callable[[], Any]],
    rounds: int = 5,
    least: float = LEAST,
    clock: Callable[[], float] = time.thread_time,
) -> dict[str, list[float]]:
    """Seconds a call of each part, one sample a round.

    All parts are measured in every round, every other round in the opposite order, so that whatever disturbs the
    machine for longer than a round disturbs all of them. Every part is called once before. The clock counts the
    processor time of the calling thread, which is what a part takes when it has a core to itself.
    """
    repeats = {}
    for name, part in parts.items():
        part()
        repeats[name] = max(1, math.ceil(least / max(seconds(part, 1, clock), 1e-9)))
    samples: dict[str, list[float]] = {name: [] for name in parts}
    names = list(parts)
    for turn in range(rounds):
        for name in names if turn % 2 == 0 else reversed(names):
            samples[name].append(seconds(parts[name], repeats[name], clock))
    return samples


def seconds(part: Callable[[], Any], repeats: int = 1, clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds a call, over some calls in a row."""
    start = clock()
    for _ in range(repeats):
        part()
    return (clock() - start) / repeats


def ratio(samples: Mapping[str, list[float]], slow: str, fast: str) -> float:
    """Median over the rounds of how many times longer ``slow`` took than ``fast`` in the same round."""
    return median(a / b for a, b in zip(samples[slow], samples[fast], strict=True))


def shown(what: str, measured: float, unit: str = "1", goal: float = math.nan, reason: str = "") -> Row:
    """A row without a verdict: times, rates, and their ratios."""
    return Row(what, goal, float(measured), 0.0, unit, "shown", reason)


def counted(what: str, measured: float, bound: float, kind: Kind, unit: str = "1", reason: str = "") -> Row:
    """A row with a verdict: work that is the same on every machine."""
    return Row(what, float(bound), float(measured), 0.0, unit, kind, reason)


def sample_table(groups: Mapping[str, Mapping[str, list[float]]]) -> list[dict[str, Any]]:
    """All samples as rows for a table: group, part, round and seconds."""
    return [
        {"measurement": group, "part": part, "round": turn, "seconds": value}
        for group, samples in groups.items()
        for part, values in samples.items()
        for turn, value in enumerate(values)
    ]


class Copies:
    """Processes of their own that prepare the same thing, and then run it together whenever told to.

    Parameters
    ----------
    module, function
        What each process calls once; it returns the function that is to be timed.
    arguments
        Keyword arguments of that call, plain values.
    count
        Number of processes; each uses one thread.
    """

    def __init__(self, module: str, function: str, arguments: dict[str, Any], count: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._ends, self._processes = [], []
        for _ in range(count):
            here, there = context.Pipe()
            process = context.Process(target=_serve, args=(there, module, function, arguments), daemon=True)
            process.start()
            self._ends.append(here)
            self._processes.append(process)
        for end in self._ends:
            end.recv()

    def run(self, repeats: int) -> list[float]:
        """Let all copies run at the same time; seconds a call of each."""
        for end in self._ends:
            end.send(repeats)
        return [end.recv() for end in self._ends]

    def close(self) -> None:
        """End the processes."""
        for end, process in zip(self._ends, self._processes, strict=True):
            end.send(0)
            process.join(10)


def answer_of(serve: Callable[..., None], *arguments: Any) -> Any:
    """What ``serve(end, *arguments)`` sends through one end of a pipe, from a process of its own."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=serve, args=(there, *arguments))
    process.start()
    there.close()
    try:
        return here.recv()
    finally:
        process.join()


def _serve(end: Any, module: str, function: str, arguments: dict[str, Any]) -> None:
    import numba

    numba.set_num_threads(1)
    part = getattr(import_module(module), function)(**arguments)
    part()
    end.send("ready")
    while repeats := end.recv():
        end.send(seconds(part, repeats))


def threads_against_copies(
    module: str, function: str, arguments: dict[str, Any], rounds: int = 5, least: float = 0.2
) -> dict[str, list[float]]:
    """Seconds a call on two threads, and on two copies of one thread each that run together, in turns.

    Returns
    -------
    dict
        ``one thread``, ``two threads``, and ``two copies``: the seconds after which the two of them have finished one
        call each, divided by two; all three alone on the machine as far as this program goes.
    """
    import numba

    before = numba.get_num_threads()
    part = getattr(import_module(module), function)(**arguments)
    copies = Copies(module, function, arguments, 2)
    samples: dict[str, list[float]] = {"one thread": [], "two threads": [], "two copies": []}
    try:
        numba.set_num_threads(1)
        part()
        repeats = max(1, math.ceil(least / max(seconds(part), 1e-9)))
        for turn in range(rounds):
            for name in list(samples) if turn % 2 == 0 else reversed(samples):
                if name == "two copies":
                    times = copies.run(repeats)
                    samples[name].append(1.0 / sum(1.0 / t for t in times))
                else:
                    numba.set_num_threads(1 if name == "one thread" else 2)
                    samples[name].append(seconds(part, repeats))
    finally:
        copies.close()
        numba.set_num_threads(before)
    return samples
