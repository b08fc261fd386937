"""Mirror lines of a body of which only a part is computed: reflections, and images of nodes and cracks.

Everything here is in a frame whose axes run along the mirror lines: a reflection is then a change of signs, which is
exact, and both ends of a bond across a mirror line see it alike to the bit (theory, section 3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pdhe.scene_blocks import Geometry

#: Axis across each edge, and whether the edge stands at its lower end.
EDGE_AXIS = {"left": (0, True), "right": (0, False), "bottom": (1, True), "top": (1, False)}

Segment = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Symmetry:
    """The mirror lines of a part, one or two, the latter at right angles.

    Reflection number ``q`` mirrors at the first line if its first bit is set and at the second one if its second bit
    is; 0 leaves everything in its place. One after another, reflections make up the one of number ``q1 ^ q2``.

    Attributes
    ----------
    axes
        Axis across each line: 0 or 1.
    origin
        Where the lines are, m (2,); zero along an axis without one.
    inward
        +1 where the part lies above the line across that axis, -1 where below, (2,).
    """

    axes: tuple[int, ...]
    origin: tuple[float, float]
    inward: tuple[float, float]

    @classmethod
    def of(cls, geometry: Geometry) -> Symmetry | None:
        """Mirror lines of a geometry; None without."""
        return cls.along(geometry.symmetry, geometry.width, geometry.height) if geometry.symmetry else None

    @classmethod
    def along(cls, edges: Sequence[str], width: float, height: float) -> Symmetry:
        """Mirror lines along some edges of a plate, m."""
        size, origin, inward = (width, height), [0.0, 0.0], [1.0, 1.0]
        for edge in edges:
            axis, low = EDGE_AXIS[edge]
            if not low:
                origin[axis], inward[axis] = size[axis], -1.0
        return cls(tuple(EDGE_AXIS[edge][0] for edge in edges), (origin[0], origin[1]), (inward[0], inward[1]))

    @property
    def copies(self) -> int:
        """How many such parts make up the whole body."""
        return 2 ** len(self.axes)

    def sign(self, number: int) -> np.ndarray:
        """Signs by which reflection ``number`` multiplies vectors, (2,)."""
        sign = np.ones(2)
        for bit, axis in enumerate(self.axes):
            if number >> bit & 1:
                sign[axis] = -1.0
        return sign

    def framed(self, points: np.ndarray) -> np.ndarray:
        """Positions (k, 2) relative to the mirror lines, m."""
        return np.asarray(points, float) - self.origin

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Bring framed points (k, 2) to the side of the part; m, in the plate's own coordinates."""
        points = points.copy()
        for axis in self.axes:
            points[:, axis] = self.inward[axis] * np.abs(points[:, axis])
        return points + self.origin

    def images(self, coordinates: np.ndarray, reach: float) -> Images:
        """Images of the nodes (n, 2) that a bond no longer than ``reach``, m, could lead to."""
        framed = self.framed(coordinates)
        source, number = [], []
        for q in range(1, self.copies):
            near = (np.abs(framed[:, self.sign(q) < 0.0]) <= reach).all(axis=1)
            source.append(np.flatnonzero(near))
            number.append(np.full(source[-1].size, q))
        nodes, reflection = np.concatenate(source).astype(np.int32), np.concatenate(number).astype(np.int8)
        sign = np.array([self.sign(q) for q in range(self.copies)])[reflection]
        positions = np.concatenate([framed, sign * framed[nodes]])
        return Images(self, nodes, reflection, sign, positions)

    def cracks(self, cracks: Sequence[Segment]) -> list[Segment]:
        """Cracks of the whole body, framed: each with its images, which keep the same side on their left.

        One along a mirror line is its own image; one that ends there goes on as its image.
        """
        found: list[Segment] = []
        for crack in cracks:
            ends = self.framed(np.array(crack))
            slack = 1e-9 * math.dist(*crack)
            pieces = [ends]
            for axis in self.axes:
                flip = np.ones(2)
                flip[axis] = -1.0
                pieces = [part for piece in pieces for part in _with_image(piece, axis, flip, slack)]
            found += [((a[0], a[1]), (b[0], b[1])) for a, b in (piece.tolist() for piece in pieces)]
        return found

    def touched(self, segment: Segment) -> list[int]:
        """Axes across the mirror lines that a segment of the part lies on or ends at."""
        ends, slack = self.framed(np.array(segment)), 1e-9 * math.dist(*segment)
        return [axis for axis in self.axes if np.abs(ends[:, axis]).min() <= slack]


def _with_image(piece: np.ndarray, axis: int, flip: np.ndarray, slack: float) -> list[np.ndarray]:
    """Return a segment (2 ends, 2) and its image, as one where they are one."""
    touches = np.abs(piece[:, axis]) <= slack
    if touches.all():
        return [piece]
    image = (piece * flip)[::-1]  # turned round, so that its left is the image of the left
    across = np.abs(np.diff(piece[:, 1 - axis])[0]) <= slack
    if touches[0] and across:
        return [np.array([image[0], piece[1]])]
    if touches[1] and across:
        return [np.array([piece[0], image[1]])]
    return [piece, image]


@dataclass(frozen=True)
class Images:
    """Images of nodes beyond mirror lines; as neighbours they are numbered on from the ``n`` nodes of the part.

    Attributes
    ----------
    symmetry
        The mirror lines.
    source, number
        Node and reflection that make each image, (g,); ascending by number, then by node.
    sign
        By what the displacement of the node is multiplied to be that of the image, (g, 2).
    positions
        Framed positions of nodes and images, m (n + g, 2).
    """

    symmetry: Symmetry
    source: np.ndarray
    number: np.ndarray
    sign: np.ndarray
    positions: np.ndarray

    @property
    def nodes(self) -> int:
        """Number of nodes that are no images."""
        return len(self.positions) - self.source.size

    @property
    def turn(self) -> np.ndarray:
        """By what the rotation of the node is multiplied to be that of the image, (g,)."""
        return self.sign.prod(axis=1)

    def fold(self, nodes: np.ndarray) -> np.ndarray:
        """The nodes behind some nodes and images."""
        n = self.nodes
        return np.where(nodes < n, nodes, self.source[np.maximum(nodes - n, 0)]).astype(nodes.dtype, copy=False)

    def numbered(self, nodes: np.ndarray) -> np.ndarray:
        """Numbers of some nodes and images in the whole body: image ``q`` of node ``i`` is ``q n + i``."""
        n, past = self.nodes, np.maximum(nodes - self.nodes, 0)
        return np.where(nodes < n, nodes, self.number[past].astype(np.int64) * n + self.source[past])

    def extend(self, values: np.ndarray) -> np.ndarray:
        """Node values that a reflection leaves as they are, with those of the images: (n, ...) to (n + g, ...)."""
        return np.concatenate([values, values[self.source]])

    def reverse(self, owner: np.ndarray, neighbours: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """The bonds, among some to images, that are the same bonds seen from their other ends.

        Parameters
        ----------
        owner, neighbours
            Ends of all directed bonds, (b,).
        rows
            Those bonds that lead to images, ascending; a bond of a node with its own image is its own reverse.
        """
        n, total = self.nodes, len(self.positions)
        image = neighbours[rows] - n
        known = self.number.astype(np.int64) * n + self.source
        mirrored = n + np.searchsorted(known, self.number[image].astype(np.int64) * n + owner[rows])
        key = owner[rows].astype(np.int64) * total + neighbours[rows]
        return rows[np.searchsorted(key, self.source[image].astype(np.int64) * total + mirrored)]
