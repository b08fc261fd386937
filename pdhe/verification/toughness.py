"""Fracture energy that a running crack takes, against the one put in: criteria, calibrations, lattices and horizons."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.bonds import Grading
from pdhe.case import build_case
from pdhe.damage import CRITERIA, critical_stretch, crossing_sum, stretch_factors, stretch_squares, together_at
from pdhe.discretization import discretize
from pdhe.materials import BY_ENERGY, BondLoad
from pdhe.mesh import make_mesh
from pdhe.scene import Scene
from pdhe.simulation import simulate
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.plates import (
    POISSON,
    THICKNESS,
    YOUNG,
    Plate,
    equilibrium,
    plate_body,
    rotated_plate,
    square_plate,
    triangle_plate,
)
from pdhe.verification.report import Report, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPACING = 1e-3
STRAIN = 1e-3
#: J/m^2; linear elasticity makes every ratio below independent of it.
TOUGHNESS = 16476.0
#: The model that paths are followed with where no other is named.
BOND = "condensed rotation"
#: Bonds within this much of the most critical one break with it.
GROUPING = 0.05
#: Of the solver.
TOLERANCE = 1e-5
#: Cells of growth after which a crack counts as running. The means leave out the first horizon and a cell.
RUN = 10
#: Largest error of the mean fracture energy, by horizon ratio and criterion.
ALLOWED = {
    "energy": {3.015: 0.30, 4.0: 0.25, 5.0: 0.15},
    "stretch": {3.015: 0.50, 4.0: 0.35, 5.0: 0.25},
}
MEASURED = {
    "energy": {3.015: "+9 % to +22 %", 4.0: "+8 % to +19 %", 5.0: "+2 % to +9 %"},
    "stretch": {3.015: "+20 % to +37 %", 4.0: "+11 % to +25 %", 5.0: "-2 % to +19 %"},
}
#: Largest energy release rate at which the crack runs over the fracture energy put in, and the range measured.
RUNS = {
    "energy": {3.015: (1.6, "1.29 to 1.46"), 4.0: (1.45, "1.22 to 1.34"), 5.0: (1.4, "1.12 to 1.30")},
    "stretch": {3.015: (2.0, "1.53 to 1.89"), 4.0: (1.75, "1.42 to 1.63"), 5.0: (1.6, "1.28 to 1.48")},
}
#: Bonds of one energy: their energy, and that which the strip loses, by horizon ratio.
EQUAL = "measured -6 % to +2 % over four kinds of nodes and three horizons, and +1 % with the state-based model"
EQUAL_LOST = {3.015: (0.40, "+19 % to +27 %"), 4.0: (0.25, "+8 % to +14 %"), 5.0: (0.15, "+3 % to +6 %")}
BONDS = "measured -5 % to +6 %: bonds left unbroken or broken beside the path, and ten cells of growth only"

TEXT = """A strip with a long crack is stretched by edges that slide freely. Its energy release rate is E eps^2 H/2
whatever the length of the crack, so that slow loading drives the crack through the strip at one load. The path is
followed bond by bond by the rules of the event stepping. Elasticity is linear, hence the order of the breaks does
not depend on the load, and these numbers come out, all as multiples of the fracture energy that was put in: the
*energy of the broken bonds* per new crack area, which is what the calibration of the critical stretch sets; the
energy that the strip *loses* per new crack area; the energy release rate at which the crack *runs*, that is, gets
through ten cells without a further increase of the load; and that at the *start*. The last line repeats one case as
a scene with a load ramp.

With the energy criterion the broken bonds take the fracture energy that was put in within 6 %, on every kind of
nodes and for every horizon. The strip loses more, the more so the fewer nodes the horizon holds: a bond that breaks
at fixed grips sheds its own energy and some of its neighbours', and in a quasi-static path that part is lost too.
The load at which the crack runs is higher still, since the crack has to pass the hardest spot of each cell (lattice
trapping): by 10 % to 50 % in energy, 5 % to 20 % in load. Both are properties of discrete bonds, not of the
calibration; nothing is done to compensate them. Under the critical stretch bonds almost parallel to the crack stay
unbroken and bridge it, and shear adds energy to the others: the load at which the crack runs is always higher, by 9 %
to 29 % in energy, and so is the energy of the bonds and of the strip but on the lattice at 22.5 degrees with m = 4 and
5, where the crack leaves many bonds whole. The crack starts below the input where the bonds at the tip of a notch cut
by a line are loaded unevenly; it then stops after a cell or two.

Nothing but the height of the strip sets a length here, so that strips with fewer and more rows of cells are the same
strip with another spacing. The energy of the broken bonds does not depend on it within the scatter of the other lines.

The discrete sum over the bonds and the integral over a full disc give critical stretches that differ by at most 2 %
with moment-matched bonds, and both hold about equally well: 3.6 % rms and 2.8 % rms, where single paths scatter by as
much. Without corrections (the lines marked "uncorrected") the integral misses a sixth of the energy and the discrete
sum holds as well as before. Its largest error over all lines is the smaller one: discrete is therefore the default.

Bonds that break at one energy whatever their length (`energy density`, theory, eq. 5.13) take the fracture energy as
well as those of one stretch do, and the strip loses as much. The constant 3 G/(pi h delta^3) that is found in places
would make it 0.64."""


@dataclass(frozen=True)
class CrackPath:
    """What a crack path gave, with the discrete calibration, over the fracture energy put in.

    Attributes
    ----------
    start, runs
        Energy release rate at the first break, and the one that carries the crack through :data:`RUN` cells.
    lost, bonds
        Energy lost by the strip, and energy of the broken bonds when they broke, per new crack area.
    continuum
        Turns every number into the one of the other calibration.
    advance, rate
        Growth in cells after each break, and the energy release rate that it needed.
    """

    start: float
    runs: float
    lost: float
    bonds: float
    continuum: float
    advance: np.ndarray
    rate: np.ndarray


def strip(nodes: str, columns: int, rows: int) -> Plate:
    """Nodes of the strip: ``triangles``, or a square lattice turned by the given degrees."""
    if nodes == "triangles":
        return triangle_plate(columns * SPACING, rows * SPACING, SPACING)
    if float(nodes) == 0.0:
        return square_plate(columns, rows, SPACING)
    return rotated_plate(columns, rows, SPACING, float(nodes))


def follow(
    plate: Plate,
    ratio: float,
    notch: float,
    criterion: str,
    cells: int,
    weights: str,
    partial: str,
    graded: tuple[float, Grading] | None = None,
    model: str = BOND,
    plane: str = "stress",
    split: tuple[float, float] | None = None,
) -> CrackPath:
    """Follow a crack through ``cells`` spacings of growth under a unit strain, scaling the load to each break.

    Bonds may break in the middle half of the height, from the tip of the notch on. ``graded`` is the reference horizon,
    m, and the grading of a mesh that has :data:`SPACING` around the path; ``split`` what the parts of the energy count.
    """
    middle = 0.5 * plate.height
    horizon = ratio * SPACING
    crack = ((-SPACING, middle), (notch, middle))
    reference, grading = graded or (horizon, None)
    body = plate_body(plate, reference, weights=weights, partial=partial, cracks=[crack], grading=grading,
                      model=model, plane=plane)  # fmt: skip
    rule = CRITERIA[criterion]
    decides, squares = BondLoad(rule.by_energy, split=split), stretch_squares(body.bonds, rule)
    tougher = np.sqrt(np.prod(stretch_factors(body.bonds, criterion=rule).get("squares", (np.ones(1),)), axis=0))
    fixed = np.zeros(plate.coordinates.shape, bool)
    fixed[plate.top, 1] = fixed[plate.bottom, 1] = True
    prescribed = np.zeros(plate.coordinates.shape)
    prescribed[:, 1] = STRAIN * (plate.coordinates[:, 1] - middle)
    solver = equilibrium(body, plate, fixed, TOLERANCE)
    together = together_at(TOLERANCE)
    bonds, owner = body.bonds, body.bonds.owners()
    centre = 0.5 * (plate.coordinates[owner] + plate.coordinates[bonds.neighbours])
    near = (np.abs(centre[:, 1] - middle) < 0.25 * plate.height) & (centre[:, 0] > notch - 2.0 * horizon)
    may_fail = near & (owner < bonds.neighbours)
    short = bonds.length < 1.5 * SPACING
    crossing = crossing_sum(bonds, plate.volume, squares)
    critical = critical_stretch(body.model, crossing, TOUGHNESS, "discrete", rule)
    continuum = (critical_stretch(body.model, crossing, TOUGHNESS, "continuum", rule) / critical) ** 2
    young = YOUNG if plane == "stress" else YOUNG / (1.0 - POISSON**2)
    nominal = 0.5 * young * STRAIN**2 * plate.height / TOUGHNESS
    stiffness = 0.5 * body.normal * bonds.weight * bonds.length
    u, _ = solver.solve(prescribed, prescribed)
    energy, tip, held, states = body.energy(u).sum(), notch, 0.0, []
    while tip < notch + cells * SPACING:
        load = body.bond_loads(u, decides) * (may_fail & body.intact) / tougher
        scale = critical / load.max()
        held = max(held, scale)
        broken = np.flatnonzero(load * held / critical >= max(1.0 - together, (1.0 - GROUPING) * held / scale))
        separation = float(stiffness[broken] @ body.bond_loads(u, BY_ENERGY)[broken] ** 2)
        body.break_bonds(broken)
        tip = max([tip, *centre[broken[short[broken]], 0]])
        u, _ = solver.solve(u, prescribed)
        previous, energy = energy, body.energy(u).sum()
        states.append((tip - notch, scale**2 * nominal, scale**2 * (previous - energy), scale**2 * separation))
    advance, rate, lost, bond_energy = np.array(states).T
    first = int(np.argmax(advance > horizon + SPACING))
    area = (advance[-1] - advance[first]) * THICKNESS * TOUGHNESS
    return CrackPath(
        start=float(rate[0]),
        runs=float(rate[: int(np.argmax(advance >= RUN * SPACING)) + 1].max()),
        lost=float(lost[first + 1 :].sum() / area),
        bonds=float(bond_energy[first + 1 :].sum() / area),
        continuum=float(continuum),
        advance=advance / SPACING,
        rate=rate,
    )


def scene_run(ratio: float, columns: int, rows: int, notch: float) -> float:
    """Energy release rate at which the crack of a scene with a load ramp runs, over the fracture energy put in."""
    width, height = columns * SPACING, rows * SPACING
    strongest = np.sqrt(2.0 * 2.0 * TOUGHNESS / (YOUNG * height))  # strain at twice the fracture energy
    ramp = {"times": [0.0, 1.0], "values": [0.0, 0.5 * strongest * height]}
    pull = {"times": [0.0, 1.0], "values": [0.0, -0.5 * strongest * height]}
    scene = Scene.from_resolved(
        {
            "title": "strip",
            "geometry": {
                "plate": {"width": width, "height": height, "thickness": THICKNESS},
                "cracks": [{"name": "notch", "from": [0.0, 0.5 * height], "to": [notch, 0.5 * height]}],
            },
            "mesh": {"spacing": SPACING},
            "horizon": {"ratio": ratio},
            "material": {
                "youngs_modulus": YOUNG, "poissons_ratio": POISSON, "critical_energy_release_rate": TOUGHNESS,
            },
            "loads": [{"on": "top", "displacement": {"y": ramp}}, {"on": "bottom", "displacement": {"y": pull}}],
            "damage": {"criterion": "energy", "no_fail": ["top", "bottom"]},
            "time": {"end": 1.0},
            "stepping": {"mode": "events", "grouping": GROUPING},
            "solver": {"tolerance": TOLERANCE},
            "outputs": {"times": [1.0]},
        }
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "strip.msh"
        make_mesh(scene.geometry, scene.mesh, path)
        result = simulate(build_case(scene, discretize(path, scene.geometry, scene.mesh)))
    grown = result["crack_extension"].values >= RUN * SPACING
    if not grown.any():
        return float("nan")
    strain = strongest * float(result["history_time"].values[int(np.argmax(grown))])
    return 0.5 * YOUNG * strain**2 * height / TOUGHNESS


def run(
    ratios: tuple[float, ...] = (3.015, 4.0, 5.0),
    nodes: tuple[str, ...] = ("0", "22.5", "45", "triangles"),
    columns: int = 60,
    rows: int = 40,
    cells: int = 14,
    heights: tuple[int, ...] = (28, 56),
    equal: tuple[str, ...] = ("0", "triangles"),
    models: tuple[str, ...] = ("state-based",),
) -> Report:
    """Follow cracks for every horizon ratio, node type and criterion.

    ``heights`` repeats one case on other strips. Bonds of one energy are followed on the ``equal`` kinds of nodes, and
    for the first ratio and kind with other ``models``.
    """
    notch = round(0.7 * rows) * SPACING
    table: list[dict[str, Any]] = []
    paths: dict[tuple, CrackPath] = {}

    def case(ratio, kind, criterion, height=rows, weights="moment matched", partial=None, model=BOND) -> CrackPath:
        plate = strip(kind, round(columns * height / rows), height)
        rule = partial or ("ramp" if kind == "triangles" else "full")
        path = follow(plate, ratio, notch * height / rows, criterion, cells, weights, rule, model=model)
        table.append(
            {
                "criterion": criterion,
                "model": model,
                "horizon_ratio": ratio,
                "nodes": kind if kind == "triangles" else f"square lattice at {kind} degrees",
                "rows": height,
                "weights": weights,
                "partial_volume": rule,
                "start": round(path.start, 3),
                "runs": round(path.runs, 3),
                "lost": round(path.lost, 3),
                "broken_bonds": round(path.bonds, 3),
                "broken_bonds_continuum_calibration": round(path.bonds * path.continuum, 3),
            }
        )
        return path

    lines: list[Row] = []

    def judge(what: str, value: float, allowed: float, why: str) -> None:
        kind = "relative" if allowed else "shown"
        lines.append(Row(what, 1.0, value, allowed, "G_c", kind, why))

    for criterion in ("energy", "stretch"):
        for ratio in ratios:
            for kind in nodes:
                path = paths[criterion, ratio, kind] = case(ratio, kind, criterion)
                where = f"{criterion} criterion, m = {ratio:g}, {kind if kind == 'triangles' else kind + ' degrees'}"
                if criterion == "energy":
                    judge(f"energy of the broken bonds, {where}", path.bonds, 0.10, BONDS)
                why = f"measured {MEASURED[criterion][ratio]} over the four kinds of nodes; see the text"
                judge(f"energy lost, {where}", path.lost, ALLOWED[criterion][ratio], why)
                most, found = RUNS[criterion][ratio]
                why = f"measured {found} over the four kinds of nodes: lattice trapping, falls with m"
                lines.append(Row(f"the crack runs, {where}", most, path.runs, 0.0, "G_c", "at most", why))
    lines += _comparisons(paths, ratios, nodes)
    for ratio, kind, model in [(m, k, BOND) for m in ratios for k in equal] + [(ratios[0], "0", m) for m in models]:
        path = case(ratio, kind, "energy density", model=model)
        where = f"energy density, m = {ratio:g}, {kind if kind == 'triangles' else kind + ' degrees'}"
        where += "" if model == BOND else f", {model}"
        judge(f"energy of the broken bonds, {where}", path.bonds, 0.10, EQUAL)
        allowed, found = EQUAL_LOST[ratio]
        judge(
            f"energy lost, {where}", path.lost, allowed, f"measured {found} over the four kinds of nodes; see the text"
        )
    for height in heights:
        path = case(ratios[0], "0", "energy", height)
        where = f"{height} rows of cells instead of {rows}"
        judge(f"energy of the broken bonds, {where}", path.bonds, 0.10, BONDS)
        judge(f"the crack runs, {where}", path.runs, 0.0, "not judged: lattice trapping")
    bare = case(ratios[0], "0", "energy", rows, "none", "thesis")
    judge("energy of the broken bonds, uncorrected, discrete calibration", bare.bonds, 0.10, BONDS)
    why = "not judged: the integral counts bonds that these families lack"
    judge("energy of the broken bonds, uncorrected, continuum calibration", bare.bonds * bare.continuum, 0.0, why)
    chosen = [bare, *(path for (criterion, *_), path in paths.items() if criterion == "energy")]
    worst = [max(abs(p.bonds * (p.continuum if integral else 1.0) - 1.0) for p in chosen) for integral in (False, True)]
    lines.append(
        Row("largest error of the energy of the broken bonds, uncorrected ones included, discrete over continuum", 1.0,
            worst[0] / worst[1], 0.0, "1", "at most", "measured 0.36: why the discrete calibration is the default")
    )  # fmt: skip
    first = paths["energy", ratios[0], "0"]
    whole = scene_run(ratios[0], columns, rows, notch)
    why = "the same breaks in the same order: measured 1e-13; a break in another order would show as some per cent"
    lines.append(Row("the crack of the scene runs, against the path", first.runs, whole, 1e-4, "G_c", "relative", why))
    return Report(
        "toughness", "Recovered fracture energy", TEXT, lines, _drawing(paths, ratios, nodes), {"paths": table}
    )


def _comparisons(paths: dict[tuple, CrackPath], ratios: tuple[float, ...], nodes: tuple[str, ...]) -> list[Row]:
    """Which criterion and which calibration come closer to the input."""
    both = [(ratio, kind) for ratio in ratios for kind in nodes]

    def rms(errors) -> float:
        return float(np.sqrt(np.mean(np.square(list(errors)))))

    lost = {c: rms(paths[c, *key].lost - 1.0 for key in both) for c in ("energy", "stretch")}
    chosen = [paths["energy", *key] for key in both]
    rules = {
        "discrete": rms(p.bonds - 1.0 for p in chosen),
        "continuum": rms(p.bonds * p.continuum - 1.0 for p in chosen),
    }
    lines = [
        Row(f"rms error of the energy of the broken bonds, {rule} calibration", 0.0, value, 0.0, "G_c", "shown",
            "energy criterion, all lines above")
        for rule, value in rules.items()
    ]  # fmt: skip
    lines.append(
        Row("rms excess of the energy lost, energy criterion over stretch criterion", 1.0,
            lost["energy"] / lost["stretch"], 0.0, "1", "at most",
            "measured 0.57: the reason why the energy criterion is the default")
    )  # fmt: skip
    if len(ratios) > 1:
        worst = {m: max(paths["energy", m, kind].lost for kind in nodes) for m in (ratios[0], ratios[-1])}
        lines.append(
            Row(f"largest energy lost, energy criterion, m = {ratios[-1]:g} over m = {ratios[0]:g}", 1.0,
                worst[ratios[-1]] / worst[ratios[0]], 0.0, "1", "at most",
                "measured 0.90: the excess falls with the number of bonds")
        )  # fmt: skip
    return lines


def _drawing(paths: dict[tuple, CrackPath], ratios: tuple[float, ...], nodes: tuple[str, ...]):
    def draw(figure: Figure) -> None:
        left, right = panels(figure, 2)
        for k, ratio in enumerate(ratios):
            path = paths["energy", ratio, nodes[0]]
            left.plot(
                path.advance, path.rate, ".-", color=COLOURS[k], markersize=3, linewidth=0.6, label=f"m = {ratio:g}"
            )
        left.axhline(1.0, color="0.3", linewidth=0.8)
        label(left, "crack growth (cells)", "energy release rate at each break / $G_c$")
        left.legend(fontsize=7, frameon=False)
        place = np.arange(len(ratios) * len(nodes))
        for k, criterion in enumerate(("energy", "stretch")):
            chosen = [paths[criterion, ratio, kind] for ratio in ratios for kind in nodes]
            shift = place + 0.24 * (k - 0.5)
            bonds, runs = [p.bonds for p in chosen], [p.runs for p in chosen]
            style = {"color": COLOURS[k], "linestyle": "none", "markersize": 4.5}
            right.vlines(shift, bonds, runs, color=COLOURS[k], linewidth=0.8)
            right.plot(shift, bonds, marker="o", label=f"{criterion}: broken bonds", **style)
            right.plot(shift, [p.lost for p in chosen], marker="s", label=f"{criterion}: lost", **style)
            right.plot(shift, runs, marker="^", markerfacecolor="white", label=f"{criterion}: runs", **style)
        right.axhline(1.0, color="0.3", linewidth=0.8)
        names = [kind if kind == "triangles" else f"{float(kind):g}°" for kind in nodes] * len(ratios)
        right.set_xticks(place, names, rotation=70, fontsize=7)
        for k, ratio in enumerate(ratios):
            at = k * len(nodes) + 0.5 * (len(nodes) - 1)
            right.text(at, 0.02, f"m = {ratio:g}", ha="center", fontsize=8, transform=right.get_xaxis_transform())
        label(right, "nodes", "recovered fracture energy / $G_c$")
        right.set_ylim(0.72, 2.4)
        right.legend(fontsize=6.5, frameon=False, ncols=2, loc="upper right")

    return draw
