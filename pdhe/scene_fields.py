"""Building blocks of a scene: value types that read quantities, and the block that knows its own keys.

Every problem is raised as pydantic's ``PydanticCustomError`` with the clauses of a :class:`pdhe.errors.SceneError`.
A validation context ``{"si": True}`` switches from the written form (quantities with units) to the resolved form
(SI floats).
"""

import difflib
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from pydantic import (
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationInfo,
    model_validator,
)
from pydantic_core import PydanticCustomError, core_schema

from pdhe import units

MAX_LENGTH = 1e4
"""Largest length in metres; longer ones are slips such as ``Mm`` (megametre) for ``mm``."""
MAX_TIME = 1e18
"""Longest time in seconds: twice the age of the universe."""


def problem(text: str, hint: str = "", key: str = "") -> PydanticCustomError:
    """Make the exception for one problem; ``key`` is relative to the block or value that raises it."""
    return PydanticCustomError("scene", "{problem}", {"problem": text, "hint": hint, "key": key})


def is_si(info: ValidationInfo) -> bool:
    """Tell whether the resolved form (SI numbers) is being read."""
    return bool(info.context and info.context.get("si"))


def number(value: Any, info: ValidationInfo, *kinds: str) -> float:
    """Read a quantity of one of ``kinds``, or a ratio if there are none, in the form that ``info`` asks for."""
    try:
        if not is_si(info):
            return units.quantity(value, *kinds) if kinds else units.ratio(value)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise units.QuantityError("is not a number", "the resolved form holds SI numbers")
        result = float(value) + 0.0
        if not math.isfinite(result):
            raise units.QuantityError("is not a finite number", "the resolved form holds SI numbers")
        return result
    except units.QuantityError as error:
        raise problem(error.problem, error.hint) from None
    except OverflowError:
        raise problem("is not a finite number", "write a smaller number") from None


@dataclass(frozen=True, eq=False)
class Reading:
    """Annotation of a field: how its written value becomes the Python value, and how editors may check it."""

    read: Callable[[Any, ValidationInfo], Any]
    schema: dict[str, Any]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        """Run ``read`` before pydantic's own check of the type."""
        return core_schema.with_info_before_validator_function(self.read, handler(source))

    def __get_pydantic_json_schema__(self, schema: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Describe the written form."""
        return dict(self.schema)


def _quantity(*kinds: str, sign: str = "any") -> Reading:
    """Make the reading of a quantity; ``sign`` is ``any``, ``positive`` or ``not negative``."""
    shown = units.KINDS[kinds[0]].example

    def read(value: Any, info: ValidationInfo) -> float:
        result = number(value, info, *kinds)
        if sign == "positive" and result <= 0.0:
            raise problem("must be greater than zero", f"for example `{shown}`")
        if sign == "not negative" and result < 0.0:
            raise problem("must not be negative", f"for example `{shown}`")
        if "length" in kinds and abs(result) > MAX_LENGTH:
            raise problem(f"is longer than {MAX_LENGTH:g} m", "`mm` is millimetre, `Mm` is megametre")
        if "time" in kinds and result > MAX_TIME:
            raise problem(f"is longer than {MAX_TIME:g} s", "a year is `365 d`")
        return result

    schema = {"type": "string", "pattern": units.QUANTITY_PATTERN}
    schema["description"] = f"{' or '.join(kinds)} with a unit, for example `{shown}`"
    return Reading(read, schema)


def _ratio(accept: Callable[[float], bool], rule: str) -> Reading:
    """Make the reading of a number without unit that must satisfy ``accept``."""

    def read(value: Any, info: ValidationInfo) -> float:
        result = number(value, info)
        if not accept(result):
            raise problem(f"must be {rule}")
        return result

    return Reading(read, {"type": "number", "description": rule})


def _count(largest: int) -> Reading:
    """Make the reading of a whole number from 1 to ``largest``."""

    def read(value: Any, info: ValidationInfo) -> int:
        result = number(value, info)
        if result != int(result):
            raise problem("must be a whole number", "write it without a fraction")
        if not 1 <= result <= largest:
            raise problem(f"must be between 1 and {largest}", "write a whole number in that range")
        return int(result)

    return Reading(read, {"type": "integer", "minimum": 1, "maximum": largest})


Length = Annotated[float, _quantity("length")]
PositiveLength = Annotated[float, _quantity("length", sign="positive")]
PositiveTime = Annotated[float, _quantity("time", sign="positive")]
Time = Annotated[float, _quantity("time", sign="not negative")]
Stiffness = Annotated[float, _quantity("stiffness", sign="positive")]
Toughness = Annotated[float, _quantity("fracture toughness", sign="positive")]
EnergyReleaseRate = Annotated[float, _quantity("energy release rate", sign="positive")]
Diffusivity = Annotated[float, _quantity("diffusivity", sign="positive")]
Density = Annotated[float, _quantity("density", sign="positive")]
SaturationConcentration = Annotated[float, _quantity("concentration", "surface concentration", sign="positive")]
Velocity = Annotated[float, _quantity("velocity")]
Rate = Annotated[float, _quantity("rate", sign="not negative")]
Angle = Annotated[float, _quantity("angle")]
Fraction = Annotated[float, _ratio(lambda x: 0.0 <= x <= 1.0, "between 0 and 1")]
Safety = Annotated[float, _ratio(lambda x: 0.0 < x <= 1.0, "greater than 0 and at most 1")]
Accuracy = Annotated[float, _ratio(lambda x: 1e-4 <= x <= 0.5, "between 0.01 % and 50 %")]
HorizonRatio = Annotated[float, _ratio(lambda x: x > 0.0, "greater than zero")]
PoissonsRatio = Annotated[float, _ratio(lambda x: -1.0 < x < 0.5, "greater than -1 and less than 0.5")]
CrossRatio = Annotated[float, _ratio(lambda x: -10.0 < x < 10.0, "between -10 and 10")]
Grouping = Annotated[float, _ratio(lambda x: 0.0 <= x < 1.0, "at least 0 and less than 1")]
Strength = Annotated[float, _ratio(lambda x: 0.01 <= x <= 100.0, "between 0.01 and 100")]
Factor = Annotated[float, _ratio(lambda x: 1e-6 <= x <= 1e6, "between 1e-6 and 1e6")]
Growth = Annotated[float, _ratio(lambda x: 0.0 < x <= 0.5, "greater than 0 and at most 0.5")]
Tolerance = Annotated[float, _ratio(lambda x: 1e-14 <= x <= 0.1, "between 1e-14 and 0.1")]
SmallCount = Annotated[int, _count(10_000)]
Count = Annotated[int, _count(1_000_000_000)]


def _read_name(value: Any, info: ValidationInfo) -> str:
    if not isinstance(value, str):
        raise problem("must be a name", "write a word, for example `notch`; quote it if it looks like a number")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,39}", value):
        raise problem("is not a usable name", "use up to 40 letters, digits and underscores, starting with a letter")
    return value


def _read_text(value: Any, info: ValidationInfo) -> str:
    if not isinstance(value, str):
        raise problem("must be text", "quote it if it looks like a number")
    if not value.strip() or len(value) > 1000:
        raise problem("must have between 1 and 1000 characters", "write a short text")
    return value


def _read_switch(value: Any, info: ValidationInfo) -> bool:
    if not isinstance(value, bool):
        raise problem("must be on or off", "write `true` or `false`")
    return value


Switch = Annotated[bool, Reading(_read_switch, {"type": "boolean"})]
Name = Annotated[str, Reading(_read_name, {"type": "string", "pattern": "^[A-Za-z][A-Za-z0-9_]{0,39}$"})]
Text = Annotated[str, Reading(_read_text, {"type": "string", "minLength": 1})]
NodeSet = Annotated[
    str,
    Reading(
        _read_name,
        {
            "type": "string",
            "description": "left, right, bottom, top, all, front, back, or the name of a hole, a crack or a region",
        },
    ),
]


def _read_pair(value: Any, info: ValidationInfo) -> tuple[str, str]:
    if not isinstance(value, (list, tuple)) or len(value) != 2:
        raise problem("must be two node sets", "for example `[weld, plate]`")
    one, other = (_read_name(name, info) for name in value)
    if one == other:
        raise problem("names the same node set twice", "an interface lies between two of them")
    return one, other


NodeSetPair = Annotated[
    tuple[str, str],
    Reading(
        _read_pair,
        {
            "type": "array",
            "items": {"type": "string", "pattern": "^[A-Za-z][A-Za-z0-9_]{0,39}$"},
            "minItems": 2,
            "maxItems": 2,
            "description": "two node sets, for example `[weld, plate]`",
        },
    ),
]


def choice(*options: str) -> Reading:
    """Make the reading of a word that is one of ``options``."""

    def read(value: Any, info: ValidationInfo) -> str:
        if isinstance(value, str) and value in options:
            return value
        near = difflib.get_close_matches(str(value).lower(), options, 1, 0.6)
        listed = ", ".join(f"`{option}`" for option in options)
        raise problem("is not one of the choices", (f"did you mean `{near[0]}`? " if near else "") + f"use {listed}")

    return Reading(read, {"type": "string", "enum": list(options)})


def _read_point(value: Any, info: ValidationInfo) -> tuple[float, float]:
    if not isinstance(value, (list, tuple)) or len(value) != 2:
        raise problem("must be a point with two coordinates", "for example `[50 mm, 0 mm]`")
    x, y = (number(coordinate, info, "length") for coordinate in value)
    if max(abs(x), abs(y)) > MAX_LENGTH:
        raise problem(f"is farther than {MAX_LENGTH:g} m", "`mm` is millimetre, `Mm` is megametre")
    return x, y


def _read_place(value: Any, info: ValidationInfo) -> tuple[float, float, float]:
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        raise problem("must be a point with three coordinates", "for example `[50 mm, 25 mm, 5 mm]`")
    x, y, z = (number(coordinate, info, "length") for coordinate in value)
    if max(abs(x), abs(y), abs(z)) > MAX_LENGTH:
        raise problem(f"is farther than {MAX_LENGTH:g} m", "`mm` is millimetre, `Mm` is megametre")
    return x, y, z


def _read_direction(value: Any, info: ValidationInfo) -> tuple[float, float, float]:
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        raise problem("must be a direction with three components", "for example `[0, 1, 0]`")
    x, y, z = (number(component, info) for component in value)
    if not 1e-9 < math.sqrt(x * x + y * y + z * z) < 1e9:
        raise problem("has no direction", "give three numbers that are not all zero, for example `[0, 1, 0]`")
    return x, y, z


Point = Annotated[
    tuple[float, float],
    Reading(
        _read_point,
        {
            "type": "array",
            "items": {"type": "string", "pattern": units.QUANTITY_PATTERN},
            "minItems": 2,
            "maxItems": 2,
            "description": "x and y from the lower-left corner of the plate, for example `[50 mm, 0 mm]`",
        },
    ),
]


Place = Annotated[
    tuple[float, float, float],
    Reading(
        _read_place,
        {
            "type": "array",
            "items": {"type": "string", "pattern": units.QUANTITY_PATTERN},
            "minItems": 3,
            "maxItems": 3,
            "description": "x, y and z from the lower-left corner of the front, for example `[50 mm, 25 mm, 5 mm]`",
        },
    ),
]
Direction = Annotated[
    tuple[float, float, float],
    Reading(
        _read_direction,
        {
            "type": "array",
            "items": {"type": "number"},
            "minItems": 3,
            "maxItems": 3,
            "description": "components along x, y and z, of any length, for example `[0, 1, 0]`",
        },
    ),
]


def as_list(value: Any) -> Any:
    """Accept a list and nothing else."""
    if not isinstance(value, (list, tuple)):
        raise problem("must be a list", "start each entry with `- `, or write `[...]`")
    return value


class Block(BaseModel):
    """A frozen block of keys; unknown keys are answered with the nearest known one."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    null_means_off: ClassVar[frozenset[str]] = frozenset()
    """Keys for which an empty value switches something off; elsewhere it stands for the default."""
    removed: ClassVar[dict[str, str]] = {}
    """Keys that earlier versions knew, and what to do instead."""

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, data: Any) -> Any:
        known = {field.alias or name: field for name, field in cls.model_fields.items()}
        listed = ", ".join(f"`{key}`" for key in known)
        if isinstance(data, cls):
            return data
        if not isinstance(data, dict):
            raise problem("must be a block of keys", f"give {listed}")
        for key in data:
            if key in cls.removed:
                raise problem("is no longer a key", cls.removed[key], key=str(key))
            if key not in known:
                near = difflib.get_close_matches(str(key), known, 1, 0.5)
                hint = (f"did you mean `{near[0]}`? " if near else "") + f"known keys here: {listed}"
                raise problem("is not a known key", hint, key=str(key)[:60])
        for key, field in known.items():
            if field.is_required() and data.get(key) is None:
                raise problem("is missing", f"give `{key}`; keys here: {listed}", key=key)
        return {key: value for key, value in data.items() if value is not None or key in cls.null_means_off}
