"""Values of a scene that depend on the place: written as a number, a formula of x, y and z, or a table."""

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import ValidationInfo

from pdhe import scene_fields as fields
from pdhe import units
from pdhe.scene_fields import Block, Reading, problem
from pdhe.scene_tables import Table, table_of

if TYPE_CHECKING:
    import numpy as np


class Formula(Block):
    """A value as a formula of the place, in metres, and the unit that it comes out in; none for ratios."""

    expression: fields.Text
    unit: fields.Text | None = None

    def at(self, place: "np.ndarray") -> "np.ndarray":
        """Values at points (k, 2) or (k, 3), m; SI (k,)."""
        from pdhe import formulas  # here, so that reading scenes without any does not load NumPy

        scale = 1.0 if self.unit is None else units.measure(f"1 {self.unit}")[0]
        return scale * formulas.value_at(self.expression, place)

    @property
    def coordinates(self) -> set[str]:
        """Those of x, y and z that it depends on."""
        from pdhe import formulas

        return formulas.coordinates_of(self.expression)


def at(value: float | Formula | Table, place: "np.ndarray") -> "np.ndarray | float":
    """Value of a key of a scene at points (k, 2) or (k, 3), m, if it depends on them at all; SI."""
    return value.at(place) if isinstance(value, Formula | Table) else value


def _by_place(plain: Any, *kinds: str) -> Reading:
    """Make the reading of what ``plain`` reads, or of a formula or a table of one of ``kinds``."""
    reading: Reading = plain.__metadata__[0]
    unit = f", unit: {units.KINDS[kinds[0]].unit}" if kinds else ""
    example = f"for example `{{expression: 1 + 5*x{unit}}}`"

    def read(value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, Formula | Table):
            return value
        if not isinstance(value, dict):
            return reading.read(value, info)
        if "points" in value or "values" in value:
            _check_unit(value.get("unit"), kinds, example)
            return table_of(value)
        for key in value:
            if key not in ("expression", "unit"):
                raise problem("is not a known key", f"a formula has `expression` and `unit`, {example}", str(key)[:60])
        if not isinstance(value.get("expression"), str):
            raise problem("is missing" if value.get("expression") is None else "must be text", example, "expression")
        _check_unit(value.get("unit"), kinds, example)
        from pdhe import formulas

        try:
            formulas.coordinates_of(value["expression"])
        except formulas.FormulaError as error:
            raise problem(error.problem, error.hint, "expression") from None
        return Formula(expression=value["expression"].strip(), unit=value.get("unit"))

    keys = {"expression": {"type": "string"}} | ({"unit": {"type": "string"}} if kinds else {})
    formula = {"type": "object", "properties": keys, "required": list(keys), "additionalProperties": False}
    formula["description"] = f"a formula of x, y and z in metres, {example}"
    table = {"type": "object", "properties": keys | {"table": {"type": "string"}}, "additionalProperties": False}
    del table["properties"]["expression"]
    table["required"] = list(table["properties"])
    table["description"] = "a CSV file with the columns x, y, in space z, all in metres, and value"
    return Reading(read, {"anyOf": [reading.schema, formula, table]})


def _check_unit(unit: Any, kinds: tuple[str, ...], example: str) -> None:
    if not kinds and unit is None:
        return
    if not kinds:
        raise problem("is a unit of what has none", "leave it out", "unit")
    if unit is None:
        raise problem("is missing", example, "unit")
    if not isinstance(unit, str):
        raise problem("must be text", example, "unit")
    try:
        units.quantity(f"1 {unit}", *kinds)
    except units.QuantityError as error:
        raise problem(error.problem, error.hint, "unit") from None


Angle = Annotated[float | Formula | Table, _by_place(fields.Angle, "angle")]
Stiffness = Annotated[float | Formula | Table, _by_place(fields.Stiffness, "stiffness")]
EnergyReleaseRate = Annotated[float | Formula | Table, _by_place(fields.EnergyReleaseRate, "energy release rate")]
Diffusivity = Annotated[float | Formula | Table, _by_place(fields.Diffusivity, "diffusivity")]
Factor = Annotated[float | Formula | Table, _by_place(fields.Factor)]
