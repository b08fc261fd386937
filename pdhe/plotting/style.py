"""The style of figures: every choice that a study can make, with its default."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import matplotlib as mpl
from matplotlib.colors import Colormap, LinearSegmentedColormap

from pdhe.errors import PdheError
from pdhe.units import QuantityError, quantity

MILLIMETRE = 1.0 / 25.4  # inch
_NOTHING = (0.0, 0.0, 0.0, 0.0)
COMPONENTS = ("auto", "x", "y", "z", "magnitude")
#: Settings of every figure: thin lines, ticks inwards, small but legible type.
RC: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "axes.linewidth": 0.6,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "axes.unicode_minus": True,
    "path.simplify": True,
}


@dataclass(frozen=True)
class Style:
    """How figures look; all keys are optional."""

    times: tuple[float, ...] | None = None
    """Times of the panels, s, or quantities such as ``"20 days"``; the nearest outputs are drawn. Default: chosen so
    that they show crack growth, or the advance of hydrogen."""
    panels: int = 4
    """Number of panels where ``times`` is not given."""
    dpi: float = 300
    """Pixels per inch of figures."""
    width: float = 180.0
    """Greatest width of figures, mm: two columns of a journal."""
    font_size: float = 8.0
    """pt."""
    damage_map: str = "damage"
    """Colour map of damage: ``damage`` (white, then ``magma_r`` without its darkest third, so that cracks stand out) or
    a name that matplotlib knows."""
    coverage_map: str = "viridis"
    displacement_map: str = "RdBu_r"
    state: str | None = None
    """State variable of a user material: its name. Default: the first one."""
    state_map: str = "viridis"
    damage_limit: float = 0.5
    """Upper end of the damage scale. Next to a straight crack nearly half of all bonds are broken."""
    component: str = "auto"
    """Displacement component: ``x``, ``y``, ``magnitude``, or ``auto`` for the largest one; ``z`` in space only."""
    magnification: float | None = None
    """Of displacements in the shape of the body. Default: a round number that makes the largest one about 4 % of the
    body's length; 1 under large strains."""
    window: tuple[float, float, float, float] | None = None
    """Part that is shown: left, right, bottom and top, m, or quantities such as ``"40 mm"``. Default: everything."""
    frames: int = 60
    """Greatest number of frames in an animation."""
    frame_width: int = 800
    """Width of animations, pixels."""
    duration: float = 6.0
    """Of an animation, s; its last frame then stays for ``hold``."""
    hold: float = 2.5
    """s."""

    @classmethod
    def of(cls, style: Mapping[str, Any] | None) -> Style:
        """Build a style from the keys of a mapping.

        Raises
        ------
        PdheError
            For an unknown key, which names the nearest known one, and for a value that cannot be used.
        """
        known = [field.name for field in fields(cls)]
        values = dict(style or {})
        for key in values:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, 1, 0.5)
                hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}"
                raise PdheError(f"figure style: unknown key '{key}'; {hint}")
        for key, (check, wanted) in _CHECKS.items():
            if values.get(key) is not None and not check(values[key]):
                raise PdheError(f"figure style: '{key}' needs {wanted} (got {values[key]!r})")
        for key, default in ((field.name, field.default) for field in fields(cls)):
            if key in values and values[key] is None and default is not None:
                raise PdheError(f"figure style: '{key}' needs a value; leave the key out for the default, {default}")
        if values.get("times") is not None:
            values["times"] = tuple(_si("times", value, "time") for value in values["times"])
        if values.get("window") is not None:
            values["window"] = tuple(_si("window", value, "length") for value in values["window"])
            left, right, bottom, top = values["window"]
            if not (left < right and bottom < top):
                raise PdheError("figure style: 'window' needs left < right and bottom < top")
        return cls(**values)

    def colour_map(self, kind: str) -> Colormap:
        """Return the colour map of a kind of picture, transparent where there is no body."""
        name = getattr(self, f"{kind}_map")
        if name == "damage":
            shades: list[Any] = [mpl.colormaps["magma_r"](k / 255) for k in range(8, 177, 8)]
            return LinearSegmentedColormap.from_list("damage", ["white", *shades], 256).with_extremes(bad=_NOTHING)
        return mpl.colormaps[name].with_extremes(bad=_NOTHING)


def _si(key: str, value: Any, kind: str) -> float:
    """A bare number, which is SI, or a quantity."""
    if _number(value):
        return float(value)
    try:
        return quantity(value, kind)
    except QuantityError as error:
        raise PdheError(f"figure style: '{key}': {value!r} {error.problem}; {error.hint}, or a number (SI)") from error


def _number(value: object) -> bool:
    # Numbers of hundreds of digits are whole, but no number that anything could be measured with.
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _between(low: float, high: float, whole: bool = False) -> tuple[Callable[[Any], bool], str]:
    def check(value: Any) -> bool:
        return _number(value) and low <= value <= high and (not whole or isinstance(value, int))

    return check, f"{'a whole number' if whole else 'a number'} from {low:g} to {high:g}"


def _colour_map(special: str | None = None) -> tuple[Callable[[Any], bool], str]:
    def check(value: Any) -> bool:
        return isinstance(value, str) and (value == special or value in mpl.colormaps)

    return check, "the name of a matplotlib colour map" + (f", or '{special}'" if special else "")


#: What each key accepts, and how a message says so.
_CHECKS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "times": (lambda v: isinstance(v, (list, tuple)) and len(v) > 0, "a list of times"),
    "panels": _between(1, 12, whole=True),
    "dpi": _between(40, 1200),
    "width": _between(60, 500),
    "font_size": _between(5, 16),
    "damage_map": _colour_map("damage"),
    "coverage_map": _colour_map(),
    "displacement_map": _colour_map(),
    "state": (lambda v: isinstance(v, str), "the name of a state variable"),
    "state_map": _colour_map(),
    "damage_limit": _between(0.01, 1),
    "component": (lambda v: v in COMPONENTS, f"one of {', '.join(COMPONENTS)}"),
    "magnification": _between(0, 1e9),
    "window": (lambda v: isinstance(v, (list, tuple)) and len(v) == 4, "left, right, bottom and top"),
    "frames": _between(1, 500, whole=True),
    "frame_width": _between(200, 2000, whole=True),
    "duration": _between(0.1, 60),
    "hold": _between(0, 60),
}
