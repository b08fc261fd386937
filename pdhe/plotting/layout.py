"""Panels and a colour bar placed on a page, in millimetres, so that text never meets text and no space is wasted."""

from __future__ import annotations

from dataclasses import dataclass, replace

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pdhe.plotting.picture import Picture
from pdhe.plotting.style import MILLIMETRE

#: Largest size of one panel, smallest width of several, longest colour bar, mm; length of its longest label, em.
_PANEL, _NARROWEST, _BAR, _LABEL = (120.0, 110.0), 28.0, 75.0, 17.0
#: Width below which a panel has no room for a second text above it, mm.
ROOMY = 46.0


@dataclass(frozen=True)
class Layout:
    """Where things are, mm; texts are measured in multiples of the type size ``em``.

    The colour bar stands beside the panels, or lies below them where they are too low for its label.
    """

    columns: int
    rows: int
    panel: tuple[float, float]
    em: float
    below: bool

    @classmethod
    def of(cls, count: int, aspect: float, width: float, font_size: float) -> Layout:
        """Place ``count`` panels of width over height ``aspect`` on a page of a width in mm.

        The fewest columns are taken that keep the page no taller than wide, full rows preferred; if none does, as many
        columns as leave the panels legible.
        """
        em = font_size * 25.4 / 72
        full = [k for k in range(1, count + 1) if count % k == 0]
        choices = [cls._with(columns, count, aspect, width, em) for columns in (*full, *range(1, count + 1))]
        legible = [one for one in choices if one.panel[0] >= _NARROWEST] or choices[:1]
        return next((one for one in legible if one.size[1] <= width), max(legible, key=lambda one: one.columns))

    @classmethod
    def _with(cls, columns: int, count: int, aspect: float, width: float, em: float) -> Layout:
        for below in (False, True):
            empty = cls(columns, -(-count // columns), (0.0, 0.0), em, below)
            wide = max(1.0, min((width - empty.size[0]) / columns, _PANEL[0], _PANEL[1] * aspect))
            if wide / aspect * empty.rows + empty.title * (empty.rows - 1) >= _LABEL * em:
                break
        return replace(empty, panel=(wide, wide / aspect))

    @property
    def left(self) -> float:
        """Room for the labels of the vertical axis."""
        return 4.4 * self.em

    @property
    def right(self) -> float:
        """Room for the colour bar and its labels."""
        return (1.6 if self.below else 7.2) * self.em

    @property
    def bottom(self) -> float:
        """Room for the labels of the horizontal axis, and for the colour bar."""
        return (7.8 if self.below else 3.4) * self.em

    @property
    def title(self) -> float:
        """Room above a panel."""
        return 1.9 * self.em

    @property
    def gap(self) -> float:
        """Room between columns."""
        return 2.4 * self.em

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the page."""
        wide = self.left + self.columns * self.panel[0] + (self.columns - 1) * self.gap + self.right
        return wide, self.bottom + self.rows * (self.panel[1] + self.title) + 0.3 * self.em

    def figure(self, dpi: float) -> Figure:
        """Make an empty page."""
        wide, high = self.size
        figure = Figure(figsize=(wide * MILLIMETRE, high * MILLIMETRE), dpi=dpi)
        FigureCanvasAgg(figure)
        return figure

    def axes(self, figure: Figure, number: int) -> Axes:
        """Make the axes of a panel; inner ones carry no labels."""
        row, column = divmod(number, self.columns)
        x = self.left + column * (self.panel[0] + self.gap)
        y = self.bottom + (self.rows - 1 - row) * (self.panel[1] + self.title)
        axes = self._place(figure, x, y, *self.panel)
        steps = [1, 2, 2.5, 5, 10]
        axes.xaxis.set_major_locator(MaxNLocator(max(2, int(self.panel[0] / (4.5 * self.em))), steps=steps))
        axes.yaxis.set_major_locator(MaxNLocator(max(2, int(self.panel[1] / (2.6 * self.em))), steps=steps))
        axes.tick_params(labelleft=column == 0, labelbottom=row == self.rows - 1, pad=2)
        if column == 0:
            axes.set_ylabel("$y$ (mm)", labelpad=1.5)
        if row == self.rows - 1:
            axes.set_xlabel("$x$ (mm)", labelpad=1.5)
        return axes

    def colour_bar(self, figure: Figure, picture: Picture) -> None:
        """Draw the colour bar."""
        wide, high = self.size
        if self.below:
            long = min(wide - self.left - self.right, _BAR)
            axes = self._place(figure, self.left, 3.2 * self.em, long, 1.1 * self.em)
        else:
            long = high - self.bottom - self.title - 0.3 * self.em
            y = self.bottom + max(0.0, 0.5 * (long - _BAR))
            axes = self._place(figure, wide - self.right + 1.0 * self.em, y, 1.3 * self.em, min(long, _BAR))
        bar = figure.colorbar(
            ScalarMappable(picture.norm(), picture.colours), cax=axes, extendfrac=0.04,
            extend="max" if picture.beyond else "neither", orientation="horizontal" if self.below else "vertical",
        )  # fmt: skip
        bar.locator = MaxNLocator(6, steps=[1, 2, 5, 10])
        bar.update_ticks()
        bar.set_label(picture.label, labelpad=1.5 if self.below else 3)
        bar.outline.set_linewidth(0.6)
        axes.tick_params(pad=2)

    def note(self, figure: Figure, text: str) -> None:
        """Write a remark into the lower right corner."""
        wide, high = self.size
        figure.text(1.0 - 0.4 * self.em / wide, 0.55 * self.em / high, text, ha="right", va="bottom")

    def _place(self, figure: Figure, x: float, y: float, wide: float, high: float) -> Axes:
        width, height = self.size
        return figure.add_axes((x / width, y / height, wide / width, high / height))
