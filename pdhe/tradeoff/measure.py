"""Run one scene of the design: error and cost of every setting, one after the other in one process."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from pdhe.benchmarks.machine import peak_memory
from pdhe.case import build_case
from pdhe.discretization import Discretization
from pdhe.errors import PdheError
from pdhe.plan import make_plan
from pdhe.provenance import digest
from pdhe.results import write_dataset
from pdhe.scene import Scene
from pdhe.simulation import Progress, simulate
from pdhe.tradeoff.design import QUANTITIES, Run, Trade
from pdhe.tradeoff.front import excess
from pdhe.tradeoff.quantities import Limit, limit_of, values_of
from pdhe.verification.report import Report, Row
from pdhe.verification.slabs import nodes_of

#: Runs shorter than this, s, are repeated, and the shortest time counts: the first one may have to load its kernels.
SHORT = 3.0
REPEATS = 2

TEXT = """\
{runs} runs of `{scene}`, {changed}.
The reference is the limit at zero spacing, extrapolated from the {ladder} runs in the group `reference`, with settings
that are tighter than any other. A quantity's uncertainty is by how much its limit moves when one of their meshes is
left out: {uncertainties}.
The error of a run is the largest among {headline}; each is the mean distance from its
reference, relative to the reference's largest value.

Work is counted: sweeps over all bonds times directed bonds, forces and diffusion together; it is the same on every
machine. Times are processor times of one thread, set-up and output included, and mean something only in relation to
each other. Memory is the peak above what the process held before. `excess` is the work over that of the cheapest run
that is no less accurate, 1 on the front; errors below the reference's uncertainty, {uncertainty}, are not told
apart."""


@dataclass
class Outcome:
    """What came of a run; cost and values are absent where it failed."""

    run: Run
    scene: Scene
    nodes: int = 0
    bonds: int = 0
    work: float = np.nan
    force_sweeps: float = 0.0
    diffusion_sweeps: float = 0.0
    seconds: float = np.nan
    memory: float = np.nan
    file: float = np.nan
    values: dict[str, np.ndarray] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    problem: str = ""

    headline: tuple[str, ...] = ()

    @property
    def error(self) -> float:
        """Largest error of the quantities that count."""
        return max((self.errors[name] for name in self.headline if self.errors), default=np.nan)


def measure(trade: Trade, progress: Progress | None = None) -> Report:
    """Run a scene with all settings of its design."""
    outcomes = outcomes_of(trade, progress or (lambda text: None))
    limits = limits_of(trade, outcomes)
    for outcome in outcomes:
        outcome.errors = {name: limits[name].error(value) for name, value in outcome.values.items()}
    uncertainty = max(limits[name].uncertainty for name in trade.quantities)
    table = table_of(outcomes, uncertainty)
    text = TEXT.format(
        runs=len(outcomes), scene=trade.scene, ladder=len(trade.reference["spacings"]),
        changed="changed as the design says" if trade.changes else "as it is",
        headline=", ".join(QUANTITIES[name] for name in trade.quantities),
        uncertainty=f"{100 * uncertainty:.2g} %",
        uncertainties=", ".join(
            f"{QUANTITIES[name]} {100 * limit.uncertainty:.2g} %" for name, limit in limits.items()
        ),
    )  # fmt: skip
    rows = [*_reference_rows(limits, uncertainty), *_front_rows(table)]
    return Report(trade.name, trade.title, text, rows, None, {"runs": table, "limits": limit_table(limits)})


def outcomes_of(trade: Trade, progress: Progress) -> list[Outcome]:
    """Run everything in sequence; a run that cannot go on is kept with its message."""
    nodes: dict[str, Discretization] = {}
    _warm_up(trade)
    outcomes = []
    for run in trade.runs():
        scene = trade.load(run)
        key = digest(scene.resolved()["mesh"])
        if key not in nodes:
            nodes[key] = nodes_of(scene)
        outcome = Outcome(run, scene, headline=trade.quantities)
        try:
            result = _timed(outcome, nodes[key])
            outcome.values = values_of(result, scene, trade.all_quantities, trade.failure)
        except PdheError as error:
            outcome.problem = str(error)
        outcomes.append(outcome)
        progress(f"{run.name}: {outcome.problem or f'{outcome.seconds:.3g} s, work {outcome.work:.3g}'}")
    return outcomes


def limits_of(trade: Trade, outcomes: Sequence[Outcome]) -> dict[str, Limit]:
    """Limit of each quantity at zero spacing."""
    ladder = [outcome for outcome in outcomes if outcome.run.group == "reference"]
    for outcome in ladder:
        if outcome.problem:
            raise PdheError(f"{trade.file}: {trade.name}: the reference cannot be run: {outcome.problem}")
    spacings = [outcome.scene.mesh.spacing for outcome in ladder]
    end = ladder[0].scene.time.end  # the time of what does not happen
    return {
        name: limit_of(spacings, [outcome.values[name] for outcome in ladder], end if name == "crack" else math.inf)
        for name in trade.all_quantities
    }


def table_of(outcomes: Sequence[Outcome], uncertainty: float) -> list[dict[str, Any]]:
    """One row a run: settings, errors, cost."""
    points = [(outcome.work, outcome.error) for outcome in outcomes]
    rows = []
    for outcome, over in zip(outcomes, excess(points, uncertainty), strict=True):
        rows.append(
            {
                "run": outcome.run.name,
                "group": outcome.run.group,
                "spacing [m]": outcome.scene.mesh.spacing,
                "nodes": outcome.nodes,
                "bonds": outcome.bonds,
                "error": outcome.error,
                **{f"error {name}": value for name, value in _all_errors(outcome, outcomes).items()},
                "work": outcome.work,
                "force sweeps": outcome.force_sweeps,
                "diffusion sweeps": outcome.diffusion_sweeps,
                "seconds": outcome.seconds,
                "peak memory [B]": outcome.memory,
                "file [B]": outcome.file,
                "excess": over,
                "front": bool(over <= 1.0),
                "problem": outcome.problem,
            }
        )
    return rows


def limit_table(limits: dict[str, Limit]) -> list[dict[str, Any]]:
    """The reference itself, SI: one row an entry of a quantity."""
    return [
        {"quantity": name, "entry": k, "value": float(value), "order": limit.order, "uncertainty": limit.uncertainty}
        for name, limit in limits.items()
        for k, value in enumerate(limit.value)
    ]


def _all_errors(outcome: Outcome, outcomes: Sequence[Outcome]) -> dict[str, float]:
    names = next(other.errors for other in outcomes if other.errors)
    return {name: outcome.errors.get(name, np.nan) for name in names}


def _warm_up(trade: Trade) -> None:
    """Compile and load everything once, untimed."""
    scene = trade.load()
    with contextlib.suppress(PdheError):
        simulate(build_case(scene, nodes_of(scene)))


def _timed(outcome: Outcome, nodes: Discretization) -> xr.Dataset:
    """Run a scene as often as its shortness asks for, and note what it cost."""
    for repeat in range(REPEATS):
        before = _reset_peak()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "result.nc"
            begun = time.process_time()
            case = build_case(outcome.scene, nodes)
            make_plan(case)  # refuses diffusion steps that would not be stable
            result = simulate(case)
            write_dataset(result, path)
            seconds = time.process_time() - begun
            outcome.file = path.stat().st_size
        outcome.memory = peak_memory() - before if repeat == 0 else outcome.memory
        outcome.seconds = seconds if repeat == 0 else min(seconds, outcome.seconds)
        if seconds > SHORT:
            break
    outcome.nodes, outcome.bonds = case.discretization.volume.size, case.bonds.neighbours.size
    for name in ("force_sweeps", "diffusion_sweeps"):
        if name in result:
            setattr(outcome, name, float(result[name].values[-1]))
    outcome.work = (outcome.force_sweeps + outcome.diffusion_sweeps) * outcome.bonds
    return result


def _reset_peak() -> int:
    """Give free memory back and set the peak of this process to what it holds now, bytes, where the system can."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return peak_memory()


def _reference_rows(limits: dict[str, Limit], uncertainty: float) -> list[Row]:
    rows = [Row("reference: uncertainty", np.nan, uncertainty, kind="shown", reason="of what counts")]
    for name, limit in limits.items():
        what = QUANTITIES[name]
        rows += [
            Row(f"reference, {what}: uncertainty", np.nan, limit.uncertainty, kind="shown",
                reason="how far the limit moves when a mesh is left out"),
            Row(f"reference, {what}: distance of the finest mesh", np.nan, limit.finest, kind="shown",
                reason=f"order {limit.order:.2g}"),
        ]  # fmt: skip
    return rows


def _front_rows(table: list[dict[str, Any]]) -> list[Row]:
    return [
        Row(f"default at {row['run']}: excess of work", np.nan, row["excess"], kind="shown",
            reason=f"error {100 * row['error']:.2g} %; 1: on the front")
        for row in table if row["group"] == "default" and not row["problem"]
    ]  # fmt: skip
