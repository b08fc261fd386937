"""Large strains and rotations: closed forms at every node, derivatives, the elastica, and a ring."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from pdhe.materials import Body, Correspondence, FiniteStrain, make_body
from pdhe.newton import NewtonEquilibrium
from pdhe.scene import Scene
from pdhe.simulation import simulate
from pdhe.solid_bonds import build_solid_bonds
from pdhe.verification.drawing import COLOURS, MARKERS, label, panels
from pdhe.verification.plates import POISSON, THICKNESS, YOUNG, plate_body, square_plate
from pdhe.verification.report import Report, Row
from pdhe.verification.slabs import case_of

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

SPACING, SIDE = 1e-3, 6
#: Horizon of the points, and that of slender strips, m.
HORIZON, SHORT = 3.015e-3, 2.015e-3
#: Length over height of the strips, and how far their ends are moved, over the length: the first is small.
SLENDER, MOVED = 20, (0.01, 0.2, 0.4, 0.6, 0.7)
PLACES = {"stress": "plane stress", "strain": "plane strain", None: "space"}
DEGREES = (30.0, 90.0, 180.0)
#: Displacements of the edges of strips that tear, at the start and at the end, over that at which they should.
PULLED = (0.8, 1.15)

TEXT = """\
*Points.* Bodies of displaced nodes, a fifth of their bonds broken, are given displacements with strains and rotations
of any size. The deformation gradient of an affine map is exact at every node, edges and corners included. A bar (with
all of its bonds) that is stretched by l and may contract has the force per area at rest E l (l^2 - 1) / 2 (Saint Venant
and Kirchhoff; in plane strain E / (1 - nu^2)). A body that turns has no stress, and one that is deformed keeps its
energy as it turns. Forces are compared with differences of energies, the stiffness with differences of forces; what is
left is the error of the differences.

*Elastica.* A strip, twenty times as long as high, is held at one end, and the middle node of its other end is moved
sideways; that end is free to turn and to come nearer. The closed solution for a rod that keeps its length (Bisshopp and
Drucker 1945) has no constant but the bending stiffness: the shape, and how the force grows, do not depend on that. The
stiffness itself is what the force at the smallest displacement shows. With few nodes across it is too large, as it is
under small strains: the gradient of a node at a face comes from one side alone.

*Ring.* Both ends of a strip of 6 by 242 nodes are turned rigidly until they meet. It becomes a circle of its own
length, with a bending energy that is quadratic in the angle; strains at its faces reach 8 %.

*Tearing.* A strip, 32 mm long and 12 mm high, has a notch of 14 mm and is pulled at both long edges. Where it is not
cracked, it stores the energy of a uniform stretch; a crack that runs sets free that energy times the height for its
area (Rivlin and Thomas 1953), whatever the strain. The fracture energy is chosen so that this happens at a given
stretch. Bonds have the energy of theory, eq. 2.31, which sums up to that of the body."""


def point_body(plane: str | None, broken: float = 0.2) -> FiniteStrain:
    """Body of displaced nodes, SIDE along each axis, some of its bonds broken; ``plane`` None is a cube."""
    if plane is None:
        x = SPACING * (np.stack(np.meshgrid(*[np.arange(SIDE) + 0.5] * 3, indexing="ij"), axis=-1).reshape(-1, 3))
        x += 0.2 * SPACING * np.random.default_rng(0).uniform(-1.0, 1.0, x.shape)
        volume = np.full(len(x), SPACING**3)
        bonds = build_solid_bonds(x, volume, np.full(len(x), SPACING), HORIZON)
        model = Correspondence(YOUNG, POISSON, SIDE * SPACING, HORIZON, None, strain="finite")
        body = make_body(bonds, model, x, volume)
    else:
        body = large(plate_body(square_plate(12, 12, jitter=0.2), HORIZON, model="correspondence", plane=plane))
    once = np.flatnonzero(body.bonds.once())
    body.break_bonds(np.random.default_rng(1).choice(once, int(broken * once.size), replace=False))
    return body


def large(body: Body) -> FiniteStrain:
    """The same correspondence body, at large strains."""
    return make_body(body.bonds, replace(body.model, strain="finite"), body.coordinates, body.volume)


def turning(axes: int, degrees: float) -> np.ndarray:
    """Rotation in the plane, or about a diagonal in space."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    if axes == 2:
        return np.array([[c, -s], [s, c]])
    axis = np.ones(3) / np.sqrt(3.0)
    return c * np.eye(3) + (1.0 - c) * np.outer(axis, axis) - s * np.cross(np.eye(3), axis)


def _relative(found: np.ndarray, expected: np.ndarray, scale: float | None = None) -> float:
    return float(np.abs(found - expected).max() / (np.abs(expected).max() if scale is None else scale))


def tension_error(plane: str | None, stretch: float) -> float:
    """Largest error of the stress at any node of a bar that may contract, over the stress."""
    body = point_body(plane, 0.0)
    young, nu = (YOUNG / (1.0 - POISSON**2), POISSON / (1.0 - POISSON)) if plane == "strain" else (YOUNG, POISSON)
    strain = 0.5 * (stretch**2 - 1.0)
    axes = body.coordinates.shape[1]
    lengths = np.full(axes, np.sqrt(1.0 - 2.0 * nu * strain))
    lengths[0] = stretch
    expected = np.zeros((axes, axes))
    expected[0, 0] = young * stretch * strain
    return _relative(body.stress(body.coordinates * (lengths - 1.0)), expected, abs(expected[0, 0]))


def point_rows(plane: str | None) -> list[Row]:
    """What holds at every node of one body."""
    body, where = point_body(plane), PLACES[plane]
    x, random = body.coordinates, np.random.default_rng(2)
    axes = x.shape[1]
    wanted = np.array([[1.7, -0.6, 0.2], [0.4, 0.8, -0.3], [0.1, 0.5, 1.2]])[:axes, :axes]
    found = body.deformation_gradient(x @ wanted.T - x)
    u = 0.15 * SPACING * random.normal(size=x.shape) + x @ (0.15 * random.normal(size=(axes, axes))).T
    pose, v, step = body.at(u), random.normal(size=x.shape), 3e-9
    force, change, energy = pose.force(), pose.change(v), pose.energy()
    slope = -(body.energy(u + step * v).sum() - body.energy(u - step * v).sum()) / (2.0 * step)
    difference = (body.force(u + step * v) - body.force(u - step * v)) / (2.0 * step)
    other = random.normal(size=x.shape)
    there, back = float(np.sum(other * change)), float(np.sum(v * pose.change(other)))
    kept = alone = 0.0
    for degrees in DEGREES:
        turn = turning(axes, degrees)
        kept = max(kept, _relative(body.energy((x + u) @ turn.T - x), energy))
        alone = max(alone, float(np.abs(body.stress(x @ turn.T - x)).max()) / YOUNG)
    linear = make_body(body.bonds, replace(body.model, strain="small"), x, body.volume)
    linear.break_bonds(np.flatnonzero(~body.intact))
    small = 1e-8 / 0.15 * u
    least = f"turned by {', '.join(f'{degrees:g}' for degrees in DEGREES[:-1])} and {DEGREES[-1]:g} degrees"
    table = [
        ("largest error of the gradient of an affine map", _relative(found, wanted), 1e-12, "exact; measured 1e-15"),
        *(
            (f"largest error of the stress of a bar stretched to {stretch:g}", tension_error(plane, stretch), 1e-12,
             "closed form; measured 3e-15")
            for stretch in (0.8, 1.2, 1.5)
        ),
        (f"stress of a body {least}, over E", alone, 1e-13, "none; measured 4e-15"),
        (f"change of the energy of any node of a deformed body {least}", kept, 1e-12, "none; measured 7e-15"),
        ("forces against differences of energies", abs(slope - np.sum(force * v)) / float(np.abs(force * v).sum()),
         1e-9, "round-off over the step; measured 1e-11"),
        ("stiffness against differences of forces", _relative(difference, change), 2e-9,
         "round-off over the step; measured 7e-11"),
        ("asymmetry of the stiffness", abs(there - back) / float(np.abs(other * change).sum()), 1e-13,
         "none; measured 1e-16"),
        ("forces at strains of 1e-8 against those of small strains", _relative(body.force(small), linear.force(small)),
         2e-7, "of the size of the strain; measured up to 7e-8"),
    ]  # fmt: skip
    return [Row(f"{where}: {what}", most, value, kind="at most", reason=why) for what, value, most, why in table]


def elastica(tip: float) -> tuple[float, float, float]:
    """Load P L^2 / E I, deflection and remaining reach over the length, where the end has turned by ``tip``, rad."""
    square = 0.5 * (1.0 + np.sin(tip))
    start = np.arcsin(1.0 / np.sqrt(2.0 * square))
    root = ellipk(square) - ellipkinc(start, square)
    deflection = 1.0 - 2.0 / root * (ellipe(square) - ellipeinc(start, square))
    return float(root**2), float(deflection), float(np.sqrt(2.0 * np.sin(tip)) / root)


def elastica_at(deflection: float) -> tuple[float, float, float]:
    """Angle of the end, rad, load and remaining reach where the deflection is so much of the length."""
    tip = brentq(lambda angle: elastica(angle)[1] - deflection, 1e-6, 0.5 * np.pi - 1e-9, xtol=1e-15)
    load, _, reach = elastica(tip)
    return tip, load, reach


def elastica_shape(tip: float, count: int = 200) -> np.ndarray:
    """Points of the elastica, over the length, about evenly spaced: (count, 2)."""
    square = 0.5 * (1.0 + np.sin(tip))
    angle = tip * (1.0 - np.linspace(1.0, 0.0, count) ** 2)  # the curvature vanishes at the end
    phase = np.arcsin(np.minimum(np.sqrt(0.5 * (1.0 + np.sin(angle)) / square), 1.0))
    start = np.arcsin(1.0 / np.sqrt(2.0 * square))
    root = ellipk(square) - ellipkinc(start, square)
    along = (ellipkinc(phase, square) - ellipkinc(start, square)) / root
    up = along - 2.0 / root * (ellipeinc(phase, square) - ellipeinc(start, square))
    left = np.sqrt(2.0 * np.maximum(np.sin(tip) - np.sin(angle), 0.0)) / root
    return np.column_stack([np.sqrt(2.0 * np.sin(tip)) / root - left, up])


def bent(rows: int) -> dict[str, Any]:
    """Bend a strip of so many rows of nodes far: for each displacement of its end what it does, over the length."""
    plate = square_plate(SLENDER * rows, rows)
    body = large(plate_body(plate, SHORT, model="correspondence"))
    x, middle = plate.coordinates, rows // 2
    row = np.arange(middle * SLENDER * rows, (middle + 1) * SLENDER * rows)
    fixed = np.zeros(x.shape, bool)
    fixed[plate.left], fixed[row[-1], 1] = True, True
    solver, u = NewtonEquilibrium(body, fixed, plate.spacing, 1e-8), np.zeros_like(x)
    length = float(x[row[-1], 0] - x[row[0], 0])
    inertia = THICKNESS * (rows * SPACING) ** 3 / 12.0
    steps = []
    for moved in MOVED:
        prescribed = np.zeros_like(x)
        prescribed[row[-1], 1] = moved * length
        u, force = solver.solve(u, prescribed)
        place = (x + u)[row] - x[row[0]]
        steps.append({
            "moved": moved,
            "load": float(-force[row[-1], 1]) * length**2 / (YOUNG * inertia),
            "reach": float(place[-1, 0]) / length,
            "place": place / length,
        })  # fmt: skip
    return {"rows": rows, "steps": steps}


def elastica_rows(case: dict[str, Any]) -> list[Row]:
    """Shape and force of a bent strip against the closed solution."""
    rows, first = case["rows"], case["steps"][0]
    stiffness = first["load"] / elastica_at(first["moved"])[1]
    found = [
        Row(f"elastica, {rows} nodes across: bending stiffness over E I", 1.0, stiffness, kind="shown",
            reason="surfaces: see the text")
    ]  # fmt: skip
    for step in case["steps"][1:]:
        tip, load, reach = elastica_at(step["moved"])
        what = f"elastica, {rows} nodes across, end moved by {step['moved']:g} of the length"
        shape = elastica_shape(tip, 2000)
        away = max(float(np.hypot(*(shape - point).T).min()) for point in step["place"])
        why = "measured at worst {}; strains are up to {:.2g} there"
        strain = 0.5 / SLENDER * np.sqrt(2.0 * load * np.sin(tip))
        found += [
            Row(f"{what}: reach", reach, step["reach"], 3e-3, "L", reason=why.format("0.2 %", strain)),
            Row(f"{what}: force", load, step["load"] / stiffness, 0.02, "E I / L^2", reason=why.format("1 %", strain)),
            Row(f"{what}: largest distance of a node from the curve", 2e-3, away, 0.0, "L", "at most",
                "measured at worst 1.4e-3"),
        ]  # fmt: skip
    return found


def ring_rows() -> list[Row]:
    """A strip whose ends are turned until they meet."""
    plate = square_plate(242, 6)
    body, x = large(plate_body(plate, SHORT, model="correspondence", nu=0.0)), plate.coordinates
    ends = [x[:, 0] < 2.0 * SPACING, x[:, 0] > 240.0 * SPACING]
    fixed = np.zeros(x.shape, bool)
    fixed[ends[0] | ends[1]] = True
    length, middle = 239.0 * SPACING, np.array([0.5 * plate.width, 0.5 * plate.height])
    solver, u, energies = NewtonEquilibrium(body, fixed, plate.spacing, 1e-8), np.zeros_like(x), []
    for angle in (1e-3, *(0.5 * np.pi * np.arange(1, 5))):
        radius, prescribed = length / angle, np.zeros_like(x)
        for sign, end in zip((-1.0, 1.0), ends, strict=True):
            half = 0.5 * sign * angle
            inner = middle + np.array([0.5 * sign * length, 0.0])
            centre = middle + radius * np.array([np.sin(half), 1.0 - np.cos(half)])
            prescribed[end] = centre + (x[end] - inner) @ turning(2, np.rad2deg(half)).T - x[end]
        u, _ = solver.solve(u, prescribed)
        energies.append(float(body.energy(u).sum()) / angle**2)
    beside = (np.abs(x[:, 1] - middle[1]) < SPACING) & ~fixed[:, 0]
    distance = np.hypot(*((x + u)[beside] - middle - np.array([0.0, radius])).T).reshape(2, -1).mean(axis=0)
    return [
        Row("ring: energy over that of a small angle, scaled", 1.0, energies[-1] / energies[0], 0.01,
            reason="measured 0.6 % less: strains of 8 % at the faces"),
        Row("ring: largest distance of the middle line from a circle, over its radius", 0.01,
            _relative(distance, np.array(radius)), kind="at most", reason="measured 0.5 %"),
    ]  # fmt: skip


def torn(strain: str, stretch: float, steps: int, width: float = 32e-3) -> Scene:
    """Scene of a notched strip, held along both long edges, that should tear at a stretch: see the text.

    In fixed load steps it goes from 0.8 to 1.15 times the displacement of that stretch. ``width`` is in m.
    """
    high, young, nu = 12e-3, 1e6, 0.3
    toughness = 0.5 * young / (1.0 - nu**2) * _elongation(strain, stretch) ** 2 * high
    held = {"times": [0.0], "values": [0.0]}
    pull = {"times": [0.0, 1.0], "values": [share * (stretch - 1.0) * high for share in PULLED]}
    return Scene.from_resolved({
        "geometry": {
            "plate": {"width": width, "height": high, "thickness": 1e-3},
            "cracks": [{"name": "notch", "from": [0.0, 0.5 * high], "to": [14e-3, 0.5 * high]}],
        },
        "mesh": {"spacing": 1e-3},
        "horizon": {"ratio": HORIZON / SPACING},
        "material": {"youngs_modulus": young, "poissons_ratio": nu, "critical_energy_release_rate": toughness},
        "mechanics": {"model": "correspondence", "strain": strain},
        "loads": [
            {"on": "top", "displacement": {"x": held, "y": pull}},
            {"on": "bottom", "displacement": {"x": held, "y": held}},
        ],
        "damage": {"criterion": "energy", "no_fail": ["top", "bottom"]},
        "time": {"end": 1.0},
        "stepping": {"mode": "fixed", "load_steps": steps, "diffusion_substeps": 1},
        "solver": {"tolerance": 1e-6},
        "outputs": {"times": [0.0, 1.0]},
    })  # fmt: skip


def _elongation(strain: str, stretch: float) -> float:
    return 0.5 * (stretch**2 - 1.0) if strain == "finite" else stretch - 1.0


def tears_at(result: xr.Dataset, strain: str, stretch: float, steps: int) -> float:
    """Energy that a strip stores ahead of its crack, over the fracture energy, once that has run for 10 mm.

    In the middle of the load step that makes it run.
    """
    first = int(np.argmax(result["crack_extension"].values > 10e-3))
    when = float(result["history_time"].values[first]) - 0.5 / steps
    here = 1.0 + (PULLED[0] + (PULLED[1] - PULLED[0]) * when) * (stretch - 1.0)
    return (_elongation(strain, here) / _elongation(strain, stretch)) ** 2


def tearing_rows(stretches: tuple[float, ...], steps: int) -> list[Row]:
    """Toughness of strips at small strains and at large ones."""
    found, step = [], 200.0 * (PULLED[1] - PULLED[0]) / steps
    for strain, stretch in (("small", 1.0003), *(("finite", value) for value in stretches)):
        released = tears_at(simulate(case_of(torn(strain, stretch, steps))), strain, stretch, steps)
        found.append(
            Row(f"energy release rate at which a strip tears, {strain} strains, stretch {stretch:g}", 1.0, released,
                0.1, "G_c", reason=f"measured 0.97 to 1.05; a load step is {step:.2g} %")
        )  # fmt: skip
    return found


def run(
    across: tuple[int, ...] = (5, 9, 15),
    ring: bool = True,
    tears: tuple[float, ...] = (1.0003, 1.1, 1.3, 1.6),
    steps: int = 20,
) -> Report:
    """All of the above.

    ``across`` are the numbers of nodes across the strips that are bent, ``tears`` the stretches at which others tear,
    in so many load ``steps``.
    """
    rows = [row for plane in PLACES for row in point_rows(plane)]
    cases = [bent(count) for count in across]
    rows += [row for case in cases for row in elastica_rows(case)]
    if ring:
        rows += ring_rows()
    rows += tearing_rows(tears, steps)
    return Report("large_strains", "Large strains and rotations", TEXT, rows, partial(_draw, cases))


def _draw(cases: list[dict[str, Any]], figure: Figure) -> None:
    shapes, loads = panels(figure, 2)
    for step in cases[-1]["steps"]:
        shapes.plot(*elastica_shape(elastica_at(step["moved"])[0]).T, color="0.3", linewidth=1.0)
        shapes.plot(*step["place"][:: max(len(step["place"]) // 25, 1)].T, MARKERS[0], color=COLOURS[0], markersize=3)
    shapes.set_aspect("equal")
    label(shapes, "x / length", "y / length", "nodes and elastica")
    moved = np.linspace(0.01, max(MOVED), 100)
    loads.plot(moved, [elastica_at(value)[1] for value in moved], color="0.3", linewidth=1.2, label="elastica")
    for k, case in enumerate(cases):
        steps = case["steps"]
        stiffness = steps[0]["load"] / elastica_at(steps[0]["moved"])[1]
        loads.plot(
            [step["moved"] for step in steps], [step["load"] / stiffness for step in steps], MARKERS[k],
            color=COLOURS[k], markersize=4, label=f"{case['rows']} nodes across",
        )  # fmt: skip
    label(loads, "displacement of the end / length", "force L^2 / bending stiffness")
    loads.legend(fontsize=8, frameon=False)
