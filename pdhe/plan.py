"""The plan: what a scene switches on, why, and what it will take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdhe.blocks import node_values
from pdhe.bonds import Families
from pdhe.case import Case
from pdhe.damage import CRITERIA, Candidates, nearest_failure, stretch_squares
from pdhe.errors import SceneError, SimulationError
from pdhe.forecast import Forecast, Pilot, make_forecast, motion_steps
from pdhe.histories import corners_between, describe
from pdhe.scene_blocks import Hydrogen
from pdhe.scene_mirrors import whole_length
from pdhe.solvers import Equilibrium
from pdhe.supersteps import implicit_from
from pdhe.transport import STEP_SAFETY, DiffusionStep

#: Horizons that a pre-crack should be long, and spacings that hydrogen should reach, for either to be resolved.
SHORT_CRACK, SHARP_FRONT = 3.0, 3.0
#: Times 2 sqrt(D t) that hydrogen does not get: coverage there is erfc(2), half a per cent of that at a plane edge.
TOO_FAR = 2.0
#: A pilot, or an elastic equilibrium, that met less than this share of what breaks a bond says that the run will break
#: none either.
FAR_FROM_FAILURE = 0.8
#: Tolerance of such an equilibrium, and the most iterations that it may take.
ROUGHLY, FEW = 1e-3, 100
#: Share of what is prescribed below which the rest is round-off of what has been solved for.
SAME_LOAD = 1e-9


def make_plan(case: Case, pilot: Pilot | None = None, expected: Forecast | None = None) -> str:
    """Describe a case before it runs: physics and reasons, sizes, limits and steps, expected cost, warnings.

    ``pilot`` is a run on a coarser mesh (:func:`pdhe.simulation.fly_pilot`); without it, work is not foretold.
    ``expected`` is the forecast that goes with it, for those who have it; it takes some sweeps to make.

    Raises
    ------
    SceneError
        If fixed stepping asks for diffusion steps beyond the explicit limit.
    """
    scene, d = case.scene, case.discretization
    lines = [
        f"scene: {scene.title}",
        *_symmetry(case),
        f"nodes: {d.volume.size}, {_lengths(case)}, "
        f"bonds: {case.bonds.length.size // 2}, bond memory {bond_bytes(case) / 1e6:.1f} MB",
        _fields(case),
        _mechanics(case),
        *([] if case.history is None else [describe(scene, case.history)]),
        _damage(case),
        _hydrogen(case),
        f"time: 0 to {scene.time.end:.6g} s, {len(scene.outputs.times)} outputs, stepping: {_stepping(case)}",
    ]
    lines += _cost(expected or make_forecast(case, pilot), pilot)
    lines += [f"warning: {text}" for text in warnings(case, pilot)]
    return "\n".join(lines)


def _cost(expected: Forecast, pilot: Pilot | None) -> list[str]:
    lines = [f"expected memory: {expected.memory / 1e6:.0f} MB at the peak of the process"]
    if pilot is not None:
        parts = [
            f"{count:.0f} {name}"
            for name, count in (
                ("force sweeps", expected.force_sweeps), ("diffusion sweeps", expected.diffusion_sweeps),
                ("rounds of failures", expected.failure_rounds),
            )
            if count is not None
        ]  # fmt: skip
        lines.append(f"expected work: {', '.join(parts)}, scaled up from a pilot on {pilot.nodes} nodes")
    if expected.force_sweeps is not None and pilot is None:
        lines.append(
            f"expected work: {expected.force_sweeps:.0f} force sweeps, one more for each step that breaks bonds"
        )
    return lines


def warnings(case: Case, pilot: Pilot | None = None) -> list[str]:
    """What in a scene is likely not meant: cracks and fronts not resolved, loads and hydrogen without effect."""
    scene, found = case.scene, []
    horizon = case.bonds.horizon
    for crack in scene.geometry.cracks:
        if case.bonds.horizons is not None:
            horizon = float(case.bonds.horizons[case.discretization.node_sets[crack.name]].min())
        length = whole_length(scene.geometry, crack)
        if case.body is not None and length < SHORT_CRACK * horizon:
            found.append(
                f"crack '{crack.name}' is {length / horizon:.2g} horizons long, too short for its tips not to "
                "feel each other's nonlocality: make `mesh.spacing` finer"
            )
        elif case.body is not None and scene.hydrogen is not None and scene.hydrogen.saturation is not None:
            threshold = scene.hydrogen.saturation.damage
            damage = float(np.median(case.body.damage()[case.discretization.node_sets[crack.name]]))
            if damage <= threshold:
                found.append(
                    f"faces like those of crack '{crack.name}' stay unsaturated: nodes there have a damage of "
                    f"{damage:.3g} (median), which is not above `hydrogen.saturation.damage`, {threshold:g}: "
                    "lower that, or take another horizon"
                )
    if case.rule is not None and not case.rule.load.by_energy and scene.mechanics.model == "correspondence":
        found.append(
            "under `damage.criterion: stretch` cracks in a correspondence model take twice the energy they should: "
            "use `energy`"
        )
    if case.history is not None and (missed := corners_between(case.conditions.corners, scene)):
        listed = ", ".join(f"{t:.6g}" for t in missed[:5])
        found.append(
            f"loads turn between two load steps, at {listed} s, and the history goes straight on past it: take a "
            "`stepping.load_steps` that has steps there"
        )
    reach = 0.0 if scene.hydrogen is None else _reach(case)
    if scene.hydrogen is not None and reach < SHARP_FRONT * (wide := _spacing_at_sources(case)):
        found.append(
            f"hydrogen gets {reach:.3g} m far by the end (2 sqrt(D t)), {reach / wide:.2g} spacings: "
            + ("nothing arrives" if reach < wide else "its front is not resolved")
            + "; make `time.end` longer or `mesh.spacing` finer"
        )
    outlook = look_ahead(case)
    if pilot is not None and pilot.largest_load is not None:
        largest, where = pilot.largest_load, f"in a pilot on {pilot.nodes} nodes: loads reach"
    else:
        largest, where = outlook and outlook.largest, "in elastic equilibrium: loads reach"
        where += "" if scene.hydrogen is None else ", with hydrogen everywhere,"
    if outlook is not None and outlook.distance > TOO_FAR * reach:
        found.append(
            f"hydrogen does not arrive: it gets {reach:.3g} m far by the end (2 sqrt(D t)), and bonds that it can break"
            f" begin {outlook.distance:.3g} m from where it enters; without it loads reach "
            f"{100.0 * outlook.at_start:.3g} % of what breaks a bond: make `time.end` longer"
        )
    elif largest is not None and largest < FAR_FROM_FAILURE:
        found.append(
            f"nothing breaks {where} {100.0 * largest:.3g} % of what breaks a bond; "
            "without a `damage` block the run is cheaper"
        )
    return found


def _reach(case: Case) -> float:
    """How far hydrogen gets by the end, 2 sqrt(D t), m, where it is fastest."""
    d, diffusivity, hydrogen = case.discretization, case.scene.material.diffusivity, case.scene.hydrogen
    relative = node_values(d.coordinates, d.node_sets, hydrogen.regions or (), diffusivity, "hydrogen.regions")
    return 2.0 * float(np.sqrt(float(relative.max()) * diffusivity * case.scene.time.end))


def _spacing_at_sources(case: Case) -> float:
    """The widest of the spacings where hydrogen enters, m; the usual one of the plate where it enters nowhere."""
    d = case.discretization
    return max(
        (float(np.median(d.spacing[d.node_sets[item.on]])) for item in case.scene.hydrogen.boundary),
        default=float(np.median(d.spacing)),
    )


@dataclass(frozen=True)
class Outlook:
    """What can break, from elastic equilibria.

    Attributes
    ----------
    largest, at_start
        Largest load over resistance that any bond can come to before one breaks, with as much hydrogen everywhere as
        there can be anywhere, and with what there is at the start.
    distance
        From where hydrogen enters to the nearest bond that only hydrogen can break, m; zero where there is none.
    """

    largest: float
    at_start: float
    distance: float


def look_ahead(case: Case) -> Outlook | None:
    """Tell what can break.

    As long as nothing does, displacements are linear in what is prescribed, so that one equilibrium for each of its
    independent parts gives them all, and loads are largest at the corners of the histories (but for the exceptions of
    :class:`pdhe.damage.Candidates`). Solvers of the run are left alone. None without damage, with inertia, where bodies
    are not linear, and where an equilibrium is not found soon.
    """
    if case.rule is None or not isinstance(case.equilibrium, Equilibrium):
        return None
    d, conditions, end = case.discretization, case.conditions, case.scene.time.end
    solver = Equilibrium(case.body, conditions.fixed, d.coordinates, d.spacing, ROUGHLY, FEW)
    hydrogen, dense, initial = case.scene.hydrogen, None, None
    if hydrogen is not None:
        dense, initial = (np.full(d.volume.size, value) for value in (_densest(hydrogen), hydrogen.initial))
    parts: list[tuple[np.ndarray, np.ndarray]] = []
    largest = at_start = 0.0
    weak = np.zeros(d.volume.size, bool)
    for t in sorted({0.0, end, *(t for t in conditions.corners if 0.0 < t < end)}):
        rest, u = conditions.values(t), np.zeros(d.coordinates.shape)
        size = float(np.linalg.norm(rest))
        for direction, response in parts:
            share = float(np.vdot(direction, rest))
            rest -= share * direction
            u += share * response
        left = float(np.linalg.norm(rest))
        if left > SAME_LOAD * size:
            try:
                response = solver.solve(np.zeros_like(u), rest / left)[0]
            except SimulationError:
                return None
            parts.append((rest / left, response))
            u += left * response
        largest = max(largest, nearest_failure(case.body, case.rule, u, dense))
        if hydrogen is not None and largest >= 1.0:
            at_start = max(at_start, nearest_failure(case.body, case.rule, u, initial))
            critical = Candidates(case.body, case.rule, u, u, dense)
            weak[critical.i] = weak[critical.j] = True
    distance = 0.0
    if weak.any() and at_start < 1.0 and (sources := _sources(case)).any():
        from scipy.spatial import cKDTree

        distance = float(cKDTree(d.coordinates[sources]).query(d.coordinates[weak])[0].min())
    return Outlook(largest, at_start, distance)


def _sources(case: Case) -> np.ndarray:
    """Nodes where hydrogen enters from the start, bool (n,): at prescribed sets, and at faces that are saturated."""
    d, hydrogen = case.discretization, case.scene.hydrogen
    found = np.zeros(d.volume.size, bool)
    for item in hydrogen.boundary:
        found[d.node_sets[item.on]] |= max(item.coverage.values) > hydrogen.initial
    return found if hydrogen.saturation is None else found | (case.body.damage() > hydrogen.saturation.damage)


def _densest(hydrogen: Hydrogen) -> float:
    """Largest coverage that the data of a scene allow."""
    saturation = [] if hydrogen.saturation is None else [hydrogen.saturation.coverage]
    return max([hydrogen.initial, *saturation, *(v for item in hydrogen.boundary for v in item.coverage.values)])


def _symmetry(case: Case) -> list[str]:
    mirrors = case.scene.geometry.symmetry
    if not mirrors:
        return []
    part = "a half of the body, mirrored at its" if len(mirrors) == 1 else "a quarter of the body, mirrored at its"
    edges = f"{mirrors[0]} edge" if len(mirrors) == 1 else f"{mirrors[0]} and {mirrors[1]} edges"
    return [f"symmetry: the plate is {part} {edges}; energies, contents, counts and forces are those of the whole"]


def _lengths(case: Case) -> str:
    local = case.bonds.horizons
    if local is None:
        return f"spacing {np.median(case.discretization.spacing):.6g} m, horizon {case.bonds.horizon:.6g} m"
    ratio = case.scene.horizon.ratio
    return (
        f"graded spacing {local.min() / ratio:.6g} to {local.max() / ratio:.6g} m, "
        f"horizon {local.min():.6g} to {local.max():.6g} m"
    )


def bond_bytes(case: Case) -> int:
    """Memory of everything that is stored bond by bond."""
    return sum(_by_bond(case).values())


def _by_bond(case: Case) -> dict[str, int]:
    """Bytes of what a run stores bond by bond, by name; on a lattice some of it a second time, by offset."""
    sizes = _of_families(case.bonds)
    for name in ("reverse", "nx", "ny", "nz", "weight", "cut", "fineness"):
        sizes[name] = getattr(getattr(case.bonds, name, None), "nbytes", 0)
    if case.body is not None:
        sizes |= case.body.stored_by_bond()
    if case.diffusion is not None:
        sizes |= case.diffusion.stored_by_bond()
        if case.diffusion.bonds is not case.bonds:
            sizes |= {f"{name} of diffusion": size for name, size in _of_families(case.diffusion.bonds).items()}
    if case.rule is not None:
        sizes["may fail"] = case.rule.may_fail.nbytes
        sizes["critical"] = sum(values.nbytes for values in case.rule.squares if values is not case.bonds.fineness)
    return {name: size for name, size in sizes.items() if size}


def _of_families(bonds: Families) -> dict[str, int]:
    sizes = {"neighbours": bonds.neighbours.nbytes, "length": bonds.length.nbytes}
    return sizes if bonds.lattice is None else sizes | {"offset": bonds.lattice.offset.nbytes}


def _fields(case: Case) -> str:
    """Names of the fields that the run carries along; of absent physics there are none."""
    blocks = (("displacement", case.body), ("velocity", case.dynamics), ("damage", case.rule))
    by_node = [name for name, on in (*blocks, ("coverage", case.diffusion)) if on is not None]
    return f"fields: {', '.join(by_node)} by node; {', '.join(_by_bond(case))} by bond"


def _mechanics(case: Case) -> str:
    if case.body is None:
        return "mechanics: off (the scene has no loads)"
    cut = int(case.bonds.cut.sum()) // 2
    if case.dynamics is not None:
        how = f"with inertia, density {case.scene.material.density:g} kg/m^3"
    elif case.history is not None:
        how = f"increments by Newton's method to {case.equilibrium.tolerance:g}"
    elif not case.linear:
        how = (
            f"large strains (Saint Venant-Kirchhoff), equilibrium by Newton's method to {case.equilibrium.tolerance:g}"
        )
    else:
        how = f"equilibrium by conjugate gradients to {case.equilibrium.tolerance:g}"
    where = f"plane {case.scene.plane}" if case.scene.plane else "in space"
    return (
        f"mechanics: on (the scene has loads), {case.scene.mechanics.model}, {where}, "
        f"weights {case.scene.mechanics.weights}, {cut} bonds cut by pre-cracks, {how}"
        + (", weights in single precision" if case.body.cubed.dtype == np.float32 else "")
        + _stiffness(case.body.relative)
    )


def _stiffness(relative: np.ndarray | None) -> str:
    if relative is None:
        return ""
    return f"; Young's modulus {relative.min():.4g} to {relative.max():.4g} times that of the material"


def _damage(case: Case) -> str:
    if case.rule is None:
        return "damage: off (the scene has no damage block): no bond bookkeeping"
    rule = case.rule
    return (
        f"damage: on (the scene has a damage block), criterion {case.scene.damage.criterion}, "
        f"critical stretch {rule.critical:.6g} dry, "
        f"{rule.weakest:.6g} saturated"
        + (", of bonds as long as the horizon" if CRITERIA[case.scene.damage.criterion].equal_energy else "")
        + ("" if case.bonds.fineness is None else ", at the largest horizon")
        + ("" if rule.load.tension_only else ", under compression too")
        + (
            ""
            if rule.load.split is None
            else ", dilatational energy {:.4g} times, deviatoric {:.4g} times".format(*rule.load.split)
        )
        + _varied(case)
    )


def _varied(case: Case) -> str:
    """By how much the fracture energy differs from bond to bond, where it does."""
    settings = case.scene.damage
    if not (settings.regions or settings.interfaces):
        return ""
    ratio, alike = case.rule.factor() ** 2, stretch_squares(case.bonds, CRITERIA[settings.criterion])
    if alike is not None:
        ratio = ratio / alike
    if case.body.relative is not None:
        ratio = ratio * case.body.relative
    return f"; fracture energy {ratio.min():.4g} to {ratio.max():.4g} times that of the material"


def _hydrogen(case: Case) -> str:
    if case.diffusion is None:
        return "hydrogen: off (the scene has no hydrogen block): no coverage arrays"
    limit = case.diffusion.stable_step(np.zeros(case.discretization.volume.size, bool))
    stepping = case.scene.stepping
    if stepping.mode == "fixed":
        step = case.scene.time.end / (stepping.load_steps * stepping.diffusion_substeps)
        if step > limit > 0.0:
            least = int(np.ceil(case.scene.time.end / (stepping.load_steps * limit)))
            raise SceneError(
                "scene", "stepping.diffusion_substeps", stepping.diffusion_substeps,
                f"gives diffusion steps of {step:.4g} s, beyond the explicit limit of {limit:.4g} s",
                f"use at least {least}",
            )  # fmt: skip
    else:
        step = STEP_SAFETY * limit
    count = DiffusionStep.sweeps * case.scene.time.end / step if np.isfinite(step) and step > 0.0 else 0
    text = (
        f"hydrogen: on (the scene has a hydrogen block), explicit steps of at most {step:.4g} s (limit {limit:.4g} s), "
    )
    if stepping.mode == "fixed":
        return f"{text}at least {count:.0f} sweeps"
    return (
        f"{text}{count:.0f} sweeps for the whole time; fewer except just after failures: steps of many stages, "
        f"implicit ones where accuracy allows more than about {implicit_from(limit):.3g} s"
    )


def _stepping(case: Case) -> str:
    stepping = case.scene.stepping
    if stepping.mode == "fixed":
        return f"fixed, {stepping.load_steps} load steps with {stepping.diffusion_substeps} diffusion sub-steps"
    if stepping.mode == "dynamic":
        limit, damping = case.dynamics.limit, f", damping {stepping.damping:g} s^-1" if stepping.damping else ""
        wanted = stepping.step or stepping.safety * limit
        return (
            f"velocity Verlet, steps of at most {wanted:.4g} s (proved stable up to {limit:.4g} s), "
            f"{motion_steps(case)} steps{damping}"
        )
    if case.rule is None:
        return "to the next output or load corner; nothing can break"
    return f"to the next failure, output or load corner; failures within {stepping.grouping:g} of the worst together"
