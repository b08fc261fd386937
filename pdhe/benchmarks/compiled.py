"""Compiling the C and C++ programs that the benchmarks compare with, where there is a compiler."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pdhe.errors import PdheError
from pdhe.provenance import PACKAGE

SOURCES = PACKAGE.parent / "benchmarks"
COMPILERS = {".c": ("gcc", "clang", "cc"), ".cpp": ("g++", "clang++", "c++")}


def compiler(source: str) -> str | None:
    """The first compiler for a source file that the system has."""
    return next(filter(None, map(shutil.which, COMPILERS[Path(source).suffix])), None)


def compile_source(source: str, options: Sequence[str], folder: str | Path) -> Path | None:
    """Compile a file of ``benchmarks/`` into a folder; a C file becomes a shared library, a C++ file a program.

    Returns
    -------
    Path or None
        The library or program; None if there is no compiler, or the sources are not there (an installed package).

    Raises
    ------
    PdheError
        If the compiler fails.
    """
    program, path = compiler(source), SOURCES / source
    if program is None or not path.is_file():
        return None
    out = Path(folder, f"{path.stem}{''.join(options).replace('-', '_').replace('=', '_')}")
    shared = ["-shared", "-fPIC"] if path.suffix == ".c" else []
    command = [program, *options, *shared, str(path), "-o", str(out), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise PdheError(f"{' '.join(command)} failed:\n{done.stderr}")
    return out


class Library:
    """Functions of a compiled library on NumPy arrays; whole numbers are passed as int64, other numbers as double."""

    def __init__(self, path: Path) -> None:
        self._library = ctypes.CDLL(str(path))

    def bind(self, name: str, *arguments: np.ndarray | float | int):
        """A function without arguments that calls ``name`` on these arrays and numbers, in place."""
        function = getattr(self._library, name)
        function.restype = ctypes.c_double if name == "read_all" else None
        values = [_as_c(value) for value in arguments]

        def call() -> None:
            function(*values)

        call.keep = arguments  # type: ignore[attr-defined]
        return call


def _as_c(value: np.ndarray | float | int):
    if isinstance(value, np.ndarray):
        return ctypes.c_void_p(value.ctypes.data)
    return ctypes.c_int64(value) if isinstance(value, int) else ctypes.c_double(value)
