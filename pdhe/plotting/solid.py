"""A field of a body in space as a picture: seen from a corner, with a part cut away so that its inside shows.

The picture is made of the facets that can be seen, drawn from far to near into an array of facet numbers; colours,
light and lines follow from that array, pixel by pixel. Light is one of three shades, by the direction a facet faces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from PIL import Image, ImageDraw

from pdhe import post
from pdhe.plotting.layout import Layout
from pdhe.plotting.picture import CRACK, OUTLINE, Panel, Picture
from pdhe.plotting.shape import Extent
from pdhe.plotting.style import Style
from pdhe.surfaces import Surface

#: The corner that the body is seen from: degrees about the vertical axis, and above the horizontal plane.
TURNED, ABOVE = 32.0, 27.0
#: Brightness of facets that face along x, y and z: light comes from above and a little from the viewer's left.
LIGHT = np.array([0.78, 1.0, 0.89])
#: Cosine of the angle between two facets from which the line between them is drawn.
_EDGE = 0.9
#: Pixels drawn for one that is shown, along either side: edges of the body are smooth then.
_FINER = 2


def picture_of(result: xr.Dataset, kind: str, style: Style) -> Picture:
    """Make the picture that suits a result: of a plate, or of a body in space."""
    return SolidPicture(result, kind, style) if "node_z" in result else Picture(result, kind, style)


def panel_of(axes: Axes, picture: Picture, shape: tuple[int, int]) -> Panel:
    """Make the panel that suits a picture."""
    return SolidPanel(axes, picture, shape) if isinstance(picture, SolidPicture) else Panel(axes, picture, shape)


def layout_of(picture: Picture, count: int, width: float, font_size: float) -> Layout:
    """Place panels on a page, with room for labels of axes where there are axes."""
    left, right, bottom, top = picture.extent
    kind = SolidLayout if isinstance(picture, SolidPicture) else Layout
    return kind.of(count, (right - left) / (top - bottom), width, font_size)


class SolidLayout(Layout):
    """Panels without axes."""

    @property
    def left(self) -> float:
        """Room beside the panels."""
        return 0.6 * self.em

    @property
    def bottom(self) -> float:
        """Room for the colour bar, and for a note."""
        return (7.4 if self.below else 1.8) * self.em

    @property
    def gap(self) -> float:
        """Room between columns."""
        return 1.2 * self.em


@dataclass(frozen=True)
class Camera:
    """Where pictures are taken from, without perspective.

    Attributes
    ----------
    right, up, towards
        Unit vectors (3,): to the right and up in the picture, and out of it.
    """

    right: np.ndarray
    up: np.ndarray
    towards: np.ndarray

    @classmethod
    def at_corner(cls) -> Camera:
        """Look at the corner of largest x, y and z, with y upright."""
        a, b = np.radians(TURNED), np.radians(ABOVE)
        towards = np.array([np.cos(b) * np.sin(a), np.sin(b), np.cos(b) * np.cos(a)])
        right = np.array([np.cos(a), 0.0, -np.sin(a)])
        return cls(right, np.cross(towards, right), towards)

    def flat(self, points: np.ndarray) -> np.ndarray:
        """Places in the picture of points (..., 3), m (..., 2)."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)


class SolidPicture(Picture):
    """Everything about a picture of a body in space that does not depend on where it is drawn.

    The part above the crack (above the middle without one) and nearer than the middle of the thickness is cut away.
    """

    components = "xyz"

    def __init__(self, result: xr.Dataset, kind: str, style: Style) -> None:
        super().__init__(result, kind, replace(style, window=None))
        self.camera = Camera.at_corner()
        centres = np.column_stack([result[f"node_{axis}"].values for axis in "xyz"])
        level, middle = self._level(), 0.5 * (self.vertices[:, 2].min() + self.vertices[:, 2].max())
        self.kept = ~((centres[:, 1] > level) & (centres[:, 2] > middle))
        self._centres = centres

    def _facets(self) -> post.Facets:
        return post.facets_of(self.result)

    def _level(self) -> float:
        """Height of the cut, m: the mean one of the surfaces of cracks that are more level than upright."""
        found = []
        for crack in post.crack_surfaces(self.result):
            if abs(crack.normal[1]) > 0.7:
                found.append(_middle(crack)[1])
        low, high = self.vertices[:, 1].min(), self.vertices[:, 1].max()
        level = float(np.mean(found)) if found else 0.5 * (low + high)
        # Between two layers of cells, as near as can be.
        heights = np.unique(np.round(self.vertices[:, 1], 12))
        return float(heights[np.abs(heights - level).argmin()]) if self.cells.shape[1] == 8 else level

    @property
    def extent(self) -> Extent:
        """Left, right, bottom and top of everything that is ever shown, m in the picture."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        points = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        flat = self.camera.flat(points)
        if self.magnification:
            moved = self.camera.flat(self._centres + self.magnification * self.shift).reshape(-1, 2)
            cell = float(np.cbrt(np.ptp(self.vertices, axis=0).prod() / len(self.cells)))
            flat = np.concatenate([flat, moved - cell, moved + cell])
        margin = 0.01 * np.ptp(flat, axis=0).max()
        (left, bottom), (right, top) = flat.min(axis=0) - margin, flat.max(axis=0) + margin
        return (float(left), float(right), float(bottom), float(top))

    def visible(self, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Facets that may be seen at an output: the cell of each, its corners as places in it, and whether it is crack.

        Those between a cell that is kept and none, or one that is cut away, and both sides of open cracks.
        """
        crack = np.zeros(len(self.facets.vertices), bool)
        crack[self.cracks[index]] = True
        one, other = self.facets.cells.T
        show_one = self.kept[one] & (~self.kept[other] | crack)
        show_other = self.kept[other] & (~self.kept[one] | crack)
        outer = self.kept[self.facets.outer_cells]
        cells = np.concatenate([one[show_one], other[show_other], self.facets.outer_cells[outer]])
        vertices = [self.facets.vertices[show_one], self.facets.vertices[show_other], self.facets.outer_vertices[outer]]
        broken = np.concatenate([crack[show_one], crack[show_other], np.zeros(int(outer.sum()), bool)])
        place = (self.cells[cells][:, None, :] == np.concatenate(vertices)[:, :, None]).argmax(axis=2)
        return cells, place, broken

    def draw(self, index: int, extent: Extent, shape: tuple[int, int]) -> np.ndarray:
        """Paint an output: red, green, blue and opacity of each pixel, (rows, columns, 4), first row on top."""
        rows, columns = (_FINER * side for side in shape)
        cells, place, broken = self.visible(index)
        corners = self.corners(index)[cells[:, None], place]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
        # Facets are seen from outside of their own cell: the corners of inner ones are in the order of either cell.
        away = corners.mean(axis=1) - self.corners(index)[cells].mean(axis=1)
        normal *= np.sign(np.einsum("kc,kc->k", normal, away))[:, None]
        seen = np.flatnonzero(normal @ self.camera.towards > 1e-9)
        seen = seen[np.argsort(corners[seen].mean(axis=1) @ self.camera.towards, kind="stable")]
        left, right, bottom, top = extent
        flat = (self.camera.flat(corners) - (left, top)) * (columns / (right - left), -rows / (top - bottom)) - 0.5
        number = Image.new("I", (columns, rows), -1)
        polygon = ImageDraw.Draw(number).polygon
        for facet in seen.tolist():
            polygon(flat[facet].ravel().tolist(), fill=facet)
        facet = np.asarray(number)
        inside = facet >= 0
        light = LIGHT[np.abs(normal).argmax(axis=1)]
        colour = self.colours(self.norm()(self.field[index][cells]))
        colour[:, :3] *= light[:, None]
        picture = np.zeros((rows, columns, 4))
        picture[inside] = colour[facet[inside]]
        picture[_lines(facet, normal, broken)] = (0.2, 0.2, 0.2, 1.0)
        # Opacity first, so that what is transparent does not darken the rim.
        opaque = picture[..., 3:]
        fine = np.concatenate([picture[..., :3] * opaque, opaque], axis=2)
        fine = fine.reshape(shape[0], _FINER, shape[1], _FINER, 4).mean(axis=(1, 3))
        fine[..., :3] /= np.maximum(fine[..., 3:], np.finfo(float).tiny)
        return np.clip(fine, 0.0, 1.0)

    def shades(self, count: int) -> np.ndarray:
        """Colours that the picture is made of, beside greys, at most twice ``count``, (c, 3): in each light."""
        scale = self.colours(np.linspace(0, 1, 5 * count // (3 * len(LIGHT))))[:, :3]
        return np.concatenate([scale * light for light in LIGHT])


def _middle(surface: Surface) -> np.ndarray:
    """Centre of a disc, mean corner of a polygon, m (3,)."""
    return surface.origin if surface.outline is None else surface.origin + surface.outline.mean(axis=0) @ surface.axes


def _lines(facet: np.ndarray, normal: np.ndarray, broken: np.ndarray) -> np.ndarray:
    """Pixels of lines: the outline, edges between facets that face different ways, and where a crack's face ends."""
    line = np.zeros(facet.shape, bool)
    for axis in (0, 1):
        here, there = (facet[:-1], facet[1:]) if axis == 0 else (facet[:, :-1], facet[:, 1:])
        rim = (here < 0) != (there < 0)
        both = (here >= 0) & (there >= 0) & (here != there)
        a, b = here[both], there[both]
        differs = (np.einsum("kc,kc->k", normal[a], normal[b]) < _EDGE) | (broken[a] != broken[b])
        edge = rim.copy()
        edge[both] = differs
        marked = line[:-1] if axis == 0 else line[:, :-1]
        marked |= edge
    return line


class SolidPanel(Panel):
    """A picture of a body in space in a pair of axes that are not shown."""

    def __init__(self, axes: Axes, picture: SolidPicture, shape: tuple[int, int]) -> None:
        self.axes, self.picture, self.shape = axes, picture, shape
        self.extent = picture.extent
        left, right, bottom, top = (1e3 * value for value in self.extent)
        self.image = axes.imshow(
            np.zeros((*shape, 4)), extent=(left, right, bottom, top), interpolation="nearest", aspect="auto"
        )
        axes.set_xlim(left, right)
        axes.set_ylim(bottom, top)
        axes.set_axis_off()
        self._triad()

    @property
    def artists(self) -> tuple[Artist, ...]:
        """Everything that differs between outputs."""
        return (self.image,)

    def show(self, index: int) -> None:
        """Show an output."""
        self.image.set_data(self.picture.draw(index, self.extent, self.shape))

    def _triad(self) -> None:
        """Draw the three directions, as long as a round number of millimetres, beside the lower left corner."""
        camera = self.picture.camera
        left, right, bottom, top = (1e3 * value for value in self.extent)
        length = _round(0.16 * (right - left))
        directions = 1e3 * length * 1e-3 * camera.flat(np.eye(3))
        low = np.minimum(directions, 0.0).min(axis=0)
        origin = np.array([left, bottom]) - low + 0.02 * np.array([right - left, top - bottom])
        for name, (x, y) in zip("xyz", directions, strict=True):
            self.axes.annotate(
                "", origin + np.array([x, y]), origin, annotation_clip=False,
                arrowprops={"arrowstyle": "-|>", "color": OUTLINE, "linewidth": 0.7, "mutation_scale": 5,
                            "shrinkA": 0, "shrinkB": 0},
            )  # fmt: skip
            away = np.array([x, y]) * (1.0 + 0.18 * length / max(np.hypot(x, y), 0.3 * length))
            self.axes.text(*(origin + away), f"${name}$", color=CRACK, ha="center", va="center")
        # Beside the arrow along x, which the body leaves free.
        x, y = origin + directions[0]
        self.axes.text(x + 0.6 * length, y, f"{length:g} mm", ha="left", va="center", color=OUTLINE, clip_on=False)


def _round(value: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step <= value / power))
