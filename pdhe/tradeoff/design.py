"""The design: which scenes, which settings of each, and against which reference; light enough for the workflow."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdhe.errors import SceneError
from pdhe.provenance import digest
from pdhe.scene import Scene, load_scene
from pdhe.scene_blocks import FIDELITIES
from pdhe.study import folder_name
from pdhe.yamlfile import find_file, is_file, read_yaml

#: What may be compared, and what a reader calls it; computed in :mod:`pdhe.tradeoff.quantities`.
QUANTITIES = {
    "crack": "crack length against time",
    "failure_time": "failure time",
    "reaction": "reaction",
    "peak_reaction": "largest reaction",
    "opening": "opening of the notch",
    "mean_damage": "mean damage",
    "mean_coverage": "mean coverage against time",
    "far_coverage": "coverage of the far edge",
}
_KEYS = (
    "title",
    "scene",
    "set",
    "variants",
    "symmetric",
    "quantities",
    "also",
    "failure",
    "reference",
    "spacings",
    "knobs",
    "knobs_at",
    "together",
)


@dataclass(frozen=True)
class Run:
    """One run of a design.

    Attributes
    ----------
    group
        ``reference`` for the runs that the limit is extrapolated from, ``default``, ``fidelity``, the key of a knob
        that is turned by itself, or ``together``.
    changes
        What differs from the scene, by dotted key.
    """

    name: str
    group: str
    changes: dict[str, Any]


@dataclass(frozen=True)
class Trade:
    """One scene of the design.

    Attributes
    ----------
    file, scene
        The file of the design and the scene file.
    quantities, also
        Names out of :data:`QUANTITIES`: whose errors count, and whose errors are shown beside them.
    failure
        Growth of the crack that counts as failure, m.
    reference
        Settings of the runs that the reference is extrapolated from, and their ``spacings``, coarse to fine.
    spacings
        Spacings at which the defaults and the settings ``together`` are run; the knobs by themselves at ``knobs_at``.
    variants
        Further versions of the scene by name, overrides by dotted key. Every setting is run in all of them and in the
        scene itself, each against its own limit: where errors scatter, one scene is right by chance too often.
    symmetric
        Whether the scene is its own mirror image across its mid-height. Settings with which the broken bonds of a
        lattice are not, on any mesh, are no part of the front.
    """

    name: str
    file: str
    scene: str
    title: str
    quantities: tuple[str, ...]
    failure: float
    reference: dict[str, Any]
    spacings: tuple[str, ...]
    knobs: dict[str, list[Any]]
    knobs_at: tuple[str, ...]
    together: tuple[dict[str, Any], ...] = ()
    changes: dict[str, Any] = field(default_factory=dict)
    also: tuple[str, ...] = ()
    variants: dict[str, dict[str, Any]] = field(default_factory=dict)
    symmetric: bool = False

    @property
    def all_quantities(self) -> tuple[str, ...]:
        """What is computed of every run."""
        return self.quantities + self.also

    @property
    def versions(self) -> dict[str, dict[str, Any]]:
        """All versions of the scene by name: overrides of the scene itself, named "", and of its variants."""
        return {"": self.changes} | {name: self.changes | changes for name, changes in self.variants.items()}

    def load(self, run: Run | None = None, version: str = "") -> Scene:
        """The scene of a run; of the defaults at the first spacing without one."""
        settings = run.changes if run else {"mesh.spacing": self.spacings[0]}
        return load_scene(self.scene, self.versions[version] | settings)

    def identity(self) -> str:
        """Digest of all that the measurement depends on but the code."""
        block = {name: value for name, value in vars(self).items() if name not in ("file", "title")}
        return digest(block | {"base": {name: self.load(version=name).resolved() for name in self.versions}})

    def runs(self) -> list[Run]:
        """All runs, those of the reference first; a setting that is listed both by itself and together is run once."""
        runs: dict[tuple[bool, str], Run] = {}
        for run in self._listed():
            runs.setdefault((run.group == "reference", digest(run.changes)), run)
        return list(runs.values())

    def _listed(self) -> Iterator[Run]:
        finest = self.reference["set"]
        for spacing in self.reference["spacings"]:
            yield Run(f"{spacing}, tight", "reference", {"mesh.spacing": spacing, **finest})
        for spacing in self.spacings:
            yield Run(spacing, "default", {"mesh.spacing": spacing})
        for name in FIDELITIES:
            yield Run(name, "fidelity", {"fidelity": name, "mesh.spacing": None})
        for spacing in self.knobs_at:
            for key, values in self.knobs.items():
                for value in values:
                    # A setting that takes several keys is written as a block of them.
                    changes = dict(value) if isinstance(value, dict) else {key: value}
                    yield Run(f"{spacing}, {_told(changes)}", key, {"mesh.spacing": spacing, **changes})
        for spacing in self.spacings:
            for changes in self.together:
                yield Run(f"{spacing}, {_told(changes)}", "together", {"mesh.spacing": spacing, **changes})


def load_trades(config: Mapping[str, Any], configfiles: Iterable[str | Path] = ()) -> dict[str, Trade]:
    """Read the design that a workflow configuration names under ``tradeoff``, or is itself.

    Raises
    ------
    SceneError
        For anything in the design or its scenes that cannot be used.
    """
    named = config.get("tradeoff")
    if named is None:
        return {}
    if isinstance(named, Mapping):
        named = next((str(file) for file in configfiles if "tradeoff" in (read_yaml(file) or {})), "")
    found = find_file(named, configfiles) if isinstance(named, str) else ""
    if not is_file(found):
        raise SceneError("configuration", "tradeoff", named, "needs the path of a design")
    return load_design(found)


def load_design(path: str | Path) -> dict[str, Trade]:
    """Read a design: its scenes by name."""
    file, content = str(path), read_yaml(path)
    block = content.get("tradeoff") if isinstance(content, dict) else None
    if not isinstance(block, dict) or not block:
        raise SceneError(file, "tradeoff", block, "needs scenes by name", "as in config/studies/tradeoff.yaml")
    names = {key: folder_name(file, f"tradeoff.{key}", key) for key in block}
    trades = {}
    for key, name in names.items():
        try:
            trades[name] = _trade(file, name, block[key])
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
            hint = "write it as in config/studies/tradeoff.yaml"
            raise SceneError(file, f"tradeoff.{name}", None, f"cannot be used ({error})", hint) from error
    return trades


def _trade(file: str, name: str, block: Any) -> Trade:
    place = f"tradeoff.{name}"
    if not isinstance(block, dict):
        raise SceneError(file, place, block, "must be a block of keys", f"known: {', '.join(_KEYS)}")
    for key in block:
        if key not in _KEYS:
            near = difflib.get_close_matches(str(key), _KEYS, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(_KEYS)}"
            raise SceneError(file, f"{place}.{key}", block[key], "unknown key", hint)
    for key, kind in (("scene", str), ("quantities", list), ("reference", dict), ("spacings", list)):
        if not isinstance(block.get(key), kind):
            raise SceneError(file, f"{place}.{key}", block.get(key), f"needs a {kind.__name__}")
    for quantity in (*block["quantities"], *block.get("also", ())):
        if quantity not in QUANTITIES:
            known = ", ".join(QUANTITIES)
            raise SceneError(
                file, f"{place}.quantities", quantity, "is not a quantity of the design", f"known: {known}"
            )
    reference = {"set": {}, **block["reference"]}
    if not isinstance(reference.get("spacings"), list) or len(reference["spacings"]) < 4:
        hint = "a fit of three numbers needs a fourth to be judged by"
        raise SceneError(file, f"{place}.reference.spacings", reference.get("spacings"), "needs four spacings", hint)
    trade = Trade(
        name, file, find_file(block["scene"], [file]), block.get("title", name), tuple(block["quantities"]),
        float(block.get("failure", 0.0)), reference, tuple(block["spacings"]), dict(block.get("knobs") or {}),
        tuple(block.get("knobs_at") or block["spacings"]), tuple(block.get("together") or ()),
        dict(block.get("set") or {}), tuple(block.get("also") or ()),
        {str(key): dict(changes) for key, changes in dict(block.get("variants") or {}).items()},
        bool(block.get("symmetric", False)),
    )  # fmt: skip
    for version in trade.versions:
        trade.load(version=version)  # an error in a scene stops everything before it starts, as one in the lists does
    trade.runs()
    return trade


def _told(changes: Mapping[str, Any]) -> str:
    """Settings in words: last parts of their keys, and values."""
    told = {key: value for key, value in changes.items() if key != "mesh.spacing"}
    return ", ".join(f"{key.rpartition('.')[2].replace('_', ' ')} {value}" for key, value in told.items())
