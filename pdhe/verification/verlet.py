"""Velocity Verlet: what it does to the energy, its order, the longest stable step, and the speed that breaks a bond."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.bonds import build_bonds
from pdhe.boundary import DisplacementConditions
from pdhe.dynamics import Verlet
from pdhe.materials import MODELS, Body, make_body
from pdhe.simulation import simulate
from pdhe.verification.drawing import COLOURS, MARKERS, label, panels
from pdhe.verification.notched import TOUGHNESS
from pdhe.verification.pair import HORIZON_RATIO, SPACING, pair
from pdhe.verification.plates import POISSON, THICKNESS, YOUNG, plate_body, square_plate
from pdhe.verification.report import Report, Row, fitted_order
from pdhe.verification.waves import DENSITY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Steps over the stable one, and how many of the longest a plate is watched for.
SHARES = (0.8, 0.4, 0.2, 0.1)
LONGEST = 150
#: How far above and below the speed that breaks a pair it is tried.
BRACKET = 5e-5

TEXT = """\
A free plate of steel with a bump in its displacement is let go. The sum of its kinetic and elastic energy swings with
the square of the step, by an amount that is known (theory, eq. 7.10): with it, the energy is kept to round-off over
thousands of steps. Displacements at a given time converge with the square of the step.

The limit of stability is $2/\\omega_\\text{max}$ with the largest eigenvalue of the plate, found here by Lanczos'
method. Two per cent below it, the energy of random velocities stays where it was for as long as one likes; two per
cent above it grows without limit. Runs take steps by Gershgorin's bound, which is on the safe side of it for every
model.

Two nodes that fly apart tear their bond if they are fast enough. With the mass $m=\\varrho V$ each, the kinetic
energy $m v^2$ has to exceed what the bond can hold, hence $v_\\text{crit}=s_c\\sqrt{k_n\\xi V/(2\\varrho)}$. A third
comparison is the test of another code: two nodes 2 m apart that fly towards each other and repel each other like a
linear peridynamic solid in three dimensions; the same stiffness is given to a bond."""


def run(side: int = 24, steps: int = 4000, shares: tuple[float, ...] = SHARES) -> Report:
    """Follow plates of ``side`` nodes a side, for up to so many steps, at some shares of the stable step."""
    plate = square_plate(side, side)
    body = plate_body(plate, 3.015e-3)
    limit = 2.0 / math.sqrt(_largest(_free(body, DENSITY * plate.volume)))
    rows = []
    for model in MODELS:
        other = _free(plate_body(plate, 3.015e-3, model=model), DENSITY * plate.volume)
        rows.append(
            Row(
                f"stable step by Gershgorin's theorem over the true one, {model}", 1.0,
                other.limit * math.sqrt(_largest(other)) / 2.0, kind="at most",
                reason="a bound; measured 0.77 to 0.80: it adds magnitudes where short waves cancel",
            )
        )  # fmt: skip
    swings, ends = [], []
    for share in shares:
        swing, kept, u = _let_go(body, plate, share * limit, LONGEST * SHARES[0] * limit)
        swings.append(swing)
        ends.append(u)
        if share == shares[0]:
            rows += [
                Row(
                    f"swing of the energy at {share:g} of the limit, over the elastic energy at first", share**2, swing,
                    kind="at most", reason="(step omega_max / 2)^2 for the shortest wave; long ones swing less",
                ),
                Row(
                    "change of the energy with the term that swings, over the energy", 1e-12, kept, kind="at most",
                    reason="exact for linear bodies; measured 3e-15, round-off",
                ),
            ]  # fmt: skip
    sizes = [share * limit for share in shares]
    # Of equal steps, three in a row tell the order without an exact answer.
    differences = [float(np.abs(a - b).max()) for a, b in pairwise(ends)]
    rows += [
        Row("order of the swing of the energy", 2.0, fitted_order(sizes[1:], swings[1:]), 0.05, kind="absolute",
            reason="second order; measured 1.99"),
        Row("order of the displacements at a given time", 2.0, fitted_order(sizes[1:-1], differences[1:]), 0.05,
            kind="absolute", reason="second order, from differences of halved steps; measured 1.98"),
    ]  # fmt: skip
    curves = {share: _random(body, plate, share * limit, steps) for share in (0.98, 1.02)}
    rows += [
        Row(
            f"largest energy in {steps} steps of 0.98 of the limit over that at the start", 10.0, max(curves[0.98]),
            kind="at most",
            reason="1 / (1 - 0.98^2) = 25 bounds it for the shortest wave, of which there is little here; measured 1.7",
        ),
        Row(
            "the same at 1.02 of the limit", 1e12, max(curves[1.02]), kind="at least",
            reason="the shortest wave grows by 1.49 a step; measured more than 1e100",
        ),
    ]  # fmt: skip
    drift = _drift(body, plate, 0.8 * limit, steps)
    rows.append(
        Row(f"drift of the energy in {steps} steps, of the energy", 1e-11, drift, kind="at most",
            reason="slope of a straight line through what is kept; measured 4e-16")
    )  # fmt: skip
    rows += _pair_rows() + _other_code_rows()
    return Report("verlet", "Explicit dynamics", TEXT, rows, _drawing(shares, swings, differences, curves))


def _free(body: Body, mass: np.ndarray) -> Verlet:
    nothing = DisplacementConditions([], {}, body.coordinates, (1.0, 1.0))
    return Verlet(body, mass, nothing, [], np.zeros(body.coordinates.shape))


def _largest(motion: Verlet) -> float:
    """Largest eigenvalue of the stiffness over the mass, 1/s^2."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    root = np.sqrt(motion.mass)[:, None]
    shape = motion.u.shape

    def product(z: np.ndarray) -> np.ndarray:
        return (-motion.body.force(np.ascontiguousarray(z.reshape(shape) / root)) / root).ravel()

    operator = LinearOperator((root.size * 2,) * 2, matvec=product, dtype=float)
    start = np.random.default_rng(0).standard_normal(root.size * 2)
    return float(eigsh(operator, 1, which="LA", tol=1e-10, v0=start)[0][0])


def _bump(plate) -> np.ndarray:
    x = plate.coordinates / plate.width - [0.45, 0.55]
    return 1e-6 * np.exp(-30.0 * (x**2).sum(axis=1))[:, None] * [1.0, 0.5]


def _let_go(body: Body, plate, step: float, end: float) -> tuple[float, float, np.ndarray]:
    """Swing of the energy and change of what is kept, over the energy; displacements at the end."""
    motion = _free(body, DENSITY * plate.volume)
    motion.u[:] = _bump(plate)
    motion.sweep(0.0)
    begin, count = motion.elastic(), motion.steps(end, step)
    step, energy, kept = end / count, [], []
    kept.append(begin - motion.ripple(step))
    for k in range(count):
        motion.step((k + 1) * step, step)
        motion.end(step)
        total = motion.kinetic()[0] + motion.elastic()
        energy.append(total)
        kept.append(total - motion.ripple(step))
    return float(np.abs(np.array(energy) - begin).max() / begin), float(np.ptp(kept) / begin), motion.u.copy()


def _random(body: Body, plate, step: float, steps: int) -> list[float]:
    """Energy over that at the start, from random velocities."""
    motion = _free(body, DENSITY * plate.volume)
    motion.v[:] = np.random.default_rng(2).standard_normal(motion.v.shape)
    motion.sweep(0.0)
    begin, found = motion.kinetic()[0], [1.0]
    for k in range(steps):
        motion.step((k + 1) * step, step)
        motion.end(step)
        if k % 20 == 19 or k < 20:
            found.append((motion.kinetic()[0] + motion.elastic()) / begin)
            if found[-1] > 1e100:
                break
    return found


def _drift(body: Body, plate, step: float, steps: int) -> float:
    """Change of what is kept by a straight line through it, over the energy."""
    motion = _free(body, DENSITY * plate.volume)
    motion.u[:] = _bump(plate)
    motion.sweep(0.0)
    kept = []
    for k in range(steps):
        motion.step((k + 1) * step, step)
        motion.end(step)
        if k % 20 == 0:
            kept.append(motion.kinetic()[0] + motion.elastic() - motion.ripple(step))
    line = np.polyfit(np.linspace(0.0, 1.0, len(kept)), kept, 1)
    return abs(float(line[0])) / kept[0]


def breaking_speed() -> float:
    """Speed of either node of a pair at which its bond breaks, m/s (closed form of the text)."""
    horizon, volume = HORIZON_RATIO * SPACING, SPACING**2 * THICKNESS
    stiffness = 6.0 * YOUNG / (math.pi * THICKNESS * horizon**3 * (1.0 - POISSON))
    critical = math.sqrt(4.0 * TOUGHNESS**2 / YOUNG / (stiffness * THICKNESS * horizon**4))
    return critical * math.sqrt(stiffness * SPACING * volume / (2.0 * DENSITY))


def pair_broken(speed: float, criterion: str, safety: float = 0.004) -> bool:
    """Whether two nodes that fly apart at a speed each, m/s, tear their bond."""
    period = 2.0 * math.pi * math.sqrt(DENSITY * SPACING / (2.0 * _spring()))
    blocks: dict[str, Any] = {
        "loads": [{"on": on, "initial_velocity": {"x": v}} for on, v in (("left", -speed), ("right", speed))],
        "stepping": {"mode": "dynamic", "safety": safety, "damping": 0.0},
        "time": {"end": 0.5 * period},
        "outputs": {"times": [0.5 * period]},
    }
    material = {"youngs_modulus": YOUNG, "poissons_ratio": POISSON, "fracture_toughness": TOUGHNESS}
    case = pair(0.0, None, criterion, "stretch", material={**material, "density": DENSITY}, **blocks)
    return bool(simulate(case)["broken_bonds"].values[-1] > 0)


def _spring() -> float:
    """Stiffness of a bond over a volume, N/m^4 times m: ``k_n V``."""
    horizon = HORIZON_RATIO * SPACING
    return 6.0 * YOUNG / (math.pi * THICKNESS * horizon**3 * (1.0 - POISSON)) * SPACING**2 * THICKNESS


def _pair_rows() -> list[Row]:
    speed = breaking_speed()
    rows = [Row("speed at which a pair of nodes tears its bond", speed, speed, unit="m/s", kind="shown",
                reason="closed form of the text, for the steel of the thesis and nodes 1 mm apart")]  # fmt: skip
    for share, wanted in ((1.0 - BRACKET, 0), (1.0 + BRACKET, 2)):
        broken = sum(pair_broken(share * speed, criterion) for criterion in ("stretch", "energy"))
        rows.append(
            Row(
                f"pairs that tear at {share:.5f} of that speed, by stretch and by energy", wanted, broken, 0.0,
                kind="absolute", reason="steps of 0.004 of the limit overshoot and miss the peak by 8e-6 at most",
            )
        )  # fmt: skip
    return rows


def _other_code_rows() -> list[Row]:
    # Force on a node of the solid: 18 K V e / r^2, e = 2 u being the change of their distance; of a bond: k_n V^2 e/r.
    bulk, density, volume, apart = 130e9, 7800.0, 2.0, 2.0
    x = np.array([[-1.0, 0.0], [1.0, 0.0]])
    spring = 36.0 * bulk / (apart**2 * volume * volume) * volume
    horizon, thickness = 3.0, 1.0
    young = spring * math.pi * thickness * horizon**3 * (1.0 - 1.0 / 3.0) / 6.0
    model = MODELS["one-parameter"](young, 1.0 / 3.0, thickness, horizon)
    bonds = build_bonds(x, np.full(2, volume), np.ones(2), thickness, horizon, partial="full", surface="none")
    motion = _free(make_body(bonds, model, x, np.full(2, volume)), np.full(2, density * volume))
    motion.v[:, 0] = 1.0, -1.0
    motion.sweep(0.0)
    for k in range(5):
        motion.step((k + 1) * 1e-5, 1e-5)
        motion.end(1e-5)
    u, v = float(motion.u[0, 0]), float(motion.v[0, 0])
    return [
        Row("displacement of two nodes after five steps", 4.704698051e-5, u, 1e-9, "m",
            reason="reference of another code, ten digits"),
        Row("their speed", 0.8180661902, v, 1e-9, "m/s", reason="the same"),
        Row("their dilatation", -1.411409415e-4, -6.0 * u / apart, 1e-9,
            reason="the same: three times the stretch"),
    ]  # fmt: skip


def _drawing(shares, swings, differences, curves):
    def draw(figure: Figure) -> None:
        one, two = panels(figure, 2)
        figure.set_size_inches(7.6, 3.2)
        x = np.array(shares)
        one.loglog(x, swings, MARKERS[0], color=COLOURS[0], label="swing of the energy")
        scale = max(differences)
        one.loglog(x[:-1], np.array(differences) / scale, MARKERS[1], color=COLOURS[1], label="displacements (scaled)")
        one.loglog(x, swings[-1] * (x / x[-1]) ** 2, "k--", linewidth=0.8, label="order 2")
        one.legend(fontsize=7, frameon=False)
        one.set_xticks(x, [f"{share:g}" for share in shares], minor=False)
        one.set_xticks([], minor=True)
        label(one, "step over the stable one", "relative change")
        for (share, curve), colour in zip(curves.items(), COLOURS, strict=False):
            steps = [*range(min(21, len(curve))), *range(40, 20 * (len(curve) - 21) + 40, 20)][: len(curve)]
            two.semilogy(steps, curve, color=colour, linewidth=1.2, label=f"{share:g} of the limit")
        two.set_ylim(1e-1, 1e12)
        two.legend(fontsize=7, frameon=False)
        label(two, "steps", "energy over that at the start")

    return draw
