"""Quantities with units, from text to SI floats.

A quantity is a number and a unit, ``7 mm`` or ``58.4 MPa m^0.5``. The number is read here; the unit is a product of
names known to pint, so that nothing in a file is ever evaluated as code.
"""

import difflib
import math
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from pdhe.errors import PdheError

if TYPE_CHECKING:
    import pint


@dataclass(frozen=True)
class Kind:
    """A kind of quantity: its SI unit and an example to show in messages."""

    unit: str
    example: str


KINDS: dict[str, Kind] = {
    "length": Kind("m", "7 mm"),
    "time": Kind("s", "40 h"),
    "stiffness": Kind("Pa", "207 GPa"),
    "fracture toughness": Kind("Pa m^0.5", "58.4 MPa m^0.5"),
    "energy release rate": Kind("J/m^2", "16.5 kJ/m^2"),
    "diffusivity": Kind("m^2/s", "0.84e-9 m^2/s"),
    "density": Kind("kg/m^3", "7850 kg/m^3"),
    "velocity": Kind("m/s", "16.5 m/s"),
    "rate": Kind("s^-1", "1e4 s^-1"),
    "angle": Kind("rad", "30 deg"),
    "concentration": Kind("mol/m^3", "2.1 mol/m^3"),
    "surface concentration": Kind("mol/m^2", "2.65e-5 mol/m^2"),
}
"""Kinds of quantity that scene files use."""

NUMBER = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
"""Pattern of a decimal number in a file."""
QUANTITY_PATTERN = rf"^\s*{NUMBER}\s*[A-Za-zµμ%°].*$"
"""Pattern of a quantity, for editors; the units are checked on loading."""

_QUANTITY = re.compile(rf"\s*({NUMBER})\s*(.*?)\s*", re.DOTALL)
_EXPONENT = r"[-+]?[0-9]{1,2}(?:\.[0-9]{1,3})?|\([-+]?[0-9]{1,2}/[0-9]{1,2}\)"
_FACTOR = re.compile(rf"\s*([*/]?)\s*([A-Za-zµμΩ]+)(?:\s*(?:\^|\*\*)\s*({_EXPONENT}))?")
# fmt: off
_LENGTH, _TIME, _MASS, _AMOUNT = {"[length]": 1.0}, {"[time]": 1.0}, {"[mass]": 1.0}, {"[substance]": 1.0}
_FORCE = {"[length]": 1.0, "[mass]": 1.0, "[time]": -2.0}
_ENERGY = {"[length]": 2.0, "[mass]": 1.0, "[time]": -2.0}
_STRESS = {"[length]": -1.0, "[mass]": 1.0, "[time]": -2.0}
_COMMON_UNITS: dict[str, tuple[float, dict[str, float]]] = {
    "m": (1.0, _LENGTH), "cm": (0.01, _LENGTH), "mm": (0.001, _LENGTH), "um": (1e-6, _LENGTH), "µm": (1e-6, _LENGTH),
    "nm": (1e-9, _LENGTH), "km": (1000.0, _LENGTH), "in": (0.0254, _LENGTH), "ft": (0.3048, _LENGTH),
    "s": (1.0, _TIME), "ms": (0.001, _TIME), "us": (1e-6, _TIME), "µs": (1e-6, _TIME), "ns": (1e-9, _TIME),
    "min": (60.0, _TIME), "h": (3600.0, _TIME), "day": (86400.0, _TIME),
    "year": (31557600.0, _TIME), "Pa": (1.0, _STRESS), "kPa": (1e3, _STRESS), "MPa": (1e6, _STRESS),
    "GPa": (1e9, _STRESS), "J": (1.0, _ENERGY), "kJ": (1e3, _ENERGY), "mJ": (1e-3, _ENERGY), "N": (1.0, _FORCE),
    "kN": (1e3, _FORCE), "kg": (1.0, _MASS), "g": (0.001, _MASS), "mg": (1e-6, _MASS), "mol": (1.0, _AMOUNT),
    "mmol": (0.001, _AMOUNT), "umol": (1e-6, _AMOUNT), "rad": (1.0, {}), "deg": (math.pi / 180.0, {}),
}
"""SI value and dimensions of the units of nearly every scene: pint, which takes 0.4 s to begin, is asked for others."""

# fmt: on


class QuantityError(PdheError, ValueError):
    """Text that is not a quantity of the wanted kind; ``problem`` and ``hint`` are the two clauses of a message."""

    def __init__(self, problem: str, hint: str) -> None:
        self.problem, self.hint = problem, hint
        super().__init__(f"{problem}; {hint}")


def round15(value: float) -> float:
    """Round to 15 significant digits, so that 7 mm and 0.7 cm are the same float; minus zero becomes zero."""
    return float(f"{value:.15g}") + 0.0


@lru_cache(maxsize=1)
def _registry() -> "pint.UnitRegistry":
    """Build the unit registry on first use; it takes a third of a second."""
    import pint

    return pint.UnitRegistry()


@lru_cache(maxsize=1024)
def _unit(text: str) -> tuple[float, dict[str, float]]:
    """Return the SI value and the dimensions of a unit such as ``MPa m^0.5``."""
    plain = re.sub(r"sqrt\s*\(\s*([A-Za-z]+)\s*\)|√\s*([A-Za-z]+)", r" \1\2^0.5", text)
    plain = plain.replace("²", "^2").replace("³", "^3").replace("·", " ").replace("%", "percent")
    total, dimensions = 1.0, dict[str, float]()
    position, previous_end = 0, False
    while position < len(plain):
        match = _FACTOR.match(plain, position)
        if match is None or (match[1] == "*" and not previous_end):
            hint = "write a unit as names with powers, for example `m^2/s` or `MPa m^0.5`"
            raise QuantityError(f"'{text}' is not a unit", hint)
        operator, name, power = match.groups()
        factor, own = _named(name)
        exponent = (-1.0 if operator == "/" else 1.0) * _exponent(power)
        try:
            total *= factor**exponent
        except ArithmeticError:
            raise QuantityError(f"'{text}' is not a usable unit", "use a simpler unit") from None
        for dimension, value in own.items():
            dimensions[dimension] = dimensions.get(dimension, 0.0) + exponent * value
        position, previous_end = match.end(), True
    return round15(total), {dimension: value for dimension, value in dimensions.items() if value != 0.0}


@lru_cache(maxsize=1024)
def _named(name: str) -> tuple[float, dict[str, float]]:
    """Return the SI value and the dimensions of one name."""
    if name in _COMMON_UNITS:
        return _COMMON_UNITS[name]
    import pint

    registry = _registry()
    try:
        parsed = registry.parse_units(name)
        unit = registry.Quantity(1.0, parsed).to_base_units()
        offset = registry.Quantity(0.0, parsed).to_base_units().magnitude
    except (pint.errors.PintError, ValueError, TypeError, AttributeError, KeyError):
        near = difflib.get_close_matches(name, [*_COMMON_UNITS, "psi", "ksi"], 1, 0.4)
        raise QuantityError(
            f"'{name}' is not a known unit",
            (f"did you mean `{near[0]}`? " if near else "") + "Powers need `^`, and capitals matter: `MPa`, `mm`",
        ) from None
    if offset != 0.0:
        raise QuantityError(f"'{name}' is a scale with an offset", "use an absolute unit")
    return float(unit.magnitude), {str(dimension): float(value) for dimension, value in unit.dimensionality.items()}


def _exponent(text: str | None) -> float:
    if text is None:
        return 1.0
    if "/" in text:
        above, below = text.strip("()").split("/")
        if int(below) == 0:
            raise QuantityError(f"the power '{text}' divides by zero", "write a power such as `m^0.5`")
        return int(above) / int(below)
    return float(text)


def _kind(dimension: str) -> tuple[str, Kind]:
    if dimension in KINDS:
        return dimension, KINDS[dimension]
    for name, kind in KINDS.items():
        if kind.unit == dimension:
            return name, kind
    return f"quantity in {dimension}", Kind(dimension, f"1 {dimension}")


def quantity(text: object, *dimensions: str) -> float:
    """Convert a quantity to SI.

    Parameters
    ----------
    text
        The number and the unit, for example ``"0.84e-9 m^2/s"``.
    dimensions
        One or more wanted kinds: names in :data:`KINDS` or units such as ``"m^2/s"``. The first one that fits is taken.

    Returns
    -------
    float
        The value in SI units, rounded to 15 significant digits.

    Raises
    ------
    QuantityError
        If there is no unit, the unit is unknown or measures something else, or the value is not finite.
    """
    name, kind = _kind(dimensions[0])
    example = f"for example `{kind.example}`"
    if isinstance(text, (int, float)) and not isinstance(text, bool):
        raise QuantityError(f"a {name} needs a unit", f"write a unit, {example}")
    if not isinstance(text, str):
        raise QuantityError(f"is not a {name}", f"write a number and a unit, {example}")
    if len(text) > 100:
        raise QuantityError(f"is too long for a {name}", f"write a number and a unit, {example}")
    match = _QUANTITY.fullmatch(text.replace("−", "-"))
    if match is None:
        raise QuantityError(f"is not a {name}", f"write a number and a unit, {example}")
    if not match[2]:
        raise QuantityError(f"a {name} needs a unit", f"write a unit, {example}")
    if match[2].startswith(","):
        raise QuantityError(f"is not a {name}", f"write the decimal sign as a point, {example}")
    factor, dimensionality = _unit(match[2])
    if all(dimensionality != _unit(_kind(wanted)[1].unit)[1] for wanted in dimensions):
        others = " or ".join(_kind(wanted)[0] for wanted in dimensions)
        raise QuantityError(f"'{match[2]}' is not a unit of {others}", f"write a {name}, {example}")
    value = round15(float(match[1]) * factor)
    if not math.isfinite(value):
        raise QuantityError(f"is not a finite {name}", f"write a number and a unit, {example}")
    return value


def measure(text: str) -> tuple[float, str]:
    """Return the SI value and the SI unit of any quantity, or of a plain number, whose unit is ``1``.

    Raises
    ------
    QuantityError
        If the text is neither.
    """
    match = _QUANTITY.fullmatch(text.replace("−", "-"))
    if match is None or len(text) > 100:
        raise QuantityError("is not a quantity", "write a number and a unit")
    factor, dimensions = _unit(match[2]) if match[2] else (1.0, {})
    # An angle has no dimensions: only its unit tells it from a plain number.
    angle = re.search(r"\b(rad|deg|degrees?|radians?)\b|°", match[2]) is not None
    known = (
        kind.unit
        for kind in KINDS.values()
        if _unit(kind.unit)[1] == dimensions and (dimensions or (angle and kind.unit == "rad"))
    )
    bases = {"[length]": "m", "[mass]": "kg", "[time]": "s", "[substance]": "mol"}
    spelled = " ".join(f"{bases.get(dimension, dimension)}^{power:g}" for dimension, power in dimensions.items())
    return round15(float(match[1]) * factor), next(known, spelled or "1")


def ratio(value: object) -> float:
    """Convert a dimensionless number, given as a number, as text (``"1e-5"``) or in percent (``"36 %"``).

    Raises
    ------
    QuantityError
        If the value is not a finite number without unit.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise QuantityError("is not a number", "write a plain number without unit")
    scale = 1.0
    if isinstance(value, str):
        text = value.replace("−", "-").strip()
        if text.endswith("%"):
            text, scale = text[:-1].strip(), 0.01
        if not re.fullmatch(NUMBER, text) or len(text) > 100:
            raise QuantityError("is not a number", "write a plain number without unit")
        value = text
    try:
        result = round15(float(value) * scale)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise QuantityError("is not a finite number", "write a plain number without unit")
    return result
