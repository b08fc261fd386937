"""Spacing of a graded mesh as a function of place (theory, section 3).

One function serves the mesh, which is made to it, and the bonds, whose horizon is a multiple of it: cells scatter about
the spacing asked for, and a horizon that scattered with them would blur what is exact for a smooth one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pdhe.scene_blocks import Geometry, Mesh


class SizeField:
    """The spacing wanted at a place: fine within a distance of lines and holes, then growing linearly with distance.

    Parameters
    ----------
    geometry
        ``holes`` and ``cracks``, by whose names refinements may speak.
    mesh_spec
        ``spacing``, m, which is nowhere exceeded; ``refine`` and ``growth`` (see :class:`pdhe.scene_blocks.Mesh`).
    """

    def __init__(self, geometry: Geometry, mesh_spec: Mesh) -> None:
        self.coarsest, self.growth = mesh_spec.spacing, mesh_spec.growth_rate
        self.size = geometry.width, geometry.height
        self.mirrors = frozenset(geometry.symmetry or ())
        self.holes = [(hole.centre, hole.radius) for hole in geometry.holes]
        #: Each refinement as a segment with a radius: start x and y, its vector x and y, radius, spacing, within; m.
        self.regions: list[tuple[float, ...]] = []
        for item in mesh_spec.refine or ():
            hole = next((hole for hole in geometry.holes if hole.name == item.around), None)
            crack = next((crack for crack in geometry.cracks if crack.name == item.around), None)
            if hole is not None:
                (x, y), vector, radius = hole.centre, (0.0, 0.0), hole.radius
            else:
                (x, y), end = (crack.start, crack.end) if crack is not None else (item.start, item.end)
                vector, radius = (end[0] - x, end[1] - y), 0.0
            self.regions.append((x, y, *vector, radius, item.spacing, item.within))
        #: Spacings that whole parts of the plate have, m; between them it grows.
        self.plateaus = sorted({self.coarsest, *(region[5] for region in self.regions)})
        self.finest = self.plateaus[0]

    def at(self, x: float, y: float) -> float:
        """Spacing at one place, m."""
        size = self.coarsest
        for x0, y0, dx, dy, radius, spacing, within in self.regions:
            square = dx * dx + dy * dy
            t = min(max(((x - x0) * dx + (y - y0) * dy) / square, 0.0), 1.0) if square > 0.0 else 0.0
            away = abs(math.hypot(x - x0 - t * dx, y - y0 - t * dy) - radius)
            size = min(size, spacing + self.growth * max(away - within, 0.0))
        return size

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Spacing at many places (n, 2), m (n,)."""
        points, size = np.asarray(points, float), np.full(len(points), self.coarsest)
        for x0, y0, dx, dy, radius, spacing, within in self.regions:
            square, from_start = dx * dx + dy * dy, points - (x0, y0)
            t = np.clip(from_start @ (dx, dy) / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(points))
            away = np.abs(np.hypot(*(from_start - t[:, None] * (dx, dy)).T) - radius)
            size = np.minimum(size, spacing + self.growth * np.maximum(away - within, 0.0))
        return size

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Distance of places inside the plate from its nearest edge or hole, m (n,); mirror lines are no edges."""
        (x, y), (width, height) = np.asarray(points, float).T, self.size
        edges = {"left": x, "right": width - x, "bottom": y, "top": height - y}
        depth = np.minimum.reduce([away for name, away in edges.items() if name not in self.mirrors])
        for (x0, y0), radius in self.holes:
            depth = np.minimum(depth, np.hypot(x - x0, y - y0) - radius)
        return depth

    def cells(self, across: int = 200) -> float:
        """Estimate how many cells the plate takes: the integral of one over spacing^2."""
        width, height = self.size
        x, y = (np.arange(across) + 0.5) * (width / across), (np.arange(across) + 0.5) * (height / across)
        sizes = self(np.column_stack([grid.ravel() for grid in np.meshgrid(x, y)]))
        return float(np.mean(sizes**-2.0) * width * height)
