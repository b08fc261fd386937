"""Run one scene of the design, and its variants: error and cost of every setting, one by one in one process."""

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
from pdhe.fidelity import smallest_feature
from pdhe.plan import make_plan
from pdhe.provenance import digest
from pdhe.results import write_dataset
from pdhe.scene import Scene
from pdhe.simulation import Progress, simulate
from pdhe.tradeoff.design import QUANTITIES, Run, Trade
from pdhe.tradeoff.front import excess
from pdhe.tradeoff.own_error import OwnError
from pdhe.tradeoff.quantities import Limit, asymmetry, limit_of, standard_values, values_of
from pdhe.verification.report import Report, Row
from pdhe.verification.slabs import nodes_of

#: Runs shorter than this, s, are repeated, and the shortest time counts: the first one may have to load its kernels.
#: With variants there is a mean to rely on instead.
SHORT = 3.0
REPEATS = 2

TEXT = """\
{runs} settings of `{scene}`, {changed}{versions}.
The reference is the limit at zero spacing, extrapolated from the {ladder} runs in the group `reference`, with settings
that are tighter than any other. A quantity's uncertainty is by how much its limit moves when one of their meshes is
left out: {uncertainties}.
The error of a run is the largest among {headline}; each is the mean distance from its
reference, relative to the reference's largest value{mean}.

Work is counted: sweeps over all bonds times directed bonds, forces and diffusion together; it is the same on every
machine. Times are processor times of one thread, set-up and output included, and mean something only in relation to
each other. Memory is the peak above what the process held before. `excess` is the work over that of the cheapest run
that is no less accurate in any of these quantities, 1 on the front; errors below a reference's uncertainty are not
told apart.{barred}"""
BARRED = """ The scene is symmetric: settings with which, on some mesh, a bond broke and its mirror image did not
are left out of the front, and marked."""

#: Groups of runs of which one may tell the error of another, and how much coarser the coarser one may be.
ESTIMATED, COARSENINGS = ("default", "fidelity"), (1.45, 3.4)


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
    #: What results tell errors of (:func:`pdhe.tradeoff.quantities.standard_values`); of references and those in
    #: :data:`ESTIMATED`.
    standard: dict[str, np.ndarray] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    problem: str = ""

    headline: tuple[str, ...] = ()
    #: Share of the broken bonds whose mirror image is whole, in a symmetric scene; the largest of the versions. Not a
    #: number on irregular nodes, which have no mirror images.
    asymmetry: float = 0.0
    #: Least and largest error among the versions of the scene, where this outcome is their mean.
    spread: tuple[float, float] = (np.nan, np.nan)

    @property
    def error(self) -> float:
        """Largest error of the quantities that count."""
        return max((self.errors[name] for name in self.headline if self.errors), default=np.nan)


def measure(trade: Trade, progress: Progress | None = None) -> Report:
    """Run all versions of a scene with all settings of its design."""
    found: dict[str, list[Outcome]] = {}
    limits: dict[str, dict[str, Limit]] = {}
    for version in trade.versions:
        found[version] = outcomes_of(trade, version, progress or (lambda text: None))
        limits[version] = limits_of(trade, found[version])
        for outcome in found[version]:
            outcome.errors = {name: limits[version][name].error(value) for name, value in outcome.values.items()}
    outcomes = [_mean(versions) for versions in zip(*found.values(), strict=True)]
    doubt = {
        name: float(np.mean([limits[version][name].uncertainty for version in limits])) for name in trade.all_quantities
    }
    uncertainty = max(doubt[name] for name in trade.quantities)
    floors = np.array([doubt[name] for name in trade.quantities])
    table = table_of(outcomes, floors)
    several = len(found) > 1
    text = TEXT.format(
        runs=len(outcomes), scene=trade.scene, ladder=len(trade.reference["spacings"]),
        changed="changed as the design says" if trade.changes else "as it is",
        versions=f", each run in {len(found)} versions (the scene, {', '.join(trade.variants)})" if several else "",
        headline=", ".join(QUANTITIES[name] for name in trade.quantities),
        mean=".\nErrors, work and times are means over the versions" if several else "",
        barred=BARRED if trade.symmetric else "",
        uncertainties=", ".join(f"{QUANTITIES[name]} {100 * value:.2g} %" for name, value in doubt.items()),
    )  # fmt: skip
    rows = [*_reference_rows(limits, doubt, uncertainty), *_front_rows(table)]
    told = [{"version": version, **row} for version in found for row in estimate_table(found[version])]
    tables = {"runs": table, "limits": limit_table(limits), "estimates": told}
    if several:
        tables["versions"] = [
            {"version": version, **row} for version in found for row in table_of(found[version], floors)
        ]
    return Report(trade.name, trade.title, text, rows, None, tables)


def outcomes_of(trade: Trade, version: str, progress: Progress) -> list[Outcome]:
    """Run every setting of a version in sequence; a run that cannot go on is kept with its message."""
    nodes: dict[str, Discretization] = {}
    _warm_up(trade)
    outcomes = []
    for run in trade.runs():
        scene = trade.load(run, version)
        key = digest(scene.resolved()["mesh"])
        if key not in nodes:
            nodes[key] = nodes_of(scene)
        outcome = Outcome(run, scene, headline=trade.quantities)
        try:
            result = _timed(outcome, nodes[key], 1 if trade.variants else REPEATS)
            outcome.values = values_of(result, scene, trade.all_quantities, trade.failure)
            if run.group in ("reference", *ESTIMATED):
                outcome.standard = standard_values(result, scene)
            outcome.asymmetry = asymmetry(result, nodes[key].coordinates) if trade.symmetric else 0.0
        except PdheError as error:
            outcome.problem = str(error)
        outcomes.append(outcome)
        told = outcome.problem or f"{outcome.seconds:.3g} s, work {outcome.work:.3g}"
        progress(f"{f'{version}: ' if version else ''}{run.name}: {told}")
    return outcomes


def limits_of(trade: Trade, outcomes: Sequence[Outcome]) -> dict[str, Limit]:
    """Limit of each quantity of one version at zero spacing."""
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


def _mean(versions: Sequence[Outcome]) -> Outcome:
    """One setting in all versions of the scene: means of errors and costs, the largest memory, the first problem."""
    first = versions[0]
    if len(versions) == 1:
        return first
    problem = next((outcome.problem for outcome in versions if outcome.problem), "")
    found = Outcome(first.run, first.scene, headline=first.headline, problem=problem)
    for name in ("nodes", "bonds", "work", "force_sweeps", "diffusion_sweeps", "seconds", "file"):
        setattr(found, name, float(np.mean([getattr(outcome, name) for outcome in versions])))
    found.asymmetry = float(np.fmax.reduce([outcome.asymmetry for outcome in versions]))
    found.memory = max(outcome.memory for outcome in versions)
    if not problem:
        found.errors = {name: float(np.mean([outcome.errors[name] for outcome in versions])) for name in first.errors}
        found.spread = (min(outcome.error for outcome in versions), max(outcome.error for outcome in versions))
    return found


def table_of(outcomes: Sequence[Outcome], floors: np.ndarray) -> list[dict[str, Any]]:
    """One row a run: settings, errors, cost; errors of what counts are not told apart below ``floors``.

    Settings with which a symmetric scene broke asymmetrically, on whatever mesh, are kept off the front.
    """
    lopsided = {_setting(outcome) for outcome in outcomes if outcome.asymmetry > 0.0}
    eligible = [_setting(outcome) not in lopsided for outcome in outcomes]
    errors = [[outcome.errors.get(name, np.nan) for name in outcome.headline] for outcome in outcomes]
    rows = []
    found = excess([outcome.work for outcome in outcomes], np.array(errors), floors, eligible)
    for outcome, over, may in zip(outcomes, found, eligible, strict=True):
        rows.append(
            {
                "run": outcome.run.name,
                "group": outcome.run.group,
                "spacing [m]": outcome.scene.mesh.spacing,
                "nodes": outcome.nodes,
                "bonds": outcome.bonds,
                "error": outcome.error,
                "least error": outcome.spread[0],
                "largest error": outcome.spread[1],
                **{f"error {name}": value for name, value in _all_errors(outcome, outcomes).items()},
                "work": outcome.work,
                "force sweeps": outcome.force_sweeps,
                "diffusion sweeps": outcome.diffusion_sweeps,
                "seconds": outcome.seconds,
                "peak memory [B]": outcome.memory,
                "file [B]": outcome.file,
                "excess": over,
                "front": bool(over <= 1.0) and may,
                "asymmetry": outcome.asymmetry,
                "barred": not may,
                "problem": outcome.problem,
            }
        )
    return rows


def estimate_table(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """What runs with the defaults would tell of their error from coarser ones, and that error: a row a pair of meshes.

    Without runs that are nearer to the limit than twice what it is known to.
    """
    ladder = [outcome for outcome in outcomes if outcome.run.group == "reference"]
    spacings = [outcome.scene.mesh.spacing for outcome in ladder]
    limits = {name: limit_of(spacings, [o.standard[name] for o in ladder]) for name in ladder[0].standard}
    runs = {o.scene.mesh.spacing: o for o in outcomes if o.run.group in ESTIMATED and not o.problem}
    rows = []
    for fine, run in sorted(runs.items()):
        found = max(limits[name].error(value) for name, value in run.standard.items())
        if found < 2.0 * max(limit.uncertainty for limit in limits.values()):
            continue
        for coarse, other in sorted(runs.items()):
            if not COARSENINGS[0] <= coarse / fine <= COARSENINGS[1]:
                continue
            told = max(OwnError(run.scene, coarse / fine, other.nodes, other.standard).errors(run.standard).values())
            cells = smallest_feature(run.scene.geometry) / coarse
            rows.append({"spacing [m]": fine, "coarser [m]": coarse, "cells": cells, "told": told, "found": found})
    return rows


def limit_table(limits: dict[str, dict[str, Limit]]) -> list[dict[str, Any]]:
    """The references themselves, SI: one row an entry of a quantity of a version."""
    return [
        {"version": version, "quantity": name, "entry": k, "value": float(value), "order": limit.order,
         "uncertainty": limit.uncertainty}
        for version, found in limits.items()
        for name, limit in found.items()
        for k, value in enumerate(limit.value)
    ]  # fmt: skip


def _setting(outcome: Outcome) -> str:
    """What a run has in common with those of the same settings on other meshes."""
    return digest({key: value for key, value in outcome.run.changes.items() if key != "mesh.spacing"})


def _all_errors(outcome: Outcome, outcomes: Sequence[Outcome]) -> dict[str, float]:
    names = next(other.errors for other in outcomes if other.errors)
    return {name: outcome.errors.get(name, np.nan) for name in names}


def _warm_up(trade: Trade) -> None:
    """Compile and load everything once, untimed."""
    scene = trade.load()
    with contextlib.suppress(PdheError):
        simulate(build_case(scene, nodes_of(scene)))


def _timed(outcome: Outcome, nodes: Discretization, repeats: int) -> xr.Dataset:
    """Run a scene as often as its shortness asks for, and note what it cost."""
    for repeat in range(repeats):
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


def _reference_rows(limits: dict[str, dict[str, Limit]], doubt: dict[str, float], uncertainty: float) -> list[Row]:
    rows = [Row("reference: uncertainty", np.nan, uncertainty, kind="shown", reason="of what counts")]
    for name, value in doubt.items():
        found, what = [version[name] for version in limits.values()], QUANTITIES[name]
        rows += [
            Row(f"reference, {what}: uncertainty", np.nan, value, kind="shown",
                reason="how far the limit moves when a mesh is left out"),
            Row(f"reference, {what}: distance of the finest mesh", np.nan, float(np.mean([x.finest for x in found])),
                kind="shown", reason=f"order {', '.join(f'{x.order:.2g}' for x in found)}"),
        ]  # fmt: skip
    return rows


def _front_rows(table: list[dict[str, Any]]) -> list[Row]:
    return [
        Row(f"default at {row['run']}: excess of work", np.nan, row["excess"], kind="shown",
            reason=f"error {100 * row['error']:.2g} %; 1: on the front")
        for row in table if row["group"] == "default" and not row["problem"]
    ]  # fmt: skip
