"""Extremes of the elastic body: Poisson's ratio, Young's modulus, units, rotations, steps of a motion."""

from __future__ import annotations

import math
from functools import lru_cache, partial
from typing import Any

import numpy as np

from pdhe.extremes.outcome import Extreme
from pdhe.extremes.scenes import (
    BASE,
    HORIZON_RATIO,
    SPACING,
    Run,
    crack,
    history,
    largest_difference,
    promises,
    pulled,
    run,
    wet,
)
from pdhe.materials import Body
from pdhe.stability import NEGATIVE, least_eigenvalue
from pdhe.verification.plates import POISSON, YOUNG, plate_body, pull, rotated_plate, slope, square_plate
from pdhe.verification.report import Row

#: Largest Poisson's ratio at which bodies of any shape were found stable, with a horizon of three spacings.
SAFE_POISSON = 0.45
#: Strain of those cases.
STRAIN = 1e-3
#: Nodes along the side of the plate of the modulus cases.
SIDE = 24
#: Energy that a motion in steps at the limit may be off by, over that of the blow. Measured: 0.21, and 0.17 times the
#: square of the step where that is a tenth.
MOTION_ERROR = 0.3
#: Sides of the body whose stiffness is decomposed, in nodes: 72 degrees of freedom.
SMALL = 6
#: Loads that hold the lower edge and leave the rest free.
HELD_BELOW = [{"on": "bottom", "displacement": {"x": history(1.0, 0.0), "y": history(1.0, 0.0)}}]
#: What keeps a pulled plate from drifting sideways, so that its displacements are unique.
SUPPORT = {"on": "right", "displacement": {"x": history(1.0, 0.0)}}
#: Scene in which everything happens: hydrogen from the left, a notch, a ramp at whose end the crack has grown.
COUPLED: dict[str, Any] = {
    "geometry.plate.width": 16 * SPACING,
    "geometry.plate.height": 8 * SPACING,
    "geometry.cracks": [crack((0.0, 4.0), (5.0, 4.0))],
    "loads": [*pulled(1e-5, 2000.0), SUPPORT],
    "damage": {"criterion": "energy"},
    "hydrogen": wet("notch"),
    "solver": {"tolerance": 1e-12},
    "time": {"end": 3000.0},
}


def pulled_plate(nu: float, model: str = "condensed rotation", side: int = SIDE, **changes: Any) -> Run:
    """A square plate pulled along y, its sides free."""
    size = side * SPACING
    return run(
        {
            "geometry.plate.width": size,
            "geometry.plate.height": size,
            "material.poissons_ratio": nu,
            "mechanics.model": model,
            "loads": pulled(0.5 * STRAIN * size),
            "solver": {"tolerance": 1e-9},
            **changes,
        }
    )


def moduli(done: Run) -> tuple[float, float]:
    """Young's modulus over the one asked for, and Poisson's ratio, in the central half of a plate pulled along y.

    The modulus is that of the stored energy under the strain found there; what the grips do to the force on a plate of
    a few horizons does not enter.
    """
    d, geometry = done.case.discretization, done.case.scene.geometry
    place = d.coordinates / [geometry.width, geometry.height] - 0.5
    central = (np.abs(place) < 0.25).all(axis=1)
    u = np.ascontiguousarray(done.last("displacement"))
    along, across = slope(d.coordinates[central, 1], u[central, 1]), slope(d.coordinates[central, 0], u[central, 0])
    energy = float(done.case.body.energy(u)[central].sum() / d.volume[central].sum())
    young, nu = in_plane(done)
    # Energy of a uniform strain in the plane, whatever the lateral strain came out to be.
    shape = (along**2 + across**2 + 2.0 * nu * along * across) / (1.0 - nu**2)
    return energy / (0.5 * young * shape), -across / along


def in_plane(done: Run) -> tuple[float, float]:
    """Young's modulus, Pa, and Poisson's ratio that a plate has in its plane."""
    given = done.case.scene.material
    young, nu = given.youngs_modulus, given.poissons_ratio
    return (young, nu) if done.case.scene.plane == "stress" else (young / (1.0 - nu**2), nu / (1.0 - nu))


def model_rows(nu: float, model: str, plane: str = "stress") -> list[Row]:
    """Moduli of a pulled plate of any model, and whether its stiffness is positive."""
    done = pulled_plate(nu, model, **{"mechanics.plane": plane})
    modulus, ratio = moduli(done)
    least = least_eigenvalue(done.case.body, ~done.case.conditions.fixed)
    reason = "a plate of eight horizons; grips hold it"
    return [
        *promises(done),
        Row("Young's modulus in the plane over the one asked for", 1.0, modulus, 0.02, reason="central half"),
        Row("Poisson's ratio in the plane", in_plane(done)[1], ratio, 0.05, kind="absolute", reason=reason),
        Row("least over largest eigenvalue of this plate", NEGATIVE, least, kind="at least"),
    ]


def motion(share: float, steps: int = 200) -> Run:
    """A free plate whose upper edge is struck, in steps of so many times the longest that is proved stable."""
    struck = {"material.density": 7800.0, "loads": [{"on": "top", "initial_velocity": {"y": 0.1}}]}
    limit = run(struck | {"stepping": {"mode": "dynamic"}, "time": {"end": 1e-9}}).case.dynamics.limit
    stepping = {"mode": "dynamic", "step": share * limit}
    end = {"time": {"end": share * limit * steps}, "outputs": {"count": 20}}
    return run(struck | {"stepping": stepping} | end)


def motion_rows(share: float) -> list[Row]:
    """Energy of the motion at the outputs: that of the blow, as far as steps of second order keep it."""
    done = motion(share)
    kinetic, elastic = done.result["kinetic_energy"].values, done.result["elastic_energy"].values
    error = float(np.abs(kinetic + elastic - kinetic[0]).max() / kinetic[0])
    return [
        *promises(done),
        Row("energy gained or lost over that of the blow", MOTION_ERROR * share**2, error, kind="at most",
            reason="ripple of second order in the step; growth without bounds beyond the limit"),
    ]  # fmt: skip


def poisson_rows(nu: float, model: str = "condensed rotation") -> list[Row]:
    """Moduli of a pulled plate, and whether the stiffness of a free body is positive."""
    done = pulled_plate(nu, model)
    modulus, ratio = moduli(done)
    rows = [
        *promises(done),
        Row("Young's modulus over the one asked for", 1.0, modulus, 0.02, reason="central half"),
    ]
    if model == "condensed rotation":
        rows += [
            Row("Poisson's ratio", nu, ratio, 0.05, kind="absolute", reason="a plate of eight horizons; grips hold it"),
            Row("rigid motions of a free body", 3, zero_modes(nu, model), kind="absolute"),
        ]
    if nu <= SAFE_POISSON:
        return [*rows, *(lowest_row(nu, model, broken) for broken in (0.0, 0.4))]
    found = least_eigenvalue(done.case.body, ~done.case.conditions.fixed)
    return [*rows, Row("least over largest eigenvalue of this plate", NEGATIVE, found, kind="at least")]


@lru_cache(maxsize=64)
def eigenvalues(nu: float, model: str, broken: float) -> np.ndarray:
    """Eigenvalues of the stiffness of a small free body over the largest, ascending; with a share of bonds broken."""
    plate = square_plate(SMALL, SMALL, SPACING)
    body = plate_body(plate, HORIZON_RATIO * SPACING, nu=nu, model=model)
    if broken:
        once = np.flatnonzero(body.bonds.owners() < body.bonds.neighbours)
        body.break_bonds(np.random.default_rng(0).choice(once, int(broken * once.size), replace=False))
    values = np.linalg.eigvalsh(stiffness(body))
    return values / values[-1]


def stiffness(body: Body) -> np.ndarray:
    """Dense stiffness of a body, N/m (2 n, 2 n), column by column from its forces."""
    n = body.bonds.node_count
    columns = [-body.force(unit.reshape(n, 2)).ravel() for unit in np.eye(2 * n)]
    matrix = np.stack(columns, axis=1)
    return 0.5 * (matrix + matrix.T)


def lowest_row(nu: float, model: str, broken: float) -> Row:
    """The stiffness of a free body has no negative eigenvalue."""
    what = "least over largest eigenvalue of a free body" + (
        f", {100 * broken:g} % of its bonds broken" if broken else ""
    )
    lowest = float(eigenvalues(nu, model, broken)[0])
    return Row(what, -1e-12, lowest, kind="at least", reason="round-off of the three rigid motions")


def zero_modes(nu: float, model: str) -> int:
    """Motions of a free body that take no force."""
    return int(np.sum(np.abs(eigenvalues(nu, model, 0.0)) < 1e-12))


def indefinite_rows() -> list[Row]:
    """Where the thesis' springs lose positive definiteness, from the eigenvalues, and where scenes are refused."""
    low, high = 0.3, 0.36
    for _ in range(30):
        middle = 0.5 * (low + high)
        if eigenvalues(middle, "thesis spring", 0.0)[0] < -1e-12:
            high = middle
        else:
            low = middle
    least = float(eigenvalues(0.4, "thesis spring", 0.0)[0])
    return [
        Row("Poisson's ratio at which an eigenvalue turns negative", 1.0 / 3.0, high, 1e-8, reason="scenes are "
            "refused above 1/3 + 1e-9"),
        Row("least over largest eigenvalue at 0.4", 0.0, least, kind="at most", reason="a rotation releases energy"),
        *promises(pulled_plate(1.0 / 3.0, "thesis spring")),
    ]  # fmt: skip


@lru_cache(maxsize=8)
def _coupled(young: float) -> Run:
    # The same critical stretch and therefore the same history: the fracture energy is in proportion.
    toughness = 2e3 * young / YOUNG
    return run(
        COUPLED
        | {
            "material.youngs_modulus": young,
            "material.fracture_toughness": None,
            "material.critical_energy_release_rate": toughness,
        }
    )


def same_history(one: Run, other: Run, *, time: float = 1.0, length: float = 1.0, force: float = 1.0) -> list[Row]:
    """Whether two runs are the same but for their units; ``other`` times the factors is what ``one`` should be."""
    a, b = one.result, other.result
    reason = "nothing but the units differs"
    rows = [Row("broken bonds", other.last("broken_bonds"), one.last("broken_bonds"), 0.0, reason="as many as before")]
    for name, factor in (("broken_time", time), ("damage", 1.0), ("coverage", 1.0), ("displacement", length)):
        difference = largest_difference(a[name].values, factor * b[name].values)
        rows.append(Row(f"difference of {name}", 1e-10, difference, kind="at most", reason=reason))
    peaks = [np.abs(result["reaction_top_y"].values).max() for result in (a, b)]
    difference = abs(peaks[0] / (force * peaks[1]) - 1.0)
    rows.append(Row("difference of the largest reaction", 1e-10, float(difference), kind="at most", reason=reason))
    return rows


def young_rows(young: float) -> list[Row]:
    """The coupled scene with another Young's modulus: the same but for the forces."""
    done = _coupled(young)
    return [*promises(done), *same_history(done, _coupled(YOUNG), force=young / YOUNG)]


def scaled_rows(length: float = 1.0, time: float = 1.0, mass: float = 1.0) -> list[Row]:
    """The coupled scene in other units: every length, time and mass multiplied."""
    material = BASE["material"]
    stress = mass / (length * time**2)
    young, toughness = material["youngs_modulus"] * stress, 2e3 * mass / time**2
    geometry = {"width": 16 * SPACING * length, "height": 8 * SPACING * length, "thickness": 4e-3 * length}
    notch = {"name": "notch", "from": [0.0, 4 * SPACING * length], "to": [5 * SPACING * length, 4 * SPACING * length]}
    end = COUPLED["time"]["end"] * time
    done = run(
        COUPLED
        | {
            "geometry.plate": geometry,
            "geometry.cracks": [notch],
            "mesh.spacing": SPACING * length,
            "material": {
                "youngs_modulus": young,
                "poissons_ratio": POISSON,
                "critical_energy_release_rate": toughness,
                "diffusivity": material["diffusivity"] * length**2 / time,
            },
            "loads": [*pulled(1e-5 * length, 2000.0 * time), SUPPORT],
            "hydrogen": {"boundary": [{"on": "notch", "coverage": history(time, 1.0)}]},
            "time": {"end": end},
        }
    )
    force = mass * length / time**2
    return [*promises(done), *same_history(done, _coupled(YOUNG), time=time, length=length, force=force)]


def single_rows(young: float) -> list[Row]:
    """The coupled scene with weights and rates in single precision: the same history but for its digits."""
    changes = {"material.fracture_toughness": None, "material.critical_energy_release_rate": 2e3 * young / YOUNG}
    changes |= {"material.youngs_modulus": young, "solver": {"tolerance": 1e-12, "precision": "single"}}
    done, reference = run(COUPLED | changes), _coupled(YOUNG)
    rows = [*promises(done)]
    rows.append(
        Row("bonds broken", reference.last("broken_bonds"), done.last("broken_bonds"), 0.0, reason="as in double")
    )
    for name in ("broken_time", "damage", "coverage"):
        difference = largest_difference(done.result[name].values, reference.result[name].values)
        rows.append(Row(f"difference of {name}", 1e-5, difference, kind="at most", reason="digits of single precision"))
    return rows


def turned_rows(degrees: int) -> list[Row]:
    """The coupled scene turned by a multiple of a right angle: the same, node by node."""
    width, height, turns = 16, 8, degrees // 90
    reference = _coupled(YOUNG)

    def turn(x: np.ndarray, y: np.ndarray) -> tuple[Any, Any]:
        return {1: (height - y, x), 2: (width - x, height - y)}[turns]

    ends = [tuple(map(float, turn(x, 4.0))) for x in (0.0, 5.0)]
    support = {"on": "left", "displacement": SUPPORT["displacement"]}
    if turns == 1:
        support = {"on": "top", "displacement": {"y": SUPPORT["displacement"]["x"]}}
    across, up = (height, width) if turns == 1 else (width, height)
    done = run(
        COUPLED
        | {
            "geometry.plate.width": across * SPACING,
            "geometry.plate.height": up * SPACING,
            "geometry.cracks": [crack(*ends)],
            "loads": [*pulled(1e-5, 2000.0, along="x" if turns == 1 else "y"), support],
            "material.fracture_toughness": None,
            "material.critical_energy_release_rate": 2e3,
        }
    )
    x, y = reference.case.discretization.coordinates.T / SPACING
    there = np.rint(np.column_stack(turn(x, y)) - 0.5).astype(int)
    order = there[:, 1] * across + there[:, 0]
    rows = [*promises(done)]
    for name in ("damage", "coverage"):
        difference = largest_difference(done.last(name)[order], reference.last(name))
        rows.append(Row(f"difference of {name}", 1e-10, difference, kind="at most", reason="mapped node by node"))
    difference = largest_difference(done.result["broken_time"].values, reference.result["broken_time"].values)
    rows.append(Row("difference of broken_time", 1e-10, difference, kind="at most", reason="same bonds, same instants"))
    return rows


def lattice_rows(degrees: float) -> list[Row]:
    """A plate cut from a turned lattice is as stiff as one along the axes, and turning as a whole takes no force."""
    straight, turned = square_plate(30, 30, SPACING), rotated_plate(30, 30, SPACING, degrees)
    forces = []
    for plate in (straight, turned):
        body = plate_body(plate, HORIZON_RATIO * SPACING, partial="ramp")
        forces.append(pull(body, plate)[1])
    angle = math.radians(degrees)
    spin = angle * np.column_stack([-turned.coordinates[:, 1], turned.coordinates[:, 0]])
    force = np.abs(body.force(spin)).max() / np.abs(body.diagonal()).max() / np.abs(spin).max()
    return [
        Row("force on the turned lattice over that on the straight one", 1.0, forces[1] / forces[0], 0.05,
            reason="the edges of the turned one are ragged"),
        Row("largest force of a rigid rotation over stiffness and displacement", 1e-14, float(force), kind="at most",
            reason="round-off"),
    ]  # fmt: skip


def contrast_rows(factor: float) -> list[Row]:
    """A bar whose right half has another Young's modulus: the force of two springs in a row, and where they meet."""
    found = []
    for columns in (20, 40):
        done = contrast_bar([{"on": "far_half", "factor": factor}], columns)
        geometry = done.case.scene.geometry
        force = YOUNG * geometry.height * geometry.thickness * STRAIN / (0.5 * (1.0 + 1.0 / factor))
        x, u = done.case.discretization.coordinates[:, 0], done.last("displacement")[:, 0]
        joint = float(u[np.abs(x - 0.5 * geometry.width) < 0.6 * SPACING].mean()) / (STRAIN * geometry.width)
        found.append((abs(done.last("reaction_right_x") / force - 1.0), abs(joint - 1.0 / (1.0 + 1.0 / factor))))
    (coarse, joint_coarse), (fine, joint_fine) = found
    iterations = done.case.equilibrium.work.equilibrium_iterations
    return [
        *promises(done),
        Row("error of the force, 40 cells", 0.04, fine, kind="at most", reason="springs in a row; a plain bar 2.6 %"),
        Row("error of the force over that of 20 cells", 0.52, fine / coarse, kind="at most", reason="first order"),
        Row("error of the displacement between the halves, 40 cells", 0.03, joint_fine, kind="at most",
            reason="over the elongation; the border is as sharp as the horizon"),
        Row("the same over that of 20 cells", 0.52, joint_fine / joint_coarse, kind="at most", reason="first order"),
        Row("iterations", 120, iterations, kind="at most", reason="of two equilibria; some 40 each at 1e6"),
    ]  # fmt: skip


def contrast_bar(regions: list[dict[str, Any]], columns: int = 20) -> Run:
    """A bar of eight rows pulled along x, with Young's moduli by node set."""
    width, height = columns * SPACING, 8 * SPACING
    return run(
        {
            "geometry.plate.width": width,
            "geometry.plate.height": height,
            "material.poissons_ratio": 0.0,
            "regions": [{"name": "far_half", "from": [0.5 * width, 0.0], "to": [width, height]}],
            "mechanics.regions": regions,
            "loads": [
                {"on": "right", "displacement": {"x": history(1.0, 0.0, STRAIN * width)}},
                {"on": "left", "displacement": {"x": history(1.0, 0.0)}},
            ],
        }
    )


RATIOS = (-0.9, -0.5, 0.0, 0.29, 1 / 3, 0.4, 0.45, 0.49)
CONTRASTS = (1e-6, 1e-3, 1e3, 1e6)
CASES = [
    Extreme("Poisson's ratio", "-0.95", partial(pulled_plate, -0.95), refused="material.poissons_ratio"),
    *(Extreme("Poisson's ratio", f"{nu:.3g}", partial(poisson_rows, nu)) for nu in RATIOS),
    Extreme("Poisson's ratio", "0.5", partial(pulled_plate, 0.5), refused="material.poissons_ratio"),
    *(
        Extreme("indefinite stiffness", text, partial(pulled_plate, nu, **changes), refused="material.poissons_ratio")
        for text, nu, changes in (
            ("0.47, no weights", 0.47, {"side": 12, "horizon.ratio": 2.2, "mechanics.weights": "none"}),
            ("0.49, 6 x 6 nodes", 0.49, {"side": 6, "loads": HELD_BELOW}),
            ("0.499", 0.499, {"loads": HELD_BELOW}),
        )
    ),
    *(
        Extreme("Poisson's ratio, thesis spring", f"{nu:g}", partial(poisson_rows, nu, "thesis spring"))
        for nu in (-0.9, 0.0, 0.29)
    ),
    Extreme("Poisson's ratio, thesis spring", "1/3", indefinite_rows),
    *(
        Extreme(
            "Poisson's ratio, thesis spring", f"{nu:g}", partial(pulled_plate, nu, "thesis spring"),
            refused="material.poissons_ratio",
        )
        for nu in (0.334, 0.4, 0.49)
    ),
    *(
        Extreme(
            f"Poisson's ratio, {model}", f"{'' if plane == 'stress' else 'plane strain, '}{nu:g}",
            partial(model_rows, nu, model, plane),
        )
        for model in ("state-based", "correspondence")
        for plane in ("stress", "strain")
        for nu in (-0.9, 0.0, 0.29, 0.49)
    ),
    *(
        Extreme("Poisson's ratio, plane strain", f"{nu:g}", partial(model_rows, nu, "condensed rotation", "strain"))
        for nu in (-0.9, 0.0, 0.29, 0.32)
    ),
    *(
        Extreme(
            "Poisson's ratio, plane strain", f"{nu:g}", partial(pulled_plate, nu, **{"mechanics.plane": "strain"}),
            refused="material.poissons_ratio",
        )
        for nu in (0.4, 0.49)
    ),
    Extreme(
        "Poisson's ratio, one-parameter", "0.29", partial(pulled_plate, 0.29, "one-parameter"),
        refused="material.poissons_ratio",
    ),
    Extreme("Poisson's ratio, one-parameter", "1/3", partial(model_rows, 1 / 3, "one-parameter")),
    Extreme(
        "Young's modulus", "0.5 Pa", partial(pulled_plate, 0.29, **{"material.youngs_modulus": 0.5}),
        refused="material.youngs_modulus",
    ),
    *(
        Extreme("Young's modulus", f"{young:.0e} Pa", partial(young_rows, young))
        for young in (1e3, 1e5, 1e7, 1e9, 1e11, 1e13)
    ),
    *(Extreme("contrast of Young's moduli", f"{factor:g}", partial(contrast_rows, factor)) for factor in CONTRASTS),
    Extreme(
        "contrast of Young's moduli", "1e8",
        partial(contrast_bar, [{"on": "left", "factor": 1e-4}, {"on": "far_half", "factor": 1e4}]),
        refused="mechanics.regions",
    ),
    *(
        Extreme("scaled units", text, partial(scaled_rows, **factors))
        for text, factors in {
            "length 1e-6": {"length": 1e-6, "mass": 1e-6},
            "length 1e-3": {"length": 1e-3},
            "length 1e4": {"length": 1e4, "mass": 1e4},
            "time 1e-9": {"time": 1e-9, "mass": 1e-18},
            "time 1e9": {"time": 1e9, "mass": 1e18},
            "mass 1e-9": {"mass": 1e-9},
            "mass 1e12": {"mass": 1e12},
            "all": {"length": 1e-3, "time": 1e6, "mass": 1e9},
        }.items()
    ),
    *(
        Extreme("single precision", f"{young:.0e} Pa", partial(single_rows, young), quick=False)
        for young in (1e3, 1e11, 1e13)
    ),
    Extreme("rotation", "30°", partial(lattice_rows, 30.0)),
    Extreme("rotation", "90°", partial(turned_rows, 90)),
    Extreme("rotation", "180°", partial(turned_rows, 180)),
    *(
        Extreme("time step over the stable limit, motions", f"{share:g}", partial(motion_rows, share))
        for share in (0.1, 0.98)
    ),
    *(
        Extreme(
            "time step over the stable limit, motions", f"{share:g}", partial(motion, share), refused="stepping.step"
        )
        for share in (1.02, 10.0, 1e3, 1e6)
    ),
]  # fmt: skip
