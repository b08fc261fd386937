"""What lies in the folder of results: whether it still is what it says, and whether anything refers to it."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import netCDF4

from pdhe.errors import PdheError
from pdhe.netcdf import read_netcdf
from pdhe.provenance import digest, fingerprint, versions
from pdhe.results import CHECKPOINT, INCOMPLETE
from pdhe.stamps import ENDINGS, problems
from pdhe.study import RESERVED, Case, load_study
from pdhe.wholefile import PART, damaged_library, intact
from pdhe.yamlfile import read_yaml

_STAGES = {"mesh": ".msh", "nodes": ".nc", "solve": ".nc"}
_LIBRARIES = {"umat": ".so"}


def stored(results: Path) -> list[Path]:
    """Return the meshes, the files of nodes, solutions and compiled user materials below a folder of results."""
    _require(results)
    kinds = {**_STAGES, **_LIBRARIES}
    found = (path for stage in kinds for path in sorted((results / "store" / stage).glob(f"*{kinds[stage]}")))
    return [path for path in found if not PART.fullmatch(path.name)]


def check(path: Path) -> Iterator[str]:
    """Yield what is wrong with a file of the store, in words: content, and of solutions name, scene, code, versions.

    Parameters
    ----------
    path
        File in the store; its folder tells what it is.
    """
    if path.suffix == _LIBRARIES["umat"]:
        if not path.stat().st_size or damaged_library(path):
            yield "is damaged"
        return
    if path.suffix == _STAGES["mesh"]:
        if not intact(path):
            yield "is damaged, or was made by an older version: it does not end with the digest of its content"
        return
    try:
        arrays, attributes = read_netcdf(path)
    except (OSError, RuntimeError, ValueError) as error:
        yield f"cannot be read or is damaged ({error})"
        return
    if "content_sha256" not in attributes:
        yield "holds no digest of its content (made by an older version)"
    if path.parent.name != "solve":
        return
    try:
        scene = json.loads(attributes["scene"])
        identity = Case("", "", "", scene).solve_id
        stated, code, made_with = (attributes[name] for name in ("scene_hash", "code_fingerprint", "versions"))
        made_with = json.loads(made_with)
    except (KeyError, TypeError, ValueError) as error:
        yield f"does not say what made it ({type(error).__name__}: {error})"
        return
    if digest(scene) != stated:
        yield f"its scene has the hash {digest(scene)}, not {stated}"
    if identity != path.stem:
        yield f"its scene belongs to {identity}"
    if code != fingerprint("pdhe.simulation"):
        yield f"made by other code ({code}, now {fingerprint('pdhe.simulation')})"
    now = versions()
    changed = [
        f"{name} {made_with.get(name, 'none')}, now {now.get(name, 'none')}"
        for name in sorted({*made_with, *now})
        if made_with.get(name) != now.get(name)
    ]
    if changed:
        yield f"made with other versions ({'; '.join(changed)})"
    if not arrays["time"].size or attributes.get("status", "").startswith("incomplete"):
        yield "is incomplete"


def solutions_of(files: Iterable[Path]) -> dict[str, Path]:
    """Return the solutions among files of the store, by the digests of their content."""
    found = {}
    for path in files:
        if path.parent.name == "solve":
            with contextlib.suppress(OSError, RuntimeError, AttributeError), netCDF4.Dataset(path) as file:
                found[str(file.getncattr("content_sha256"))] = path
    return found


def reported(results: Path, solutions: Mapping[str, Path]) -> Iterator[tuple[Path, list[str]]]:
    """Yield every table and page below a folder of results that says what made it, with what is wrong with it.

    Parameters
    ----------
    solutions
        What :func:`solutions_of` finds.
    """
    for path in sorted(path for ending in ENDINGS for path in results.rglob(f"*{ending}")):
        try:
            found = problems(path, solutions)
        except (OSError, UnicodeDecodeError):
            continue
        if found is not None:
            yield path, found


def configured_studies(folder: Path = Path("config")) -> list[Path]:
    """Return the study files that the configuration lists, and all others in ``config/studies``.

    Raises
    ------
    PdheError
        If there are none.
    """
    found = {}
    if (folder / "config.yaml").is_file():
        listed = read_yaml(folder / "config.yaml")
        if isinstance(listed, dict):
            for name in (*(listed.get("studies") or ()), *filter(None, [listed.get("dynamics")])):
                found[Path(name).resolve()] = Path(name)
    for path in sorted((folder / "studies").glob("*.y*ml")):
        content = read_yaml(path)
        if isinstance(content, dict) and "study" in content:
            found.setdefault(path.resolve(), path)
    if not found:
        raise PdheError(f"{folder}: no studies found; name them with --study")
    return list(found.values())


def unused(results: Path, studies: Iterable[str | Path]) -> list[Path]:
    """Return what no study refers to: files of the store, folders of cases and of studies, unfinished files.

    Raises
    ------
    SceneError
        If a study cannot be read: what it refers to is then not known.
    """
    _require(results)
    cases = [case for file in studies for case in load_study(file).cases]
    names: dict[str, set[str]] = {}
    for case in cases:
        names.setdefault(case.study, set()).add(case.name)
    kept = {"mesh": {case.mesh_id for case in cases}, "solve": {case.solve_id for case in cases}}
    kept["nodes"] = kept["mesh"]
    kept["umat"] = {case.user_material[0] for case in cases if case.user_material}
    found = []
    for stage, ending in {**_STAGES, **_LIBRARIES}.items():
        for path in sorted((results / "store" / stage).glob("*")):
            part = PART.fullmatch(path.name)
            if path.suffix in (CHECKPOINT, INCOMPLETE):
                # One whose result is there was left behind by a run that was killed at its very end.
                result = path.with_suffix("")
                if result.stem not in kept[stage] or result.exists():
                    found.append(path)
            elif not _alive(int(part["process"])) if part else path.suffix == ending and path.stem not in kept[stage]:
                found.append(path)
    for folder in sorted(path for path in results.iterdir() if path.is_dir() and path.name not in RESERVED):
        if folder.name in names:
            inside = sorted(folder.iterdir())
            found += [path for path in inside if _of_case(path) and path.name not in names[folder.name]]
        elif _of_study(folder):
            found.append(folder)
    return found


def size_of(path: Path) -> int:
    """Return the bytes of a file or of all files in a folder."""
    files = path.rglob("*") if path.is_dir() and not path.is_symlink() else [path]
    return sum(file.lstat().st_size for file in files if not file.is_dir())


def remove(paths: Sequence[Path]) -> None:
    """Remove files and folders; of a link, the link."""
    for path in paths:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _require(results: Path) -> None:
    if not (results / "store").is_dir():
        raise PdheError(f"{results}: not a folder of results (it holds no store)")


def _of_case(path: Path) -> bool:
    """Whether a folder holds figures of a case and nothing else that somebody may have put there."""
    ours = re.compile(r"history\.(csv|png)|(damage|displacement|coverage|state)\.(png|gif)")
    return path.is_dir() and all(ours.fullmatch(file.name) for file in path.iterdir())


def _of_study(folder: Path) -> bool:
    """Whether a folder holds what a study leaves behind and nothing else."""
    names = ("cases.csv", "report.html")
    inside = list(folder.iterdir())
    return bool(inside) and all(_of_case(path) or path.name in names for path in inside)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
