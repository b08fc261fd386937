"""From files and overrides to the raw mapping of a scene, and from pydantic's errors to messages for people."""

import copy
import difflib
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from pdhe.errors import SceneError
from pdhe.yamlfile import read_yaml


def read_scene_file(path: str | Path) -> dict[str, Any]:
    """Read a scene file into a raw mapping of its own."""
    return copy.deepcopy(read_yaml(path))


def material_slug(name: str) -> str:
    """Return the file name (without suffix) of a material: ``AISI 4340`` is ``aisi-4340``."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def material_mapping(
    scene_file: str, name: str, materials_dir: str | Path | None, model: type[BaseModel]
) -> dict[str, Any]:
    """Find, read and check the material file for ``name``; return its raw mapping.

    Raises
    ------
    SceneError
        If there is no such material, or its file is not valid (the message then names the material file).
    """
    if materials_dir is not None:
        folders = [Path(materials_dir)]
    else:
        folders = [
            Path(scene_file).parent.parent / "materials",
            Path("config/materials"),
            Path(__file__).parent.parent / "config" / "materials",
        ]
    slug = material_slug(name)
    known: dict[str, Path] = {}
    for folder in folders:
        for found in sorted(folder.glob("*.yaml")) if folder.is_dir() else []:
            known.setdefault(found.stem, found)
    if slug not in known:
        near = difflib.get_close_matches(slug, known, 1, 0.4)
        listed = ", ".join(f"`{item}`" for item in sorted(known)) or f"none in {folders[0]}"
        hint = (f"did you mean `{near[0]}`? " if near else "") + f"known materials: {listed}"
        raise SceneError(scene_file, "material", name, "is not a known material", hint)
    path = known[slug]
    raw = read_yaml(path)
    with reporting(str(path), raw):
        model.model_validate(raw)
    return copy.deepcopy(raw)


def override(raw: dict[str, Any], key: str, value: Any, file: str) -> None:
    """Set the dotted ``key`` of ``raw`` to ``value``, in place; blocks on the way are made if absent."""
    if not isinstance(key, str) or not all(key.split(".")):
        raise SceneError(file, str(key), value, "is not a dotted key", "write it as `mesh.spacing` or `loads.0.on`")
    *parents, last = key.split(".")
    place: Any = raw
    walked: list[str] = []
    for part in parents:
        if isinstance(place, dict) and place.get(part) is None:
            place[part] = {}
        place = place[_step(place, part, walked, key, value, file)]
        walked.append(part)
    step = _step(place, last, walked, key, value, file)
    place[step] = copy.deepcopy(value)


def _step(place: Any, part: str, walked: list[str], key: str, value: Any, file: str) -> Any:
    """Return the index of ``part`` in a dict or list, or refuse the override."""
    where = ".".join(walked) or "the scene"
    if isinstance(place, dict):
        return part
    if isinstance(place, list):
        if part.isdecimal() and len(part) < 7 and int(part) < len(place):
            return int(part)
        hint = f"`{where}` has the entries 0 to {len(place) - 1}" if place else f"`{where}` is empty"
        raise SceneError(file, key, value, f"cannot be set: `{part}` is not an entry of `{where}`", hint)
    raise SceneError(file, key, value, f"cannot be set: `{where}` is a single value", f"set `{where}` itself")


@contextmanager
def reporting(file: str, raw: Any, overridden: tuple[str, ...] = ()) -> Iterator[None]:
    """Turn the first pydantic error raised inside into a :class:`SceneError` about ``file``.

    ``raw`` is the mapping that is being validated, to show values as they were written; ``overridden`` are the dotted
    keys that did not come from the file.
    """
    try:
        yield
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        context = first.get("ctx", {})
        parts = [str(part) for part in first["loc"]]
        if context.get("key"):
            parts += context["key"].split(".") if not parts else [context["key"]]
        key = ".".join(parts)
        if "problem" in context:
            text, hint = context["problem"], context["hint"]
        else:
            text, hint = _plain_message(first["type"], first["msg"])
        if any(key == item or key.startswith(item + ".") for item in overridden):
            hint = f"{hint}; this value was set from outside the file" if hint else "it was set from outside the file"
        value = _shown(_lookup(raw, parts)) if parts else None
        raise SceneError(file, key, value, text, hint) from None


def _plain_message(kind: str, message: str) -> tuple[str, str]:
    if kind in ("dict_type", "mapping_type", "model_type"):
        return "must be a block of keys", "write `key: value` lines below it"
    if kind in ("string_type", "invalid_key"):
        return "must be text", "quote it if it looks like a number"
    return message[:1].lower() + message[1:], ""


def _lookup(raw: Any, parts: list[str]) -> Any:
    """Return the value at a place of the raw mapping, None if there is none."""
    place = raw
    for part in parts:
        if isinstance(place, Mapping):
            place = place.get(part, next((v for k, v in place.items() if str(k)[:60] == part), None))
        elif isinstance(place, (list, tuple)) and part.isdecimal() and int(part) < len(place):
            place = place[int(part)]
        else:
            return None
    return place


def _shown(value: Any) -> Any:
    """Shorten a value for a message."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        return "a value too large to show"
    if len(text) <= 80:
        return value
    if isinstance(value, Mapping):
        return f"a block with {len(value)} keys"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    return str(value)[:60] + "..."
