"""What the groups share: one small scene with every part of the physics, its run, and what every run promises."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr

from pdhe.case import Case, build_case
from pdhe.discretization import Discretization
from pdhe.plan import make_plan
from pdhe.post import energy_balance
from pdhe.scene import Scene
from pdhe.scene_reading import override
from pdhe.simulation import simulate
from pdhe.verification.notched import TOUGHNESS
from pdhe.verification.plates import POISSON, THICKNESS, YOUNG
from pdhe.verification.report import Row
from pdhe.verification.slabs import DIFFUSIVITY, HORIZON_RATIO, nodes_of

SPACING = 1e-3
#: Nodes along the sides of the plate that cases use unless they say otherwise.
COLUMNS = ROWS = 16
#: Coverage may leave the bounds of its data by the round-off of the sums over a family. Measured: 3e-15.
BOUND_SLACK = 1e-12
#: Hydrogen that entered against hydrogen that is there, over the capacity of the plate or what can pass through it.
#: Measured: 2e-14.
HYDROGEN_BALANCE = 1e-11
#: The same with rates in single precision, whose two directions differ by 6e-8 on irregular nodes. Measured: 2e-10.
SINGLE_BALANCE = 1e-6
#: Energy that may appear from nowhere, over the largest energy of the run: the residual of the equilibria.
ENERGY_BALANCE = 1e-5
#: Energy of a motion that is not accounted for, over the largest: the ripple of steps of up to the longest stable one.
#: Measured: 0.2 at most in 700 random scenes, where loads jump and few steps follow; an unstable run has 1e3 and more.
MOTION_BALANCE = 0.5

BASE: dict[str, Any] = {
    "title": "extreme",
    "geometry": {"plate": {"width": COLUMNS * SPACING, "height": ROWS * SPACING, "thickness": THICKNESS}},
    "mesh": {"spacing": SPACING},
    "horizon": {"ratio": HORIZON_RATIO},
    "material": {
        "youngs_modulus": YOUNG,
        "poissons_ratio": POISSON,
        "fracture_toughness": TOUGHNESS,
        "diffusivity": DIFFUSIVITY,
    },
    "time": {"end": 1.0},
    "outputs": {"count": 2},
    "solver": {"tolerance": 1e-5},  # a tenth of the default: bounds are measured with it
}


@dataclass(frozen=True)
class Run:
    """A scene that has run."""

    case: Case
    result: xr.Dataset

    def last(self, name: str) -> Any:
        """Value of a variable at the end: a number of the history, or a field."""
        value = self.result[name].values[-1]
        return value if np.ndim(value) else float(value)


def history(end: float, *values: float) -> dict[str, list[float]]:
    """A resolved history with the given values at equal intervals up to ``end``, s; one value is a constant."""
    times = [0.0] if len(values) == 1 else [end * k / (len(values) - 1) for k in range(len(values))]
    return {"times": times, "values": list(values)}


def pulled(amount: float, end: float = 1.0, *, jump: bool = False, along: str = "y") -> list[dict[str, Any]]:
    """Loads that move two opposite edges apart by ``amount`` each, m, within ``end`` seconds or at once (``jump``)."""
    low, high = {"x": ("left", "right"), "y": ("bottom", "top")}[along]
    return [
        {"on": on, "displacement": {along: history(end, sign * amount) if jump else history(end, 0.0, sign * amount)}}
        for on, sign in ((high, 1.0), (low, -1.0))
    ]


def crack(*ends: tuple[float, float], name: str = "notch") -> dict[str, Any]:
    """A crack between two points given in spacings."""
    start, end = ([SPACING * x for x in point] for point in ends)
    return {"name": name, "from": start, "to": end}


def wet(on: str = "left", coverage: float = 1.0, **options: Any) -> dict[str, Any]:
    """A hydrogen block with one prescribed coverage."""
    return {"boundary": [{"on": on, "coverage": history(1.0, coverage)}], **options}


def scene_of(changes: Mapping[str, Any]) -> Scene:
    """The scene of :data:`BASE` with changes by dotted key, SI."""
    raw = copy.deepcopy(BASE)
    for key, value in changes.items():
        override(raw, key, value, "extreme")
    return Scene.from_resolved(raw, "extreme")


def run(changes: Mapping[str, Any], nodes: Discretization | None = None) -> Run:
    """Run a scene as the command line would: check, mesh, plan, solve.

    Raises
    ------
    SceneError
        If it is refused.
    """
    scene = scene_of(changes)
    case = build_case(scene, _nodes(json.dumps(scene.resolved(), sort_keys=True)) if nodes is None else nodes)
    make_plan(case)
    return Run(case, simulate(case))


@lru_cache(maxsize=64)
def _nodes(scene: str) -> Discretization:
    return nodes_of(Scene.from_resolved(json.loads(scene)))


def promises(done: Run) -> list[Row]:
    """What every run promises, whatever the scene: finite numbers, bounds, balances.

    The energy that leaves a run at a failure is at least that of the bonds which break: a bond that breaks at fixed
    displacements lets the rest of the body relax, and where that energy goes (waves, heat) is not modelled. So work
    minus elastic minus fracture energy is never negative, and zero as long as nothing breaks.
    """
    result, case = done.result, done.case
    rows = [Row("values that are not finite", 0.0, _not_finite(result), kind="absolute")]
    if "coverage" in result:
        low, high = coverage_bounds(case.scene)
        psi = result["coverage"].values
        outside = max(low - float(psi.min()), float(psi.max()) - high)
        rows.append(Row("coverage beyond the bounds of its data", BOUND_SLACK, outside, kind="at most"))
        content = result["hydrogen_content"].values
        # Nodes held from the start are filled before the first entry, and that counts as influx too.
        first = case.scene.hydrogen.initial * _whole_volume(case)
        lost = np.abs(content - first - result["hydrogen_influx"].values).max() / _passing(case)
        allowed = HYDROGEN_BALANCE if case.scene.solver.precision == "double" else SINGLE_BALANCE
        rows.append(Row("hydrogen that is not accounted for", allowed, float(lost), kind="at most"))
    if "damage" in result:
        phi = result["damage"].values
        beyond = max(float(phi.max()) - 1.0, -float(phi.min()), float(-np.diff(phi, axis=0).min(initial=0.0)))
        rows.append(Row("damage beyond 0 to 1 or healed", 1e-12, beyond, kind="at most"))
    if "kinetic_energy" in result:
        error = np.abs(energy_balance(result)["error"]).max() / _largest_energy(result)
        rows.append(Row("energy of the motion that is not accounted for", MOTION_BALANCE, float(error), kind="at most"))
    elif "elastic_energy" in result and case.scene.mechanics.strain == "small":
        # Under large strains the work between two equilibria is known to second order of a load step only.
        rows.append(Row("energy from nowhere", ENERGY_BALANCE, energy_from_nowhere(done), kind="at most"))
    return rows


def _passing(case: Case) -> float:
    """Most hydrogen that can be in the plate or pass through it along its shorter side, m^3."""
    scene = case.scene
    across = min(scene.geometry.width, scene.geometry.height)
    place = case.discretization.coordinates
    regions = scene.hydrogen.regions or ()
    fastest = max([1.0, *(float(np.max(region.over(scene.material.diffusivity, place))) for region in regions)])
    fillings = fastest * scene.material.diffusivity * scene.time.end / across**2
    return _whole_volume(case) * max(1.0, fillings)


def _whole_volume(case: Case) -> float:
    """Volume of the body with its mirror images, which results speak of, m^3."""
    return float(case.discretization.volume.sum()) * 2 ** len(case.scene.geometry.symmetry or ())


def _largest_energy(result: xr.Dataset) -> float:
    """The largest of the energies of a motion, J."""
    return max([float(np.abs(part).max()) for part in energy_balance(result).values()] + [np.finfo(float).tiny])


def coverage_bounds(scene: Scene) -> tuple[float, float]:
    """Least and largest coverage that the data of a scene allow."""
    hydrogen = scene.hydrogen
    values = [hydrogen.initial, *(v for condition in hydrogen.boundary for v in condition.coverage.values)]
    if hydrogen.saturation is not None:
        values.append(hydrogen.saturation.coverage)
    return min(values), max(values)


def energy_from_nowhere(done: Run) -> float:
    """Elastic plus fracture energy beyond the work done, over the largest energy; both ways while nothing broke.

    Of a body that is only moved along, all energy is what the solver leaves: forces of its tolerance times the largest
    there were, along the displacements. Correspondence models promise this only while nothing broke: what a break sets
    free is less than what the bond had (docs/limits.md).
    """
    result, equilibrium = done.result, done.case.equilibrium
    work, elastic = result["external_work"].values, result["elastic_energy"].values
    broken = result["broken_bonds"].values if "broken_bonds" in result else np.zeros(work.size)
    fracture = result["fracture_energy"].values if "fracture_energy" in result else np.zeros(work.size)
    moved = float(np.linalg.norm(result["displacement"].values, axis=(1, 2)).max())
    left = equilibrium.tolerance * equilibrium.reference * moved / ENERGY_BALANCE
    scale = float(max(np.abs(work).max(), elastic.max(), fracture.max(), left))
    gain = elastic + fracture - work
    torn = np.zeros_like(gain) if done.case.scene.mechanics.model == "correspondence" else gain
    gain = np.where(broken > 0.0, torn, np.abs(gain))
    return float(gain.max()) / scale if scale > 0.0 else 0.0


def _not_finite(result: xr.Dataset) -> int:
    """Values that are not finite, but for the place of a tip before anything has broken, which has none."""
    count = 0
    for name, variable in {**result.data_vars, **result.coords}.items():
        if variable.dtype.kind == "f":
            bad = ~np.isfinite(variable.values)
            if str(name).startswith("crack_tip"):
                bad &= result["crack_extension"].values > 0.0
            count += int(bad.sum())
    return count


def failure_stretch(changes: Mapping[str, Any]) -> float:
    """Dry critical stretch of a scene."""
    scene = scene_of(changes)
    return build_case(scene, _nodes(json.dumps(scene.resolved(), sort_keys=True))).rule.critical


def largest_difference(one: np.ndarray, two: np.ndarray) -> float:
    """Largest difference of two arrays over the largest magnitude of the second; infinite for different shapes."""
    one, two = np.asarray(one, float), np.asarray(two, float)
    if one.shape != two.shape:
        return math.inf
    scale = float(np.abs(two).max(initial=0.0))
    difference = float(np.abs(one - two).max(initial=0.0))
    return difference / scale if scale > 0.0 else difference
