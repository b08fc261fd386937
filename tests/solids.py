"""Small bodies in space that several tests share."""

from __future__ import annotations

import numpy as np

from pdhe.materials import MODELS, make_body
from pdhe.materials.solid import SolidBondBody
from pdhe.solid_bonds import build_solid_bonds

YOUNG = 207e9


def block(columns: int, rows: int, layers: int, spacing: float = 1e-3) -> np.ndarray:
    """Centroids of a regular grid of cubes, layer by layer."""
    sides = ((np.arange(count) + 0.5) * spacing for count in (layers, rows, columns))
    z, y, x = np.meshgrid(*sides, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()])


def make_solid(
    shape: tuple[int, int, int] = (7, 6, 5),
    *,
    nu: float = 0.29,
    m: float = 2.5,
    model: str = "condensed rotation",
    perturb: float = 0.0,
    break_share: float = 0.0,
    seed: int = 0,
    **options,
) -> tuple[np.ndarray, SolidBondBody]:
    """A block with a spacing of 1 mm, optionally with displaced nodes and randomly broken bonds."""
    rng, spacing = np.random.default_rng(seed), 1e-3
    coordinates = block(*shape, spacing)
    coordinates += perturb * spacing * rng.uniform(-1, 1, coordinates.shape)
    volume, horizon = np.full(len(coordinates), spacing**3), m * spacing
    bonds = build_solid_bonds(coordinates, volume, np.full(len(coordinates), spacing), horizon, **options)
    law = MODELS[model](YOUNG, nu, shape[2] * spacing, horizon, None)
    body = make_body(bonds, law, coordinates, volume)
    if break_share:
        once = np.flatnonzero(bonds.once())
        body.break_bonds(rng.choice(once, int(break_share * once.size), replace=False))
    return coordinates, body
