"""How the figures of the mechanics topics look."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Colours that stay apart in grey and for colour-blind readers (Okabe and Ito), dark ones first.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")


def panels(figure: Figure, columns: int, rows: int = 1, **options) -> list[Axes]:
    """Axes in a row or grid, with a light grid and no box, lettered where there are several."""
    axes = list(figure.subplots(rows, columns, squeeze=False, **options).ravel())
    for letter, ax in zip("abcdefgh", axes, strict=False):
        ax.grid(True, which="major", color="0.9", linewidth=0.7)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelsize=8)
        if len(axes) > 1:
            ax.set_title(f"({letter})", loc="left", fontsize=9, fontweight="bold")
    return axes


def label(ax: Axes, x: str, y: str, title: str = "") -> None:
    """Axis labels, and a title beside the letter."""
    ax.set_xlabel(x, fontsize=9)
    ax.set_ylabel(y, fontsize=9)
    if title:
        ax.set_title(title, fontsize=9)


def band(ax: Axes, centre: float, half_width: float, text: str = "") -> None:
    """Shade what is allowed around an expected value."""
    ax.axhspan(centre - half_width, centre + half_width, color="#009E73", alpha=0.12, linewidth=0, label=text or None)
    ax.axhline(centre, color="0.3", linewidth=0.8)
