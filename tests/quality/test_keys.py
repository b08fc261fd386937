"""Every key of a scene is among those that tests spoil: a new one goes into tests/every_key.py."""

from pathlib import Path

from pdhe.scene import scene_json_schema
from pdhe.yamlfile import parse_yaml, read_yaml
from tests.every_key import SCENES

ROOT = Path(__file__).parents[2]


def paths_of(value, path=()):
    """Keys of a nested value from its top, entries of lists without their number."""
    if isinstance(value, list):
        return {found for item in value for found in paths_of(item, path)}
    if not isinstance(value, dict):
        return {path}
    return {path} | {found for key, item in value.items() for found in paths_of(item, (*path, key))}


def paths_of_schema(schema, blocks, path=()):
    if "$ref" in schema:
        return paths_of_schema(blocks[schema["$ref"].rpartition("/")[2]], blocks, path)
    found = {path}
    for inner in (*schema.get("anyOf", ()), *([schema["items"]] if "items" in schema else ())):
        found |= paths_of_schema(inner, blocks, path)
    for key, inner in schema.get("properties", {}).items():
        found |= paths_of_schema(inner, blocks, (*path, key))
    return found


def test_every_key_is_spoilt():
    schema = scene_json_schema()
    scenes = [parse_yaml(text, "every_key.py") for text in SCENES]
    scenes += [read_yaml(path) for path in (ROOT / "config/scenes").glob("*.yaml")]
    there = {path for scene in scenes for path in paths_of(scene)}
    # What has to be compiled beforehand, and the digest of what is.
    there |= {("material", "umat", key) for key in ("library", "content")}
    assert not paths_of_schema(schema, schema["$defs"]) - there
