"""Animations: a field over time as a GIF with one palette, fixed axes and fixed colours."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from pdhe import post
from pdhe.plotting.picture import Picture, check_kind
from pdhe.plotting.solid import layout_of, panel_of, picture_of
from pdhe.plotting.style import MILLIMETRE, RC, Style
from pdhe.results import open_result
from pdhe.wholefile import moved_when_whole

#: Colours of the palette that come from the colour map; the others are greys, for text and lines.
_SHADES = 128
#: Bits per channel in the table that finds the palette's nearest colour.
_BITS = 6
_SHORTEST, _LONGEST = 0.05, 0.5  # seconds that a frame is shown
_WIDTH = 120.0  # of the page in mm; with the type at its usual size, this makes it legible on screens


def animate(kind: str, result_path: str | Path, style: Mapping[str, Any] | None, out_path: str | Path) -> None:
    """Draw ``damage``, ``displacement``, ``coverage`` or a ``state`` variable of a result in time, as a GIF that loops.

    Every output is a frame, or as many evenly spaced ones as the style allows; the last one is held.

    Raises
    ------
    PdheError
        If the result lacks that field, or the style cannot be used.
    """
    chosen = Style.of(style)
    with open_result(result_path) as result:
        check_kind(result, kind, result_path)
        picture = picture_of(result, kind, chosen)
        count = picture.times.size
        indices = np.unique(np.linspace(0, count - 1, min(count, chosen.frames)).round().astype(int))
        if chosen.frames == 1:
            indices = np.array([count - 1])
        with mpl.rc_context(RC | {"font.size": chosen.font_size}):
            frames = _frames(picture, indices.tolist(), chosen)
        made = post.origin(result, ".gif")["Source"].encode()
    shown = float(np.clip(chosen.duration / len(frames), _SHORTEST, _LONGEST))
    durations = [round(1e3 * shown)] * (len(frames) - 1) + [round(1e3 * (shown + chosen.hold))]
    more = {"save_all": True, "append_images": frames[1:], "duration": durations, "loop": 0, "comment": made}
    with moved_when_whole(out_path) as place:
        frames[0].save(place, format="GIF", **more)


def _frames(picture: Picture, indices: list[int], style: Style) -> list[Image.Image]:
    """Draw what never changes once, and over it what does."""
    layout = layout_of(picture, 1, _WIDTH, style.font_size)
    figure = layout.figure(style.frame_width / (layout.size[0] * MILLIMETRE))
    axes = layout.axes(figure, 0)
    box = axes.get_window_extent()
    panel = panel_of(axes, picture, (round(box.height), round(box.width)))
    time = axes.set_title("", loc="left", pad=3, fontsize=style.font_size)
    remark = axes.set_title("", loc="right", pad=3, fontsize=style.font_size)
    layout.colour_bar(figure, picture)
    if picture.magnification:
        layout.note(figure, f"shape: $\\mathbf{{u}}$ × {picture.magnification:g}")
    changing = (*panel.artists, time, remark)
    for artist in changing:
        artist.set_animated(True)
    figure.canvas.draw()
    still = figure.canvas.copy_from_bbox(figure.bbox)
    palette = _palette(picture)
    nearest = _nearest(palette)
    frames = []
    for index in indices:
        figure.canvas.restore_region(still)
        panel.show(index)
        time.set_text(f"t = {picture.time(index)}")
        remark.set_text(picture.remark(index))
        for artist in changing:
            axes.draw_artist(artist)
        red, green, blue, _ = np.moveaxis(np.asarray(figure.canvas.buffer_rgba()) >> (8 - _BITS), -1, 0).astype(
            np.int32
        )
        frame = Image.fromarray(nearest[(red << 2 * _BITS) | (green << _BITS) | blue], mode="P")
        frame.putpalette(palette.tobytes())
        frames.append(frame)
    return frames


def _palette(picture: Picture) -> np.ndarray:
    """Colours of all frames, uint8 (256, 3): shades of the colour map, then greys."""
    shades = picture.shades(_SHADES)
    greys = np.linspace(0, 1, 256 - len(shades))[:, None].repeat(3, axis=1)
    return (255 * np.concatenate([shades, greys])).round().astype(np.uint8)


def _nearest(palette: np.ndarray) -> np.ndarray:
    """Number of the palette's nearest colour for every colour of ``_BITS`` bits per channel, uint8."""
    levels = np.linspace(0, 255, 2**_BITS)
    grid = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(-1, 3)
    return cKDTree(palette).query(grid)[1].astype(np.uint8)
