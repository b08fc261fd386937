"""What commands read from their arguments and write to files, or show."""

import contextlib
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path

from pdhe.errors import PdheError


def read_object(text: str, name: str) -> dict:
    """Read a JSON object given as an option."""
    try:
        value = json.loads(text)
        json.dumps(value, ensure_ascii=False).encode()  # no characters that no file takes
    except (ValueError, RecursionError) as error:
        raise PdheError(f"{name} is not JSON: {error}") from error
    if not isinstance(value, dict):
        raise PdheError(f"{name} needs a JSON object, not {text[:80]}")
    return value


def ready(path: Path) -> Path:
    """Make the folder of a file that is about to be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def write(path: Path | None, text: str, made: Mapping[str, str] | None = None) -> None:
    """Write a text to a file, with what made it if that is given, or to standard output when there is none."""
    if path is None:
        sys.stdout.write(text)
    else:
        from pdhe.wholefile import write_text

        if made:
            from pdhe.stamps import ENDINGS, stamped

            text = stamped(text, path.suffix, made) if path.suffix in ENDINGS else text
        write_text(ready(path), text)


def progress(message: str) -> None:
    """Show the progress of a solve; a full disk under the log or a closed terminal is no reason to end one."""
    try:
        print(message, flush=True)
    except OSError:
        # What is waiting to be written would fail again at the end of the process.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
        with contextlib.suppress(OSError):
            print("error: standard output cannot be written to: the rest of it is lost", file=sys.stderr, flush=True)
