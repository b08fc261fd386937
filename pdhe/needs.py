"""What to ask a cluster for: memory, threads and time of a solve in closed form, before there is a mesh.

A plan of a thousand cases has milliseconds for each, so that nothing is meshed or tried here; :mod:`pdhe.forecast` does
that, and shares the numbers. A limit on time is no loss if it turns out too short: the next attempt goes on from the
last checkpoint, and has twice the time.
"""

import errno
import itertools
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from pdhe.costs import COPIES, ITERATION, PROCESS, SEARCH, STEP, bond_reach, bytes_of_bond, seconds_before
from pdhe.provenance import canonical
from pdhe.scene_blocks import LATTICES, SOLID_CELLS
from pdhe.scene_umat import numbers_of

#: Directed bonds a second and thread of a force sweep and a diffusion sweep, on a lattice and on other nodes: rounded
#: down from 4.0e8 to 7.0e8, 1.4e8 to 1.8e8, 8.2e8 to 2.4e9 and 7.4e8 to 1.8e9 (docs/performance-tables.md).
FORCE_RATE, DIFFUSION_RATE = {True: 4e8, False: 1.4e8}, {True: 1e9, False: 8e8}
#: The same in space: 6.9e7 (correspondence), 9.3e7 (bonds), 1.6e8 (state-based), 4.3e8 to 1.5e9, measured with 4000
#: nodes of cubes and tetrahedra.
SOLID_FORCE_RATE, SOLID_DIFFUSION_RATE = {"correspondence": 6e7, "state-based": 1.2e8}, 4e8
SOLID_BOND_RATE = 7e7
#: Iterations of an equilibrium, 8 to 16 measured, and rounds of failures for each cell that a crack can cross: 7 to 10
#: on a lattice, 11 to 22 on triangles, where every crack that was drawn can grow. In space for each cell of the area
#: that it can cross (2.3 on cubes and 2.6 on tetrahedra where it did): layers may break one by one.
ITERATIONS, ROUNDS, SOLID_ROUNDS = 14.0, {True: 10.0, False: 20.0}, 3.0
#: Iterations of an increment of a user material over those of an equilibrium: several Newton steps, and worse
#: conditioned where it yields (measured 4.1 and 5.6 in ``plastic_hole`` at 1 and 0.5 mm).
NEWTON = 10.0
#: Work of an equilibrium at large strains over that at small ones: Newton steps, with sweeps that take three times as
#: long (measured 4 in a plate that is stretched by half, 6 to 10 in strips bent by more than a right angle).
LARGE_STRAIN = 12.0
#: Sweeps over the root of the number of explicit steps times that of instants at which they have to stop: without
#: damage (measured 1.8 to 2.6), and with it (1.6 to 4.6).
LONG = {False: 2.6, True: 5.0}
#: Share of the explicit limit that a step takes, sweeps of a step, and sweeps that a round of failures adds.
SAFETY, SWEEPS, AFTER_ROUND = 0.9, 2.0, 2.0
#: Stable step with inertia over the time that sound takes for a spacing, at three spacings a horizon (1.04 and 1.09 in
#: two scenes, 0.84 in space), and the share of it that correspondence models whose bonds may break have (0.5 in the
#: plane, 0.27 in space).
STABLE, STIFFER = 0.8, {2: 0.5, 3: 0.25}
#: Time of such a step in force sweeps, where bonds break in many of them: with kernels that find forces and failures at
#: once, and without.
MOVING, MOVING_APART = 4.0, 6.0
#: Powers of the length in the weights of the kernels (:data:`pdhe.transport.KERNELS`).
POWERS = {"constant": 0, "inverse": 1, "inverse square": 2}

#: Directed bonds that are worth a thread of their own, about 50,000 nodes, and the most threads that are asked for. Two
#: threads do 1.45 times the work of one with 100,000 nodes: each further one is taken as 0.45 of one.
WORTH_A_THREAD, MOST_THREADS, FURTHER_THREAD = 1_400_000, 8, 0.45
#: What a job asks for over what is expected, and besides: memory of the two Snakemakes around it (2e8 each) and of the
#: compiler (4e8); seconds to start on a slow file system and to compile the kernels, up to 100 the first time.
MARGIN, BESIDE, START = 1.3, 8e8, 300.0
#: Bytes of the mesher, and of each cell in it (measured 0.8e8 and 770 between 20,000 and 220,000 triangles).
MESHER, CELL = 1e8, 800.0
#: Expected over measured time is 1.05 to 9, so that this is ample on a machine that is not three times slower.
TIME_MARGIN = 3.0


@dataclass(frozen=True)
class Needs:
    """What a solve is expected to take.

    Attributes
    ----------
    nodes
        Their number, about.
    fields
        Bytes of everything that is kept for every node and output.
    memory
        Peak of the process, bytes.
    threads
        As many as are worth it.
    seconds
        On these threads of a machine like the one measured, an upper estimate.
    """

    nodes: float
    fields: float
    memory: float
    threads: int
    seconds: float

    def mem_mb(self, attempt: int = 1) -> int:
        """Memory to ask for, MB; half as much again with each attempt."""
        return math.ceil((MARGIN * self.memory + BESIDE) / 1e6 * 1.5 ** (attempt - 1))

    def runtime(self, attempt: int = 1) -> int:
        """Time to ask for, minutes; twice as much with each attempt, which goes on from the checkpoint of the last."""
        return math.ceil((START + TIME_MARGIN * self.seconds) / 60.0) * 2 ** (attempt - 1)

    def mesh_mem_mb(self) -> int:
        """Memory to ask for when the mesh is made and read, MB."""
        return math.ceil((MARGIN * (MESHER + CELL * self.nodes) + BESIDE) / 1e6)

    def drawing_mem_mb(self) -> int:
        """Memory to ask for when the result is drawn, MB."""
        return math.ceil((MARGIN * (PROCESS + COPIES * self.fields) + BESIDE) / 1e6)


def needs_of(scene: Mapping[str, Any]) -> Needs:
    """Estimate what a resolved scene will take to solve.

    Parameters
    ----------
    scene
        As :meth:`pdhe.scene.Scene.resolved` gives it, SI.

    Notes
    -----
    Cracks are taken to cross the plate and hydrogen to stop at every round of their failures, the most that can happen,
    so that the time is above what is measured: 1.05 to 9 times in ``config/scenes``.
    """
    plate, mesh = scene["geometry"]["plate"], scene["mesh"]
    width, height = plate["width"], plate["height"]
    axes = 3 if mesh["cells"] in SOLID_CELLS else 2
    area = width * height - sum(math.pi * hole["radius"] ** 2 for hole in scene["geometry"]["holes"])
    nodes, finest = area / mesh["spacing"] ** 2, mesh["spacing"]
    layers = plate["thickness"] / mesh["spacing"] if axes == 3 else 1.0
    if mesh.get("refine"):
        nodes, finest = _graded(canonical(scene["geometry"]), canonical(mesh))
    mean = math.sqrt(area / nodes)
    nodes *= layers
    ratio = scene["horizon"].get("ratio") or scene["horizon"]["length"] / mesh["spacing"]
    lattice = mesh["cells"] in LATTICES and not scene["geometry"]["holes"]
    reach = round(bond_reach(ratio, scene["mechanics"]["partial_volume"], lattice), 3)
    sides = (width, height, plate["thickness"])
    bonds = nodes * (
        _moments(reach, 0, axes)[0] if axes == 2 else _neighbours(reach, tuple(s / mesh["spacing"] for s in sides))
    )

    moving = scene["stepping"]["mode"] == "dynamic"
    mechanics, hydrogen = bool(scene.get("loads")) or moving, scene.get("hydrogen")
    breaks, outputs = mechanics and "damage" in scene, len(scene["outputs"]["times"])
    numbers = axes * mechanics + axes * moving + breaks + bool(hydrogen)
    umat, kept = scene["material"].get("umat") if mechanics else None, 0
    if umat is not None:
        written, kept = numbers_of(len(umat["states"]), scene["mechanics"]["plane"] if axes == 2 else None)
        numbers += written
    fields = 8.0 * numbers * nodes * outputs
    memory = PROCESS + bytes_of_bond(axes, mechanics, bool(hydrogen)) * bonds + 8.0 * kept * nodes + COPIES * fields

    solves, sweeps, stepping = outputs, 0.0, scene["stepping"]
    if stepping["mode"] == "fixed":
        solves = stepping["load_steps"]
        sweeps = SWEEPS * solves * stepping["diffusion_substeps"]
    rounds = 0.0
    if breaks:
        cracks = scene["geometry"]["cracks"]
        # A disc or a polygon is taken to have the whole way before it.
        lengths = [math.dist(crack["from"], crack["to"]) for crack in cracks if crack.get("from")]
        ways = 1 if lattice else max(1, len(cracks))
        each = ROUNDS[lattice] if axes == 2 else SOLID_ROUNDS * layers
        rounds = each * ways * max(max(width, height) - max(lengths, default=0.0), 0.0) / mean
    if hydrogen and stepping["mode"] == "events":
        number, square = _moments(round(ratio, 3), POWERS[hydrogen["kernel"]], axes)
        diffusivity = scene["material"]["diffusivity"]
        regions = hydrogen.get("regions") or ()
        fastest = max([diffusivity, *(item.get("diffusivity") or item["factor"] * diffusivity for item in regions)])
        limit = square / number / (2.0 * axes) * finest**2 / fastest  # theory, eq. 4.6
        explicit = scene["time"]["end"] / (SAFETY * limit)
        long = LONG[breaks] * math.sqrt(explicit * (outputs + rounds))
        sweeps = min(SWEEPS * explicit + AFTER_ROUND * rounds, long)
    # The others have no kernels for lattices: 2.0e8 and 1.2e8 measured.
    quick = lattice and scene["mechanics"]["model"] not in ("state-based", "correspondence")
    rates = FORCE_RATE[quick], DIFFUSION_RATE[lattice]
    if axes == 3:
        rates = SOLID_FORCE_RATE.get(scene["mechanics"]["model"], SOLID_BOND_RATE), SOLID_DIFFUSION_RATE
    force, diffusion = (bonds / rate for rate in rates)
    work = STEP * diffusion * sweeps
    if moving:
        young = scene["material"]["youngs_modulus"]
        regions = scene["mechanics"].get("regions") or ()
        stiffest = max([young, *(item.get("youngs_modulus") or item["factor"] * young for item in regions)])
        sound = math.sqrt(stiffest / scene["material"]["density"])
        stable = STABLE * ratio / 3.0 * finest / sound
        if breaks and scene["mechanics"]["model"] == "correspondence":
            stable *= STIFFER[axes]
        each = MOVING_APART if scene["mechanics"]["model"] == "correspondence" else MOVING
        work += force * each * scene["time"]["end"] / (stepping.get("step") or stepping["safety"] * stable)
    elif mechanics:
        iterations = ITERATIONS * (1.0 if umat is None else NEWTON)
        large = LARGE_STRAIN if scene["mechanics"].get("strain") == "finite" else 1.0
        work += large * force * (ITERATION * iterations + SEARCH) * (solves + rounds)
    threads = min(max(int(bonds // WORTH_A_THREAD), 1), MOST_THREADS)
    seconds = seconds_before(axes, mechanics, bonds) + work / (1.0 + FURTHER_THREAD * (threads - 1))
    return Needs(nodes, fields, memory, threads, seconds)


@cache
def _graded(geometry: str, mesh: str) -> tuple[float, float]:
    """Number of cells of a graded mesh, and its finest spacing, m; the blocks as JSON."""
    from pdhe.scene import Geometry, Mesh
    from pdhe.sizing import SizeField

    plate, spacing = (
        kind.model_validate(json.loads(block), context={"si": True})
        for kind, block in ((Geometry, geometry), (Mesh, mesh))
    )
    return SizeField(plate, spacing).cells(), spacing.finest


@cache
def _neighbours(ratio: float, cells: tuple[float, ...]) -> float:
    """Mean number of neighbours within ``ratio`` spacings in a block of so many cells along its sides."""
    reach = range(-math.floor(ratio), math.floor(ratio) + 1)
    places = (place for place in itertools.product(reach, repeat=3) if 0.0 < math.hypot(*place) <= ratio)
    return sum(math.prod(max(0.0, 1.0 - abs(k) / n) for k, n in zip(p, cells, strict=True)) for p in places)


@cache
def _moments(ratio: float, power: int, axes: int) -> tuple[float, float]:
    """Sums over the neighbours on a lattice, within ``ratio`` spacings, of r^-power and of r^(2 - power)."""
    number = square = 0.0
    reach = range(-math.floor(ratio), math.floor(ratio) + 1)
    for place in itertools.product(reach, repeat=axes):
        r = math.hypot(*place)
        if 0.0 < r <= ratio:
            number += r**-power
            square += r ** (2 - power)
    return number, square


def fails_again(log: str | Path) -> bool:
    """Tell from the log of a job that failed whether it would fail again for the same reason.

    So it does where the program says what is wrong with the scene, the mesh or the physics. It does not where the job
    was ended from outside (time, memory, a node: no last word, or that of an interruption), nor where the machine is
    what was wrong.
    """
    try:
        with Path(log).open("rb") as file:
            file.seek(max(0, file.seek(0, 2) - _LAST_WORDS))
            text = file.read().decode(errors="replace")
    except OSError:
        return False
    said = [line for line in text.splitlines() if line.startswith("error: ")]
    return bool(said) and not any(reason in said[-1].lower() for reason in _OF_THE_MACHINE)


_LAST_WORDS = 20_000
#: What passes by itself, or is set right beside the scene.
_PASSING = (
    "EIO",
    "ESTALE",
    "EAGAIN",
    "EBUSY",
    "EINTR",
    "EMFILE",
    "ENFILE",
    "ETIMEDOUT",
    "ENOTCONN",
    "ECONNRESET",
    "ENOLCK",
)
_OF_THE_MACHINE = (
    "memory",
    "give the same command again",
    *(os.strerror(getattr(errno, name)).lower() for name in _PASSING if hasattr(errno, name)),
)
