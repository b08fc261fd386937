"""Curves over time: loads, energies, crack and hydrogen, as far as a result has them."""

from __future__ import annotations

import string
from pathlib import Path

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pdhe import post
from pdhe.errors import PdheError
from pdhe.plotting.style import MILLIMETRE, RC, Style
from pdhe.results import open_result
from pdhe.wholefile import moved_when_whole

#: Colours that remain distinct for colour-blind readers (Wong 2011), and dashes that remain distinct in print.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_DASHES = ("-", "--", "-.", ":", "-", "--")
_PREFIXES = (("G", 1e9), ("M", 1e6), ("k", 1e3), ("", 1.0), ("m", 1e-3), ("µ", 1e-6), ("n", 1e-9))
_COLUMNS, _PITCH, _AXES, _LABELS = 2, 42.0, 36.0, 8.0  # mm: height of a row, of its axes, of labels below the last row

Curves = tuple[str, dict[str, np.ndarray]]
"""Axis label, and values by name."""


def draw_history(result_path: str | Path, out_path: str | Path) -> None:
    """Draw the history of a result in panels; those of absent physics are left out.

    Raises
    ------
    PdheError
        If the file is not a result or holds no history.
    """
    style = Style()
    with open_result(result_path) as result:
        if "history_time" not in result:
            raise PdheError(f"{result_path}: the result holds no history")
        panels = [
            panel
            for make in (_applied, _tractions, _reactions, _energies, _crack, _speed, _damage, _hydrogen)
            if (panel := make(result))
        ]
        if not panels:
            raise PdheError(f"{result_path}: the history of the result holds nothing to draw")
        with mpl.rc_context(RC | {"font.size": style.font_size, "legend.fontsize": style.font_size - 1}):
            made = post.origin(result, Path(out_path).suffix)
            figure = _draw(result["history_time"].values, panels, style)
            with moved_when_whole(out_path) as place:
                figure.savefig(place, dpi=style.dpi, metadata=made, format=Path(out_path).suffix[1:])


def _draw(times: np.ndarray, panels: list[Curves], style: Style) -> Figure:
    columns = min(_COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    width, height = style.width * columns / _COLUMNS, _PITCH * rows + _LABELS
    figure = Figure(figsize=(width * MILLIMETRE, height * MILLIMETRE), dpi=style.dpi)
    FigureCanvasAgg(figure)
    unit, size = post.unit_of_time(times[-1])
    for number, panel in enumerate(panels):
        row, column = divmod(number, columns)
        wide = width / columns
        box = (column * wide + 15.0, height - (row + 1) * _PITCH + 0.5, wide - 18.0, _AXES)
        axes = figure.add_axes((box[0] / width, box[1] / height, box[2] / width, box[3] / height))
        last = number + columns >= len(panels)
        axes.tick_params(labelbottom=last, pad=2)
        if last:
            axes.set_xlabel(f"time ({unit})", labelpad=1.5)
        _curves(axes, times / size, *panel)
        axes.text(-14.0 / box[2], 1.03, f"({string.ascii_lowercase[number]})", transform=axes.transAxes, va="bottom")
    return figure


def _curves(axes: Axes, times: np.ndarray, label: str, curves: dict[str, np.ndarray]) -> None:
    for (name, values), colour, dash in zip(curves.items(), _COLOURS, _DASHES, strict=False):
        marker = "o" if times.size < 3 else None
        axes.plot(times, values, dash, color=colour, label=name, linewidth=1.1, marker=marker, markersize=3)
    axes.set_ylabel(label)
    axes.yaxis.set_label_coords(-0.145, 0.5)
    axes.margins(y=0.08)
    if times[-1] > times[0]:
        axes.set_xlim(times[0], times[-1])
        axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    else:
        axes.set_xticks([times[0]])
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    axes.grid(color="0.9", linewidth=0.5)
    axes.set_axisbelow(True)
    if len(curves) > 1 or next(iter(curves)):
        axes.legend(
            loc="lower left", bbox_to_anchor=(-0.01, 0.98), ncols=4, frameon=False, borderaxespad=0.1, borderpad=0.1,
            handlelength=1.8, handletextpad=0.4, columnspacing=1.0,
        )  # fmt: skip


def _scaled(label: str, unit: str, curves: dict[str, np.ndarray]) -> Curves:
    """Choose a decimal prefix for the unit so that the largest value lies between 1 and 1000 where possible."""
    top = max(float(np.nanmax(np.abs(values), initial=0.0)) for values in curves.values())
    prefix, size = next((p for p in _PREFIXES if top >= p[1]), _PREFIXES[-1]) if top > 0 else ("", 1.0)
    return f"{label} ({prefix}{unit})", {name: values / size for name, values in curves.items()}


def _of_node_sets(result: xr.Dataset, kind: str) -> dict[str, np.ndarray]:
    curves = {}
    for name in result.data_vars:
        if str(name).startswith(kind):
            where, component = str(name).removeprefix(kind).rsplit("_", 1)
            curves[f"{where}, ${component}$"] = result[name].values
    return curves


def _applied(result: xr.Dataset) -> Curves | None:
    curves = _of_node_sets(result, "applied_")
    return _scaled("applied displacement", "m", curves) if curves else None


def _tractions(result: xr.Dataset) -> Curves | None:
    curves = _of_node_sets(result, "traction_")
    return _scaled("traction", "Pa", curves) if curves else None


def _reactions(result: xr.Dataset) -> Curves | None:
    curves = _of_node_sets(result, "reaction_")
    return _scaled("reaction", "N", curves) if curves else None


def _energies(result: xr.Dataset) -> Curves | None:
    if "elastic_energy" not in result or "external_work" not in result:
        return None
    balance = post.energy_balance(result)
    shown = ("work", "elastic", "dissipated", "fracture") if "fracture_energy" in result else ("work", "elastic")
    if "kinetic" in balance:
        shown = ("work", "elastic", "kinetic", *(("fracture",) if "fracture_energy" in result else ()))
        shown += ("damping",) if balance["damping"].any() else ()
    if "plastic" in balance:
        shown += ("plastic", *(("creep",) if balance["creep"].any() else ()))
    names = {"fracture": "broken bonds"}
    return _scaled("energy", "J", {names.get(name, name): balance[name] for name in shown})


def _crack(result: xr.Dataset) -> Curves | None:
    if "crack_extension" not in result:
        return None
    curves = {"tip": result["crack_extension"].values}
    if "crack_length" in result:
        length = result["crack_length"].values
        curves["from broken bonds"] = length - length[0]
    return "crack extension (mm)", {name: 1e3 * values for name, values in curves.items()}


def _speed(result: xr.Dataset) -> Curves | None:
    if "kinetic_energy" not in result or "crack_extension" not in result:
        return None
    return "crack speed (m/s)", {"": post.crack_speed(result)}


def _damage(result: xr.Dataset) -> Curves | None:
    return ("mean damage", {"": result["mean_damage"].values}) if "mean_damage" in result else None


def _hydrogen(result: xr.Dataset) -> Curves | None:
    if "mean_coverage" not in result:
        return None
    curves = {"mean": result["mean_coverage"].values}
    if {"hydrogen_content", "hydrogen_influx"} <= set(result):
        volume = float(result["volume"].values.sum())
        start = result["hydrogen_content"].values[0] - result["hydrogen_influx"].values[0]
        curves["initial and taken up"] = (start + result["hydrogen_influx"].values) / volume
    return "coverage", curves
