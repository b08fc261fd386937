"""Scenes whose material is a compiled user material: the library, its trial, the body and what a result tells of it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pdhe.bonds import Bonds
from pdhe.discretization import Discretization
from pdhe.errors import PdheError, SceneError
from pdhe.increments import Increments
from pdhe.materials.correspondence import Correspondence
from pdhe.materials.umat import TRIAL_STRAIN, UserMaterial, UserPoints, build
from pdhe.materials.user import SolidUserBody, UserBody
from pdhe.scene_umat import content_of
from pdhe.wholefile import damaged_library

if TYPE_CHECKING:
    from pdhe.scene import Scene

#: How far a corner of the loads may be from a load step, in steps over their number, that counts as on it.
ROUND_OFF = 1e-9


def user_material(scene: Scene, file: str = "scene") -> UserMaterial:
    """Compile and load the user material of a scene, and try one point of it.

    Parameters
    ----------
    scene
        With ``material.umat``.
    file
        Named in messages.

    Raises
    ------
    SceneError
        If the file has changed since the scene was read, cannot be compiled or loaded, has no such routine, or does
        not come back from a trial with a stress and a positive stiffness.
    """
    umat = scene.material.umat
    key = "source" if umat.source is not None else "library"
    path = Path(umat.source or umat.library)
    with _blamed_on(file, f"material.umat.{key}", str(path), f"{path}: "):
        if umat.source is not None and path.is_file() and umat.content not in (None, content_of(path)):
            raise PdheError("has changed since the scene was read; give the command again")
        library = build(path) if umat.source is not None else path
    initial = tuple(state.initial for state in umat.states)
    with _blamed_on(file, *_place_of_routine(scene, library), f"{library}: "):
        material = UserMaterial(library, umat.name, umat.properties, initial, scene.plane, umat.symbol)
    with _blamed_on(file, "material.umat.properties", list(umat.properties), f"user material {umat.name}: "):
        _try(material)
    return material


def _place_of_routine(scene: Scene, library: Path) -> tuple[str, str]:
    """Key and value that are to blame if a library has no routine, or cannot be loaded."""
    umat = scene.material.umat
    if umat.library is not None and not _loads(library):
        return "material.umat.library", umat.library
    return "material.umat.symbol", umat.symbol


def _loads(library: Path) -> bool:
    import ctypes

    if damaged_library(library):
        return False
    try:
        ctypes.CDLL(str(library.resolve()))
    except OSError:
        return False
    return True


@contextlib.contextmanager
def _blamed_on(file: str, key: str, value: object, prefix: str) -> Iterator[None]:
    """Turn an error into one of a scene."""
    try:
        yield
    except SceneError:
        raise
    except PdheError as error:
        problem, _, hint = str(error).removeprefix(prefix).partition("; ")
        raise SceneError(file, key, value, problem, hint) from error


def _try(material: UserMaterial) -> None:
    """Strain one point a little along each direction, in a process of its own and then here."""
    dim = material.dimensions
    points = UserPoints(material, np.zeros((1, dim)), np.ones(1))
    for k in range(dim):
        gradient = np.zeros((1, dim * dim))
        gradient[0, k * dim + k] = TRIAL_STRAIN
        points.trial(gradient)
        tangent = points.tangent[0]
        if not np.isfinite(tangent).all():
            raise PdheError(f"user material {material.name}: gives a DDSDDE that is not finite")
        if np.linalg.eigvalsh(0.5 * (tangent + tangent.T))[0] <= 0.0:
            raise PdheError(f"user material {material.name}: gives a DDSDDE that is not positive at a small strain")


def make_user_body(
    scene: Scene, bonds: Bonds, model: Correspondence, coordinates: np.ndarray, volume: np.ndarray
) -> UserBody | SolidUserBody:
    """The body of a scene with a user material; arguments as for :class:`UserBody`.

    Raises
    ------
    SceneError
        As :func:`user_material`.
    """
    kind = UserBody if scene.plane else SolidUserBody
    return kind(bonds, model, coordinates, volume, user_material(scene))


def make_increments(scene: Scene, d: Discretization, body: UserBody | SolidUserBody, fixed: np.ndarray) -> Increments:
    """What brings the body of a scene from one load step to the next; ``fixed`` are prescribed, bool (n, dim)."""
    solver, steps = scene.solver, scene.stepping.load_steps
    return Increments(
        body, fixed, d.spacing, solver.tolerance, max_iterations=solver.max_iterations, length=scene.time.end / steps
    )


def node_fields(scene: Scene, body: UserBody | SolidUserBody) -> dict[str, np.ndarray]:
    """Stresses, Pa (n, c), and each state variable (n,) at the last committed step, by their names in results."""
    points = body.points
    names = (f"state_{state.name}" for state in scene.material.umat.states)
    return {"stress": points.stress, **dict(zip(names, points.state.T, strict=True))}


def units_of(scene: Scene) -> dict[str, str]:
    """Units of the state variables, by their names in results."""
    umat = scene.material.umat
    return {} if umat is None else {f"state_{state.name}": state.unit for state in umat.states}


def energies(body: UserBody | SolidUserBody, u: np.ndarray, copies: int) -> dict[str, float]:
    """Energies at the last committed step, J, of the whole body: what is stored (SSE), and lost (SPD, SCD)."""
    plastic, creep = copies * body.dissipation().sum(axis=0)
    return {
        "elastic_energy": copies * float(body.energy(u).sum()),
        "plastic_dissipation": float(plastic),
        "creep_dissipation": float(creep),
    }


def corners_between(corners: Sequence[float], scene: Scene) -> list[float]:
    """Those times, s, of corners of the loads that lie between two load steps."""
    steps = ((t, t * scene.stepping.load_steps / scene.time.end) for t in corners if 0.0 < t < scene.time.end)
    return [t for t, step in steps if abs(step - round(step)) > ROUND_OFF * max(1.0, step)]


def describe(scene: Scene, body: UserBody | SolidUserBody) -> str:
    """A line of the plan."""
    umat, points = scene.material.umat, body.points
    names = ", ".join(f"{state.name} [{state.unit}]" for state in umat.states)
    file = Path(umat.source or umat.library).name
    return (
        f"user material: {umat.name} of {file}, {len(umat.properties)} properties, "
        f"{len(umat.states)} state variable{'' if len(umat.states) == 1 else 's'}{f' ({names})' if names else ''}, "
        f"history {points.nbytes / 1e6:.3g} MB; the result keeps stresses and state variables at every output"
        + ("; it is told the coverage as PREDEF(1)" if scene.hydrogen is not None else "")
    )
