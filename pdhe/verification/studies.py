"""Check files: which topics of the verification run, and with which settings; light enough for the workflow."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pdhe.errors import SceneError
from pdhe.verification.topics import TOPICS
from pdhe.yamlfile import find_file, is_file, read_yaml


@dataclass(frozen=True)
class Check:
    """One topic with its settings, as a file asks for it."""

    topic: str
    settings: dict[str, Any]
    file: str


def load_checks(config: Mapping[str, Any], configfiles: Iterable[str | Path] = ()) -> tuple[Check, ...]:
    """Read the checks of a workflow configuration.

    Parameters
    ----------
    config
        Key ``verification`` (list of check files), or ``check`` from a check file that was given as configuration.
    configfiles
        Files the configuration came from.

    Raises
    ------
    SceneError
        If a file is missing or names an unknown topic or key.
    """
    if "check" in config:
        files = [str(file) for file in configfiles if "check" in (read_yaml(file) or {})]
    else:
        files = config.get("verification") or []
    if not isinstance(files, list):
        raise SceneError("configuration", "verification", files, "needs a list of check files")
    return tuple(load_check(file) for file in dict.fromkeys(find_file(str(file), configfiles) for file in files))


def load_check(path: str) -> Check:
    """Read one check file."""
    if not is_file(path):
        raise SceneError(path, "", None, "no such check file")
    content = read_yaml(path)
    block = content.get("check") if isinstance(content, dict) else None
    if not isinstance(block, dict) or not isinstance(block.get("settings", {}), dict):
        raise SceneError(path, "check", block, "needs a topic and, if wanted, settings", "check: {topic: moduli}")
    for key in block:
        if key not in ("topic", "settings"):
            raise SceneError(path, f"check.{key}", block[key], "unknown key", "known: topic, settings")
    topic = block.get("topic")
    if not isinstance(topic, str) or topic not in TOPICS:
        near = difflib.get_close_matches(str(topic), TOPICS, 1)
        hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(TOPICS)}"
        raise SceneError(path, "check.topic", topic, "no such topic", hint)
    return Check(topic, block.get("settings", {}), path)
