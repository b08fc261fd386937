"""Small bodies that several tests share."""

from __future__ import annotations

import numpy as np

from pdhe import materials
from pdhe.bonds import build_bonds
from pdhe.materials import MODELS, Body

YOUNG, THICKNESS = 207e9, 4e-3


def lattice(columns: int, rows: int, spacing: float = 1e-3) -> np.ndarray:
    """Centroids of a regular grid of square cells, row by row."""
    x, y = np.meshgrid((np.arange(columns) + 0.5) * spacing, (np.arange(rows) + 0.5) * spacing)
    return np.column_stack([x.ravel(), y.ravel()])


def make_body(
    columns: int = 12,
    rows: int = 10,
    *,
    nu: float = 0.29,
    m: float = 3.015,
    spacing: float = 1e-3,
    model: str = "condensed rotation",
    plane: str = "stress",
    perturb: float = 0.0,
    break_share: float = 0.0,
    seed: int = 0,
    cracks=(),
    **options,
) -> tuple[np.ndarray, Body]:
    """A rectangular body, optionally with displaced nodes and randomly broken bonds."""
    rng = np.random.default_rng(seed)
    coordinates = lattice(columns, rows, spacing)
    coordinates += perturb * spacing * rng.uniform(-1, 1, coordinates.shape)
    volume = np.full(len(coordinates), spacing**2 * THICKNESS)
    horizon = m * spacing
    law = MODELS[model](YOUNG, nu, THICKNESS, horizon, plane)
    bonds = build_bonds(
        coordinates, volume, np.full(len(coordinates), spacing), THICKNESS, horizon,
        tangential_ratio=law.tangential_ratio, cracks=cracks, **options,
    )  # fmt: skip
    body = materials.make_body(bonds, law, coordinates, volume)
    if break_share:
        once = np.flatnonzero(bonds.owners() < bonds.neighbours)
        body.break_bonds(rng.choice(once, int(break_share * once.size), replace=False))
    return coordinates, body
