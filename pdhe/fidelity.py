"""Named fidelities: settings that a scene may leave out, chosen for its size and its physics.

Every fidelity of every kind of scene is a run of the study of speed against accuracy (docs/tradeoff.md), where its
error and its cost are measured. Values that a scene gives win over those of its fidelity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from pdhe.errors import SceneError
from pdhe.scene_blocks import FIDELITIES, SOLID_CELLS, Geometry, Horizon, Mesh
from pdhe.scene_checks import square_cells
from pdhe.scene_mirrors import whole_length, whole_size
from pdhe.units import round15

#: A spacing may be this much smaller than the largest that fits, to put cracks between nodes.
NEAR = 0.7
#: Horizons in spacings. The short one holds the eight nearest nodes of a lattice of squares, whose weights make the
#: elasticity tensor exact; cracks need the long one (with two spacings, the time of failure is wrong by 25 to 74 %, on
#: any mesh), and so do irregular nodes, where it is not known who the nearest are.
SHORT_RATIO, LONG_RATIO = 1.515, 3.015
#: Cells of a lattice may be larger than the spacing asked for, where that does not divide the sides: up to this much
#: the short horizon still holds their diagonals.
SHORT_DIAGONAL = 0.99 * SHORT_RATIO


@dataclass(frozen=True)
class Settings:
    """What a fidelity stands for.

    Attributes
    ----------
    cells
        Cells along the smallest feature of the plate (:func:`smallest_feature`).
    tolerance
        Of equilibria.
    """

    cells: int
    tolerance: float


#: Kind of scene -> fidelity -> settings; the horizon is the usual one (:func:`usual_ratio`).
SETTINGS: dict[str, dict[str, Settings]] = {
    "elastic": {
        "draft": Settings(6, 1e-3),
        "standard": Settings(16, 1e-3),
        "fine": Settings(32, 1e-4),
        "reference": Settings(64, 1e-4),
    },
    "diffusion": {
        "draft": Settings(4, 1e-3),
        "standard": Settings(8, 1e-3),
        "fine": Settings(16, 1e-4),
        "reference": Settings(32, 1e-4),
    },
    "fracture": {
        "draft": Settings(6, 3e-4),
        "standard": Settings(12, 3e-4),
        "fine": Settings(24, 3e-4),
        "reference": Settings(40, 1e-4),
    },
}


def kind_of(scene: Mapping[str, Any]) -> str:
    """Kind of a scene by the blocks it has: ``fracture``, ``elastic`` (with or without hydrogen) or ``diffusion``."""
    if scene.get("damage") is not None:
        return "fracture"
    return "elastic" if scene.get("loads") is not None else "diffusion"


def usual_ratio(geometry: Geometry, mesh: Mesh, whole: bool) -> float:
    """Horizon in spacings of a scene that gives none: the front of the study of speed against accuracy.

    Short where the body stays ``whole`` on a lattice of squares, where it is as accurate in elasticity and twice as
    accurate in diffusion for less than half of the work; long elsewhere.
    """
    if not whole or mesh.cells != "quadrilateral" or geometry.holes:
        return LONG_RATIO
    columns, rows, wrong = square_cells(geometry.width, geometry.height, mesh.spacing)
    diagonal = math.hypot(geometry.width / columns, geometry.height / rows)
    return LONG_RATIO if wrong or diagonal > SHORT_DIAGONAL * mesh.spacing else SHORT_RATIO


def usual_tolerance(breaks: bool) -> float:
    """Relative residual of equilibria of a scene that gives none: the front of the study of speed against accuracy.

    Where bonds break it is the loosest one that keeps symmetric scenes symmetric: with 3e-4 no run of the study came
    out lopsided, with 1e-3 both of its scenes did on some mesh, with 1e-2 on most. Errors are the same below.
    """
    return SETTINGS["fracture" if breaks else "elastic"]["fine"].tolerance


def smallest_feature(geometry: Geometry) -> float:
    """Smallest of the plate's sides, the lengths of its cracks and the diameters of its holes, m; of the whole body."""
    cracks = (whole_length(geometry, crack) for crack in geometry.cracks)
    return min(*whole_size(geometry), *cracks, *(2.0 * hole.radius for hole in geometry.holes))


def spacing_for(geometry: Geometry, target: float, lattice: bool) -> float:
    """A spacing near a wanted one and not larger, m.

    On a lattice of squares it divides both sides, and by preference puts level cracks between rows of nodes and their
    ends between columns: a crack that ends inside a cell is longer or shorter than it should be.
    """
    if not lattice:
        return round15(target)
    least = math.ceil(geometry.width / target * (1.0 - 1e-9))
    fitting = [
        geometry.width / columns
        for columns in range(least, 2 * least + 1)
        if not square_cells(geometry.width, geometry.height, geometry.width / columns)[2]
    ]
    if not fitting:
        return round15(target)  # no lattice of squares fits: the check of the scene says so

    level = [crack for crack in geometry.cracks if crack.start[1] == crack.end[1]]
    rows = [crack.start[1] for crack in level]
    ends = [x for crack in level for x in (crack.start[0], crack.end[0])]
    near = [spacing for spacing in fitting if spacing > NEAR * fitting[0]]
    for lengths in ([*rows, *ends], rows):
        for spacing in near:
            if all(abs(length / spacing - round(length / spacing)) < 1e-6 for length in lengths):
                return round15(spacing)
    return round15(fitting[0])


def fill_in(raw: dict[str, Any], file: str) -> None:
    """Complete a scene as it is written by what its fidelity stands for, in place.

    Raises
    ------
    SceneError
        If the fidelity is not known.
    """
    name = raw.get("fidelity")
    if raw.get("accuracy") is not None:
        _check_accuracy(raw, file)
    key = "accuracy" if raw.get("accuracy") is not None else "fidelity"
    cells = raw["mesh"].get("cells") if isinstance(raw.get("mesh"), dict) else None
    if raw.get(key) is not None and cells in SOLID_CELLS:
        text = "is measured on plane meshes, and this scene is one in space"
        raise SceneError(file, key, raw[key], text, "give `mesh.spacing` instead")
    if name is None:
        return
    if name not in FIDELITIES:
        raise SceneError(file, "fidelity", name, "is not a fidelity", f"use {', '.join(f'`{f}`' for f in FIDELITIES)}")
    kind = kind_of(raw)
    _apply(raw, kind, SETTINGS[kind][name])


def leaves_spacing_to_accuracy(raw: Mapping[str, Any]) -> bool:
    """Tell whether a scene as it is written asks for an accuracy and says nothing of the spacing that it takes."""
    mesh = raw.get("mesh")
    open_mesh = mesh is None or (isinstance(mesh, dict) and mesh.get("spacing") is None)
    return raw.get("accuracy") is not None and open_mesh


def _check_accuracy(raw: dict[str, Any], file: str) -> None:
    if raw.get("fidelity") is not None:
        raise SceneError(file, "accuracy", raw["accuracy"], "and `fidelity` are both given", "give one of them")
    if leaves_spacing_to_accuracy(raw):
        text = "needs runs on coarse meshes, which reading a scene does not do, and `mesh.spacing` is missing"
        hint = "write down what `pdhe choose` finds, or use `pdhe run`"
        raise SceneError(file, "accuracy", raw["accuracy"], text, hint)


def _apply(raw: dict[str, Any], kind: str, settings: Settings) -> None:
    blocks = {block: raw.get(block) or {} for block in ("mesh", "solver")}
    try:
        geometry = Geometry.model_validate(raw.get("geometry"))
        horizon = Horizon.model_validate(raw["horizon"]) if raw.get("horizon") else None
    except ValidationError:
        return  # the check of the scene, which follows, says what is wrong
    if not all(isinstance(block, dict) for block in blocks.values()):
        return
    # Cracks in space are refused in a plate, by that check too.
    geometry = geometry.model_copy(
        update={"cracks": tuple(crack for crack in geometry.cracks if crack.start is not None)}
    )
    raw |= blocks
    lattice = raw["mesh"].get("cells") in (None, "quadrilateral") and not geometry.holes
    if raw["mesh"].get("spacing") is None:
        target = smallest_feature(geometry) / settings.cells
        if horizon is not None and horizon.length is not None:
            target = min(target, horizon.length / (SHORT_RATIO if lattice and kind != "fracture" else LONG_RATIO))
        raw["mesh"]["spacing"] = f"{spacing_for(geometry, target, lattice)!r} m"
    if raw["solver"].get("tolerance") is None:
        raw["solver"]["tolerance"] = settings.tolerance
