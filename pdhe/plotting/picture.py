"""A field of a result as a picture: its values, colours and labels, and panels that show it at one time."""

from __future__ import annotations

import difflib
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, Normalize
from matplotlib.lines import Line2D

from pdhe import post
from pdhe.errors import PdheError
from pdhe.plotting.shape import Extent, cell_of_pixel, displaced_corners, facet_lines, in_loops
from pdhe.plotting.style import Style
from pdhe.whole import whole_result

#: Kinds of picture, and the part of the scene without which a result lacks the field.
KINDS = {"damage": "damage", "displacement": "loads", "coverage": "hydrogen", "state": "material.umat.states"}
#: What the names of state variables of a user material begin with.
STATE = "state_"
CRACK, OUTLINE, CASING = "black", "0.35", (1.0, 1.0, 1.0, 0.75)
_PREFIXES = (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9))
#: Largest displacement in the displaced shape over the length of the body.
_VISIBLE = 0.04


def check_kind(result: xr.Dataset, kind: str, path: str | Path) -> None:
    """Raise :class:`PdheError` if there is no such kind of picture, or the result has nothing to show in it."""
    if kind not in KINDS:
        near = difflib.get_close_matches(kind, KINDS, 1)
        raise PdheError(
            f"no picture of '{kind}'; " + (f"did you mean '{near[0]}'?" if near else f"known: {', '.join(KINDS)}")
        )
    if kind not in result and not (kind == "state" and states_of(result)):
        raise PdheError(f"{path}: the result holds no {kind}, because its scene has no `{KINDS[kind]}`")


def states_of(result: xr.Dataset) -> list[str]:
    """Names of the state variables of a user material in a result, in order."""
    return [str(name).removeprefix(STATE) for name in result.data_vars if str(name).startswith(STATE)]


class Picture:
    """Everything about a picture that does not depend on where it is drawn."""

    components = "xy"

    def __init__(self, result: xr.Dataset, kind: str, style: Style) -> None:
        result = whole_result(result)
        self.result, self.kind = result, kind
        self.times = result["time"].values
        self.colours: Colormap = style.colour_map(kind)
        self.vertices, self.cells = result["vertices"].values, result["cells"].values
        self.facets = self._facets()
        self.cracks = post.open_facets(result, self.facets)
        self.pre_cracks = post.pre_cracks(result)
        self.field = result[kind].values if kind != "state" else np.empty(0)
        self.magnification = 0.0
        if kind == "displacement":
            self._set_displacement(style)
        elif kind == "state":
            self._set_state(style)
        else:
            self.limits = (0.0, style.damage_limit if kind == "damage" else 1.0)
            self.label = {"damage": r"damage $\phi$ (share of broken bonds)", "coverage": r"hydrogen coverage $\psi$"}[
                kind
            ]
        self.beyond = kind == "damage" and self.field.max() > self.limits[1]
        self._lookup: tuple[tuple, np.ndarray] | None = None
        self.window = style.window

    def _facets(self) -> post.Facets:
        return in_loops(post.facets_of(self.result))

    def _set_displacement(self, style: Style) -> None:
        largest = np.abs(self.field).max(axis=(0, 1))
        chosen = style.component if style.component != "auto" else self._largest(largest)
        if chosen not in (*self.components, "magnitude"):
            raise PdheError(
                f"figure style: 'component' is '{chosen}', which a plate does not have; use x, y or magnitude"
            )
        self.shift = self.field
        if chosen == "magnitude":
            self.field, symbol = np.linalg.norm(self.field, axis=2), r"|\mathbf{u}|"
            if style.displacement_map == Style.displacement_map:
                self.colours = Style(displacement_map="viridis").colour_map("displacement")
        else:
            self.field, symbol = self.field[:, :, self.components.index(chosen)], f"u_{chosen}"
        top = float(np.abs(self.field).max())
        unit, size = next((p for p in _PREFIXES if top >= p[1]), _PREFIXES[-1]) if top > 0 else _PREFIXES[1]
        self.field = self.field / size
        top = top / size or 1.0
        self.limits = (0.0 if chosen == "magnitude" else -top, top)
        self.label = f"displacement ${symbol}$ ({unit})"
        if style.magnification is not None:
            self.magnification = style.magnification
        elif post.scene_of(self.result).get("mechanics", {}).get("strain") == "finite":
            self.magnification = 1.0
        elif largest.max() > 0:
            self.magnification = _round_down(_VISIBLE * np.ptp(self.vertices, axis=0).max() / largest.max())

    def _set_state(self, style: Style) -> None:
        known = states_of(self.result)
        name = style.state or known[0]
        if name not in known:
            raise PdheError(f"figure style: 'state' is '{name}', not one of {', '.join(known)}")
        variable = self.result[STATE + name]
        self.field, unit = variable.values, variable.attrs.get("units", "1")
        low, high = float(self.field.min()), float(self.field.max())
        self.limits = (min(low, 0.0), high if high > low else max(high, 0.0) + 1.0)
        self.label = name.replace("_", " ") + (f" ({unit})" if unit != "1" else "")

    def _largest(self, amount: np.ndarray) -> str:
        """The component that grows largest; of equal ones y, then x."""
        return max(self.components, key=lambda name: (amount["xyz".index(name)], name == "y", name == "x"))

    @property
    def extent(self) -> Extent:
        """Left, right, bottom and top of everything that is ever shown, m."""
        if self.window:
            return self.window
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        if self.magnification:
            centres = np.column_stack([self.result["node_x"].values, self.result["node_y"].values])
            moved = centres + self.magnification * self.shift
            half = np.sqrt(np.ptp(self.vertices, axis=0).prod() / len(self.cells))  # a cell's width, generously
            low = np.minimum(low, moved.min(axis=(0, 1)) - half)
            high = np.maximum(high, moved.max(axis=(0, 1)) + half)
        return (low[0], high[0], low[1], high[1])

    def norm(self) -> Normalize:
        """Scale of the colours, the same in all panels and frames."""
        return Normalize(*self.limits)

    def corners(self, index: int) -> np.ndarray:
        """Corners of the cells at an output, m (n, k, 2)."""
        if not self.magnification:
            return self.vertices[self.cells]
        shift = self.magnification * self.shift[index]
        return displaced_corners(self.vertices, self.cells, self.facets, self.cracks[index], shift)

    def pixels(self, index: int, extent: Extent, shape: tuple[int, int], corners: np.ndarray) -> np.ndarray:
        """Values at the pixels of a picture, masked outside of the body; (rows, columns), first row on top."""
        if self._lookup is None or self._lookup[0] != (extent, shape) or self.magnification:
            self._lookup = (extent, shape), cell_of_pixel(corners, extent, shape)
        lookup = self._lookup[1]
        return np.ma.masked_array(self.field[index][lookup], lookup < 0)

    def crack(self, index: int, corners: np.ndarray) -> np.ndarray:
        """Lines of the crack, m (k, 2, 2): both faces in a displaced shape, else pre-cracks as the scene has them."""
        rows, facets = self.cracks[index], self.facets
        if self.magnification:
            sides = [facet_lines(corners, self.cells, side, facets.vertices[rows]) for side in facets.cells[rows].T]
            return np.concatenate(sides)
        rows = rows[facets.broken[rows] > post.PRE_CRACKED]
        return np.concatenate([self.pre_cracks, self.vertices[facets.vertices[rows]]])

    def outline(self, corners: np.ndarray) -> np.ndarray:
        """Lines of the boundary of the body, m (k, 2, 2)."""
        return facet_lines(corners, self.cells, self.facets.outer_cells, self.facets.outer_vertices)

    def shades(self, count: int) -> np.ndarray:
        """Colours that the picture is made of, beside greys, at most twice ``count``, (c, 3)."""
        return self.colours(np.linspace(0, 1, count))[:, :3]

    def time(self, index: int) -> str:
        """The time of an output, for a reader."""
        return post.time_label(self.times[index], self.times[-1])

    def remark(self, index: int) -> str:
        """A number that tells how far things are at an output."""
        time = self.times[index]
        if self.kind == "state":
            return f"up to {self.field[index].max():.3g}"
        if "crack_extension" in self.result:
            return f"Δa = {1e3 * post.at_time(self.result, 'crack_extension', time):.1f} mm"
        if "mean_coverage" in self.result:
            return f"mean {post.at_time(self.result, 'mean_coverage', time):.2f}"
        return ""


class Panel:
    """A picture in a pair of axes, at one output at a time."""

    def __init__(self, axes: Axes, picture: Picture, shape: tuple[int, int]) -> None:
        self.axes, self.picture, self.shape = axes, picture, shape
        self.extent = picture.extent
        left, right, bottom, top = (1e3 * value for value in self.extent)
        self.image = axes.imshow(
            np.zeros(shape), cmap=picture.colours, norm=picture.norm(), extent=(left, right, bottom, top),
            interpolation="nearest", aspect="auto",
        )  # fmt: skip

        def line(colour: object, width: float) -> Line2D:
            return axes.plot([], [], color=colour, linewidth=width, solid_capstyle="round", solid_joinstyle="round")[0]

        # A crack is a thin line where damage shows it too; on the colours of coverage it needs a light edge.
        width = 0.5 if picture.kind == "damage" else 0.9
        self.outline = line(OUTLINE, 0.5)
        self.casing = line(CASING, 2.0 * width if picture.kind == "coverage" else 0.0)
        self.crack = line(CRACK, width)
        axes.set_xlim(left, right)
        axes.set_ylim(bottom, top)
        for spine in axes.spines.values():
            spine.set_visible(bool(picture.magnification or picture.window))
            spine.set_color(OUTLINE)

    @property
    def artists(self) -> tuple[Artist, ...]:
        """Everything that differs between outputs, from back to front."""
        return self.image, self.outline, self.casing, self.crack

    def show(self, index: int) -> None:
        """Show an output."""
        corners = self.picture.corners(index)
        self.image.set_data(self.picture.pixels(index, self.extent, self.shape, corners))
        self.outline.set_data(*_strokes(self.picture.outline(corners)))
        for line in (self.casing, self.crack):
            line.set_data(*_strokes(self.picture.crack(index, corners)))


def _strokes(segments: np.ndarray) -> np.ndarray:
    """Segments (k, 2 ends, 2), m, as one line in mm, lifted where one does not begin at the last one's end, (2, p)."""
    follows = np.zeros(len(segments), bool)
    follows[1:] = (segments[1:, 0] == segments[:-1, 1]).all(axis=1)
    points = np.pad(segments, ((0, 0), (1, 0), (0, 0)), constant_values=np.nan)
    keep = np.ones(points.shape[:2], bool)
    keep[follows, :2] = False
    return 1e3 * points[keep].T


def _round_down(value: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step <= value / power * (1 + 1e-9)))
