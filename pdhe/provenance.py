"""Identities: canonical text and digest of parameters, fingerprint of source code, versions of dependencies.

A result is the same result when the numbers that went in and the code that ran are the same. `digest` names the
numbers; `fingerprint` names the code of a module together with every pdhe module it imports, with comments and
docstrings left out, so that rewording an explanation does not ask for a computation to be repeated.
"""

import ast
import contextlib
import hashlib
import json
import os
import platform
import re
import sys
from collections.abc import Iterable
from functools import cache
from importlib import metadata, util
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
"""Folder of the package whose modules are fingerprinted."""

DISTRIBUTION = PACKAGE.name


def canonical(obj: object) -> str:
    """Write parameters as one JSON text that depends on their values alone.

    Keys are sorted, tuples become lists and whole floats become integers, so that ``1.0`` and ``1`` are the same.

    Parameters
    ----------
    obj
        Nested dicts, lists, tuples, strings, numbers, booleans and None.

    Raises
    ------
    TypeError
        For any other type, NumPy scalars included.
    ValueError
        For a number that is not finite.
    """
    return json.dumps(_plain(obj), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def _plain(obj: object) -> object:
    if obj is None or isinstance(obj, bool | str | int):
        return obj
    if isinstance(obj, float):
        return int(obj) if obj.is_integer() and abs(obj) < 2**53 else obj
    if isinstance(obj, dict):
        return {str(key): _plain(value) for key, value in obj.items()}
    if isinstance(obj, list | tuple):
        return [_plain(value) for value in obj]
    raise TypeError(f"cannot write a {type(obj).__name__} as canonical JSON")


def digest(obj: object, length: int = 10) -> str:
    """Return the first `length` hexadecimal digits of the SHA-256 of ``canonical(obj)``."""
    return hashlib.sha256(canonical(obj).encode()).hexdigest()[:length]


def fingerprint(*modules: str) -> str:
    """Return 12 hexadecimal digits that change when the code of a module, or of one it imports, changes.

    Parameters
    ----------
    modules
        Dotted names inside the package, for example ``"pdhe.mesh"``.

    Notes
    -----
    Imports inside functions count, imports under ``if TYPE_CHECKING:`` do not. A module reached through
    ``importlib`` is not seen. The text that is hashed comes from `ast.unparse`, which can differ between minor
    versions of Python.

    Raises
    ------
    FileNotFoundError
        For a name that is no module of the package.
    """
    text = hashlib.sha256()
    for name in closure(*modules):
        text.update(f"{name}\0{_module(name)[0]}\0".encode())
    _KNOWN.save()
    return text.hexdigest()[:12]


def closure(*modules: str) -> tuple[str, ...]:
    """Return the sorted names of the modules and of every package module they import, directly or not."""
    found: set[str] = set()
    todo = list(modules)
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += _module(name)[1]
    return tuple(sorted(found))


@cache
def versions() -> dict[str, str]:
    """Return the installed versions of the package and of the packages it declares as dependencies, by name."""
    try:
        declared = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        declared = []
    names = [re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in declared if "extra ==" not in line]
    found = {}
    for name in sorted({DISTRIBUTION, *names}, key=str.lower):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


@cache
def machine() -> str:
    """Describe the machine: processor, system and Python, nothing that names it."""
    model = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    return f"{model}, {platform.system()} {platform.machine()}, Python {platform.python_version()}"


def _path(name: str) -> Path | None:
    """Return the source file of a dotted name inside the package, or None when there is none."""
    head, *rest = name.split(".")
    if head != PACKAGE.name:
        return None
    base = PACKAGE.joinpath(*rest)
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file() and (rest or path.name == "__init__.py"):
            return path
    return None


@cache
def _module(name: str) -> tuple[str, tuple[str, ...]]:
    """Return the digest of a module's code without comments and docstrings, and the package modules it imports."""
    path = _path(name)
    if path is None:
        raise FileNotFoundError(f"no module '{name}' in {PACKAGE}")
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    code, candidates = _KNOWN.of(path.read_bytes(), package, str(path))
    imported: dict[str, None] = {}
    for candidate in candidates:
        parts = candidate.split(".")
        for end in range(1, len(parts) + 1):
            prefix = ".".join(parts[:end])
            if prefix != name and _path(prefix) is not None:
                imported[prefix] = None
    return code, tuple(imported)


def _analysis(source: bytes, package: str, filename: str) -> tuple[str, list[str]]:
    """Return the digest of the code of a source text, and the names inside the package that it may import."""
    tree = ast.parse(source, filename=filename)
    names = {name for node in _walk(tree) for name in _candidates(node, package)}
    inside = sorted(name for name in names if name.partition(".")[0] == package.partition(".")[0])
    _strip(tree)
    return hashlib.sha256(ast.unparse(tree).encode()).hexdigest(), inside


class _Analyses:
    """Analyses of source texts, kept from one process to the next: taking every module apart costs 0.3 s.

    They are found by a digest of the text itself, of this module and of the version of Python, so that none can be
    out of date. The file lies where Python keeps compiled modules; without a place to write, nothing is kept.
    """

    def __init__(self) -> None:
        self._entries: dict[str, list] | None = None
        self._salt = b""
        self._new = False

    def of(self, source: bytes, package: str, filename: str) -> tuple[str, list[str]]:
        """Return the analysis of a source text."""
        if self._entries is None:
            self._entries = self._load()
            self._salt = f"{sys.version_info[:2]} ".encode() + hashlib.sha256(Path(__file__).read_bytes()).digest()
        key = hashlib.sha256(self._salt + f"{package}\0".encode() + source).hexdigest()[:32]
        if key not in self._entries:
            self._entries[key] = list(_analysis(source, package, filename))
            self._new = True
        code, names = self._entries[key]
        return code, names

    def save(self) -> None:
        """Keep what this process needed, if any of it is new."""
        if not self._new or sys.dont_write_bytecode:
            return
        path = self._file()
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            # Those of other processes stay, up to a number that no checkout needs.
            kept = dict(list(self._entries.items())[-_MOST_ANALYSES:])
            temporary.write_text(json.dumps(kept), encoding="utf-8")
            temporary.replace(path)
        self._new = False

    def _load(self) -> dict[str, list]:
        try:
            entries = json.loads(self._file().read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return {
            key: value
            for key, value in (entries.items() if isinstance(entries, dict) else ())
            if isinstance(value, list) and len(value) == 2
        }

    @staticmethod
    def _file() -> Path:
        return Path(util.cache_from_source(__file__)).with_name("pdhe-fingerprints.json")


_MOST_ANALYSES = 1000
_KNOWN = _Analyses()


def _walk(tree: ast.AST) -> Iterable[ast.AST]:
    """Yield every node except those that only a type checker reaches."""
    todo = [tree]
    while todo:
        node = todo.pop()
        yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            todo += node.orelse
        else:
            todo += ast.iter_child_nodes(node)


def _candidates(node: ast.AST, package: str) -> list[str]:
    """Return the dotted names an import statement may refer to; which of them are modules is decided later."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            parents = package.split(".")
            base = ".".join(parents[: len(parents) - node.level + 1] + ([node.module] if node.module else []))
        return [f"{base}.{alias.name}" for alias in node.names]
    return []


def _strip(tree: ast.Module) -> None:
    """Remove docstrings and other bare strings, in place."""
    for node in ast.walk(tree):
        for field in ("body", "orelse", "finalbody"):
            block = getattr(node, field, None)
            if not isinstance(block, list):
                continue
            kept = [statement for statement in block if not _is_text(statement)]
            if field == "body" and not kept and not isinstance(node, ast.Module):
                kept = [ast.Pass()]
            setattr(node, field, kept)


def _is_text(statement: ast.AST) -> bool:
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )
