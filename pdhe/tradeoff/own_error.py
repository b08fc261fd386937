"""The error that a result tells of itself: the run against one on a coarser mesh, by measured orders of convergence."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pdhe.case import EDGES
from pdhe.errors import PdheError, SceneError
from pdhe.fidelity import smallest_feature, spacing_for
from pdhe.forecast import coarser
from pdhe.provenance import PACKAGE
from pdhe.results import Contents
from pdhe.scene import Scene
from pdhe.simulation import compute, mesh_case
from pdhe.tradeoff.quantities import distance, standard_values

#: What the study of speed against accuracy measured; written by ``pdhe tradeoff-page --models``.
MODELS = PACKAGE / "tradeoff" / "models.json"
#: Order at which hydrogen from cracks and holes converges: its nodes are held half a cell inside (docs/limits.md). On
#: graded meshes that from edges does no better everywhere.
ORDER_OF_INNER_SOURCES = 1.0
#: Coverages on irregular nodes are told to be off by at least that much, by whether the mesh is graded: errors that
#: small do not fall evenly. With it, errors found were at most twice those told (before, seven times).
LEAST_COVERAGE = {False: 0.0005, True: 0.002}
#: By how much coarser the other mesh is, the first that can be had. Estimates from three times the spacing were as good
#: as from twice (docs/tradeoff.md), at a 27th of the work of fracture instead of an eighth.
COARSENINGS = (3.0, 2.0, 1.5)
#: Cells along the smallest feature that three times the spacing must leave; with fewer on any mesh it is told.
ENOUGH = 6
#: Cells along it below which nothing is known of how far an estimate can be trusted.
TOO_FEW = 3
#: A lattice may be so much coarser than asked for, to put cracks between rows of nodes.
ROOM = 1.1
#: Fracture: what differs between two meshes times this (once on graded meshes), and at least two per cent. Cracks
#: advance cell by cell and in jumps, so that two meshes may agree by chance. Of 119 estimates of ten scenes 4 % were
#: then below half of the error found and 6 % above thrice (errors below 1 % taken as that); with no factor and nothing
#: at least, 24 % and 4 %.
FRACTURE, LEAST = 1.5, 0.02

Log = Callable[[str], None]


@dataclass(frozen=True)
class OwnError:
    """What a run on a coarser mesh found, for the run on the scene's own to be compared with.

    Attributes
    ----------
    coarsening
        Spacing of the coarser mesh over that of the scene.
    nodes
        Of the coarser mesh.
    values
        Quantities by name (:func:`pdhe.tradeoff.quantities.standard_values`), SI.
    reason
        Why there is no such run; empty where there is one.
    """

    scene: Scene
    coarsening: float = 1.0
    nodes: int = 0
    values: Mapping[str, np.ndarray] = field(default_factory=dict)
    reason: str = ""

    def errors(self, found: Mapping[str, np.ndarray]) -> dict[str, float]:
        """Relative error expected of each quantity, given what the run on the scene's own mesh found."""
        fracture, errors = self.scene.damage is not None, {}
        for name, value in found.items():
            if name not in self.values:
                continue
            growth = self.coarsening ** order_of(self.scene, name) - 1.0
            error = distance(value, value + (value - self.values[name]) / growth)
            if fracture and settles(self.scene):
                error = max(_safety(self.scene) * error, LEAST)
            elif name == "mean_coverage" and _irregular(self.scene):
                error = max(error, LEAST_COVERAGE[bool(self.scene.mesh.refine)])
            errors[name] = error
        return errors

    def attributes(self, contents: Contents) -> dict[str, Any]:
        """What the result file says: ``predicted_error(s)`` where there are any, ``error_basis`` in any case."""
        if self.reason:
            return {"error_basis": f"not estimated: {self.reason}"}
        errors = self.errors(quantities(contents, self.scene))
        if not errors:
            return {"error_basis": "not estimated: the scene has none of the quantities that errors are known of"}
        return {
            "predicted_error": max(errors.values()),
            "predicted_errors": json.dumps(errors),
            "error_basis": self.basis(),
        }

    def basis(self) -> str:
        """Say where the estimates come from and how far they can be trusted."""
        scene = self.scene
        how = f"from a run on {self.nodes} nodes with {self.coarsening:.3g} times the spacing"
        if not settles(scene):
            return (
                f"{how}: no errors but changes from there to here, since there is no limit: cracks grow the faster the "
                "finer the mesh where fresh crack faces are saturated"
            )
        orders = sorted({order_of(scene, name) for name in self.values})
        parts = [f"{how}, errors of order {' and '.join(f'{order:g}' for order in orders)}"]
        if scene.damage is not None:
            parts.append(f"times {_safety(scene):g} and at least {100.0 * LEAST:g} %, as cracks advance in jumps")
        parts.append(f"right {self._trust()}")
        if scene.stepping.mode == "fixed":
            parts.append("without the error of the fixed steps")
        if scene.horizon.length is not None:
            parts.append("against a horizon that shrinks with the spacing")
        return "; ".join(parts)

    def _trust(self) -> str:
        scene = self.scene
        coarse = self.coarsening * scene.mesh.spacing
        if scene.damage is not None and (scene.mesh.solid or scene.stepping.mode == "dynamic" or scene.damage.regions):
            return "by an unknown factor, never measured for fracture of this kind"
        if scene.mesh.cells == "tetrahedron":
            return "by an unknown factor, never measured on tetrahedra"
        if not scene.mesh.refine and smallest_feature(scene.geometry) < (TOO_FEW - 1e-9) * coarse:
            return f"by an unknown factor, as there are fewer than {TOO_FEW} cells along the smallest feature"
        few = not scene.mesh.refine and smallest_feature(scene.geometry) < (ENOUGH - 1e-9) * coarse
        factor = 9 if few and scene.damage is not None else 3 if few or scene.damage is not None else 2
        if scene.mechanics.regions or scene.stepping.mode == "dynamic":
            factor = 3
        if scene.loads is None and _irregular(scene) and not _inner(scene):
            return "in that errors found were at most twice that, on irregular nodes often much smaller"
        share = " in nine of ten cases" if scene.damage is not None else ""
        return f"within a factor of {factor}{share}{', because of few cells along the smallest feature' * few}"


def own_error(scene: Scene, log: Log) -> OwnError:
    """Run a scene on a coarser mesh, so that the run on its own can say how far off it is; what failed is a reason.

    Costs a fifth of the run for elastic bodies and an eighth or less where time passes; a 27th in fracture on meshes of
    18 cells and more along the smallest feature.
    """
    if not scene.outputs.error_estimate:
        return OwnError(scene, reason="`outputs.error_estimate` is off")
    if scene.material.umat is not None:
        return OwnError(scene, reason="user materials are not run a second time")
    if scene.loads is not None and scene.mechanics.strain == "finite":
        return OwnError(scene, reason="the order of errors at large strains has not been measured")
    reason = "no coarser mesh fits the scene"
    for coarse in coarser_scenes(scene):
        ratio = coarse.mesh.spacing / scene.mesh.spacing
        log(f"error estimate: a run with {ratio:.3g} times the spacing, to compare with")
        try:
            case = mesh_case(coarse)
            values = quantities(compute(case), coarse)
        except PdheError as error:
            reason = f"a run on a coarser mesh fails ({error})"
            continue
        return OwnError(scene, ratio, case.discretization.volume.size, values)
    return OwnError(scene, reason=reason)


def coarser_scenes(scene: Scene) -> Iterator[Scene]:
    """The scene on coarser meshes, the one to be tried first before the others."""
    plate, spacing = scene.geometry, scene.mesh.spacing
    lattice = scene.mesh.cells == "quadrilateral" and not plate.holes
    for times in COARSENINGS:
        few = smallest_feature(plate) < ENOUGH * times * spacing
        if times == COARSENINGS[0] and (few or scene.mesh.refine):
            continue
        wanted = spacing_for(plate, ROOM * times * spacing, True) if lattice else times * spacing
        if wanted < COARSENINGS[-1] / ROOM * spacing:
            continue
        try:
            yield coarser(scene, wanted / spacing, with_horizon=True)
        except SceneError:
            continue  # too coarse for the scene's own details, which says nothing against the scene


def settles(scene: Scene) -> bool:
    """Tell whether the answer of a scene settles as the mesh is refined: not where fresh crack faces are saturated."""
    return scene.damage is None or scene.hydrogen is None or scene.hydrogen.saturation is None


def order_of(scene: Scene, name: str) -> float:
    """Order at which a quantity of a scene converges, as the study of speed against accuracy measured it."""
    kinds = json.loads(MODELS.read_text(encoding="utf-8"))["kinds"]
    if scene.damage is not None or name != "mean_coverage":
        return float(kinds["fracture" if scene.damage is not None else "elastic"]["order"])
    first = _inner(scene) or scene.mesh.refine
    return ORDER_OF_INNER_SOURCES if first else float(kinds["diffusion"]["order"])


def _safety(scene: Scene) -> float:
    return 1.0 if scene.mesh.refine else FRACTURE


def _inner(scene: Scene) -> bool:
    """Tell whether hydrogen comes from anything but edges."""
    return not {item.on for item in scene.hydrogen.boundary} <= set(EDGES)


def _irregular(scene: Scene) -> bool:
    return scene.mesh.cells not in ("quadrilateral", "hexahedron") or bool(scene.geometry.holes)


def quantities(contents: Contents, scene: Scene) -> dict[str, np.ndarray]:
    """What errors are told of; openings only of cracks that have nodes on both their sides."""
    values = standard_values(_View(contents), scene)
    sets = json.loads(contents.attributes["node_sets"])
    for crack in scene.geometry.cracks:
        name = f"opening of {crack.name}"
        if name in values and crack.start is not None and not scene.geometry.symmetry:
            rows = sets[crack.name]
            x, y = (contents.variables[axis].values[rows] for axis in ("node_x", "node_y"))
            (x0, y0), (x1, y1) = crack.start, crack.end
            away = (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
            least = 1e-6 * np.abs(away).max(initial=0.0)
            # A crack along a row of nodes counts that row alone (docs/limits.md), on one of its sides.
            if not ((away > least).any() and (away < -least).any()):
                del values[name]
    return values


class _View:
    """Contents of a result as functions of a dataset see them: no need to load xarray."""

    def __init__(self, contents: Contents) -> None:
        self.data_vars, self.attrs = contents.variables, contents.attributes

    def __contains__(self, name: str) -> bool:
        return name in self.data_vars

    def __getitem__(self, name: str) -> Any:
        return self.data_vars[name]
