"""Identities: canonical text and digest of parameters, fingerprint of source code, versions of dependencies.

A result is the same result when the numbers that went in and the code that ran are the same. `digest` names the
numbers; `fingerprint` names the code of a module together with every pdhe module it imports, with comments and
docstrings left out, so that rewording an explanation does not ask for a computation to be repeated.
"""

import ast
import hashlib
import json
import re
from collections.abc import Iterable
from functools import cache
from importlib import metadata
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
    """Return the code of a module without comments and docstrings, and the package modules it imports."""
    path = _path(name)
    if path is None:
        raise FileNotFoundError(f"no module '{name}' in {PACKAGE}")
    tree = ast.parse(path.read_bytes(), filename=str(path))
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    imported: dict[str, None] = {}
    for node in _walk(tree):
        for candidate in _candidates(node, package):
            parts = candidate.split(".")
            for end in range(1, len(parts) + 1):
                prefix = ".".join(parts[:end])
                if prefix != name and _path(prefix) is not None:
                    imported[prefix] = None
    _strip(tree)
    return ast.unparse(tree), tuple(imported)


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
