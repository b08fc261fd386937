"""Settings from an accuracy: pilot runs on coarse meshes tell how far off they are, measured orders how errors fall."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from pdhe.case import EDGES, build_case
from pdhe.errors import SceneError
from pdhe.fidelity import SETTINGS, kind_of, smallest_feature, spacing_for
from pdhe.provenance import PACKAGE
from pdhe.scene import load_scene
from pdhe.scene_fields import Accuracy
from pdhe.scene_reading import read_scene_file, reporting
from pdhe.simulation import Progress, simulate
from pdhe.tradeoff.quantities import distance, standard_values
from pdhe.verification.slabs import nodes_of

#: What the study of speed against accuracy measured; written by ``pdhe tradeoff-page --models``.
MODELS = PACKAGE / "tradeoff" / "models.json"
#: Cells along the smallest feature in the coarsest pilot run, and the number of pilot runs.
COARSEST, PILOTS = 6, 3
#: Order at which hydrogen from cracks and holes converges: its nodes are held half a cell inside (docs/limits.md).
ORDER_OF_INNER_SOURCES = 1.0
#: Tolerance of equilibria over the wanted accuracy: reactions were off by up to seven tolerances.
TOLERANCE = 0.01
#: Share of it that is aimed at: elastic and diffusion scenes that were held back needed up to 1.7 times the prediction.
AIM = 0.75


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
    raw = read_scene_file(path)
    if raw.get("accuracy") is None:
        raise SceneError(file, "accuracy", None, "is missing", "for example `accuracy: 2 %`")
    with reporting(file, raw):
        accuracy = TypeAdapter(Accuracy).validate_python(raw.get("accuracy"))
    base = {"accuracy": None, "fidelity": "fine", "mesh.spacing": None}
    scene = load_scene(path, base)
    kind = kind_of(scene.resolved())
    if kind == "fracture" and scene.hydrogen is not None and scene.hydrogen.saturation is not None:
        text = "cannot be promised: where fresh crack faces are saturated, cracks grow the faster the finer the mesh"
        raise SceneError(file, "accuracy", accuracy, text, "give `mesh.spacing` or a `fidelity` instead")
    model = json.loads(MODELS.read_text(encoding="utf-8"))["kinds"][kind]
    order = model["order"]
    if scene.hydrogen is not None and not {item.on for item in scene.hydrogen.boundary} <= set(EDGES):
        order = min(order, ORDER_OF_INNER_SOURCES)
    settings = SETTINGS[kind]["fine"]
    changes: dict[str, Any] = {}
    if scene.loads is not None:
        changes["solver.tolerance"] = float(f"{TOLERANCE * accuracy:.2g}")
    if scene.horizon.ratio == settings.ratio and settings.ratio != 3.015:
        changes["horizon.ratio"] = settings.ratio
    lattice = scene.mesh.cells == "quadrilateral" and not scene.geometry.holes
    feature = smallest_feature(scene.geometry)
    spacings, found, cells = [], [], COARSEST
    while len(spacings) < PILOTS:
        spacing = spacing_for(scene.geometry, feature / cells, lattice)
        if spacing not in spacings:
            pilot = load_scene(path, {**base, **changes, "mesh.spacing": f"{spacing!r} m"})
            spacings.append(spacing)
            found.append(standard_values(simulate(build_case(pilot, nodes_of(pilot))), pilot))
            log(f"pilot run at {1e3 * spacing:.4g} mm")
        cells += 2
    fits = {name: _fit(spacings, [values[name] for values in found], order) for name in found[0]}
    scatter = max(misfit for _, misfit in fits.values())
    if scatter > 0.5 * accuracy:
        text = f"cannot be promised: errors of pilot runs scatter by {100.0 * scatter:.2g} % about any order"
        raise SceneError(file, "accuracy", accuracy, text, "accept more, or give a `fidelity`")
    steepest = max(slope for slope, _ in fits.values())
    wanted = min((AIM * accuracy / steepest) ** (1.0 / order), spacings[0])
    spacing = spacing_for(scene.geometry, wanted, lattice)
    changes = {"mesh.spacing": f"{1e3 * spacing!r} mm", **changes}
    errors = {name: slope * spacing**order for name, (slope, _) in fits.items()}
    return Choice(changes, accuracy, max(errors.values()), errors)


def _fit(spacings: list[float], values: list[np.ndarray], order: float) -> tuple[float, float]:
    """Relative error per spacing to the power of the order, and the relative misfit, of ``q + c h^p``."""
    h, q = np.asarray(spacings) ** order, np.asarray(values)
    basis = np.column_stack([np.ones_like(h), h])
    (limit, slope), *_ = np.linalg.lstsq(basis, q, rcond=None)
    fitted = basis @ np.array([limit, slope])
    misfit = max(distance(value, fit) for value, fit in zip(q, fitted, strict=True))
    return distance(limit + slope, limit), misfit
