"""Values that change in time: piecewise linear, written as a constant or as a map of time to value."""

import bisect
import math
from itertools import pairwise
from typing import Annotated, Any

from pydantic import ValidationInfo

from pdhe import units
from pdhe.scene_fields import Block, Reading, is_si, number, problem


class PiecewiseLinear(Block):
    """A value that is linear in time between given points and constant before the first and after the last.

    ``times`` in seconds, strictly increasing and not negative; ``values`` in SI.
    """

    times: tuple[float, ...]
    values: tuple[float, ...]

    def __call__(self, time: float) -> float:
        """Return the value at ``time`` (s)."""
        after = bisect.bisect_right(self.times, time)
        if after == 0:
            return self.values[0]
        if after == len(self.times):
            return self.values[-1]
        t0, t1 = self.times[after - 1], self.times[after]
        v0, v1 = self.values[after - 1], self.values[after]
        return v0 + (v1 - v0) * ((time - t0) / (t1 - t0))

    def integral(self, time: float) -> float:
        """Return the integral from 0 to ``time`` (s), exactly: of a velocity, the way travelled."""
        knots = [0.0, *(t for t in self.times if 0.0 < t < time), time]
        return sum(0.5 * (self(t1) + self(t0)) * (t1 - t0) for t0, t1 in pairwise(knots))

    @property
    def corners(self) -> tuple[float, ...]:
        """Times (s) at which the slope changes."""
        return self.times if len(self.times) > 1 else ()

    def equals(self, other: "PiecewiseLinear") -> bool:
        """Tell whether both have the same value at every time, to within rounding."""
        times = sorted({*self.times, *other.times})
        return all(math.isclose(self(t), other(t), rel_tol=1e-12, abs_tol=1e-300) for t in times)


def _read_history(value: Any, info: ValidationInfo, *kinds: str) -> dict[str, tuple[float, ...]]:
    """Turn a constant, a ``time: value`` map or the resolved form into times and values."""
    value1 = units.KINDS[kinds[0]].example if kinds else "1"
    example = f"{{0 h: 0{value1[value1.find(' ') :] if kinds else ''}, 1 h: {value1}}}"
    if is_si(info):
        if not isinstance(value, dict) or set(value) != {"times", "values"}:
            raise problem("must hold times and values", "give both as lists of SI numbers")
        if not all(isinstance(value[part], (list, tuple)) for part in value):
            raise problem("must hold times and values", "give both as lists of SI numbers")
        times = tuple(number(time, info) for time in value["times"])
        values = tuple(number(item, info) for item in value["values"])
    elif isinstance(value, dict):
        times = tuple(number(time, info, "time") for time in value)
        values = tuple(number(item, info, *kinds) for item in value.values())
    else:
        if isinstance(value, (list, tuple)):
            raise problem("must be one value or a map of time to value", f"for example `{example}`")
        times, values = (0.0,), (number(value, info, *kinds),)
    if not times or len(times) != len(values):
        raise problem("has no points", f"give one value or a map of time to value, for example `{example}`")
    if min(times) < 0.0:
        raise problem("has a negative time", "time starts at `0 s`")
    for earlier, later in pairwise(times):
        if later == earlier:
            raise problem(f"gives the time {later:g} s twice", "keep one value for each time")
        if later < earlier:
            raise problem(f"has times out of order, {later:g} s after {earlier:g} s", "write them in increasing order")
    return {"times": times, "values": values}


def _read_displacement(value: Any, info: ValidationInfo) -> Any:
    return _read_history(value, info, "length")


def _read_velocity(value: Any, info: ValidationInfo) -> Any:
    return _read_history(value, info, "velocity")


def _read_traction(value: Any, info: ValidationInfo) -> Any:
    return _read_history(value, info, "stiffness")


def _read_coverage(value: Any, info: ValidationInfo) -> Any:
    history = _read_history(value, info)
    if min(history["values"]) < 0.0 or max(history["values"]) > 1.0:
        raise problem("must be between 0 and 1", "coverage is the occupied fraction of hydrogen sites")
    return history


def _schema(constant: dict[str, Any], text: str) -> dict[str, Any]:
    points = {"type": "object", "additionalProperties": constant, "minProperties": 1}
    return {"anyOf": [constant, points], "description": text}


DisplacementHistory = Annotated[
    PiecewiseLinear,
    Reading(
        _read_displacement,
        _schema(
            {"type": "string", "pattern": units.QUANTITY_PATTERN},
            "constant such as `7 mm`, or a map of time to length such as `{0 h: 0 mm, 1 h: 7 mm}`",
        ),
    ),
]
VelocityHistory = Annotated[
    PiecewiseLinear,
    Reading(
        _read_velocity,
        _schema(
            {"type": "string", "pattern": units.QUANTITY_PATTERN},
            "constant such as `16.5 m/s`, or a map of time to velocity such as `{0 us: 0 m/s, 1 us: 16.5 m/s}`",
        ),
    ),
]
TractionHistory = Annotated[
    PiecewiseLinear,
    Reading(
        _read_traction,
        _schema(
            {"type": "string", "pattern": units.QUANTITY_PATTERN},
            "constant such as `12 MPa`, or a map of time to force per area such as `{0 us: 0 MPa, 1 us: 12 MPa}`",
        ),
    ),
]
CoverageHistory = Annotated[
    PiecewiseLinear,
    Reading(
        _read_coverage,
        _schema(
            {"type": "number", "minimum": 0, "maximum": 1},
            "constant from 0 to 1, or a map of time to coverage such as `{0 h: 0, 1 h: 1}`",
        ),
    ),
]
