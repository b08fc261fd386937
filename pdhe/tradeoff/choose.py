"""Settings from an accuracy: pilot runs on coarse meshes tell how far off they are, measured orders how errors fall."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from pdhe.case import EDGES, build_case
from pdhe.errors import PdheError, SceneError
from pdhe.fidelity import kind_of, smallest_feature, spacing_for, usual_tolerance
from pdhe.scene import Scene, load_scene
from pdhe.scene_blocks import SOLID_CELLS
from pdhe.scene_fields import Accuracy
from pdhe.scene_reading import read_scene_file, reporting
from pdhe.simulation import Progress, simulate
from pdhe.tradeoff.own_error import MODELS, ORDER_OF_INNER_SOURCES, settles
from pdhe.tradeoff.quantities import distance, standard_values
from pdhe.verification.slabs import nodes_of

#: Cells along the smallest feature in the coarsest pilot run, and the number of pilot runs.
COARSEST, PILOTS = 6, 3
#: By how much finer than the coarsest pilot run a mesh must be for an estimate beforehand: the pilots then cost a tenth
#: of the run (measured: 9 and 11 % of fracture with and without hydrogen) and less beyond.
CHEAP = 6.0
#: Tolerance of equilibria over the wanted accuracy: reactions were off by up to seven tolerances.
TOLERANCE = 0.01
#: Share of it that is aimed at: elastic and diffusion scenes that were held back needed up to 1.7 times the prediction.
AIM = 0.75
#: Overrides that leave the spacing of a scene open, at the settings of a fine mesh.
OPEN: dict[str, Any] = {"accuracy": None, "fidelity": "fine", "mesh.spacing": None}


class _Wanted(BaseModel):
    """The accuracy of a scene by itself, so that what is wrong with it is told under its key."""

    accuracy: Accuracy


@dataclass(frozen=True)
class Choice:
    """Settings chosen for an accuracy.

    Attributes
    ----------
    changes
        By dotted key, as overrides of the scene.
    accuracy, predicted
        Wanted error, and the one that is expected: the largest of the quantities.
    errors
        Expected error of each quantity.
    """

    changes: dict[str, Any]
    accuracy: float
    predicted: float
    errors: dict[str, float]

    def text(self) -> str:
        """What was chosen, in a line for people."""
        told = ", ".join(f"{key}: {value}" for key, value in self.changes.items())
        worst = max(self.errors, key=self.errors.__getitem__)
        return (
            f"accuracy: {100.0 * self.accuracy:.3g} % wanted, {100.0 * self.predicted:.2g} % predicted "
            f"(largest: {worst}); chosen {told}"
        )


def choose(path: str | Path, progress: Progress | None = None) -> Choice:
    """Choose the settings of a scene that names an accuracy; what the scene gives is left as it is.

    Three runs of the scene on coarse meshes are fitted by ``q + c h^p``, with the order p that the study measured for
    this kind of scene; the spacing is the largest at which ``c h^p`` is below the accuracy. Covers errors of spacing
    and equilibria in the quantities of :func:`pdhe.tradeoff.quantities.standard_values`; not the horizon ratio of
    fracture, nor anything that the model leaves out.

    Raises
    ------
    SceneError
        If the accuracy cannot be promised: the pilot runs scatter more than that, the mesh would be too large, or the
        scene has no limit (hydrogen that saturates fresh crack faces).
    """
    log, file = progress or (lambda text: None), str(path)
    accuracy, scene = check(path)
    changes: dict[str, Any] = {}
    if scene.loads is not None and (read_scene_file(path).get("solver") or {}).get("tolerance") is None:
        # Never looser than usual: scenes whose bonds break would not stay symmetric.
        most = usual_tolerance(breaks=True) if scene.damage is not None else math.inf
        changes["solver.tolerance"] = float(f"{min(TOLERANCE * accuracy, most):.2g}")
    pilots = _fly(scene, lambda h: load_scene(path, {**OPEN, **changes, "mesh.spacing": f"{h!r} m"}), log)
    if pilots.scatter > 0.5 * accuracy:
        text = f"cannot be promised: errors of pilot runs scatter by {100.0 * pilots.scatter:.2g} % about any order"
        raise SceneError(file, "accuracy", accuracy, text, "accept more, or give a `fidelity`")
    wanted = min((AIM * accuracy / max(pilots.slopes.values())) ** (1.0 / pilots.order), pilots.spacings[0])
    spacing = spacing_for(scene.geometry, wanted, _lattice(scene))
    changes = {"mesh.spacing": f"{1e3 * spacing!r} mm", **changes}
    errors = pilots.errors(spacing)
    return Choice(changes, accuracy, max(errors.values()), errors)


def check(path: str | Path) -> tuple[float, Scene]:
    """Accuracy that a scene asks for, and the scene on a mesh of its size; runs nothing.

    Raises
    ------
    SceneError
        If there is none, or none can be promised whatever pilot runs would find.
    """
    file, raw = str(path), read_scene_file(path)
    wanted = raw.get("accuracy")

    def refuse(text: str, hint: str = "give `mesh.spacing` or a `fidelity` instead") -> SceneError:
        return SceneError(file, "accuracy", wanted, text, hint)

    if wanted is None:
        raise refuse("is missing", "for example `accuracy: 2 %`")
    if raw.get("fidelity") is not None:
        raise refuse("and `fidelity` are both given", "give one of them")
    mesh = raw["mesh"] if isinstance(raw.get("mesh"), dict) else {}
    if mesh.get("refine") is not None:
        text = "cannot be promised on a graded mesh, whose spacings the scene chooses itself"
        raise refuse(text, "leave `mesh.refine` out, or `accuracy`")
    if mesh.get("cells") in SOLID_CELLS:
        raise refuse("is measured on plane meshes, and this scene is one in space", "give `mesh.spacing` instead")
    with reporting(file, raw):
        accuracy = _Wanted.model_validate({"accuracy": wanted}).accuracy
    scene = load_scene(path, OPEN)
    if scene.stepping.mode == "dynamic":
        raise refuse("cannot be promised with inertia, for which no order of the errors has been measured")
    if scene.mechanics.regions:
        raise refuse(
            "cannot be promised where Young's modulus differs by place: no order of the errors has been measured"
        )
    if scene.mechanics.strain == "finite" or scene.material.umat is not None:
        kind = "under large strains" if scene.mechanics.strain == "finite" else "with a user material"
        raise refuse(f"cannot be promised {kind}: no order of the errors has been measured")
    if not has_limit(scene):
        raise refuse(
            "cannot be promised: where fresh crack faces are saturated, cracks grow the faster the finer the mesh"
        )
    return accuracy, scene


def estimate(scene: Scene, progress: Progress | None = None) -> dict[str, float]:
    """Expected error of each quantity of a scene before it is run, relative, from runs on coarse meshes.

    Covers and leaves out what :func:`choose` does. Empty where nothing can be said cheaply: for meshes that are hardly
    finer than those of the pilot runs, graded meshes, bodies in space, horizons given as lengths, and scenes without a
    limit.
    """
    if scene.mesh.refine or scene.mesh.solid:
        return {}
    cheap = spacing_for(scene.geometry, smallest_feature(scene.geometry) / COARSEST, _lattice(scene)) / CHEAP
    if scene.horizon.ratio is None or not has_limit(scene) or scene.mesh.spacing > cheap * (1.0 + 1e-9):
        return {}

    def coarse(spacing: float) -> Scene:
        content = scene.resolved()
        content["mesh"]["spacing"] = spacing
        return Scene.from_resolved(content)

    try:
        return _fly(scene, coarse, progress or (lambda text: None)).errors(scene.mesh.spacing)
    except PdheError:
        return {}  # too coarse for the scene's own details, which says nothing against the scene


def has_limit(scene: Scene) -> bool:
    """Tell whether the answer of a scene settles as the mesh is refined, at an order that has been measured.

    Not where fresh crack faces are saturated, and not known with inertia, where Young's modulus differs by place, for
    user materials, or under large strains.
    """
    mechanics = scene.mechanics
    if scene.stepping.mode == "dynamic" or mechanics.regions or scene.material.umat is not None:
        return False
    if mechanics.strain == "finite":
        return False
    return settles(scene)


@dataclass(frozen=True)
class _Pilots:
    """Fits of ``q + c h^p``: relative slopes ``c`` by quantity, the largest misfit, the order."""

    spacings: tuple[float, ...]
    slopes: dict[str, float]
    scatter: float
    order: float

    def errors(self, spacing: float) -> dict[str, float]:
        return {name: slope * spacing**self.order for name, slope in self.slopes.items()}


def _fly(scene: Scene, at: Callable[[float], Scene], log: Progress) -> _Pilots:
    """Run a scene at the coarsest spacings that fit it."""
    order = json.loads(MODELS.read_text(encoding="utf-8"))["kinds"][kind_of(scene.resolved())]["order"]
    if scene.hydrogen is not None and not {item.on for item in scene.hydrogen.boundary} <= set(EDGES):
        order = min(order, ORDER_OF_INNER_SOURCES)
    spacings, found, cells = [], [], COARSEST
    while len(spacings) < PILOTS:
        spacing = spacing_for(scene.geometry, smallest_feature(scene.geometry) / cells, _lattice(scene))
        if spacing not in spacings:
            pilot = at(spacing)
            spacings.append(spacing)
            found.append(standard_values(simulate(build_case(pilot, nodes_of(pilot))), pilot))
            log(f"pilot run at {1e3 * spacing:.4g} mm")
        cells += 2
    fits = {name: _fit(spacings, [values[name] for values in found], order) for name in found[0]}
    slopes = {name: slope for name, (slope, _) in fits.items()}
    return _Pilots(tuple(spacings), slopes, max(misfit for _, misfit in fits.values()), order)


def _lattice(scene: Scene) -> bool:
    return scene.mesh.cells == "quadrilateral" and not scene.geometry.holes


def _fit(spacings: list[float], values: list[np.ndarray], order: float) -> tuple[float, float]:
    """Relative error per spacing to the power of the order, and the relative misfit, of ``q + c h^p``."""
    h, q = np.asarray(spacings) ** order, np.asarray(values)
    basis = np.column_stack([np.ones_like(h), h])
    (limit, slope), *_ = np.linalg.lstsq(basis, q, rcond=None)
    fitted = basis @ np.array([limit, slope])
    misfit = max(distance(value, fit) for value, fit in zip(q, fitted, strict=True))
    return distance(limit + slope, limit), misfit
