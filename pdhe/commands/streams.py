"""What commands read from their arguments and write to files, or show."""

import json
import sys
from pathlib import Path

from pdhe.errors import PdheError


def read_object(text: str, name: str) -> dict:
    """Read a JSON object given as an option."""
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise PdheError(f"{name} is not JSON: {error}") from error
    if not isinstance(value, dict):
        raise PdheError(f"{name} needs a JSON object, not {text}")
    return value


def ready(path: Path) -> Path:
    """Make the folder of a file that is about to be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def write(path: Path | None, text: str) -> None:
    """Write a text to a file, or to standard output when there is none."""
    if path is None:
        sys.stdout.write(text)
    else:
        ready(path).write_text(text, encoding="utf-8")


def progress(message: str) -> None:
    """Show the progress of a solve."""
    print(message, flush=True)
