"""Where the time of a run goes: the loop of the thesis with its equal steps, and the same scene from event to event."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pdhe import advance, simulation
from pdhe.case import Case
from pdhe.results import write_dataset
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.notched import HEIGHT, PULL, plate_with_cracks
from pdhe.verification.report import Report, Row
from pdhe.verification.slabs import case_of

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

#: Hegde (2025, chapter 9): 10,000 points, 3000 load steps of 20 diffusion sub-steps, s; ms per sub-step and force.
THESIS_STEPS, SUBSTEPS, LOAD_STEP = 3000, 20, 2000.0
THESIS = {"total": 910.0, "diffusion": 11.2e-3, "force": 77e-3}
#: Displacement of either edge in a shortened run, m: so high that the crack grows within it.
SHORT_PULL = 40e-6
PARTS = ("hydrogen", "forces", "rest of equilibrium", "failures", "output", "everything else")

TEXT = """\
Two runs of the main scene on about as many nodes as the thesis has (chapter 9). The first steps as the thesis does:
3000 load steps of 2000 s, a third of them loading and the rest holding, each with 20 diffusion sub-steps, an
equilibrium and the failures that follow. The second goes through the same 6e6 s from event to event, and ends with
the same crack. Times exclude meshing, the set-up of bonds, and compilation;
they are seconds of wall time on one thread of the machine that made this page, possibly a busy one, and never fail.
Counts are the same on every machine and are checked.

Nothing converges to the same accuracy in the two programs that are compared here: the thesis makes one explicit
relaxation per load step, which need not be in equilibrium, while every load step here is solved to a residual of 1e-6.
Events need fewer of both, since displacements are solved
for only when a bond fails or the load turns a corner, and hydrogen goes in steps as long as its stability allows."""


@dataclass
class Stopwatch:
    """Exclusive wall time and number of calls of each part of a run; parts inside others stop their clock."""

    seconds: dict[str, float] = field(default_factory=dict)
    calls: dict[str, int] = field(default_factory=dict)
    _running: list[str] = field(default_factory=list)
    _since: float = 0.0

    def _switch(self) -> None:
        now = time.perf_counter()
        if self._running:
            part = self._running[-1]
            self.seconds[part] = self.seconds.get(part, 0.0) + now - self._since
        self._since = now

    def of(self, part: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """A function that counts its time under a part."""

        def timed(*arguments: Any, **options: Any) -> Any:
            self._switch()
            self._running.append(part)
            self.calls[part] = self.calls.get(part, 0) + 1
            try:
                return call(*arguments, **options)
            finally:
                self._switch()
                self._running.pop()

        return timed


@contextmanager
def watched(case: Case) -> Iterator[Stopwatch]:
    """Time the parts of a run of a case; nothing in the code that runs knows of it."""
    watch = Stopwatch()
    places = [
        (advance, "advance", "hydrogen"),
        (advance, "substep", "hydrogen"),
        (advance, "fail_until_stable", "failures"),
        (simulation, "Candidates", "failures"),
        (simulation, "record", "output"),
    ]
    kept = [(owner, name, getattr(owner, name)) for owner, name, _ in places]
    for owner, name, part in places:
        setattr(owner, name, watch.of(part, getattr(owner, name)))
    solver, body = case.equilibrium, case.body
    solver.solve = watch.of("rest of equilibrium", solver.solve)
    body.force = watch.of("forces", body.force)
    try:
        yield watch
    finally:
        for owner, name, original in kept:
            setattr(owner, name, original)
        del solver.solve, body.force


def run(rows_of_nodes: int = 71, load_steps: int = THESIS_STEPS, end: float = 6e6) -> Report:
    """Time both runs.

    Parameters
    ----------
    rows_of_nodes
        Over the height of the plate; twice as many along its width.
    load_steps
        Of the run with equal steps; fewer than the thesis has are a shorter time under a higher load.
    end
        Time of the run from event to event, s.
    """
    spacing = HEIGHT / rows_of_nodes
    short = load_steps * LOAD_STEP
    stepping = {"mode": "fixed", "load_steps": load_steps, "diffusion_substeps": SUBSTEPS}
    whole = load_steps == THESIS_STEPS
    pull = PULL if whole else SHORT_PULL
    for warm in (stepping | {"load_steps": 5}, {"mode": "events"}):  # compiles
        scene = plate_with_cracks(5e-3, 1e6, ramp=1e5, pull=SHORT_PULL, stepping=warm, outputs={"count": 1})
        simulation.simulate(case_of(scene))
    equal = timed_run(
        plate_with_cracks(spacing, short, ramp=short / 3.0, pull=pull, stepping=stepping, outputs={"count": 60})
    )
    events = timed_run(plate_with_cracks(spacing, end, ramp=end / 3.0, outputs={"count": 60}))
    rows = _count_rows(equal[1], events[1], load_steps) + _time_rows(equal, events, load_steps)
    if whole and math.isclose(short, end):
        rows.append(
            Row("crack growth with equal steps over that with events", 1.0,
                _last(equal[1], "crack_extension") / _last(events[1], "crack_extension"), 1.01 * spacing
                / _last(events[1], "crack_extension"), reason="measured no difference; a step can miss a cell")
        )  # fmt: skip
    return Report("timing", "Where the time goes", TEXT, rows, _drawing(equal, events, load_steps))


def timed_run(scene) -> tuple[dict[str, float], xr.Dataset, Stopwatch]:
    """Run a scene: wall time of each part, s, the result, and the stopwatch."""
    case = case_of(scene)
    with watched(case) as watch, tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        result = simulation.simulate(case)
        watch.of("output", write_dataset)(result, Path(folder) / "result.nc")
        total = time.perf_counter() - begun
    parts = {part: watch.seconds.get(part, 0.0) for part in PARTS}
    parts["everything else"] = total - sum(parts.values())
    return parts, result, watch


def _last(result: xr.Dataset, name: str) -> float:
    return float(result[name].values[-1])


def _count_rows(equal: xr.Dataset, events: xr.Dataset, load_steps: int) -> list[Row]:
    nodes = equal.sizes["node"]
    rounds = _last(equal, "failure_rounds")
    most = {"diffusion_sweeps": (12_000, 7549), "equilibrium_solves": (400, 240), "force_sweeps": (3_500, 2084)}
    rows = [
        Row("nodes", math.nan, nodes, kind="shown", reason="10,000 in the thesis"),
        Row("equal steps: diffusion sweeps", 1.0 * load_steps * SUBSTEPS, _last(equal, "diffusion_sweeps"), 0.0,
            kind="absolute", reason="one for each sub-step: 100 s is below the stable step"),
        Row("equal steps: equilibria", 1.0 + load_steps + rounds, _last(equal, "equilibrium_solves"), 0.0,
            kind="absolute", reason="one at the start, one a load step, and one after each round of failures"),
        Row("equal steps: rounds of failures", 1.0, rounds, kind="at least",
            reason="so that failures are in the times"),
        Row("events: rounds of failures", 5.0, _last(events, "failure_rounds"), kind="at least",
            reason="so that failures are in the times"),
    ]  # fmt: skip
    for name, (bound, found) in most.items():
        rows.append(
            Row(f"events: {name.replace('_', ' ')}", bound, _last(events, name), kind="at most",
                reason=f"measured {found} at 10,082 nodes; half as much again would be a loss to look into")
        )  # fmt: skip
    thesis = 1.0 * THESIS_STEPS * SUBSTEPS
    rows.append(
        Row("diffusion sweeps of all 3000 load steps over those of the events", 2.0,
            thesis / _last(events, "diffusion_sweeps"), kind="at least", reason="the stable step is longer than 100 s")
    )  # fmt: skip
    return rows


def _time_rows(equal, events, load_steps: int) -> list[Row]:
    rows = []
    for name, (parts, _, _) in (("equal steps", equal), ("events", events)):
        total = sum(parts.values())
        rows.append(Row(f"{name}: time of the run", math.nan, total, unit="s", kind="shown", reason="wall time"))
        rows += [
            Row(
                f"{name}: share of {part}", math.nan, parts[part] / total, kind="shown", reason="of the time of the run"
            )
            for part in PARTS
        ]
    parts, _, watch = equal
    substep = parts["hydrogen"] / (load_steps * SUBSTEPS)
    force = parts["forces"] / watch.calls["forces"]
    rows += [
        Row("one diffusion sub-step", THESIS["diffusion"], substep, unit="s", kind="shown",
            reason="expected: Hegde (2025), another machine"),
        Row("one evaluation of the forces", THESIS["force"], force, unit="s", kind="shown",
            reason="expected: Hegde (2025), another machine"),
        Row("3000 load steps at this pace", THESIS["total"], sum(parts.values()) * THESIS_STEPS / load_steps, unit="s",
            kind="shown", reason="expected: Hegde (2025), another machine, one relaxation a step; here equilibria"),
    ]  # fmt: skip
    return rows


def _drawing(equal, events, load_steps: int):
    def draw(figure: Figure) -> None:
        figure.set_size_inches(8.2, 3.4)
        left, right = panels(figure, 2, width_ratios=(1.25, 1.0))
        thesis = {"hydrogen": THESIS["diffusion"] * SUBSTEPS * THESIS_STEPS, "forces": THESIS["force"] * THESIS_STEPS}
        thesis["everything else"] = max(THESIS["total"] - sum(thesis.values()), 0.0)
        bars = {
            "thesis (its machine)": thesis,
            f"equal steps, {load_steps:,} of {THESIS_STEPS:,}": equal[0],
            "events, all of the scene": events[0],
        }
        names = list(bars)
        for k, parts in enumerate(bars.values()):
            total, begin = sum(parts.values()), 0.0
            for c, part in enumerate(PARTS):
                share = 100.0 * parts.get(part, 0.0) / total
                left.barh(k, share, 0.62, left=begin, color=(*COLOURS[:5], "0.75")[c], label=part if k == 1 else None)
                if share > 6.0:
                    left.text(
                        begin + 0.5 * share, k, f"{share:.0f}", ha="center", va="center", fontsize=8, color="white"
                    )
                begin += share
        left.set_yticks(range(3), [f"{name}\n{sum(bars[name].values()):.3g} s" for name in names], fontsize=8)
        left.set_ylim(2.5, -1.1)
        left.set_xlim(0.0, 100.0)
        left.legend(fontsize=7, frameon=False, ncols=3, loc="upper center", bbox_to_anchor=(0.45, 1.0))
        label(left, "share of the time (%)", "")
        substep = equal[0]["hydrogen"] / (load_steps * SUBSTEPS)
        force = equal[0]["forces"] / equal[2].calls["forces"]
        pairs = {
            "diffusion\nsub-step": (THESIS["diffusion"], substep),
            "forces": (THESIS["force"], force),
            "load step": (THESIS["total"] / THESIS_STEPS, sum(equal[0].values()) / load_steps),
        }
        for k, (there, here) in enumerate(pairs.values()):
            for shift, value, colour, name in ((-0.2, there, "0.6", "thesis"), (0.2, here, COLOURS[0], "here")):
                right.bar(k + shift, 1e3 * value, 0.36, color=colour, label=name if k == 0 else None)
                right.text(k + shift, 1.1e3 * value, f"{1e3 * value:.3g}", ha="center", va="bottom", fontsize=8)
        right.set_xticks(range(len(pairs)), list(pairs), fontsize=8)
        right.set_yscale("log")
        right.set_ylim(0.05, 3000.0)
        right.legend(fontsize=8, frameon=False, loc="upper left")
        label(right, "", "time of one (ms)")

    return draw
