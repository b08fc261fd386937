"""Studies: many scenes made from one by changing values, and the identity of every stage of each.

A study file names a scene and what to change in it::

    study:
      name: spacing
      scene: config/scenes/mode_i.yaml
      set: {time.end: 1e6 s}                       # for every case
      sweep: {mesh.spacing: [1 mm, 2 mm]}          # one case a value; several keys give every combination
      cases:                                       # named cases, combined with the sweep
        wet: {}
        fast: {scene: config/scenes/mode_i_fast.yaml, solver.tolerance: 1e-7}
      figures: {dpi: 150}

Every stage (mesh and nodes, solve) is named by a digest of just those parts of the scene that it reads. Two cases,
of one study or of two, that agree in these parts share the result; a value put back finds its old result again.
"""

import csv
import difflib
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from pdhe.errors import SceneError
from pdhe.provenance import canonical, digest
from pdhe.scene import load_scene
from pdhe.scene_umat import identity_of
from pdhe.yamlfile import find_file, is_file, read_yaml

STUDY_KEYS = ("name", "scene", "set", "sweep", "cases", "figures")
CONFIG_KEYS = (
    "studies", "figures", "study", "verification", "verification_docs", "check", "benchmarks", "tradeoff", "dynamics",
)  # fmt: skip
"""Keys of a workflow configuration."""

PICTURES = {"damage": "damage", "displacement": "loads", "coverage": "hydrogen", "state": "material.umat.states"}
"""Pictures of a case, each with the part of the scene that has to be there for it."""

STYLE_KEYS = (
    "times",
    "panels",
    "dpi",
    "width",
    "font_size",
    "damage_map",
    "coverage_map",
    "displacement_map",
    "state",
    "state_map",
    "damage_limit",
    "component",
    "magnification",
    "window",
    "frames",
    "frame_width",
    "duration",
    "hold",
)
"""Keys that :mod:`pdhe.plotting` knows; written out because reading a study must not load matplotlib."""

UNTOLD = ("title", "outputs.times")
"""Values that the table of cases leaves out, words and long lists."""

SPEC_LIMIT = 100_000
"""Longest description of a stage in bytes; it travels on a command line, where one argument may hold 128 kB."""

RESERVED = ("store", "verification", "benchmarks", "tradeoff", "extremes", "umat")
"""Folders of results that belong to no study."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._=+-]*")
_LONGEST_NAME = 120


@dataclass(frozen=True)
class Case:
    """One scene of a study, in SI, with the identities of its stages."""

    study: str
    name: str
    scene: str
    resolved: dict[str, Any] = field(repr=False)
    pictures: tuple[str, ...] = ()

    @cached_property
    def mesh_spec(self) -> str:
        """Canonical JSON of what the mesh and the nodes depend on."""
        return canonical(self._mesh)

    @cached_property
    def mesh_id(self) -> str:
        """Name of the mesh and of the nodes made from it."""
        return f"{self._mesh_slug}-{digest(self._mesh)}"

    @cached_property
    def solve_spec(self) -> str:
        """Canonical JSON of what the solution depends on: the whole scene but for words that change no number."""
        return canonical(self._solve)

    @cached_property
    def solve_id(self) -> str:
        """Name of the solution."""
        return f"{self._mesh_slug}-{slug(self.resolved['material']['name'])}-{digest(self._solve)}"

    @property
    def _mesh(self) -> dict[str, Any]:
        return {key: self.resolved[key] for key in ("geometry", "mesh")}

    @property
    def _solve(self) -> dict[str, Any]:
        spec = {key: value for key, value in self.resolved.items() if key != "title"}
        spec["material"] = {key: value for key, value in spec["material"].items() if key != "source"}
        if "umat" in spec["material"]:
            spec["material"]["umat"] = identity_of(spec["material"]["umat"])
        return spec

    @property
    def user_material(self) -> tuple[str, str] | None:
        """Name of the compiled user material of this case and the file it comes from; None where it has none."""
        umat = self.resolved["material"].get("umat")
        if umat is None or "loads" not in self.resolved:
            return None
        file = umat.get("source") or umat["library"]
        return f"{slug(Path(file).name).replace('.', '_')}-{umat['content']}", file

    @property
    def _mesh_slug(self) -> str:
        plate, mesh = self.resolved["geometry"]["plate"], self.resolved["mesh"]
        size = f"{1e3 * plate['width']:.6g}x{1e3 * plate['height']:.6g}mm"
        return f"{size}-{1e3 * mesh['spacing']:.6g}mm-{slug(str(mesh['cells']))[:4]}"


@dataclass(frozen=True)
class Study:
    """The cases of one study file and the style of its figures."""

    name: str
    file: str
    cases: tuple[Case, ...]
    animations: bool = True
    style: dict[str, Any] = field(default_factory=dict)
    named: tuple[str, ...] = ()
    """Named cases; the cases are every one of them, in this order, with every combination of the swept values."""
    sweep: dict[str, list[Any]] = field(default_factory=dict)
    """Swept keys with their values as the file gives them; the last one changes fastest."""

    def table(self, outcomes: Mapping[str, Mapping[str, object]] | None = None) -> str:
        """Return the cases as CSV: names and identities, every value that differs between them, and how each ended.

        Parameters
        ----------
        outcomes
            Numbers that sum up a solution, by its identity; they become the last columns.
        """
        flat = [dict(_flatten(case.resolved)) for case in self.cases]
        keys = [key for key in dict.fromkeys(key for row in flat for key in row) if key not in UNTOLD]
        varying = [key for key in keys if any(row.get(key) != flat[0].get(key) for row in flat)]
        ends = [(outcomes or {}).get(case.solve_id, {}) for case in self.cases]
        ended = list(dict.fromkeys(key for end in ends for key in end))
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["case", "scene", "mesh", "solve", *varying, *ended])
        for case, row, end in zip(self.cases, flat, ends, strict=True):
            names = [case.name, case.scene, case.mesh_id, case.solve_id]
            writer.writerow(names + [_cell(row.get(key)) for key in varying] + [_cell(end.get(key)) for key in ended])
        return text.getvalue()


def load_studies(config: Mapping[str, Any], configfiles: Iterable[str | Path] = ()) -> tuple[Study, ...]:
    """Read the studies that a workflow configuration asks for.

    Parameters
    ----------
    config
        Keys ``studies`` (list of study files), ``figures`` (style for all) and, from a study file that was itself
        given as configuration, ``study``; only the latter runs then. ``verification`` and ``check`` belong to
        :mod:`pdhe.verification.studies`, ``tradeoff`` to :mod:`pdhe.tradeoff.design`.
    configfiles
        Files the configuration came from. Those that hold a ``study`` are read again from the file, each by itself.

    Raises
    ------
    SceneError
        For anything in the configuration, the studies or their scenes that cannot be used.
    """
    source = "configuration"
    for key in config:
        _known(source, key, CONFIG_KEYS)
    if "check" in config or isinstance(config.get("tradeoff"), Mapping):
        return ()
    if "study" in config:
        files = [str(file) for file in configfiles if "study" in (read_yaml(file) or {})]
        if not files:
            raise SceneError(source, "study", None, "a study has to come from a file", "list the file under 'studies'")
    else:
        files = config.get("studies") or []
        if not isinstance(files, list) or not files:
            raise SceneError(
                source, "studies", files, "needs a list of study files", f"known keys: {', '.join(CONFIG_KEYS)}"
            )
    found = dict.fromkeys(find_file(str(file), configfiles) for file in files)
    studies = tuple(load_study(file, config.get("figures")) for file in found)
    seen: dict[str, str] = {}
    for study in studies:
        if study.name in seen:
            raise SceneError(
                study.file, "study.name", study.name, f"already the name of the study in {seen[study.name]}"
            )
        seen[study.name] = study.file
    return studies


def load_aside(config: Mapping[str, Any], configfiles: Iterable[str | Path] = ()) -> tuple[Study, ...]:
    """Read the studies that have a target of their own and that the main job leaves alone: ``dynamics``.

    None where the configuration asks for one study, one check or a study of the trade alone.
    """
    alone = "study" in config or "check" in config or isinstance(config.get("tradeoff"), Mapping)
    file = config.get("dynamics")
    if alone or file is None:
        return ()
    if not isinstance(file, str):
        raise SceneError("configuration", "dynamics", file, "needs the path of a study file")
    return (load_study(find_file(file, configfiles), config.get("figures")),)


def load_study(path: str | Path, figures: Mapping[str, Any] | None = None) -> Study:
    """Read one study file and resolve every case of it.

    Parameters
    ----------
    path
        Study file; scene files it names are looked for from the working directory, then beside it and in the
        folders above.
    figures
        Style that the ``figures`` block of the file overrides key by key.

    Raises
    ------
    SceneError
        For anything in the file or in the scenes it names that cannot be used.
    """
    file = str(path)
    if not is_file(path):
        raise SceneError(file, "", None, "no such study file")
    content = _mapping(file, "", read_yaml(path))
    for key in content:
        _known(file, key, ("study", "figures"))
    study = _mapping(file, "study", content.get("study"))
    for key in study:
        _known(file, f"study.{key}", STUDY_KEYS)
    name = folder_name(file, "study.name", study.get("name", Path(path).stem))
    style = _mapping("configuration", "figures", figures or {})
    for block in (content.get("figures"), study.get("figures")):
        style.update(_mapping(file, "study.figures", block or {}))
    for key in style:
        _known(file, f"study.figures.{key}", ("pictures", "animations", *STYLE_KEYS))
    animations = style.pop("animations", True)
    if not isinstance(animations, bool):
        raise SceneError(file, "study.figures.animations", animations, "needs true or false")
    cases = tuple(_cases(file, name, study, _wanted(file, style)))
    named = tuple(given for given in _named(file, study) if given)
    return Study(name, file, cases, animations, style, named, _sweep(file, study))


def _cases(file: str, study_name: str, study: Mapping[str, Any], wanted: Sequence[str]) -> Iterable[Case]:
    """Yield the cases: every named case with every combination of the swept values."""
    base = _mapping(file, "study.set", study.get("set") or {})
    sweep = _sweep(file, study)
    label = labels(sweep)
    seen: set[str] = set()
    for given, block in _named(file, study).items():
        place = f"study.cases.{given}"
        changes = dict(_mapping(file, place, block or {}))
        scene = _scene_file(file, f"{place}.scene" if "scene" in changes else "study.scene", changes, study)
        for key in sweep:
            if key in changes:
                hint = "give the value in one place"
                raise SceneError(file, f"{place}.{key}", changes[key], "is swept as well", hint)
        places = {key: f"study.set.{key}" for key in base} | {key: f"study.sweep.{key}" for key in sweep}
        places |= {key: f"{place}.{key}" for key in changes}
        for values in product(*sweep.values()):
            swept = dict(zip(sweep, values, strict=True))
            parts = [f"{label[key]}={text_of(value)}" for key, value in swept.items()]
            name = _short("_".join(([given] if given else []) + parts)) or "base"
            if name in seen:
                raise SceneError(file, place if given else "study.sweep", name, "two cases have the same name")
            seen.add(name)
            resolved = _resolve(file, scene, {**base, **swept, **changes}, places)
            pictures = tuple(kind for kind, part in PICTURES.items() if kind in wanted and _has(resolved, part))
            case = Case(study_name, name, scene, resolved, pictures)
            if len(case.solve_spec) > SPEC_LIMIT:
                hint = "use fewer output times or shorter tables"
                raise SceneError(scene, "", None, "the scene is too long to pass to a solve", hint)
            yield case


def _has(resolved: Mapping[str, Any], part: str) -> bool:
    """Tell whether a scene has a part that is not empty; user materials come with loads alone."""
    place: Any = resolved
    for key in part.split("."):
        place = place.get(key)
        if place is None or (key == "umat" and "loads" not in resolved):
            return False
    return len(place) > 0


def _sweep(file: str, study: Mapping[str, Any]) -> dict[str, Any]:
    """Return the swept keys with their values."""
    sweep = _mapping(file, "study.sweep", study.get("sweep") or {})
    for key, values in sweep.items():
        if not isinstance(values, list) or not values:
            raise SceneError(file, f"study.sweep.{key}", values, "needs a list of at least one value")
    return sweep


def _named(file: str, study: Mapping[str, Any]) -> dict[str, Any]:
    """Return the named cases with their changes; one without a name where the study names none."""
    if "cases" not in study:
        return {"": {}}
    named = _mapping(file, "study.cases", study["cases"])
    if not named:
        raise SceneError(file, "study.cases", None, "names no case")
    for name in named:
        folder_name(file, f"study.cases.{name}", name)
    return named


def _resolve(file: str, scene: str, changes: dict[str, Any], places: Mapping[str, str]) -> dict[str, Any]:
    """Load a scene with changes; an error in a changed value is reported where the study file makes the change."""
    try:
        return load_scene(scene, changes).resolved()
    except SceneError as error:
        for key, place in places.items():
            if error.key == key or error.key.startswith(f"{key}."):
                problem = error.problem if error.key == key else f"{error.key.removeprefix(f'{key}.')}: {error.problem}"
                hint = re.sub(r"(; this value|it) was set from outside the file$", "", error.hint)
                raise SceneError(file, place, error.value, problem, hint) from error
        load_scene(scene)  # an error of the scene itself is reported as one
        blamed = [place for key, place in places.items() if key.startswith(f"{error.key}.")] or list(places.values())
        raise SceneError(file, blamed[0] if blamed else "", None, f"does not fit the scene: {error}") from error


def _scene_file(file: str, key: str, changes: dict[str, Any], study: Mapping[str, Any]) -> str:
    """Return the path of the scene of a case, and take it out of the changes."""
    scene = changes.pop("scene", study.get("scene"))
    if not isinstance(scene, str):
        raise SceneError(file, key, scene, "needs the path of a scene file", "for example config/scenes/mode_i.yaml")
    found = find_file(scene, [file])
    if not is_file(found):
        beside = Path(file).parent / scene
        raise SceneError(
            file,
            key,
            scene,
            "no such scene file",
            f"looked for {scene}, {beside}, in folders above it and in the checkout",
        )
    return found


def _wanted(file: str, style: dict[str, Any]) -> Sequence[str]:
    """Take the list of pictures out of the style block; all kinds where there is none."""
    wanted = style.pop("pictures", list(PICTURES))
    if not isinstance(wanted, list):
        raise SceneError(file, "study.figures.pictures", wanted, "needs a list", f"of {', '.join(PICTURES)}")
    for kind in wanted:
        if not isinstance(kind, str) or kind not in PICTURES:
            raise SceneError(file, "study.figures.pictures", kind, "no such picture", _nearest(str(kind), PICTURES))
    return wanted


def slug(text: str) -> str:
    """Return `text` in lower case with everything but letters, digits, dot, plus and minus turned into dashes."""
    return re.sub(r"[^a-z0-9.+]+", "-", text.lower()).strip("-")


def labels(sweep: Iterable[str]) -> dict[str, str]:
    """Return the last part of each swept key, or all of it where two keys end alike."""
    last = {key: key.rpartition(".")[2] for key in sweep}
    return {key: key if list(last.values()).count(label) > 1 else label for key, label in last.items()}


def text_of(value: object) -> str:
    """Write a swept value so that it can stand in a file name."""
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.12g}"
    if isinstance(value, dict | list):
        return digest(value, 6)
    return re.sub(r"[^A-Za-z0-9.+-]+", "-", str(value).replace(" ", "")).rstrip("-")


def _cell(value: object) -> object:
    """Write a number of a table with the digits a reader may want."""
    return f"{value:.8g}" if isinstance(value, float) else value


def _short(name: str) -> str:
    """Shorten a name that a file system might refuse; a digest of the whole keeps it unique."""
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 11]}-{digest(name)}"


def folder_name(file: str, key: str, name: object) -> str:
    """Return a name that a folder of results can have: it stands in paths and on command lines.

    Raises
    ------
    SceneError
        For any other name, at this place of this file.
    """
    name = str(name)
    if not _NAME.fullmatch(name) or name in RESERVED:
        fitting = "use letters, digits and . _ = + - , a letter or digit first"
        hint = f"{', '.join(RESERVED)} are reserved" if name in RESERVED else fitting
        raise SceneError(file, key, name, "cannot name a folder of results", hint)
    return name


def _mapping(file: str, key: str, value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise SceneError(file, key, value, "needs 'key: value' lines", "" if key else "start with 'study:'")
    return {str(name): item for name, item in value.items()}


def _known(file: str, key: str, known: Sequence[str]) -> None:
    name = key.rpartition(".")[2]
    if name not in known:
        raise SceneError(file, key, None, "unknown key", _nearest(name, known))


def _nearest(name: str, known: Iterable[str]) -> str:
    known = list(known)
    close = difflib.get_close_matches(name, known, 1)
    return f"did you mean '{close[0]}'?" if close else f"known: {', '.join(known)}"


def _flatten(value: object, prefix: str = "") -> Iterable[tuple[str, object]]:
    """Yield the leaves of a resolved scene with dotted keys; lists of numbers or words stay whole, as JSON."""
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        value = {str(place): item for place, item in enumerate(value)}
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _flatten(item, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, canonical(value) if isinstance(value, list | tuple) else value
