"""Permeation: hydrogen through a slab from a wet to a dry edge, its steady flux and its time lag."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pdhe.transport import KERNELS
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.report import Report, Row
from pdhe.verification.slabs import DIFFUSIVITY, LENGTH, THICKNESS, case_of, states_at, strip_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: End over L^2/D, and from when on the asymptote is fitted; the first mode is down to e^-20 there.
END, FITTED_FROM = 3.0, 2.0
#: The lag in shares of L^2/D (Daynes 1920): L^2 / (6 D).
LAG = 1.0 / 6.0

TEXT = """\
A slab that is empty at first has coverage 1 at its left edge and 0 at its right one, as a permeation cell does. The
amount that has come out at the right approaches a straight line; its slope is the steady flux, D/L per unit of
coverage and area, and it meets the time axis at the lag L^2/(6 D), from which experiments determine D. Both are
read off here as an experimenter would, from the history of what left through the right edge, and give D back. In
the steady state coverage falls linearly through the slab, which the mirror images reproduce exactly: flux and
profile are right to round-off."""


def run(columns: int = 60, points: int = 150) -> Report:
    """Run the topic: cells through the slab, instants at which the amounts are read."""
    rows, histories = [], {}
    for kernel in KERNELS:
        found = _permeate(kernel, columns, points)
        histories[kernel] = found["tau"], found["entered"], found["left"]
        rows += _rows(kernel, columns, found)
    return Report("permeation", "Permeation", TEXT, rows, lambda figure: _draw(figure, histories))


def _permeate(kernel: str, columns: int, points: int) -> dict:
    """Amounts through either edge over that of a full slab, at times over L^2/D, and the last profile."""
    tau = np.linspace(0.0, END, points + 1)
    case = case_of(strip_scene(columns, {"left": 1.0, "right": 0.0}, END * LENGTH**2 / DIFFUSIVITY, kernel=kernel))
    x, volume = case.discretization.coordinates[:, 0] / LENGTH, case.discretization.volume
    far = x > 0.5
    entered, left = [], []
    for state in states_at(case, list(tau * LENGTH**2 / DIFFUSIVITY)):
        entered.append(state.supply[~far].sum() / volume.sum())
        left.append(-state.supply[far].sum() / volume.sum())
    area = case.scene.geometry.height * THICKNESS
    return {
        "tau": tau,
        "entered": np.array(entered),
        "left": np.array(left),
        "profile_error": float(np.abs(state.coverage - (1.0 - x)).max()),
        "capacity": float(volume.sum() / area),
    }


def _rows(kernel: str, columns: int, found: dict) -> list[Row]:
    late = found["tau"] >= FITTED_FROM
    slope, offset = np.polyfit(found["tau"][late], found["left"][late], 1)
    flux = float(slope) * DIFFUSIVITY / LENGTH**2 * found["capacity"]
    seconds = LENGTH**2 / DIFFUSIVITY
    lag = float(-offset / slope) * seconds
    inward = np.polyfit(found["tau"][late], found["entered"][late], 1)
    scale = (60.0 / columns) ** 2
    return [
        Row(
            f"steady flux per unit of coverage, kernel {kernel}",
            DIFFUSIVITY / LENGTH,
            flux,
            1e-8,
            "m/s",
            reason="exact for the linear profile; measured 3e-10, what is left of the first mode where the fit starts",
        ),
        Row(
            f"time lag at the far edge, kernel {kernel}",
            LAG * seconds,
            lag,
            2e-4 * scale,
            "s",
            reason="L^2/(6 D); sums over cells for integrals err by (spacing/L)^2 / 2: measured 1.4e-4 with 60 columns",
        ),
        Row(
            f"diffusivity that the lag gives, kernel {kernel}",
            DIFFUSIVITY,
            LENGTH**2 / (6.0 * lag),
            2e-4 * scale,
            "m^2/s",
            reason="as an experimenter would determine it; the error is that of the lag",
        ),
        Row(
            f"intercept of what came in at the near edge over that of a full slab, kernel {kernel}",
            1.0 / 3.0,
            float(inward[1]),
            2e-4 * scale,
            reason="the steady slab holds 1/2, the far edge's lag takes 1/6 of it; measured 0.7e-4 with 60 columns",
        ),
        Row(
            f"largest error of the steady profile, kernel {kernel}",
            1e-10,
            found["profile_error"],
            kind="at most",
            reason="it solves the discrete equations; measured 3e-11, round-off over steps of up to 99 stages",
        ),
    ]


def _series(tau: np.ndarray, sign: float) -> np.ndarray:
    """What left (sign -1) or came in (sign +1) over the content of a full slab."""
    n = np.arange(1, 2000)
    waves = (1.0 if sign > 0 else (-1.0) ** n) / (n * math.pi) ** 2
    decay = np.exp(-np.multiply.outer(tau, (n * math.pi) ** 2))
    return tau + (1.0 / 3.0 if sign > 0 else -LAG) - 2.0 * (decay @ waves)


def _draw(figure: Figure, histories) -> None:
    left, right = panels(figure, 2)
    tau, entered, out = histories["inverse square"]
    fine = np.linspace(0.0, 1.0, 300)
    some = tau <= 1.0
    for values, sign, colour, text in ((entered, 1.0, COLOURS[0], "came in"), (out, -1.0, COLOURS[1], "went out")):
        left.plot(fine, _series(fine, sign), color=colour, linewidth=1.2)
        left.plot(tau[some][::2], values[some][::2], "o", color=colour, ms=3.5, markerfacecolor="none", label=text)
    line = fine >= LAG
    left.plot(fine[line], fine[line] - LAG, "--", color="0.4", linewidth=1.0, label="asymptote")
    left.annotate("lag $L^2/(6D)$", (LAG, 0.0), (0.42, 0.05), fontsize=8, arrowprops={"arrowstyle": "-", "lw": 0.6})
    left.plot([], [], color="0.3", label="series")
    left.legend(fontsize=8, frameon=False)
    label(left, "$D t / L^2$", "amount over that of a full slab")
    for (kernel, (when, _, gone)), colour in zip(histories.items(), COLOURS, strict=False):
        exact = _series(when, -1.0)
        right.plot(when, (gone - exact) * 1e3, color=colour, linewidth=1.2, label=f"kernel {kernel}")
    right.axhline(0.0, color="0.6", linewidth=0.8)
    right.legend(fontsize=8, frameon=False)
    label(right, "$D t / L^2$", "went out − series ($10^{-3}$ of a full slab)")
