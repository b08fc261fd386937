"""Plane surfaces in space: what crosses a crack, and how far points are from it; the counterpart of segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pdhe.scene import Crack

#: Distance over the size of a surface at which a point counts as lying on its plane or on its rim.
ROUND_OFF = 1e-12


@dataclass(frozen=True, eq=False)
class Surface:
    """A disc or a plane polygon.

    Attributes
    ----------
    origin
        A point of its plane, the centre of a disc, m (3,).
    normal
        Unit vector (3,).
    axes
        Two unit vectors in the plane (2, 3).
    radius
        Of a disc, m; None for a polygon.
    outline
        Corners of a polygon in the plane, in order around it, m (k, 2); None for a disc.
    """

    origin: np.ndarray
    normal: np.ndarray
    axes: np.ndarray
    radius: float | None = None
    outline: np.ndarray | None = None

    @classmethod
    def disc(cls, centre: Sequence[float], normal: Sequence[float], radius: float) -> Surface:
        """A disc."""
        return cls(np.asarray(centre, float), *_frame(np.asarray(normal, float)), radius=radius)

    @classmethod
    def polygon(cls, corners: Sequence[Sequence[float]]) -> Surface:
        """A polygon whose corners (k, 3), m, are given in order around it; its normal follows the right-hand rule."""
        points = np.asarray(corners, float)
        relative = points - points[0]
        normal, axes = _frame(np.cross(relative, np.roll(relative, -1, axis=0)).sum(axis=0))
        return cls(points[0], normal, axes, outline=relative @ axes.T)

    @property
    def size(self) -> float:
        """Diameter of a disc, largest distance of two corners of a polygon, m."""
        if self.outline is None:
            return 2.0 * self.radius
        return float(np.linalg.norm(self.outline[:, None] - self.outline, axis=-1).max())

    @property
    def width(self) -> float:
        """Smallest extent in the plane, m: of a polygon, the least over the directions of its sides' normals."""
        if self.outline is None:
            return 2.0 * self.radius
        sides = np.roll(self.outline, -1, axis=0) - self.outline
        across = np.stack([-sides[:, 1], sides[:, 0]]) / np.linalg.norm(sides, axis=1)
        return float(np.ptp(self.outline @ across, axis=0).min())

    @property
    def area(self) -> float:
        """m^2."""
        if self.outline is None:
            return float(np.pi * self.radius**2)
        x, y = self.outline.T
        return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))

    def height(self, points: np.ndarray) -> np.ndarray:
        """Signed distance of points (k, 3) from the plane, m (k,); exactly zero within round-off of the coordinates."""
        above = (points - self.origin) @ self.normal
        scale = max(float(np.abs(points).max(initial=0.0)), float(np.abs(self.origin).max()), self.size)
        return np.where(np.abs(above) <= ROUND_OFF * scale, 0.0, above)

    def depth(self, points: np.ndarray) -> np.ndarray:
        """How far inside its rim the projections of points (k, 3) lie, m (k,); negative outside, zero on the rim."""
        flat = (points - self.origin) @ self.axes.T
        if self.outline is None:
            depth = self.radius - np.hypot(*flat.T)
        else:
            nearest, inside = np.full(len(flat), np.inf), np.zeros(len(flat), bool)
            for a, b in zip(self.outline, np.roll(self.outline, -1, axis=0), strict=True):
                side = b - a
                t = np.clip((flat - a) @ side / float(side @ side), 0.0, 1.0)
                nearest = np.minimum(nearest, np.hypot(*(flat - a - t[:, None] * side).T))
                # A ray along x meets this side, counted from its lower end on so that corners count once.
                spans = (a[1] > flat[:, 1]) != (b[1] > flat[:, 1])
                turn = side[0] * (flat[:, 1] - a[1]) - side[1] * (flat[:, 0] - a[0])
                inside ^= spans & ((turn > 0.0) == (side[1] > 0.0))
            depth = np.where(inside, nearest, -nearest)
        scale = max(float(np.abs(points).max(initial=0.0)), self.size)
        return np.where(np.abs(depth) <= 10.0 * ROUND_OFF * scale, 0.0, depth)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance of points (k, 3) from the surface, m (k,)."""
        return np.hypot(self.height(points), np.minimum(self.depth(points), 0.0))


def surface_of(crack: Crack, thickness: float) -> Surface:
    """The surface of a crack of a scene; one given by a segment goes through the thickness, m."""
    if crack.disc is not None:
        return Surface.disc(crack.disc.centre, crack.disc.normal, crack.disc.radius)
    if crack.polygon is not None:
        return Surface.polygon(crack.polygon)
    # In this order the left of the segment, seen from its start, is on the side of the normal, as in the plane.
    a, b = crack.start, crack.end
    return Surface.polygon([(*b, 0.0), (*a, 0.0), (*a, thickness), (*b, thickness)])


def crossed_by(start: np.ndarray, end: np.ndarray, surfaces: Sequence[Surface]) -> np.ndarray:
    """Tell which segments ``start -> end`` (b, 3) cross one of the surfaces.

    A segment that only touches a rim is not cut, unless another surface goes on there. A point on a surface counts as
    lying on the side of its normal.
    """
    crossed = np.zeros(len(start), bool)
    for index, surface in enumerate(surfaces):
        low, high = surface.height(start), surface.height(end)
        rows = np.flatnonzero((low >= 0.0) != (high >= 0.0))
        share = low[rows] / (low[rows] - high[rows])
        points = start[rows] + share[:, None] * (end[rows] - start[rows])
        depth = surface.depth(points)
        inside, rim = depth > 0.0, np.flatnonzero(depth == 0.0)
        for other in (*surfaces[:index], *surfaces[index + 1 :]):
            inside[rim] |= other.distance(points[rim]) <= 1e-9 * surface.size
        crossed[rows[inside]] = True
    return crossed


def _frame(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normal, and two unit vectors that with it make a right-handed frame."""
    unit = normal / np.linalg.norm(normal)
    first = np.cross(np.eye(3)[int(np.abs(unit).argmin())], unit)
    first /= np.linalg.norm(first)
    return unit, np.stack([first, np.cross(unit, first)])
