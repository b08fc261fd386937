"""Command line: one subcommand a step. What they do is in :mod:`pdhe.commands`."""

import argparse
import contextlib
import errno
import functools
import os
import shlex
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pdhe.commands.files import diagnose, gc, index, schema, stamp, validate, verify
from pdhe.commands.pictures import animate, figures, history
from pdhe.commands.reports import (
    benchmark,
    benchmark_compare,
    benchmark_page,
    check,
    extremes,
    extremes_page,
    page,
    trade,
    tradeoff_page,
    verdict,
)
from pdhe.commands.steps import choose, mesh, nodes, plan, run, solve
from pdhe.commands.umat import umat_build, umat_check
from pdhe.errors import Interrupted, PdheError

_HINTS = (
    (
        (errno.ENOSPC, errno.EDQUOT, errno.EFBIG),
        "nothing half-written is left; free some space (`pdhe gc` lists results that no study refers to) and give the "
        "same command again",
    ),
    (
        (errno.EROFS, errno.EACCES, errno.EPERM),
        "write elsewhere (another `--out`, `snakemake --directory FOLDER`), or change who may write there",
    ),
)
_SMALLER = (
    "`pdhe plan SCENE` tells what a run needs: take a coarser `mesh.spacing`, fewer `outputs` or a machine with more "
    "memory, or run fewer jobs at a time, and give the same command again; a solve goes on from its last checkpoint"
)
#: What the loader of shared libraries says of one for which there is no memory.
_NOT_MAPPED = "failed to map segment"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    Parameters
    ----------
    argv
        Arguments without the name of the program; those of the process when None.

    Returns
    -------
    int
        0 after success, 1 after an error that is explained on standard error, 128 and the number of the signal after
        an interruption.
    """
    arguments = _parser().parse_args(argv)
    arguments.command = shlex.join(["pdhe", *map(str, sys.argv[1:] if argv is None else argv)])
    try:
        with _terminable():
            arguments.run(arguments)
    except PdheError as error:
        return _tell(f"error: {error}", 1)
    except OSError as error:
        return _tell(f"error: {_explained(error)}", 1)
    except MemoryError as error:
        return _tell(f"error: out of memory{f' ({error})' if str(error) else ''}; {_SMALLER}", 1)
    except ImportError as error:
        # Modules are loaded when they are needed, and that may be when memory is short.
        if _NOT_MAPPED not in str(error):
            raise
        return _tell(f"error: out of memory ({error}); {_SMALLER}", 1)
    except KeyboardInterrupt as stop:
        return _tell(str(stop) or "interrupted", getattr(stop, "status", 130))
    return 0


def _tell(text: str, status: int) -> int:
    with contextlib.suppress(OSError):
        print(text, file=sys.stderr, flush=True)
    return status


def _explained(error: OSError) -> str:
    """Say what the system refused, and what to do about it."""
    place = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes | os.PathLike) else ""
    if not error.errno or not error.strerror:
        return str(error)
    reason = error.strerror[:1].lower() + error.strerror[1:]
    hint = next((hint for numbers, hint in _HINTS if error.errno in numbers), "")
    return f"{place}{reason}{f'; {hint}' if hint else ''}"


@contextlib.contextmanager
def _terminable() -> Iterator[None]:
    """Meanwhile SIGTERM ends what is done as Ctrl-C does, so that nothing half-written is left."""

    def stop(number: int, _: Any) -> None:
        raise Interrupted(f"interrupted by {signal.Signals(number).name}; give the same command again", 128 + number)

    listening = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, stop) if listening else None
    try:
        yield
    finally:
        if listening:
            signal.signal(signal.SIGTERM, signal.SIG_DFL if before is None else before)


@functools.cache
def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="pdhe", description="Studies of hydrogen-assisted fracture.")
    parser.add_argument("--version", action=_Version, nargs=0, help="show program's version number and exit")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    def add(function, *options):
        summary = function.__doc__.splitlines()[0]
        command = commands.add_parser(function.__name__.replace("_", "-"), help=summary, description=summary)
        for names, settings in options:
            command.add_argument(*names, **settings)
        command.set_defaults(run=function)

    def option(*names, **settings):
        return names, settings

    def file(*names, help, required=True):
        return option(*names, help=help, required=required, type=Path, metavar="FILE")

    spec = option("--spec", required=True, metavar="JSON", help="resolved blocks of the scene, SI")
    style = option("--style", default="{}", metavar="JSON", help="style of the figures")
    result = file("--result", help="result of a solve")
    kind = option(
        "--kind", required=True, choices=("damage", "displacement", "coverage", "state"), help="field to draw"
    )
    scene = option("scene", type=Path, metavar="SCENE", help="scene file")
    anywhere = file("--out", help="file to write; standard output when not given", required=False)

    add(run, scene, file("--out", help="result to write; the mesh goes beside it"))
    add(plan, scene)
    add(choose, scene)
    add(validate, option("files", nargs="+", type=Path, metavar="FILE", help="scene or study file"))
    add(schema, anywhere)
    add(mesh, spec, file("--out", help="mesh to write"))
    add(nodes, spec, file("--mesh", help="mesh to read"), file("--out", help="nodes to write"))
    umat = file("--umat", help="compiled user material, where the scene has one", required=False)
    add(solve, spec, file("--nodes", help="nodes to read"), umat, file("--out", help="result to write"))
    add(figures, result, kind, style, file("--out", help="picture to write"))
    add(animate, result, kind, style, file("--out", help="animation to write"))
    add(
        history,
        result,
        file("--out-csv", help="table to write", required=False),
        file("--out-png", help="picture to write", required=False),
    )
    add(
        index,
        option("study", type=Path, metavar="STUDY", help="study file"),
        option("--solutions", type=Path, metavar="FOLDER", help="folder of the solutions, results/store/solve"),
        anywhere,
    )
    add(diagnose, option("files", nargs="+", type=Path, metavar="RESULT", help="result of a solve"))
    place = option("results", nargs="?", type=Path, default=Path("results"), metavar="RESULTS", help="results folder")
    add(verify, place)
    add(
        stamp,
        option("files", nargs="+", type=Path, metavar="FILE", help="table (.csv) or page (.html)"),
        option("--made-by", metavar="COMMAND", help="command that made it"),
    )
    add(
        gc,
        place,
        option(
            "--study",
            dest="studies",
            type=Path,
            action="append",
            metavar="FILE",
            help="study that keeps its results, several times for several; all below config when none is given",
        ),
        option("--remove", action="store_true", help="remove what is listed"),
    )
    folders = option("folders", nargs="+", type=Path, metavar="FOLDER", help="folder of a checked topic")
    folder = option("--out", required=True, type=Path, metavar="FOLDER", help="folder to write into")
    settings = option("--settings", default="{}", metavar="JSON", help="settings of the topic")
    add(check, option("topic", metavar="TOPIC", help="topic of the verification"), settings, folder)
    docs = option("--docs", type=Path, metavar="FOLDER", help="write verification.md and its figures here as well")
    add(page, folders, file("--out", help="page to write"), docs)
    add(extremes, option("group", metavar="GROUP", help="group of extreme cases"), folder)
    add(
        extremes_page,
        folders,
        file("--out", help="page to write"),
        file("--map", help="picture to write"),
        file("--table", help="table to write"),
        option("--docs", type=Path, metavar="FOLDER", help="write extremes.md and its picture here as well"),
    )
    add(verdict, folders, file("--out", help="file to write when all is well"))
    add(benchmark, option("name", metavar="NAME", help="benchmark to run"), settings, folder)
    results = option("folders", nargs="+", type=Path, metavar="FOLDER", help="folder of a benchmark that has run")
    tables = file("--markdown", help="tables to write", required=False)
    add(benchmark_page, results, file("--out", help="page to write"), file("--json", help="numbers to write"), tables)
    runs = [option(name, type=Path, metavar=name.upper(), help=f"benchmarks.json, {name}") for name in ("old", "new")]
    add(benchmark_compare, *runs)
    add(
        trade,
        option("design", type=Path, metavar="DESIGN", help="file of the design"),
        option("--scene", required=True, metavar="NAME", help="scene of it"),
        folder,
    )
    measured = option("folders", nargs="+", type=Path, metavar="FOLDER", help="folder of a measured scene")
    pictures = file("--picture", help="picture of work to write"), file("--costs", help="picture of time and memory")
    numbers = file("--csv", help="table of all runs to write")
    models = file("--models", help="orders of convergence to write, for `pdhe choose`", required=False)
    add(tradeoff_page, measured, file("--out", help="page to write"), *pictures, numbers, tables, models)
    source = option("source", type=Path, metavar="SOURCE", help=".c, .f, .for, .f90 or a compiled .so")
    library = file("--out", help="library to write; printed where it is when not given", required=False)
    add(umat_build, source, option("--content", metavar="DIGEST", help="refuse a source with another digest"), library)
    add(
        umat_check,
        source,
        option("--name", default="MATERIAL", help="name that the routine is told"),
        option("--properties", default="[]", metavar="JSON", help="list of its properties"),
        option("--state", default="[]", metavar="JSON", help="list of initial state variables"),
        option("--plane", default="strain", choices=("strain", "stress", "solid"), help="NDI and NSHR"),
        option("--strains", required=True, metavar="JSON", help="list of strains, each a number or a list"),
        option("--free", default="[]", metavar="JSON", help="components without stress, from 1"),
        option("--symbol", default="umat_", help="name of the routine in the library"),
        anywhere,
    )
    return parser


class _Version(argparse.Action):
    """Print the version, which takes as long to look up as all the rest of the command line to load."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib import metadata

        try:
            version = metadata.version("pdhe")
        except metadata.PackageNotFoundError:
            version = "(not installed)"
        print(f"pdhe {version}")
        parser.exit()
