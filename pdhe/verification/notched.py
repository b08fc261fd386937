"""What the crack topics share: the plate of the thesis with cracks as scenes, and numbers read from their results."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from pdhe.scene import Scene
from pdhe.verification.slabs import DIFFUSIVITY, HORIZON_RATIO, THICKNESS

#: Plate and notch of the thesis (section 8.7), m.
WIDTH, HEIGHT, NOTCH = 0.2, 0.1, 0.05
#: Displacement of each edge, m, and the time in which it is reached, s.
PULL, RAMP = 0.02e-3, 2e6
#: Toughness and Young's modulus of its steel, Pa m^0.5 and Pa.
TOUGHNESS, YOUNG = 58.4e6, 207e9

Segment = tuple[tuple[float, float], tuple[float, float]]
MIDDLE_NOTCH: dict[str, Segment] = {"notch": ((0.0, HEIGHT / 2), (NOTCH, HEIGHT / 2))}


def plate_with_cracks(
    spacing: float,
    end: float,
    *,
    size: tuple[float, float] = (WIDTH, HEIGHT),
    cracks: Mapping[str, Segment] = MIDDLE_NOTCH,
    holes: Sequence[Mapping[str, Any]] = (),
    cells: str = "quadrilateral",
    ratio: float = HORIZON_RATIO,
    pull: float = PULL,
    ramp: float = RAMP,
    wet: Sequence[str] | None = ("notch",),
    criterion: str = "stretch",
    **blocks: Any,
) -> Scene:
    """A plate of the thesis' steel pulled by its lower and upper edge, which slide freely.

    Parameters
    ----------
    spacing, end, size
        m, s and m.
    pull, ramp
        Displacement of each edge, m, reached after ``ramp`` seconds and held; at once if that is zero.
    wet
        Node sets that are saturated with hydrogen; None for a dry plate.
    blocks
        Further blocks of the scene, resolved.
    """
    history = {"times": [0.0, ramp], "values": [0.0, 1.0]} if ramp > 0.0 else {"times": [0.0], "values": [1.0]}
    loads = [
        {"on": on, "displacement": {"y": history | {"values": [sign * pull * v for v in history["values"]]}}}
        for on, sign in (("top", 1.0), ("bottom", -1.0))
    ]
    geometry: dict[str, Any] = {"plate": {"width": size[0], "height": size[1], "thickness": THICKNESS}}
    if cracks:
        geometry["cracks"] = [{"name": name, "from": a, "to": b} for name, (a, b) in cracks.items()]
    if holes:
        geometry["holes"] = [dict(hole) for hole in holes]
    resolved: dict[str, Any] = {
        "title": "verification",
        "geometry": geometry,
        "mesh": {"spacing": spacing, "cells": cells},
        "horizon": {"ratio": ratio},
        "material": {
            "name": "AISI 4340",
            "youngs_modulus": YOUNG,
            "poissons_ratio": 0.29,
            "fracture_toughness": TOUGHNESS,
            "diffusivity": DIFFUSIVITY,
        },
        "loads": loads,
        "damage": {"criterion": criterion},
        "time": {"end": end},
        "outputs": {"times": [end]},
    }
    if wet is not None:
        boundary = [{"on": name, "coverage": {"times": [0.0], "values": [1.0]}} for name in wet]
        resolved["hydrogen"] = {"boundary": boundary, "degradation": "stretch"}
    return Scene.from_resolved(resolved | blocks)


def mean_damage(length: float, horizon: float, width: float = WIDTH, height: float = HEIGHT) -> float:
    """Mean damage of a plate with one straight crack of a length, 4 delta a / (3 pi W H); lengths m."""
    return 4.0 * horizon * length / (3.0 * math.pi * width * height)


def arrival(result: xr.Dataset, lengths: Sequence[float], name: str = "crack_extension") -> np.ndarray:
    """Times at which the crack first has each extension, s; infinity where it never does."""
    reached = result[name].values[:, None] >= np.asarray(lengths)
    times = result["history_time"].values[reached.argmax(axis=0)]
    return np.where(reached.any(axis=0), times, np.inf)


def off_plane(result: xr.Dataset, level: float = HEIGHT / 2) -> int:
    """Number of bonds broken in a run that do not cross the horizontal line at a height, m."""
    if "broken_i" not in result:
        return 0
    y = result["node_y"].values - level
    return int(np.sum(y[result["broken_i"].values] * y[result["broken_j"].values] > 0.0))
