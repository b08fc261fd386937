"""What the transport topics share: slabs as scenes, closed forms of diffusion into them, and error norms."""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.integrate import quad
from scipy.special import j0

from pdhe import advance as moves
from pdhe import supersteps
from pdhe.case import Case, build_case
from pdhe.discretization import Discretization, discretize
from pdhe.mesh import make_mesh
from pdhe.scene import Scene
from pdhe.simulation import start
from pdhe.state import State
from pdhe.transport import Diffusion

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Diffusivity of hydrogen in the steel of the thesis (table 4), m^2/s.
DIFFUSIVITY = 0.84e-9
#: Length of the slabs, m: the plate of the thesis from edge to edge.
LENGTH = 0.2
THICKNESS = 4e-3
HORIZON_RATIO = 3.015
#: Terms of the series below: the last is 1e-30 for the shortest time in use, D t / L^2 = 1e-3.
TERMS = 200


def plate_scene(
    width: float,
    height: float,
    spacing: float,
    boundary: Mapping[str, float],
    end: float,
    *,
    kernel: str = "inverse square",
    ratio: float = HORIZON_RATIO,
    cells: str = "quadrilateral",
    geometry: Mapping[str, Any] | None = None,
    hydrogen: Mapping[str, Any] | None = None,
    **blocks: Any,
) -> Scene:
    """A scene of the thesis' steel; only hydrogen unless ``blocks`` adds loads. Lengths in m, times in s."""
    material = {
        "name": "AISI 4340",
        "youngs_modulus": 207e9,
        "poissons_ratio": 0.29,
        "fracture_toughness": 58.4e6,
        "diffusivity": DIFFUSIVITY,
    }
    # A sealed plate without any hydrogen would be refused: there is nothing to compute.
    hydrogen = {"initial": 0.0 if boundary else 1.0, **(hydrogen or {})}
    conditions = [{"on": name, "coverage": {"times": [0.0], "values": [value]}} for name, value in boundary.items()]
    resolved = {
        "title": "verification",
        "geometry": {"plate": {"width": width, "height": height, "thickness": THICKNESS}, **(geometry or {})},
        "mesh": {"spacing": spacing, "cells": cells},
        "horizon": {"ratio": ratio},
        "material": material,
        "hydrogen": {"kernel": kernel, "boundary": conditions, **hydrogen},
        "time": {"end": end},
        "outputs": {"times": [end]},
    }
    return Scene.from_resolved(resolved | blocks)


def strip_scene(columns: int, boundary: Mapping[str, float], end: float, *, length: float = LENGTH, **options) -> Scene:
    """A slab of ``columns`` cells between left and right, no higher than its mirror images at the sealed sides need."""
    spacing = length / columns
    rows = math.ceil(options.get("ratio", HORIZON_RATIO) + 0.5)
    return plate_scene(length, rows * spacing, spacing, boundary, end, **options)


def nodes_of(scene: Scene) -> Discretization:
    """Mesh a scene in a temporary folder and return its nodes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plate.msh"
        make_mesh(scene.geometry, scene.mesh, path)
        return discretize(path, scene.geometry, scene.mesh)


def case_of(scene: Scene) -> Case:
    """Build the case of a scene on a mesh of its own."""
    return build_case(scene, nodes_of(scene))


def states_at(case: Case, times: list[float]) -> Iterator[State]:
    """March a case through the given times, s, and yield the state (one object) at each."""
    state = start(case)
    for time in times:
        if time > state.time:
            with _errors_of_the_mesh_alone():
                moves.advance(case, state, time, None, None)
        yield state


@contextlib.contextmanager
def _errors_of_the_mesh_alone() -> Iterator[None]:
    """Hold the long diffusion steps to 1e-9: their usual 1e-4 would hide what a refinement study looks for."""
    usual = supersteps.TOLERANCE
    supersteps.TOLERANCE = 1e-9
    try:
        yield
    finally:
        supersteps.TOLERANCE = usual


def coverage_at(case: Case, time: float) -> np.ndarray:
    """Coverage of a case at one time (n,)."""
    return next(states_at(case, [time])).coverage


def slab(place: np.ndarray, tau: float, terms: int = TERMS, decay=None) -> np.ndarray:
    """Coverage of a slab with coverage 1 at ``place = x/L = 0``, sealed at 1, empty at first, at ``tau = D t / L^2``.

    The series of theory, eq. 4.13. ``decay`` replaces the rate a^2 of the mode sin(a x/L) of local diffusion.
    """
    a = (np.arange(terms) + 0.5) * math.pi
    rate = a**2 if decay is None else decay(a)
    return 1.0 - np.sin(np.multiply.outer(place, a)) @ (2.0 / a * np.exp(-rate * tau))


def slab_mean(tau: float, terms: int = TERMS) -> float:
    """Mean coverage of that slab (theory, eq. 4.14)."""
    a = (np.arange(terms) + 0.5) * math.pi
    return float(1.0 - np.sum(2.0 / a**2 * np.exp(-(a**2) * tau)))


def half_space(place: np.ndarray, tau: float) -> np.ndarray:
    """Coverage of a half space with coverage 1 at its face, ``erfc(x / (2 sqrt(D t)))``; arguments as for the slab."""
    return np.array([math.erfc(x / (2.0 * math.sqrt(tau))) for x in np.ravel(place)])


def rms(values: np.ndarray, volume: np.ndarray) -> float:
    """Root of the volume mean of the squares; of a coverage, so in shares of saturation."""
    return math.sqrt(float(np.average(values**2, weights=volume)))


def symbol(power: int, wave: float) -> float:
    """Decay rate over D k^2 of a mode with ``wave = k delta`` in the nonlocal continuum (theory, eq. 4.11)."""
    factor = 4.0 * (4 - power)
    integral, _ = quad(lambda s: (1.0 - j0(wave * s)) * s ** (1 - power), 0.0, 1.0, limit=200)
    return factor * integral / wave**2


def rate_of_change(diffusion: Diffusion, psi: np.ndarray) -> np.ndarray:
    """Rate of coverage that the bonds alone give, 1/s (n,): the operator of a plate with sealed edges."""
    bonds = diffusion.bonds
    return bonds.sum_by_node(diffusion.rate * (psi[bonds.neighbours] - psi[bonds.owners()]))


def plain_ticks(ax: Axes, places: list[float]) -> None:
    """Label a logarithmic x axis with plain numbers at the given places only."""
    ax.set_xticks(places, [f"{place:g}" for place in places])
    ax.set_xticks([], minor=True)
