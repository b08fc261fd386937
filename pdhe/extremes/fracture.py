"""Extremes of loads and failure: nothing, everything at once, fragments, coincidences in time."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from pdhe.extremes.elasticity import SUPPORT
from pdhe.extremes.outcome import Extreme
from pdhe.extremes.scenes import (
    SPACING,
    THICKNESS,
    TOUGHNESS,
    YOUNG,
    Run,
    crack,
    failure_stretch,
    largest_difference,
    promises,
    run,
    wet,
)
from pdhe.extremes.scenes import pulled as pulled_apart
from pdhe.verification.report import Row

SIDE = 10
PLATE: dict[str, Any] = {
    "geometry.plate.width": SIDE * SPACING,
    "geometry.plate.height": SIDE * SPACING,
    "damage": {"criterion": "energy"},
}
#: The same so brittle that a thousand times its failure load moves an edge by less than the plate, as scenes demand.
BRITTLE = PLATE | {"material.fracture_toughness": 0.2 * TOUGHNESS}


def pulled(factor: float, **changes: Any) -> Run:
    """A plate pulled to so many times the stretch at which a bond fails."""
    stretch = failure_stretch(PLATE | {"loads": pulled_apart(1e-6)})
    amount = 0.5 * factor * stretch * SIDE * SPACING
    return run(PLATE | {"loads": [*pulled_apart(amount), SUPPORT], **changes})


def small_load_rows(factor: float) -> list[Row]:
    """A load far below failure: the same field, as much smaller; nothing at all for none."""
    done, reference = pulled(factor), pulled(1e-2)
    u = done.last("displacement")
    rows = [*promises(done), Row("bonds broken", 0, done.last("broken_bonds"), kind="absolute")]
    if factor == 0.0:
        return [*rows, Row("largest displacement", 0, float(np.abs(u).max()), kind="absolute", unit="m")]
    difference = largest_difference(u / factor, reference.last("displacement") / 1e-2)
    return [*rows, Row("difference from the field of a hundredth of the failure load", 1e-9, difference,
            kind="at most", reason="linear")]  # fmt: skip


def large_load_rows(factor: float, *, jump: bool = False) -> list[Row]:
    """A load beyond failure, as a ramp or at once: the plate comes apart, and nothing else happens."""
    stretch = failure_stretch(BRITTLE | {"loads": pulled_apart(1e-6)})
    amount = 0.5 * factor * stretch * SIDE * SPACING
    done = run(BRITTLE | {"loads": [*pulled_apart(amount, jump=jump), SUPPORT]})
    strongest = YOUNG * stretch * SIDE * SPACING * THICKNESS
    return [
        *promises(done),
        Row("force at the end over that at the failure stretch", 1e-3, abs(done.last("reaction_top_y")) / strongest,
            kind="at most", reason="apart"),
        Row("bonds broken", 1, done.last("broken_bonds"), kind="at least"),
        Row("largest load over resistance that is left", 1.0, done.last("largest_load"), kind="at most",
            reason="what would break has broken"),
    ]  # fmt: skip


def everything_rows(*, jump: bool) -> list[Row]:
    """Nine nodes stretched alike in both directions: every bond reaches its limit at one instant, in one step."""
    size = {"geometry.plate.width": 3 * SPACING, "geometry.plate.height": 3 * SPACING, "horizon.ratio": 2.9}
    stretch = failure_stretch(PLATE | size | {"loads": pulled_apart(1e-6)})
    amount = 0.5 * 1.25 * stretch * 3 * SPACING
    loads = [*pulled_apart(amount, jump=jump), *pulled_apart(amount, along="x", jump=jump)]
    done = run(PLATE | size | {"loads": loads})
    bonds, instant = done.case.bonds.length.size // 2, np.unique(done.result["broken_time"].values)
    return [
        *promises(done),
        Row("bonds broken", bonds, done.last("broken_bonds"), kind="absolute", reason="all of them"),
        Row("rounds of failures", 1, done.last("failure_rounds"), kind="absolute", reason="one step"),
        Row("damage of every node", 1.0, float(done.last("damage").min()), 1e-12),
        Row("instant of the failures", 0.0 if jump else 0.8, float(instant[0]), 1e-9, "s", "absolute",
            f"{instant.size} instant"),
        Row("force that is left", 0.0, abs(done.last("reaction_top_y")), kind="absolute", unit="N"),
        Row("energy of the bonds over the work done", 1.0, done.last("fracture_energy") / done.last("external_work"),
            1e-9, reason="all energy was in the bonds"),
    ]  # fmt: skip


def pieces_rows(*cracks: dict[str, Any], floating: int) -> list[Row]:
    """Fragments that nothing holds, in a plate that is pulled: they stay or go along, without a force."""
    done = run(PLATE | {"geometry.cracks": list(cracks), "loads": [*pulled_apart(1e-5), SUPPORT], "hydrogen": wet()})
    d = done.case.discretization
    middle = (np.abs(d.coordinates / SPACING - 5.0) < floating / 2).all(axis=1)
    force = np.abs(done.case.body.force(np.ascontiguousarray(done.last("displacement"))))
    return [
        *promises(done),
        Row("nodes of the fragment", floating**2, int(middle.sum()), kind="absolute"),
        Row("force on the fragment over that on the grips", 1e-5, float(force[middle].max() / force.max()),
            kind="at most", reason="the solver's tolerance"),
        Row("displacement of the fragment over that of the grips", 10.0,
            float(np.abs(done.last("displacement")[middle]).max() / 1e-5), kind="at most",
            reason="nothing holds it, but it does not fly off"),
    ]  # fmt: skip


def box(low: float, high: float) -> list[dict[str, Any]]:
    """Four cracks that close a square, in spacings."""
    corners = [(low, low), (high, low), (high, high), (low, high)]
    return [crack(corners[k], corners[(k + 1) % 4], name=f"side{k}") for k in range(4)]


def coincidence_rows(shift: float) -> list[Row]:
    """Output, load corner and failure at one instant, or the failure a last digit before or after it.

    The load stays at its value after the corner, so that a failure which is due a digit later never comes.
    """
    columns = {"geometry.plate.width": 4 * SPACING, "geometry.plate.height": 2 * SPACING, "horizon.ratio": 1.42}
    base = {**PLATE, **columns}
    probe = run(base | {"loads": [*pulled_apart(1e-4), SUPPORT]})
    # One second of a load in proportion to time, on a body that is linear until then.
    first = float(probe.result["broken_time"].values[0])
    amount = 1e-4 * first * (1.0 + shift)
    moves = [
        {"on": on, "displacement": {"y": {"times": [0.0, 0.5, 1.0], "values": [0.0, sign * amount, sign * amount]}}}
        for on, sign in (("top", 1.0), ("bottom", -1.0))
    ]
    done = run(base | {"loads": [*moves, SUPPORT], "outputs": {"times": [0.0, 0.25, 0.5, 1.0]}})
    times = done.result["broken_time"].values if "broken_time" in done.result else np.empty(0)
    rows = [
        *promises(done),
        Row("outputs", 4, done.result["time"].size, kind="absolute", reason="each once"),
        Row("largest load over resistance at the end", 1.0 + 1e-9, done.last("largest_load"), kind="at most"),
    ]
    if shift > 0.0:
        rows.append(Row("instant of the first failure", 0.5, float(times.min(initial=math.inf)), 1e-8, "s"))
    elif shift < 0.0:
        rows.append(Row("bonds broken", 0, times.size, kind="absolute", reason="just below"))
    else:
        early = float(np.abs(times - 0.5).max(initial=0.0))
        rows.append(Row("failures at another instant", 1e-9, early, kind="at most", unit="s",
                        reason="at the last digit a bond may break or not, but at no other time"))  # fmt: skip
    return rows


def no_time_rows(mode: str) -> list[Row]:
    """End time zero: the state at the start, with what breaks at once."""
    stepping = {"mode": "events"} if mode == "events" else {"mode": "fixed", "load_steps": 3, "diffusion_substeps": 2}
    changes = {"loads": [*pulled_apart(1e-5, jump=True), SUPPORT], "time": {"end": 0.0}, "stepping": stepping}
    done = run(PLATE | changes | {"hydrogen": wet()})
    return [
        *promises(done),
        Row("snapshots", 1, done.result["time"].size, kind="absolute"),
        Row("time at the end", 0.0, done.last("history_time"), kind="absolute", unit="s"),
        Row("force of the jump", 1.0, done.last("reaction_top_y"), kind="at least", unit="N"),
    ]


def nothing_may_fail() -> Run:
    """A block `damage` whose bonds are all protected."""
    return run(PLATE | {"loads": pulled_apart(1e-5), "damage": {"no_fail": ["all"]}})


def no_source() -> Run:
    """Hydrogen that comes from nowhere."""
    return run(PLATE | {"damage": None, "hydrogen": {"boundary": []}})


def load_steps_rows(steps: int) -> list[Row]:
    """Fixed steps of a load that never changes: nothing accumulates."""
    stepping = {"mode": "fixed", "load_steps": steps, "diffusion_substeps": 1}
    done = run(PLATE | {"loads": [*pulled_apart(1e-6, jump=True), SUPPORT], "stepping": stepping})
    u = done.result["displacement"].values
    change = float(np.abs(u[-1] - u[0]).max() / np.abs(u[0]).max())
    return [*promises(done), Row("change of the displacements", 1e-12, change, kind="at most",
            reason="an equilibrium that holds is left alone")]  # fmt: skip


CASES = [
    *(
        Extreme("load over failure load", f"{factor:g}", partial(small_load_rows, factor))
        for factor in (0.0, 1e-12, 1e-6)
    ),
    *(
        Extreme("load over failure load", f"{factor:g}", partial(large_load_rows, factor), quick=False)
        for factor in (3.0, 1e3)
    ),
    Extreme("load over failure load", "1000 at once", partial(large_load_rows, 1e3, jump=True), quick=False),
    Extreme("every bond at once", "ramp", partial(everything_rows, jump=False)),
    Extreme("every bond at once", "jump", partial(everything_rows, jump=True)),
    Extreme("fragments", "16 nodes", partial(pieces_rows, *box(3, 7), floating=4)),
    Extreme("fragments", "4 nodes", partial(pieces_rows, *box(4, 6), floating=2)),
    Extreme("output, corner, failure", "together", partial(coincidence_rows, 0.0)),
    Extreme("output, corner, failure", "just after", partial(coincidence_rows, 1e-9)),
    Extreme("output, corner, failure", "just before", partial(coincidence_rows, -1e-6)),
    Extreme("end time", "0, events", partial(no_time_rows, "events")),
    Extreme("end time", "0, fixed", partial(no_time_rows, "fixed")),
    Extreme("steps under a load that stays", "1e+04", partial(load_steps_rows, 10_000), quick=False),
    Extreme("nothing to do", "no bond may fail", nothing_may_fail, refused="damage.no_fail"),
    Extreme("nothing to do", "no source", no_source, refused="hydrogen"),
]  # fmt: skip
