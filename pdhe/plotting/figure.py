"""Figures: a field at chosen times, in panels that share axes and colours."""

from __future__ import annotations

import string
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl

from pdhe import post
from pdhe.plotting.layout import ROOMY
from pdhe.plotting.picture import Picture, check_kind
from pdhe.plotting.solid import layout_of, panel_of, picture_of
from pdhe.plotting.style import MILLIMETRE, RC, Style
from pdhe.results import open_result
from pdhe.wholefile import moved_when_whole


def draw(kind: str, result_path: str | Path, style: Mapping[str, Any] | None, out_path: str | Path) -> None:
    """Draw ``damage``, ``displacement``, ``coverage`` or a ``state`` variable of a result at the times of the style.

    Cracks are drawn as dark lines along the facets of the cells. Displacement is shown on the displaced shape, whose
    magnification stands in the figure, as its ``y`` component unless another grows larger. Bodies in space are seen
    from a corner with a part cut away.

    Raises
    ------
    PdheError
        If the result lacks that field, or the style cannot be used.
    """
    chosen = Style.of(style)
    with open_result(result_path) as result:
        check_kind(result, kind, result_path)
        picture = picture_of(result, kind, chosen)
        if chosen.times is None:
            indices = post.telling_snapshots(result, chosen.panels)
        else:
            indices = list(dict.fromkeys(post.nearest_snapshot(result, time) for time in chosen.times))
        with mpl.rc_context(RC | {"font.size": chosen.font_size}):
            made = post.origin(result, Path(out_path).suffix)
            figure = _draw(picture, indices, chosen)
            with moved_when_whole(out_path) as place:
                figure.savefig(place, dpi=chosen.dpi, metadata=made, format=Path(out_path).suffix[1:])


def _draw(picture: Picture, indices: list[int], style: Style):
    layout = layout_of(picture, len(indices), style.width, style.font_size)
    figure = layout.figure(style.dpi)
    shape = tuple(max(2, round(side * MILLIMETRE * style.dpi)) for side in reversed(layout.panel))
    for number, index in enumerate(indices):
        axes = layout.axes(figure, number)
        panel_of(axes, picture, shape).show(index)
        letter = f"({string.ascii_lowercase[number]})  " if len(indices) > 1 else ""
        axes.set_title(letter + picture.time(index), loc="left", pad=3, fontsize=style.font_size)
        if layout.panel[0] >= ROOMY:
            axes.set_title(picture.remark(index), loc="right", pad=3, fontsize=style.font_size)
    layout.colour_bar(figure, picture)
    if picture.magnification:
        layout.note(figure, f"shape: $\\mathbf{{u}}$ × {picture.magnification:g}")
    return figure
