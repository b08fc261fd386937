"""Reading of YAML files: the one place where scene, study and material files become Python objects.

The loader is a small, strict part of YAML 1.2: ``on``, ``off``, ``yes`` and ``no`` are words, ``1e-5`` is a number,
``010`` is ten, dates are text, duplicate keys are refused, and tags, merge keys and self-references do not exist.
"""

import copy
import re
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import yaml
from yaml.composer import ComposerError
from yaml.constructor import ConstructorError

from pdhe.errors import SceneError

MAX_BYTES = 1_000_000
"""Largest file that is read; scene files are a few kilobytes."""
MAX_ALIASES = 100
"""Most ``*aliases`` in one file."""
MAX_VALUES = 100_000
"""Most values in one file after aliases are expanded."""


class _Loader(yaml.SafeLoader):
    """YAML 1.2 core types only, with duplicate keys refused and aliases counted."""

    yaml_implicit_resolvers: dict = {}  # noqa: RUF012 - PyYAML declares it without ClassVar
    yaml_constructors: ClassVar[dict] = {}

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._aliases = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            self._aliases += 1
            if self._aliases > MAX_ALIASES:
                mark = self.peek_event().start_mark
                raise ComposerError(None, None, f"more than {MAX_ALIASES} aliases", mark)
        return super().compose_node(parent, index)

    def construct_document(self, node: Any) -> Any:
        if _expanded_size(node, {}) > MAX_VALUES:
            raise ConstructorError(None, None, f"more than {MAX_VALUES} values", node.start_mark)
        return super().construct_document(node)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict:
        if not isinstance(node, yaml.MappingNode):
            raise ConstructorError(None, None, "a mapping is expected here", node.start_mark)
        lines: dict[Any, int] = {}
        pairs = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise ConstructorError(None, None, "a key must be plain text", key_node.start_mark)
            key = self.construct_object(key_node, deep=True)
            if key in lines:
                text = f"key '{key}' is given twice, first on line {lines[key]}"
                raise ConstructorError(None, None, text, key_node.start_mark)
            lines[key] = key_node.start_mark.line + 1
            pairs[key] = self.construct_object(value_node, deep=deep)
        return pairs


def _expanded_size(node: Any, known: dict[int, int | None]) -> int:
    """Count the values below ``node`` with aliases written out; refuse a node that contains itself."""
    if id(node) in known:
        size = known[id(node)]
        if size is None:
            raise ConstructorError(None, None, "a value that contains itself", node.start_mark)
        return size
    known[id(node)] = None
    children: list = []
    if isinstance(node, yaml.SequenceNode):
        children = node.value
    elif isinstance(node, yaml.MappingNode):
        children = [child for pair in node.value for child in pair]
    size = 1 + sum(_expanded_size(child, known) for child in children)
    known[id(node)] = size
    return size


def _construct_str(loader: _Loader, node: Any) -> str:
    text = loader.construct_scalar(node)
    for character in text:
        # Written as escapes: no file and no terminal takes them.
        if (ord(character) < 32 and character not in "\t\n\r") or 0xD800 <= ord(character) <= 0xDFFF:
            raise ConstructorError(None, None, f"the character {character!r} is no text", node.start_mark)
    return text


def _construct_int(loader: _Loader, node: Any) -> int:
    text = loader.construct_scalar(node)
    if len(text) > 100:
        raise ConstructorError(None, None, "a number with more than 100 digits", node.start_mark)
    try:
        if text.startswith(("0o", "0x")):
            return int(text, 0)
        return int(text)
    except ValueError:
        raise ConstructorError(None, None, "not a whole number", node.start_mark) from None


def _construct_float(loader: _Loader, node: Any) -> float:
    text = loader.construct_scalar(node)
    try:
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    except ValueError:
        raise ConstructorError(None, None, "not a number", node.start_mark) from None


def _refuse_tag(loader: _Loader, node: Any) -> None:
    raise ConstructorError(None, None, f"the tag {node.tag!r} has no meaning here", node.start_mark)


_CORE = [
    ("null", r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", list("tTfF")),
    ("int", r"^(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$", list("-+0123456789")),
    (
        "float",
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$",
        list("-+.0123456789"),
    ),
]
for _name, _pattern, _first in _CORE:
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_name}", re.compile(_pattern), _first)
for _name, _constructor in {
    "null": yaml.SafeLoader.construct_yaml_null,
    "str": _construct_str,
    "seq": yaml.SafeLoader.construct_yaml_seq,
    "map": yaml.SafeLoader.construct_yaml_map,
    "bool": lambda loader, node: loader.construct_scalar(node).lower() == "true",
    "int": _construct_int,
    "float": _construct_float,
}.items():
    _Loader.add_constructor(f"tag:yaml.org,2002:{_name}", _constructor)
_Loader.add_constructor(None, _refuse_tag)


def find_file(named: str, beside: Iterable[str | Path]) -> str:
    """Return the path of a file that another file names: from the working directory, or beside that or above it.

    Then from the folder of this checkout, and the name itself where there is no such file.
    """
    if not is_file(named):
        parents = [parent for file in beside for parent in Path(file).resolve().parents]
        for parent in (*parents, Path(__file__).resolve().parents[1]):
            if is_file(parent / named):
                return str(parent / named)
    return named


def is_file(path: str | Path) -> bool:
    """Whether there is such a file; a name that no file can have is none."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


def parse_yaml(text: str, file: str) -> dict[Any, Any]:
    """Turn YAML text into a mapping.

    Parameters
    ----------
    text
        The content of one file.
    file
        Name of the file, for messages.

    Raises
    ------
    SceneError
        If the text is empty, is not YAML, has duplicate keys or holds something other than a mapping.
    """
    try:
        data = yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = error.problem or error.context or "it cannot be read"
        raise SceneError(file, "", None, f"cannot be read{place}: {problem}", _syntax_hint(problem)) from None
    except yaml.YAMLError as error:
        problem = " ".join(str(error).split())
        raise SceneError(file, "", None, f"cannot be read: {problem}", "write plain UTF-8 text") from None
    except RecursionError:
        raise SceneError(file, "", None, "is nested too deeply", "scene files are a few levels deep") from None
    if data is None:
        raise SceneError(file, "", None, "is empty", "start from one of the files in config/scenes")
    if not isinstance(data, dict):
        kind = "list" if isinstance(data, list) else type(data).__name__
        hint = "write `key: value` lines, as in the files in config/scenes"
        raise SceneError(file, "", None, f"holds a {kind}, not a mapping of keys", hint)
    return data


def _syntax_hint(problem: str) -> str:
    if "given twice" in problem:
        return "keep one of the two"
    if "mapping values are not allowed" in problem:
        return "quote a text that contains ': ', and indent with the same number of spaces"
    if "'\\t'" in problem:
        return "indent with spaces, not tabs"
    return "check indentation, brackets and quotes near that line"


def read_yaml(path: str | Path) -> dict[Any, Any]:
    """Read one YAML file into a mapping; see :func:`parse_yaml` for what is refused."""
    file = str(path)
    try:
        with Path(path).open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise SceneError(file, "", None, "does not exist", "check the path, relative to where you started") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise SceneError(file, "", None, f"cannot be opened: {reason}", "give the path of a readable file") from None
    if len(content) > MAX_BYTES:
        raise SceneError(file, "", None, f"is larger than {MAX_BYTES} bytes", "give a scene file, not a data file")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        problem = f"is not UTF-8 text (line {line})"
        raise SceneError(file, "", None, problem, "save the file with UTF-8 encoding") from None
    return copy.deepcopy(_parsed(text, file))


@lru_cache(maxsize=32)
def _parsed(text: str, file: str) -> dict[Any, Any]:
    """Parse a text once: a study reads the same scene for every case, and parsing is most of that."""
    return parse_yaml(text, file)
