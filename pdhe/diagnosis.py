"""A run explained: what broke or how far from it everything is, where energy and hydrogen went, what it took."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from pdhe.case import Case, build_case
from pdhe.discretization import Discretization
from pdhe.errors import PdheError
from pdhe.post import energy_balance, scene_of, summary, time_label
from pdhe.results import open_result
from pdhe.scene import Scene

#: Relative difference below which the rebuilt damage is that of the result: it is stored in single precision.
SAME_DAMAGE = 1e-6
#: Relative error of a balance above which it is called open. Runs of the verification stay below 1e-9.
OPEN = 1e-6
#: The same with inertia, where it swings with the square of the step (measured 1e-4 to 5e-3 at a safety of 0.8).
OPEN_MOTION = 0.02


def diagnose(path: str | Path) -> str:
    """Explain a result in words and numbers.

    Parameters
    ----------
    path
        Result file. The bonds are built again from the scene and the nodes that it holds, broken ones broken, so that
        the bond nearest to failure can be named.

    Raises
    ------
    PdheError
        If the file is not a result.
    """
    with open_result(path) as opened:
        result = opened.load()
    lines = [f"{result.attrs.get('title', path)}: {result.attrs.get('status', 'no status')}"]
    case, problem = None, ""
    if "displacement" in result:
        try:
            case = rebuild(result)
        except (PdheError, KeyError, ValueError) as error:
            problem = f"the bonds at the end cannot be built again: {error}"
    for heading, section in (
        ("run", _run(result)),
        ("failure", _failure(result, case, problem)),
        ("energy", _energy(result, case)),
        ("hydrogen", _hydrogen(result)),
        ("work", _work(result)),
        ("made by", _origin(result)),
    ):
        told = list(section)
        if told:
            lines += [f"{heading}:", *(f"  {line}" for line in told)]
    return "\n".join(lines)


@dataclass(frozen=True)
class Nearest:
    """The bond that is nearest to failure at the last output.

    Attributes
    ----------
    i, j
        Its nodes.
    middle
        Their middle, m (2,).
    load, dry, resistance, ratio
        Load, resistance without hydrogen and at its coverage, as stretches, and load over resistance.
    coverage
        Mean of its ends; None without hydrogen.
    needed
        Coverage of this bond at which it would break as it is; None without hydrogen, or if no coverage is enough.
    highest
        Largest load of any bond over the least resistance that hydrogen could leave.
    """

    i: int
    j: int
    middle: np.ndarray
    load: float
    dry: float
    resistance: float
    ratio: float
    coverage: float | None
    needed: float | None
    highest: float


def nearest_to_failure(result: xr.Dataset, case: Case) -> Nearest | None:
    """Find the bond nearest to failure at the last output of a result, given its case (:func:`rebuild`).

    Returns None where no bond that may break is loaded.
    """
    body, rule = case.body, case.rule
    may = rule.may_fail & body.intact
    load = np.where(may, body.bond_loads(result["displacement"].values[-1], rule.load), 0.0)
    owner, neighbour = case.bonds.owners(), case.bonds.far()
    psi = None
    if "coverage" in result:
        coverage = result["coverage"].values[-1].astype(float)
        psi = 0.5 * (coverage[owner] + coverage[neighbour])
    every = np.arange(load.size)
    ratio = load / rule.resistance_at(psi, every)
    k = int(ratio.argmax())
    if ratio[k] <= 0.0:
        return None
    i, j = int(owner[k]), int(neighbour[k])
    needed = None
    if psi is not None and load[k] >= np.ravel(rule.weakest_of(every[k : k + 1]))[0]:
        low, needed = 0.0, 1.0
        for _ in range(50):
            half = 0.5 * (low + needed)
            enough = float(rule.resistance_at(np.array([half]), every[k : k + 1])[0]) <= load[k]
            low, needed = (low, half) if enough else (half, needed)
    return Nearest(
        i,
        j,
        case.bonds.middles(case.discretization.coordinates, owner[k : k + 1], every[k : k + 1])[0],
        float(load[k]),
        float(np.ravel(rule.resistance_at(None, every[k : k + 1]))[0]),
        float(load[k] / ratio[k]),
        float(ratio[k]),
        None if psi is None else float(psi[k]),
        needed,
        float((load / rule.weakest_of(every)).max()),
    )


def rebuild(result: xr.Dataset) -> Case:
    """Build the case of a result as it stood at its last output: its bonds, the broken ones broken.

    Raises
    ------
    PdheError
        If the bonds do not have the damage that the result holds: other code has made it.
    """
    scene = Scene.from_resolved(scene_of(result))
    if scene.material.umat is not None:
        raise PdheError("its stresses follow from the history of a user material, which is not run again")
    case = build_case(scene, _discretization(result, scene))
    if case.body is None:
        return case
    if "broken_i" in result:
        seen = result["broken_time"].values <= result["time"].values[-1]
        i, j = result["broken_i"].values[seen], result["broken_j"].values[seen]
        bonds = case.bonds
        nodes = case.copies * bonds.node_count
        key = bonds.owners().astype(np.int64) * nodes + bonds.numbered()
        wanted = i.astype(np.int64) * nodes + j
        place = np.minimum(np.searchsorted(key, wanted), key.size - 1)
        if (key[place] != wanted).any():
            raise PdheError("the bonds that broke are not among those of this code")
        case.body.break_bonds(place)
    if "damage" in result:
        difference = np.abs(case.body.damage() - result["damage"].values[-1]).max()
        if difference > SAME_DAMAGE:
            raise PdheError(f"the damage of its bonds differs by {difference:.2g} from what it holds")
    return case


def _discretization(result: xr.Dataset, scene: Scene) -> Discretization:
    """Return the nodes of a result."""
    vertices, cells = result["vertices"].values, result["cells"].values
    thickness = scene.geometry.thickness
    solid = scene.mesh.solid
    spacing = np.cbrt(result["volume"].values) if solid else np.sqrt(result["volume"].values / thickness)
    extent = np.ptp(vertices[cells], axis=1)
    # As discretize finds it: equal squares, or cubes, along the axes.
    regular = cells.shape[1] == (8 if solid else 4) and bool((np.abs(extent - spacing[0]) <= 1e-6 * spacing[0]).all())
    sets = {name: np.array(nodes, np.int32) for name, nodes in json.loads(result.attrs["node_sets"]).items()}
    sets["all"] = np.arange(spacing.size, dtype=np.int32)
    names = ("node_x", "node_y", "node_z") if solid else ("node_x", "node_y")
    coordinates = np.column_stack([result[name].values for name in names])
    return Discretization(coordinates, result["volume"].values, spacing, vertices, cells, sets, regular, thickness)


def _run(result: xr.Dataset) -> Iterator[str]:
    times = result["time"].values
    span = float(times[-1])
    yield f"{result.sizes['node']} nodes, from 0 to {time_label(span, span)} ({span:.6g} s), {times.size} outputs"
    if "history_time" not in result:
        return
    at = result["history_time"].values
    failed = np.zeros(at.size, bool)
    if "broken_bonds" in result:
        failed = np.diff(result["broken_bonds"].values, prepend=0.0) > 0
    if "time_steps" in result:
        yield f"{at.size} history entries, {int(failed.sum())} of them after failures since the one before"
        return
    output = np.isin(at, times) & ~failed
    other = at.size - int(failed.sum()) - int(output.sum())
    yield (
        f"{at.size} history entries: {int(failed.sum())} ended by failures, {int(output.sum())} by an output, "
        f"{other} by a {'load step' if 'plastic_dissipation' in result else 'corner of the loads'}"
    )
    if span > 0.0 and scene_of(result)["time"]["end"] > span * (1.0 + 1e-9):
        yield f"it stops before the end that the scene asks for ({scene_of(result)['time']['end']:.6g} s)"


def _failure(result: xr.Dataset, case: Case | None, problem: str) -> Iterator[str]:
    if "damage" not in result:
        yield "bonds cannot break: the scene has no block `damage`"
        return
    span = float(result["time"].values[-1])
    broken = result["broken_bonds"].values
    numbers = summary(result)
    if broken[-1] > 0:
        first, last = float(result["broken_time"].values.min()), float(result["broken_time"].values.max())
        yield (
            f"{int(broken[-1])} bonds broke between {time_label(first, span)} and {time_label(last, span)} "
            f"({first:.6g} to {last:.6g} s)"
            + ("" if "time_steps" in result else f", in {int(result['failure_rounds'].values[-1])} rounds")
        )
        if scene_of(result).get("geometry", {}).get("cracks"):
            tip = tuple(1e3 * numbers[f"crack_tip_{axis}"] for axis in "xyz" if f"crack_tip_{axis}" in numbers)
            where = f", to ({', '.join(f'{place:.4g}' for place in tip)}) mm" if tip else ""
            yield f"the crack grew by {1e3 * numbers['crack_extension']:.4g} mm{where}"
    else:
        yield "nothing broke"
        highest = result["largest_load"].values
        when = float(result["history_time"].values[int(highest.argmax())])
        yield f"the largest load came to {highest.max():.4g} of the resistance, at {time_label(when, span)}"
    if case is None:
        yield problem
        return
    near = nearest_to_failure(result, case)
    if near is None:
        yield "at the last output no bond that may break is loaded"
        return
    yield f"at the last output the bond nearest to failure carries {near.ratio:.4g} of its resistance:"
    yield f"  nodes {near.i} and {near.j}, about ({', '.join(f'{1e3 * place:.4g}' for place in near.middle)}) mm"
    law = "stretch of the same energy" if case.rule.load.by_energy else "stretch"
    yield f"  {law} {near.load:.4g}, critical {near.dry:.4g} dry" + (
        f", {near.resistance:.4g} at its coverage of {near.coverage:.4g}" if near.coverage is not None else ""
    )
    yield f"  it breaks at {1.0 / near.ratio:.4g} times the load" + (
        f", or as it is at a coverage of {near.needed:.4g}" if near.needed is not None else ""
    )
    if near.coverage is not None and near.highest < 1.0:
        yield f"  hydrogen alone breaks no bond: the largest load is {near.highest:.4g} of what full coverage leaves"


def _energy(result: xr.Dataset, case: Case | None) -> Iterator[str]:
    if "external_work" not in result:
        return
    balance = {name: float(values[-1]) for name, values in energy_balance(result).items()}
    work = float(result["external_work"].values[-1])
    yield f"work of the prescribed displacements {work:.6g} J, elastic energy at the end {balance['elastic']:.6g} J"
    scale = max(abs(work), abs(balance["elastic"]), 1e-300)
    if "kinetic" in balance:
        yield from _energy_of_motion(result, balance)
        return
    if "plastic" in balance:
        yield (
            f"the user material tells of {balance['plastic']:.6g} J of plastic and {balance['creep']:.6g} J of creep "
            f"dissipation; {balance['error'] / scale:.2g} of the work is left over: by the length of the load steps, "
            "unless it does not keep SSE and SPD"
        )
        return
    if "damage" in result and result["broken_bonds"].values[-1] > 0:
        yield (
            f"dissipated {balance['dissipated']:.6g} J: {balance['fracture']:.6g} J held by bonds as they broke, "
            f"{balance['relaxation']:.6g} J lost as the body fell into new equilibria"
        )
        if balance["relaxation"] < -OPEN * scale:
            yield f"the balance is open: {-balance['relaxation'] / scale:.2g} of the work came from nowhere"
    elif scene_of(result).get("mechanics", {}).get("strain") == "finite":
        error = abs(work - balance["elastic"]) / scale
        yield f"work and elastic energy differ by {error:.2g} of the work: by the length of the load steps"
    else:
        yield _balance(abs(work - balance["elastic"]) / scale, "work")
    if case is not None and case.equilibrium is not None:
        force = case.body.force(result["displacement"].values[-1])
        free, held = force[~case.conditions.fixed], force[case.conditions.fixed]
        left = float(np.linalg.norm(free) / max(np.linalg.norm(held), 1e-300))
        yield (
            f"at the last output the forces on free nodes are {left:.2g} of those that hold the body "
            f"(asked for: {case.scene.solver.tolerance:g} of the largest so far)"
        )


def _energy_of_motion(result: xr.Dataset, balance: dict[str, float]) -> Iterator[str]:
    kinetic = result["kinetic_energy"].values
    yield f"kinetic energy {kinetic[0]:.6g} J at the start, {kinetic[-1]:.6g} J at the end"
    if "fracture_energy" in result:
        yield f"broken bonds took {balance['fracture']:.6g} J, damping {balance['damping']:.6g} J"
    elif balance["damping"] > 0.0:
        yield f"damping took {balance['damping']:.6g} J"
    error = np.abs(energy_balance(result)["error"])
    scale = max(np.abs(result["external_work"].values).max(), kinetic.max(), 1e-300)
    worst = float(error.max()) / scale
    said = "open" if worst > OPEN_MOTION else "closed"
    yield f"the balance is {said}: error at most {worst:.2g} of the largest energy, by the length of the steps"


def _balance(error: float, of: str) -> str:
    return f"the balance is {'open' if error > OPEN else 'closed'}: error {error:.2g} of the {of}"


def _hydrogen(result: xr.Dataset) -> Iterator[str]:
    if "hydrogen_influx" not in result:
        return
    content, influx = result["hydrogen_content"].values, result["hydrogen_influx"].values
    mean, psi = result["mean_coverage"].values, result["coverage"].values[-1]
    yield f"mean coverage from {mean[0]:.4g} to {mean[-1]:.4g}; at the end {psi.min():.4g} to {psi.max():.4g}"
    yield (
        f"content from {content[0]:.6g} to {content[-1]:.6g} m^3 of full coverage; "
        f"{influx[-1] - influx[0]:.6g} m^3 entered through edges and held nodes"
    )
    yield _balance(float(summary(result)["hydrogen_imbalance"]), "content")


def _work(result: xr.Dataset) -> Iterator[str]:
    def last(name: str) -> int:
        return int(result[name].values[-1])

    if "equilibrium_solves" in result:
        solves, iterations = last("equilibrium_solves"), last("equilibrium_iterations")
        yield (
            f"{solves} equilibria, {iterations} iterations ({iterations / max(solves, 1):.3g} each), "
            f"{last('force_sweeps')} force sweeps"
        )
    if "time_steps" in result:
        yield f"{last('time_steps')} steps, {last('force_sweeps')} force sweeps"
    if "failure_rounds" in result and "time_steps" not in result:
        yield f"{last('failure_rounds')} rounds of failures"
    if "diffusion_sweeps" in result:
        yield f"{last('diffusion_sweeps')} diffusion sweeps"
    for line in str(result.attrs.get("plan", "")).splitlines():
        if line.startswith(("hydrogen: on", "time:")):
            yield f"planned: {line}"


def _origin(result: xr.Dataset) -> Iterator[str]:
    versions = json.loads(result.attrs.get("versions", "{}"))
    named = ", ".join(f"{name} {versions[name]}" for name in ("pdhe", "numpy", "numba", "scipy") if name in versions)
    code = result.attrs.get("code_fingerprint", "unknown")
    yield f"code {code}, {named or 'unknown versions'}, {result.attrs.get('machine', 'unknown machine')}"
    if result.attrs.get("command"):
        yield str(result.attrs["command"])
