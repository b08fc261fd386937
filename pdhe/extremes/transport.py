"""Extremes of hydrogen: diffusivity, time steps of each integrator, coverage, very many steps of nothing."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np

from pdhe.extremes.outcome import Extreme
from pdhe.extremes.scenes import SPACING, Run, history, promises, pulled, run, wet
from pdhe.verification.plates import THICKNESS
from pdhe.verification.report import Row
from pdhe.verification.slabs import DIFFUSIVITY, slab_mean
from pdhe.verification.time_step import rate_matrix

#: Slab between a wet left edge and a sealed right one, in nodes; as high as its mirror images need.
LONG, HIGH = 24, 4
LENGTH = LONG * SPACING
SLAB: dict[str, Any] = {
    "geometry.plate.width": LENGTH,
    "geometry.plate.height": HIGH * SPACING,
    "hydrogen": wet("left"),
}
#: Time of the diffusivity cases in units of the filling time L^2/D.
TAU = 0.1
#: What each way of stepping allows as error of a coverage against the exact solution of the discrete equations, over
#: that of the edge. The first steps after the edge is wetted at once have the largest: measured 0.20 (one Euler step at
#: the limit: bounded, of first order), 0.0016 and 0.012.
ERRORS = {"fixed": 0.25, "two stages": 5e-3, "many stages": 0.02}
COVERAGE = 0.3


def slab(diffusivity: float, end: float, **changes: Any) -> Run:
    """The slab with one diffusivity, m^2/s, up to a time, s."""
    return run(SLAB | {"material.diffusivity": diffusivity, "time": {"end": end}, **changes})


@lru_cache(maxsize=4)
def _reference() -> Run:
    return slab(DIFFUSIVITY, TAU * LENGTH**2 / DIFFUSIVITY)


def diffusivity_rows(diffusivity: float) -> list[Row]:
    """A slab a third full: the closed form, and the same profile as with the diffusivity of steel."""
    done = slab(diffusivity, TAU * LENGTH**2 / diffusivity)
    difference = float(np.abs(done.last("coverage") - _reference().last("coverage")).max())
    return [
        *promises(done),
        Row("mean coverage at D t / L^2 = 0.1", slab_mean(TAU), done.last("mean_coverage"), 0.01,
            reason="series of the slab; the mesh of 24 cells is in error"),
        Row("difference from the profile in steel", 1e-10, difference, kind="at most",
            reason="the same but for the unit of time"),
    ]  # fmt: skip


def same_time_rows(diffusivity: float) -> list[Row]:
    """One year, whatever the diffusivity: from nothing at all to long since full."""
    year = 3.15e7
    done = slab(diffusivity, year)
    tau = diffusivity * year / LENGTH**2
    wanted = slab_mean(tau, 2000) if tau > 1e-4 else float(exact(done, [year]).mean())
    error = abs(done.last("mean_coverage") - wanted)
    reason = f"D t / L^2 = {tau:.2g}; closed form, or the discrete equations where less than a cell fills"
    return [*promises(done), Row("error of the mean coverage", 0.005, error, kind="at most", reason=reason)]


def exact(done: Run, times: Sequence[float], coverage: float = 1.0) -> np.ndarray:
    """Coverage of a slab with a wet left edge and initially none, (times, nodes), by the modes of its equations."""
    diffusion = done.case.diffusion
    rates, modes = np.linalg.eigh(-rate_matrix(diffusion))
    source = modes.T @ diffusion.source({"left": coverage})
    filled = -np.expm1(-np.outer(times, rates)) / rates
    return (filled * source) @ modes.T


def step_rows(way: str, share: float) -> list[Row]:
    """Outputs, or fixed steps, at a share of the explicit limit, against the exact solution at each."""
    probe = slab(DIFFUSIVITY, 1.0)
    limit = probe.case.diffusion.stable_step(np.zeros(LONG * HIGH, bool))
    count = max(4, min(200, round(20.0 / share)))
    end = share * limit * count
    changes: dict[str, Any] = {"hydrogen": wet("left", COVERAGE), "outputs": {"count": min(count, 20)}}
    if way == "fixed":
        changes["stepping"] = {"mode": "fixed", "load_steps": count, "diffusion_substeps": 1}
    elif way == "two stages":
        # Bonds that could break if coverage rose to saturation, which it does not: steps stay short.
        changes |= {"loads": pulled(0.5 * 6.4e-3 * 0.5 * HIGH * SPACING, jump=True), "damage": {"criterion": "energy"}}
    done = slab(DIFFUSIVITY, end, **changes)
    found, times = done.result["coverage"].values, done.result["time"].values
    wanted = exact(done, times, COVERAGE)
    error = float(np.abs(found - wanted).max()) / COVERAGE
    sweeps = done.last("diffusion_sweeps")
    return [
        *promises(done),
        Row("largest error of a coverage", ERRORS[way], error, kind="at most",
            reason=f"{times.size} instants up to {end / limit:.3g} limits, {sweeps:.0f} sweeps; exact in time"),
    ]  # fmt: skip


def uniform_rows(coverage: float, **changes: Any) -> list[Row]:
    """A plate that is as full as its surroundings: nothing ever changes."""
    done = slab(DIFFUSIVITY, 1e7, hydrogen=wet("left", coverage, initial=coverage), **changes)
    change = float(np.abs(done.result["coverage"].values - coverage).max())
    return [*promises(done), Row("largest change of a coverage", 1e-14, change, kind="at most", reason="round-off")]


def saturated_failure_rows() -> list[Row]:
    """A pair of edges pulled apart in a plate that is saturated everywhere: it fails at 12.2 % of the dry load."""
    times = []
    for coverage in (0.0, 1.0):
        done = run(
            {
                "geometry.plate.width": 4 * SPACING,
                "geometry.plate.height": 4 * SPACING,
                "horizon.ratio": 1.5,
                "loads": pulled(1e-4),
                "damage": {"criterion": "stretch"},
                "hydrogen": wet("left", coverage, initial=coverage, saturation="off", degradation="stretch"),
            }
        )
        times.append(float(done.result["broken_time"].values[0]))
    return [*promises(done), Row("time of the first failure over the dry one", 0.122, times[1] / times[0], 1e-9,
            reason="1 - 1.0467 + 0.1687: the embrittlement law at saturation")]  # fmt: skip


def nothing_rows(steps: int, coverage: float = 0.5) -> list[Row]:
    """Very many fixed steps of a uniform plate without loads: nothing accumulates."""
    limit = slab(DIFFUSIVITY, 1.0).case.diffusion.stable_step(np.zeros(LONG * HIGH, bool))
    load_steps = min(steps, 1000)
    done = slab(
        DIFFUSIVITY,
        0.5 * limit * steps,
        hydrogen=wet("left", coverage, initial=coverage),
        stepping={"mode": "fixed", "load_steps": load_steps, "diffusion_substeps": steps // load_steps},
    )
    change = float(np.abs(done.last("coverage") - coverage).max())
    return [
        *promises(done),
        Row("sweeps", steps, done.last("diffusion_sweeps"), 0.0, reason="as many as asked for"),
        Row("largest change of a coverage", 1e-12, change, kind="at most", reason="round-off of that many steps"),
    ]


def idle_rows(end: float) -> list[Row]:
    """A full plate with a load that never changes, for very long: events are few, whatever the time."""
    done = run(
        {
            "loads": pulled(1e-6, jump=True),
            "damage": {"criterion": "energy"},
            "hydrogen": wet("left", 1.0, initial=1.0),
            "time": {"end": end},
        }
    )
    return [
        *promises(done),
        Row("sweeps", 1e4, done.last("diffusion_sweeps"), kind="at most", reason="nothing changes after the first"),
        Row("broken bonds", 0, done.last("broken_bonds"), kind="absolute", reason="the load is far below failure"),
    ]


def layer_rows(factor: float) -> list[Row]:
    """The steady flux through two layers, one of another diffusivity: that of resistances in a row."""
    width, height = 40 * SPACING, HIGH * SPACING
    slow = min(1.0, factor) * DIFFUSIVITY
    done = run(
        {
            "geometry.plate.width": width,
            "geometry.plate.height": height,
            "regions": [{"name": "far_half", "from": [0.5 * width, 0.0], "to": [width, height]}],
            "hydrogen": {
                "boundary": [{"on": on, "coverage": history(1.0, c)} for on, c in (("left", 1.0), ("right", 0.0))],
                "regions": [{"on": "far_half", "factor": factor}],
            },
            "time": {"end": 2.0 * width**2 / slow},
            "outputs": {"count": 1},
        }
    )
    # At the edge of the slower layer, whose coverages differ; those of the faster one hardly do.
    edge, outside = ("left", 1.0) if factor > 1.0 else ("right", 0.0)
    diffusion, psi = done.case.diffusion, done.last("coverage")
    flow = float((diffusion.exchange[edge] * np.abs(outside - psi) * diffusion.volume).sum()) / (height * THICKNESS)
    error = abs(flow / (DIFFUSIVITY / (0.5 * width * (1.0 + 1.0 / factor))) - 1.0)
    # The border is as sharp as the horizon: 0.8 % (tests/invariants); steps allow 1e-4 of a coverage, 0.5 % of it.
    reason = "resistances in a row; border as sharp as the horizon, steps of finite accuracy"
    return [*promises(done), Row("error of the steady flux", 0.015, error, kind="at most", reason=reason)]


WAYS = {"fixed": "fixed steps", "two stages": "steps up to failures", "many stages": "steps of many stages"}
SHARES = (0.1, 0.98, 1.02, 10.0, 1e3, 1e6)
CASES = [
    *(
        Extreme("diffusivity", f"{value:.0e} m²/s", partial(diffusivity_rows, value))
        for value in (1e-16, 1e-13, 1e-10, 1e-7, 1e-5, 1e-3)
    ),
    *(
        Extreme("diffusivity, one year", f"{value:.0e} m²/s", partial(same_time_rows, value))
        for value in (1e-16, 1e-13, 1e-10, 1e-7, 1e-5, 1e-3)
    ),
    *(
        Extreme("contrast of diffusivities", f"{factor:g}", partial(layer_rows, factor))
        for factor in (1e-6, 1e-3, 1e3, 1e6)
    ),
    *(
        Extreme(
            f"time step over the explicit limit, {name}", f"{share:g}", partial(step_rows, way, share),
            refused="stepping.diffusion_substeps" if way == "fixed" and share > 1.0 else "",
        )
        for way, name in WAYS.items()
        for share in SHARES
    ),
    Extreme("coverage", "0 everywhere", partial(uniform_rows, 0.0)),
    Extreme("coverage", "1 everywhere", partial(uniform_rows, 1.0)),
    Extreme("coverage", "1, failure", saturated_failure_rows),
    *(
        Extreme("steps of nothing", f"{steps:.0e}", partial(nothing_rows, steps), quick=steps < 1e6)
        for steps in (10_000, 1_000_000)
    ),
    *(Extreme("idle time", f"{end:.0e} s", partial(idle_rows, end)) for end in (1e9, 1e18)),
    Extreme("idle time", "1e300 s", partial(idle_rows, 1e300), refused="time.end"),
]  # fmt: skip
