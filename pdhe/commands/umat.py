"""Commands that compile user materials and try them on one point."""

import argparse
import json

from pdhe.commands.streams import ready, write
from pdhe.errors import PdheError

_PLANES = {"strain": "strain", "stress": "stress", "solid": None}
_COMPONENTS = ("11", "22", "33", "12", "13", "23")


def umat_build(arguments: argparse.Namespace) -> None:
    """Compile an Abaqus user material (.c, .f, .for, .f90)."""
    from pdhe.materials.umat import build
    from pdhe.scene_umat import content_of
    from pdhe.wholefile import copy

    if (
        arguments.content is not None
        and arguments.source.is_file()
        and content_of(arguments.source) != arguments.content
    ):
        raise PdheError(f"{arguments.source}: has changed since it was planned to compile it; give the command again")
    library = build(arguments.source)
    if arguments.out is None:
        print(library)
    else:
        copy(library, ready(arguments.out))


def umat_check(arguments: argparse.Namespace) -> None:
    """Take one point of an Abaqus user material through a path of strains."""
    options = {name: _numbers(arguments, name) for name in ("properties", "state", "free")}
    strains = _list(arguments.strains, "--strains")

    import numpy as np

    from pdhe.materials.umat import COMPILERS, UserMaterial, UserPoints, build, drive

    plane, source = _PLANES[arguments.plane], arguments.source
    library = build(source) if source.suffix.lower() in COMPILERS else source
    material = UserMaterial(
        library, arguments.name, tuple(options["properties"]), tuple(options["state"]), plane, arguments.symbol
    )
    names = [name for name in _COMPONENTS if material.components == 6 or name in ("11", "22", "12")]
    if material.components == 4:
        names.insert(2, "33")
    size = len(names)
    rows = [row if isinstance(row, list) else [row] for row in strains]
    if not rows or not all(len(row) <= size and all(map(_is_number, row)) for row in rows):
        raise PdheError(f"--strains needs a list of strains of up to {size} components ({', '.join(names)})")
    free = [int(number) - 1 for number in options["free"]]
    if not set(free) <= set(range(size)):
        raise PdheError(f"--free needs numbers from 1 to {size}, of {', '.join(names)}")
    path = np.array([row + [0.0] * (size - len(row)) for row in rows])
    points = UserPoints(material, np.zeros((1, material.dimensions)), np.ones(1))
    columns = [f"{what}_{name}" for what in ("strain", "stress") for name in names]
    columns += [*(f"state_{k + 1}" for k in range(len(material.state))), "elastic_energy", "plastic_energy"]
    lines = [",".join(columns)]
    for strain in path:
        (found,) = drive(points, strain, tuple(free))
        lines.append(",".join(f"{v:.12g}" for v in [*found.ravel(), *points.state[0], *points.energy[0, :2]]))
    write(arguments.out, "\n".join(lines) + "\n")


def _list(text: str, name: str) -> list:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PdheError(f"{name} is not JSON: {error}") from error
    if not isinstance(value, list):
        raise PdheError(f"{name} needs a JSON list, not {text[:80]}")
    return value


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _numbers(arguments: argparse.Namespace, name: str) -> list:
    values = _list(getattr(arguments, name), f"--{name}")
    if not all(map(_is_number, values)):
        raise PdheError(f"--{name} needs a JSON list of numbers, not {getattr(arguments, name)[:80]}")
    return values
