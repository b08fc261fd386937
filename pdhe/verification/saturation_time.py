"""How long saturation takes: the time of the thesis, and the time that its results need."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq

from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.report import Report, Row
from pdhe.verification.slabs import DIFFUSIVITY, LENGTH, case_of, coverage_at, slab, slab_mean, states_at, strip_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Hegde (2025), section 8.4: mean and right-edge concentration and saturation, 1e-5 mol/m^2.
MEAN, FAR_EDGE, SATURATION = 1.88, 1.50, 2.65
#: Diffusion sub-steps and their length, s; together 3.7e-4 s.
STEPS, STEP = 60_000, 6.2e-9
#: The factor 1.5/delta of the mixed-up constant for the horizon of 5 mm.
MIXED = 300.0

TEXT = """\
Hegde (2025, section 8.4) shows a plate of 200 mm nearly saturated from its left edge: 1.88e-5 of 2.65e-5 mol/m^2 in
the mean and 1.5e-5 at the right edge, after 60,000 sub-steps of 6.2 ns, which is 0.37 ms. This cannot be
reproduced. In that time hydrogen of the stated diffusivity comes half a micrometre far, and the mean coverage is of
the order of 1e-6.

The two concentrations do agree with each other: the series reaches either at D t / L^2 of about 0.42 to 0.44. With
the stated diffusivity that takes 2.0e7 s, some 230 days, and this time is used where the result is shown here. With
the mixed-up constant of eqs. 10 and 11, which makes the diffusivity 300 times larger for a horizon of 5 mm, it
takes 6.6e4 s: the results would follow from steps of about one second, not of nanoseconds. That this is how they
came about is an inference; nothing in the thesis states it."""


def run(columns: int = 50) -> Report:
    """Run the topic on a slab of ``columns`` cells."""
    unit = LENGTH**2 / DIFFUSIVITY
    short = STEPS * STEP
    by_mean = brentq(lambda tau: slab_mean(tau) - MEAN / SATURATION, 1e-3, 2.0)
    by_edge = brentq(lambda tau: _far_edge(tau) - FAR_EDGE / SATURATION, 1e-2, 2.0)
    case = case_of(strip_scene(columns, {"left": 1.0}, by_mean * unit))
    x, volume = case.discretization.coordinates[:, 0], case.discretization.volume
    early = coverage_at(case, short)
    late = coverage_at(case, by_mean * unit)
    far = x > x.max() - 1e-6 * LENGTH
    rows = [
        Row(
            "mean coverage after 0.37 ms",
            2.0 * math.sqrt(short / unit / math.pi),
            float(np.average(early, weights=volume)),
            kind="at most",
            reason=f"2 sqrt(D t / pi) / L, where the claim is {MEAN / SATURATION:.2f}; cells much larger "
            "than the depth of half a micrometre take up less",
        ),
        Row(
            "mean coverage after 0.37 ms, so that some came in",
            1e-12,
            float(np.average(early, weights=volume)),
            kind="at least",
            reason="measured 5e-10: one short step of the first row of cells",
        ),
        Row(
            "depth sqrt(D t) that hydrogen reaches in 0.37 ms",
            0.56e-6,
            math.sqrt(DIFFUSIVITY * short),
            0.01,
            "m",
            reason="a front that fills the plate needs a good part of 0.2 m",
        ),
        Row(
            "D t / L^2 that the far edge tells over the one that the mean tells",
            1.0,
            by_edge / by_mean,
            0.06,
            reason="measured 1.05: the two numbers of the thesis agree with each other on one time",
        ),
        Row(
            "time that the mean tells, with the stated diffusivity",
            2.0e7,
            by_mean * unit,
            0.02,
            "s",
            reason="measured 1.98e7 s, 229 days: root of the series",
        ),
        Row(
            "time needed over the time simulated in the thesis",
            5.3e10,
            by_mean * unit / short,
            0.02,
            reason="measured 5.3e10",
        ),
        Row(
            "step that 60,000 of them would need, with 300 times the diffusivity",
            1.1,
            by_mean * unit / STEPS / MIXED,
            0.02,
            "s",
            reason="measured 1.10 s, for a step stated as 6.2e-9 s",
        ),
        Row(
            "mean coverage simulated here for the time needed",
            MEAN / SATURATION,
            float(np.average(late, weights=volume)),
            5e-4 * (50.0 / columns) ** 2,
            reason="measured 1.6e-4 with 50 columns; scales with the spacing squared",
        ),
        Row(
            "coverage simulated here at the far edge for the time needed",
            float(slab(np.array([x.max() / LENGTH]), by_mean)[0]),
            float(late[far].mean()),
            8e-4 * (50.0 / columns) ** 2,
            reason="series at the last row of nodes; measured 2.9e-4 with 50 columns; the thesis has 0.566 at the edge",
        ),
    ]
    return Report("saturation_time", "Time to saturation", TEXT, rows, lambda figure: _draw(figure, by_mean, columns))


def _far_edge(tau: float) -> float:
    return float(slab(np.array([1.0]), tau)[0])


def _draw(figure: Figure, by_mean: float, columns: int) -> None:
    (ax,) = panels(figure, 1)
    unit = LENGTH**2 / DIFFUSIVITY
    time = np.logspace(-4.5, 8.5, 400)
    mean = np.array([slab_mean(t / unit) if t / unit > 1e-3 else 2.0 * math.sqrt(t / unit / math.pi) for t in time])
    far = np.array([max(_far_edge(t / unit), 1e-30) if t / unit > 1e-3 else 0.0 for t in time])
    ax.loglog(time, mean, color=COLOURS[0], linewidth=1.4, label="mean coverage, stated diffusivity")
    ax.loglog(time / MIXED, mean, "--", color=COLOURS[0], linewidth=1.2, label="mean coverage, 300 times that")
    ax.loglog(time, np.where(far > 1e-7, far, np.nan), color=COLOURS[1], linewidth=1.4, label="far edge")
    instants = list(np.logspace(5, math.log10(by_mean * unit), 8))
    case = case_of(strip_scene(columns, {"left": 1.0}, instants[-1]))
    volume = case.discretization.volume
    means = [float(np.average(state.coverage, weights=volume)) for state in states_at(case, instants)]
    ax.loglog(instants, means, "o", color=COLOURS[0], markersize=4, markerfacecolor="none", label="simulated")
    ax.plot([STEPS * STEP], [MEAN / SATURATION], "X", color="black", markersize=7, label="Hegde (2025), section 8.4")
    ax.axhline(MEAN / SATURATION, color="0.6", linewidth=0.8)
    ax.set_ylim(1e-7, 3.0)
    ax.legend(fontsize=8, frameon=False, loc=(0.41, 0.02))
    label(ax, "time (s)", "coverage")
