"""What made a table or a page, written into it: comment lines before a table, meta tags in a page, and a digest.

A comment line is ``# key: "value"``, the value as JSON; ``pandas.read_csv(path, comment="#")`` reads the rest, and so
does :func:`table_of`. Of a page the tags are ``<meta name="pdhe-key" content="value">``. ``content_sha256`` is the
digest of all that is not such a line or tag.
"""

from __future__ import annotations

import csv
import hashlib
import html
import io
import json
import re
from collections.abc import Mapping
from pathlib import Path

from pdhe.provenance import fingerprint, machine, versions
from pdhe.wholefile import write_text

ENDINGS = (".csv", ".html")
"""Endings of the files that can hold a stamp."""
_DIGEST = "content_sha256"
_LINE = re.compile(r'# (\w+): (".*")\n')
_TAG = re.compile(r'<meta name="pdhe-(\w+)" content="([^"]*)">\n')
_HEAD = re.compile(r"<meta charset=[^>]*>|<head[^>]*>|<!doctype html>", re.IGNORECASE)


def made_by(module: str, command: str, **more: str) -> dict[str, str]:
    """Say what makes a file: the module and its code, versions, machine, command, and more about where it is from.

    Parameters
    ----------
    module
        Dotted name inside the package, whose fingerprint is that of the code.
    command
        The command line.
    """
    return {
        **more,
        "module": module,
        "code_fingerprint": fingerprint(module),
        "versions": json.dumps(versions(), sort_keys=True),
        "machine": machine(),
        "command": command,
    }


def stamped(text: str, ending: str, made: Mapping[str, str]) -> str:
    """Return the text of a table (``.csv``) or a page (``.html``) with what made it; what it said of that is gone."""
    text = read(text, ending)[1]
    made = {**made, _DIGEST: hashlib.sha256(text.encode()).hexdigest()}
    if ending == ".csv":
        return "".join(f"# {key}: {json.dumps(value, ensure_ascii=False)}\n" for key, value in made.items()) + text
    tags = "".join(f'<meta name="pdhe-{key}" content="{html.escape(value)}">\n' for key, value in made.items())
    head = _HEAD.search(text)
    place = head.end() if head else 0
    return text[:place] + tags + text[place:]


def read(text: str, ending: str) -> tuple[dict[str, str], str]:
    """Return what a table or a page says about what made it, nothing if it does not, and the rest of it."""
    made: dict[str, str] = {}
    if ending == ".csv":
        place = 0
        while line := _LINE.match(text, place):
            try:
                made[line[1]] = json.loads(line[2])
            except ValueError:
                break
            place = line.end()
        return made, text[place:]
    for key, value in _TAG.findall(text):
        made.setdefault(key, html.unescape(value))
    return made, _TAG.sub("", text)


def stamp(path: Path, made: Mapping[str, str]) -> None:
    """Write into a table or a page what made it."""
    write_text(path, stamped(_text(path), path.suffix, made))


def table_of(path: Path) -> list[dict[str, str]]:
    """Read a table without the lines that say what made it."""
    return list(csv.DictReader(io.StringIO(read(_text(path), ".csv")[1], newline="")))


def problems(path: Path, solutions: Mapping[str, Path]) -> list[str] | None:
    """Return in words what no longer matches of a table or a page; None where it does not say what made it.

    Parameters
    ----------
    solutions
        Those there are, by the digests of their content.
    """
    made, text = read(_text(path), path.suffix)
    if _DIGEST not in made:
        return None
    found = []
    if hashlib.sha256(text.encode()).hexdigest() != made[_DIGEST]:
        found.append("is not as it was written")
    try:
        code = fingerprint(made.get("module", ""))
    except FileNotFoundError:
        code = "none"
    if code != made.get("code_fingerprint"):
        found.append(f"made by other code ({made.get('code_fingerprint')}, now {code})")
    if made.get("versions") != json.dumps(versions(), sort_keys=True):
        found.append("made with other versions")
    if "solution_sha256" in made and made["solution_sha256"] not in solutions:
        found.append("its solution is not in the store, or another one by now")
    return found


def _text(path: Path) -> str:
    with path.open(encoding="utf-8", newline="") as file:
        return file.read()
