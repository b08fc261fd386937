"""What a run will take: memory from its bonds, work from a pilot on a coarser mesh, time from sweeps tried at once."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pdhe.case import Case
from pdhe.costs import (
    COPIES,
    ITERATION,
    MOTION,
    MOTION_ALONE,
    MOTION_APART,
    PROCESS,
    SEARCH,
    STEP,
    bond_reach,
    bytes_of_bond,
    seconds_before,
)
from pdhe.errors import PdheError, SceneError
from pdhe.materials import Body
from pdhe.scene import Scene
from pdhe.scene_blocks import LATTICES
from pdhe.scene_solid import cubic_cells, size_of
from pdhe.scene_umat import numbers_of

#: Nodes of a pilot, and by how much coarser it is at least. Both its flights cost 3 to 15 % of runs with 10,000 to
#: 20,000 nodes, and a quarter of the seconds that 2500 take; 2000 nodes foretell no better, for twice as much.
PILOT_NODES, LEAST_COARSENING = 800, 2.0
#: Nodes from which one is flown, and those of a graded mesh: it has a quarter of them, fewer tell nothing.
LEAST_NODES, LEAST_GRADED = 700, 1200
#: Share of the memory of the machine from which a warning is due.
USUAL_SHARE = 0.8


@dataclass(frozen=True)
class Pilot:
    """What a run on a coarser mesh came to.

    Attributes
    ----------
    nodes
        Their number.
    coarsening
        Its spacing over that of the run; on graded meshes the same at every place.
    counts
        Last value of each history, by name, and where bonds broke ``sweeps_before_failure``, ``rounds_while_loaded``,
        ``extension_while_loaded`` (m), ``first_failure`` and ``end`` (s), and ``failure_instants``: at how many times.
    largest_load
        Largest load over resistance that it met; None without damage.
    later
        Counts of another one that had more time, see :func:`longer`; None where it makes no difference.
    """

    nodes: int
    coarsening: float
    counts: dict[str, float]
    largest_load: float | None
    later: dict[str, float] | None = None


@dataclass(frozen=True)
class Forecast:
    """Expected cost of a run.

    Attributes
    ----------
    memory
        Peak of the process, bytes. Compiling kernels for the first time takes up to 4e8 more.
    force_sweeps, diffusion_sweeps, failure_rounds
        Counted work; None without a pilot.
    seconds
        Processor time on one thread; None without a pilot.
    """

    memory: float
    force_sweeps: float | None = None
    diffusion_sweeps: float | None = None
    failure_rounds: float | None = None
    seconds: float | None = None


def pilot_scene(scene: Scene, nodes: int) -> Scene | None:
    """The scene on a mesh of about :data:`PILOT_NODES` nodes, or twice as coarse; None for few nodes.

    A graded mesh keeps its shape: all spacings become larger by the same factor. Where bonds may break, all outputs but
    the last are left out: on few nodes they, and not the failures, would decide on the length of diffusion steps. None
    for motions with inertia, whose steps are known beforehand, for user materials and for large strains.
    """
    coarsening = max(LEAST_COARSENING, (nodes / PILOT_NODES) ** (1.0 / (3 if scene.mesh.solid else 2)))
    if scene.mesh.solid:
        coarsening = _fitting(scene, coarsening)
    elif nodes < (LEAST_GRADED if scene.mesh.refine else LEAST_NODES):
        return None
    elif scene.mesh.cells in LATTICES:
        coarsening = _like_the_lattice(scene, coarsening)
    if coarsening < LEAST_COARSENING or scene.stepping.mode == "dynamic":
        return None
    if scene.material.umat is not None or scene.mechanics.strain == "finite":
        return None
    try:
        return coarser(scene, coarsening, outputs=scene.damage is None)
    except SceneError:
        return None


def _like_the_lattice(scene: Scene, coarsening: float) -> float:
    """How much coarser a lattice can be, next to what is wanted, and be like the scene's: square, cracks between rows.

    Cells that are not squares have partial volumes, and a crack through nodes is another one than that between them:
    both differ more in what breaks than lattices of different spacings do. What is wanted, if there is no such lattice.
    """
    g, h = scene.geometry, scene.mesh.spacing
    places = [coordinate for crack in g.cracks for end in (crack.start, crack.end) for coordinate in end]

    def alike(length: float) -> bool:
        whole = all(abs(side / length - round(side / length)) < 1e-6 for side in (g.width, g.height))
        apart = [abs(x / length - x / h - round(x / length - x / h)) < 1e-6 for x in places]
        return whole and all(apart)

    most = int(g.width / (LEAST_COARSENING * h) * (1.0 + 1e-9))
    found = [length / h for length in (g.width / count for count in range(2, most + 1)) if alike(length)]
    return min(found, key=lambda some: abs(math.log(some / coarsening)), default=coarsening)


def _fitting(scene: Scene, coarsening: float) -> float:
    """How much coarser a body in space can be, next to what is wanted: cells have to be cubes; 0 if it cannot."""
    if scene.mesh.cells not in LATTICES:
        return coarsening
    size, spacing = size_of(scene), scene.mesh.spacing
    lengths = [size[0] / count for count in range(1, int(size[0] / (LEAST_COARSENING * spacing) * (1.0 + 1e-9)) + 1)]
    cubes = [length / spacing for length in lengths if not cubic_cells(size, length)[1]]
    return min(cubes, key=lambda some: abs(math.log(some / coarsening)), default=0.0)


def coarser(scene: Scene, coarsening: float, outputs: bool = True, with_horizon: bool = False) -> Scene:
    """The scene with all spacings larger by one factor.

    Without ``outputs`` there is but the last one. A horizon that is given as a length becomes larger ``with_horizon``.

    Raises
    ------
    SceneError
        If it cannot be so coarse.
    """
    content = scene.resolved()
    mesh = content["mesh"]
    mesh["spacing"] = scene.mesh.spacing * coarsening
    for region in mesh.get("refine") or ():
        region["spacing"] *= coarsening
    if scene.mesh.refine:
        # Bonds must not be longer than any horizon (theory, section 3), which bounds the growth.
        growth = scene.mesh.growth_rate
        mesh["growth"] = min(growth * coarsening, max(growth, 0.9 / scene.horizon.ratio))
    if with_horizon and scene.horizon.length is not None:
        content["horizon"]["length"] = scene.horizon.length * coarsening
    if not outputs:
        content["outputs"] = {"times": [scene.time.end]}
    return Scene.from_resolved(content)


def longer(scene: Scene, coarsening: float, since: float) -> Scene:
    """A pilot with as much more time from an instant on, s, as hydrogen needs more time on its mesh; loads are held."""
    content, end = scene.resolved(), scene.time.end
    for load in content["loads"]:
        load["displacement"] = {axis: _held_from(history, end) for axis, history in load["displacement"].items()}
    for item in content["hydrogen"]["boundary"]:
        item["coverage"] = _held_from(item["coverage"], end)
    content["time"]["end"] = since + coarsening * (end - since)
    content["outputs"] = {"times": [content["time"]["end"]]}
    return Scene.from_resolved(content)


def _held_from(history: Mapping[str, list[float]], end: float) -> dict[str, list[float]]:
    """A resolved history that stays as it is from an instant on, s."""
    times, values = history["times"], history["values"]
    kept = [(t, v) for t, v in zip(times, values, strict=True) if t < end]
    kept.append((end, float(np.interp(end, times, values))))
    return {"times": [t for t, _ in kept], "values": [v for _, v in kept]}


def make_forecast(case: Case, pilot: Pilot | None) -> Forecast:
    """Scale what a pilot counted up to the mesh of a case.

    With the spacing h, a crack takes rounds of failures in proportion to 1/h for each length of growth. Where hydrogen
    carries it under loads that are held, its speed goes with 1/h as well. If it also depends on the time alone, as that
    of hydrogen far around the tip does, the crack grows so many times farther, until it has crossed the plate; if it
    depends on the place alone, the crack comes as far as the pilot does with so many times more time (:func:`longer`).
    While loads change, growth follows them, on any mesh, or waits for hydrogen all the same. Of two such limits the
    geometric mean is taken: a pilot does not tell which holds.

    Iterations of an equilibrium do not change. Sweeps of the diffusion grow as the square root of the number of plain
    steps, which goes as 1/h^2, and of the number of instants at which they have to stop: failures, and outputs, which a
    pilot leaves out. Fixed stepping has the same number of load steps and of sweeps.

    Cracks on so coarse a mesh are rough guides: times are right within a factor of three (the benchmark `same_answer`
    has 2.7), counts of failures less so.
    """
    bonds, nodes = case.bonds.neighbours.size, case.discretization.volume.size
    axes = case.discretization.dimension
    numbers = axes * (bool(case.body) + bool(case.dynamics)) + bool(case.rule) + bool(case.diffusion)
    kept = 0
    if case.history is not None:
        written, kept = numbers_of(len(case.scene.material.umat.states), case.scene.plane)
        numbers += written
    total = numbers * nodes * len(case.scene.outputs.times)
    memory = _memory(axes, bonds, bool(case.body), bool(case.diffusion), total)
    setup = seconds_before(axes, case.body is not None, bonds)
    memory += 8.0 * kept * nodes
    if case.dynamics is not None:
        sweeps, (force, _) = motion_steps(case), _sweep_seconds(case)
        apart = type(case.body).force_and_ratios is Body.force_and_ratios
        each = MOTION_ALONE if case.rule is None else MOTION_APART if apart else MOTION
        return Forecast(memory, float(sweeps), seconds=setup + each * force * sweeps)
    if pilot is None:
        return Forecast(memory)
    last, fixed = pilot.counts, case.scene.stepping.mode == "fixed"
    estimates = [_rounds_and_sweeps(case, pilot, counts) for counts in (last, pilot.later) if counts]
    rounds, sweeps = (math.prod(values) ** (1.0 / len(values)) for values in zip(*estimates, strict=True))
    solves = max(last.get("equilibrium_solves", 0.0) - last.get("failure_rounds", 0.0), 0.0) + rounds
    flown = pilot.later or last
    iterations = flown.get("equilibrium_iterations", 0.0) / max(flown.get("equilibrium_solves", 0.0), 1.0) * solves
    if fixed:
        sweeps = last.get("diffusion_sweeps", 0.0)
    force, diffusion = _sweep_seconds(case)
    seconds = setup + force * (ITERATION * iterations + SEARCH * solves) + STEP * diffusion * sweeps
    return Forecast(
        memory,
        force_sweeps=iterations + solves if case.equilibrium else None,
        diffusion_sweeps=sweeps if case.diffusion else None,
        failure_rounds=rounds if case.rule else None,
        seconds=seconds,
    )


def motion_steps(case: Case) -> int:
    """Steps with inertia that a case takes, if it were not for outputs and corners of loads: they add some."""
    stepping = case.scene.stepping
    return case.dynamics.steps(case.scene.time.end, stepping.step or stepping.safety * case.dynamics.limit)


def _memory(axes: int, bonds: float, mechanics: bool, hydrogen: bool, written: float) -> float:
    """Peak of the process with so many directed bonds, and so many numbers at all outputs together, bytes."""
    return PROCESS + bytes_of_bond(axes, mechanics, hydrogen) * bonds + COPIES * 8.0 * written


def check_memory(scene: Scene, nodes: int) -> str:
    """Return a warning if a run is expected to take most of the memory of this machine, nothing otherwise.

    Raises
    ------
    PdheError
        If it is expected to take more than there is, swap included, before any of it is taken.
    """
    # As many neighbours as a circle or a ball of this radius holds: fewer at the boundary.
    ratio, axes = scene.horizon.ratio or scene.horizon_length / scene.mesh.spacing, 3 if scene.mesh.solid else 2
    lattice = scene.mesh.cells in LATTICES and not scene.geometry.holes
    ratio = bond_reach(ratio, scene.mechanics.partial_volume, lattice)
    family = math.pi * ratio**2 if axes == 2 else 4.0 / 3.0 * math.pi * ratio**3
    numbers = axes * bool(scene.loads) + bool(scene.damage) + bool(scene.hydrogen)
    kept = 0
    if scene.material.umat is not None and scene.loads is not None:
        more, kept = numbers_of(len(scene.material.umat.states), scene.plane)
        numbers += more
    written = numbers * nodes * len(scene.outputs.times)
    needed = _memory(axes, nodes * family, bool(scene.loads), bool(scene.hydrogen), written) + 8.0 * kept * nodes
    memory, swap = memory_of_machine()
    if needed <= USUAL_SHARE * memory:
        return ""
    text = f"about {needed / 1e9:.3g} GB of memory are needed ({nodes} nodes, {family:.0f} bonds each)"
    hint = "take a coarser `mesh.spacing`, fewer `outputs` or a machine with more memory"
    if needed > memory + swap:
        raise PdheError(f"{text}, more than the {(memory + swap) / 1e9:.3g} GB of this machine: {hint}")
    return f"warning: {text} of the {memory / 1e9:.3g} GB of this machine: run nothing else beside it, or {hint}"


def memory_of_machine() -> tuple[float, float]:
    """Memory that processes of this kind may take, bytes, and swap; both infinite where the system does not tell."""
    try:
        told = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text(encoding="utf-8").splitlines())
        memory, swap = (1024.0 * float(told[name].split()[0]) for name in ("MemTotal", "SwapTotal"))
    except (OSError, ValueError, KeyError):
        return math.inf, math.inf
    with contextlib.suppress(OSError, ValueError):
        # Groups of processes may be given less, as by a cluster; theirs is the least of all groups around them.
        group = Path("/proc/self/cgroup").read_text(encoding="utf-8").rpartition("0::")[2].strip().strip("/")
        for place in (folder := Path("/sys/fs/cgroup", group), *folder.parents):
            with contextlib.suppress(OSError, ValueError):
                memory = min(memory, float(Path(place, "memory.max").read_text(encoding="utf-8")))
    return memory, swap


def _rounds_and_sweeps(case: Case, pilot: Pilot, counts: Mapping[str, float]) -> tuple[float, float]:
    """Rounds of failures and sweeps of the diffusion as one flight has them foretell."""
    coarsening, end = pilot.coarsening, case.scene.time.end
    sweeps, before = counts.get("diffusion_sweeps", 0.0), counts.get("sweeps_before_failure", 0.0)
    broken, loaded = counts.get("failure_rounds", 0.0), counts.get("rounds_while_loaded", 0.0)
    if not broken:
        return 0.0, before * coarsening
    wet, farther = case.diffusion is not None, 1.0
    if wet and counts is pilot.counts:
        grown = counts["crack_extension"] - counts["extension_while_loaded"]
        g = case.scene.geometry
        lengths = [crack.length for crack in g.cracks]
        room = max(g.width, g.height) - max(lengths, default=0.0) - counts["extension_while_loaded"]
        farther = min(coarsening, max(1.0, room / grown)) if grown > 0.0 else 1.0
    following = math.sqrt(coarsening) if wet else 1.0
    more = coarsening * (loaded * following + (broken - loaded) * farther) / broken
    instants, first = counts["failure_instants"], counts["first_failure"]
    outputs = sum(t > first for t in case.scene.outputs.times)
    time = (end - first) / (counts["end"] - first) if counts["end"] > first else 1.0
    longer_steps = math.sqrt(max(time, 0.0) * (more + outputs / instants))
    return more * broken, before * coarsening + (sweeps - before) * coarsening * longer_steps


def _sweep_seconds(case: Case, repeats: int = 5) -> tuple[float, float]:
    """Processor time of a force sweep and of a diffusion sweep of this case, s; zero for absent physics."""
    n, times = case.discretization.volume.size, [0.0, 0.0]
    parts: list = [None, None]
    if case.body is not None:
        u = np.zeros(case.discretization.coordinates.shape)
        parts[0] = lambda: case.body.force(u)
    if case.diffusion is not None:
        held, zeros = np.zeros(n, bool), np.zeros(n)
        parts[1] = lambda: case.diffusion.step(zeros, 1.0, held, zeros, np.empty(n), np.zeros(n))
    for k, part in enumerate(parts):
        if part is not None:
            part()
            samples = []
            for _ in range(repeats):
                start = time.process_time()
                part()
                samples.append(time.process_time() - start)
            times[k] = min(samples)
    return times[0], times[1]
