"""The scene: everything that one simulation is asked to do, read from a YAML file, checked and frozen.

All attributes are SI. :func:`load_scene` reads the written form (quantities with units); :meth:`Scene.resolved` and
:meth:`Scene.from_resolved` convert to and from plain nested dictionaries of SI numbers.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from pdhe import scene_fields as fields
from pdhe.fidelity import LONG_RATIO, fill_in, usual_ratio, usual_tolerance
from pdhe.scene_blocks import (
    FIDELITIES,
    CoverageCondition,
    Crack,
    Damage,
    Disc,
    Displacement,
    Geometry,
    Hole,
    Horizon,
    Hydrogen,
    Load,
    Material,
    Mechanics,
    Mesh,
    Outputs,
    Plate,
    Refinement,
    Region,
    Saturation,
    Solver,
    Stepping,
    Time,
)
from pdhe.scene_checks import check_scene, reserved_names
from pdhe.scene_fields import Block, choice
from pdhe.scene_history import PiecewiseLinear
from pdhe.scene_reading import material_mapping, override, read_scene_file, reporting
from pdhe.scene_tables import read_tables
from pdhe.scene_umat import find_files
from pdhe.units import round15

__all__ = [
    "CoverageCondition",
    "Crack",
    "Damage",
    "Disc",
    "Displacement",
    "Geometry",
    "Hole",
    "Horizon",
    "Hydrogen",
    "Load",
    "Material",
    "Mechanics",
    "Mesh",
    "Outputs",
    "PiecewiseLinear",
    "Plate",
    "Refinement",
    "Region",
    "Saturation",
    "Scene",
    "Solver",
    "Stepping",
    "Time",
    "load_scene",
    "scene_json_schema",
]


class Scene(Block):
    """One simulation: geometry, mesh, material, physics, time and outputs. Blocks that are absent are None."""

    title: fields.Text = "Untitled scene"
    fidelity: Annotated[str, choice(*FIDELITIES)] | None = None
    accuracy: fields.Accuracy | None = None
    geometry: Geometry
    regions: Annotated[tuple[Region, ...], BeforeValidator(fields.as_list)] | None = None
    mesh: Mesh
    material: Material
    mechanics: Mechanics = Mechanics()
    loads: Annotated[tuple[Load, ...], BeforeValidator(fields.as_list)] | None = None
    damage: Damage | None = None
    # After what its default depends on.
    horizon: Horizon = Field(default=None, validate_default=True)
    hydrogen: Hydrogen | None = None
    time: Time
    stepping: Stepping = Stepping()
    solver: Solver = Field(default=Solver(), validate_default=True)
    outputs: Outputs = Field(default=Outputs(), validate_default=True)

    @field_validator("horizon", mode="before")
    @classmethod
    def _usual_horizon(cls, horizon: Any, info: ValidationInfo) -> Any:
        given = info.data
        if horizon is not None or not {"geometry", "mesh", "mechanics", "loads", "damage"} <= set(given):
            return Horizon(ratio=LONG_RATIO) if horizon is None else horizon
        # What the short horizon is worth has been measured with this model.
        measured = given["loads"] is None or given["mechanics"].model == "condensed rotation"
        return Horizon(ratio=usual_ratio(given["geometry"], given["mesh"], given["damage"] is None and measured))

    @field_validator("solver", mode="after")
    @classmethod
    def _usual_tolerance(cls, solver: Solver, info: ValidationInfo) -> Solver:
        given = info.data
        if solver.tolerance is not None or not {"mechanics", "damage"} <= set(given):
            return solver
        # Measured at small strains.
        tolerance = usual_tolerance(given["damage"] is not None and given["mechanics"].strain == "small")
        return solver.model_copy(update={"tolerance": tolerance})

    @field_validator("outputs", mode="after")
    @classmethod
    def _resolve_outputs(cls, outputs: Outputs, info: ValidationInfo) -> Outputs:
        if "time" not in info.data:
            return outputs
        times = outputs.at(info.data["time"].end)
        return Outputs.model_construct(every=None, count=None, times=times, error_estimate=outputs.error_estimate)

    @model_validator(mode="after")
    def _check(self) -> "Scene":
        check_scene(self)
        return self

    @property
    def horizon_length(self) -> float:
        """The horizon (m)."""
        if self.horizon.length is not None:
            return self.horizon.length
        return round15((self.horizon.ratio or 0.0) * self.mesh.spacing)

    @property
    def plane(self) -> str | None:
        """What vanishes across the plate, ``stress`` or ``strain``; None in space."""
        return None if self.mesh.solid else self.mechanics.plane

    @property
    def node_sets(self) -> tuple[str, ...]:
        """Names of all node sets: the four edges, ``all``, in space the two faces, then holes, cracks, regions."""
        holes = (hole.name for hole in self.geometry.holes)
        regions = (region.name for region in self.regions or ())
        return (*reserved_names(self), *holes, *(crack.name for crack in self.geometry.cracks), *regions)

    def resolved(self) -> dict[str, Any]:
        """Return the scene as nested dicts and lists of SI numbers and strings; absent blocks are left out."""
        return cast(dict[str, Any], _plain(self))

    @classmethod
    def from_resolved(cls, data: Mapping[str, Any], file: str = "resolved scene") -> "Scene":
        """Build the scene that :meth:`resolved` described; ``file`` is used in messages.

        Raises
        ------
        SceneError
            If the data are not those of a valid scene.
        """
        with reporting(file, data):
            return cls.model_validate(data, context={"si": True})

    def __hash__(self) -> int:
        return hash(json.dumps(self.resolved(), sort_keys=True))


def _plain(value: Any) -> Any:
    if isinstance(value, Block):
        plain = {}
        for name, field in type(value).model_fields.items():
            item = getattr(value, name)
            if item is not None:
                plain[field.alias or name] = _plain(item)
            elif name in value.null_means_off:
                plain[field.alias or name] = "off"
        return plain
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    return dict(value) if isinstance(value, dict) else value


def load_scene(
    path: str | Path, overrides: Mapping[str, Any] | None = None, materials_dir: str | Path | None = None
) -> Scene:
    """Read, complete and check a scene file.

    Parameters
    ----------
    path
        The YAML file.
    overrides
        Values that replace those of the file, by dotted key, for example ``{"mesh.spacing": "2 mm"}``; entries of a
        list are counted from zero (``loads.0.displacement.y``). None puts a key back to its default.
    materials_dir
        Folder of material files. By default ``materials`` beside the folder of the scene file, then
        ``config/materials`` below the current folder.

    Raises
    ------
    SceneError
        If anything in the file, the overrides or the material file cannot be used.
    """
    file = str(path)
    raw = read_scene_file(path)
    if isinstance(raw.get("material"), str):
        raw["material"] = material_mapping(file, raw["material"], materials_dir, Material)
    for key, value in (overrides or {}).items():
        override(raw, key, value, file)
        if isinstance(raw.get("material"), str):
            raw["material"] = material_mapping(file, raw["material"], materials_dir, Material)
    fill_in(raw, file)
    find_files(raw, file)
    read_tables(raw, file)
    with reporting(file, raw, tuple(overrides or ())):
        return Scene.model_validate(raw)


def scene_json_schema() -> dict[str, Any]:
    """Return the JSON schema of the written form, for editors that complete and check YAML."""
    schema = Scene.model_json_schema()
    material = schema["properties"]["material"]
    name = {"type": "string", "description": "name of a material file, for example `AISI 4340`"}
    schema["properties"]["material"] = {"anyOf": [name, material]}
    # A fidelity gives the spacing where the scene does not.
    schema["required"].remove("mesh")
    schema["$defs"]["Mesh"]["required"].remove("spacing")
    schema["$defs"]["Hydrogen"]["properties"]["saturation"]["anyOf"].append({"const": "off"})
    states = schema["$defs"]["Umat"]["properties"]["states"]
    states["items"] = {"anyOf": [states["items"], {"type": "string"}]}
    schema["$defs"]["Umat"]["properties"]["states"] = {"anyOf": [{"type": "integer", "minimum": 0}, states]}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "pdhe scene",
        **cast(dict[str, Any], _without_titles(schema)),
    }


def _without_titles(schema: Any) -> Any:
    """Drop the titles that pydantic makes from attribute names; they tell an editor nothing."""
    if isinstance(schema, list):
        return [_without_titles(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    return {key: _without_titles(item) for key, item in schema.items() if key != "title" or isinstance(item, dict)}
