"""Quantities: conversion, rounding, refusals."""

import contextlib
import math
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdhe import units
from pdhe.units import KINDS, QuantityError, quantity, ratio


@pytest.mark.parametrize(
    ("text", "kind", "expected"),
    [
        ("7 mm", "length", 0.007),
        ("0.7 cm", "length", 0.007),
        ("1 inch", "length", 0.0254),  # by definition of the inch
        ("−0.02 mm", "length", -2e-5),  # typographic minus
        ("207 GPa", "stiffness", 207e9),
        ("207GPa", "Pa", 207e9),
        ("40 h", "time", 144000.0),
        ("1e-5 s", "time", 1e-5),
        ("0.84e-9 m^2/s", "diffusivity", 0.84e-9),
        ("0.84e-3 mm²/s", "m^2/s", 0.84e-9),
        ("58.4 MPa m^0.5", "fracture toughness", 58.4e6),
        ("58.4 MPa*sqrt(m)", "fracture toughness", 58.4e6),
        ("58.4 MPa √m", "fracture toughness", 58.4e6),
        ("58.4 MPa m^(1/2)", "fracture toughness", 58.4e6),
        ("16.5 kJ/m^2", "energy release rate", 16500.0),
        ("16.5 N/mm", "energy release rate", 16500.0),
        ("7.85 g/cm**3", "density", 7850.0),
        ("2.65e-5 mol/m^2", "surface concentration", 2.65e-5),
        ("-0 mm", "length", 0.0),
    ],
)
def test_conversion(text, kind, expected):
    result = quantity(text, kind)
    assert result == expected
    assert math.copysign(1.0, result) == math.copysign(1.0, expected)


@pytest.mark.parametrize("name", units._COMMON_UNITS)
def test_common_units_are_those_of_pint(name, monkeypatch):
    value, dimensions = units._named(name)
    monkeypatch.setattr(units, "_COMMON_UNITS", {})
    assert units._named.__wrapped__(name) == (pytest.approx(value, rel=1e-15), dimensions)
    # Rounded to 15 digits, as every quantity is, nothing of the last bit is left.
    assert units.round15(units._named.__wrapped__(name)[0]) == units.round15(value)


def test_units_that_scenes_use_do_not_load_pint():
    text = "import sys\nfrom pdhe.units import *\nquantity('58.4 MPa m^0.5', 'fracture toughness')\n"
    for kind in KINDS.values():
        text += f"quantity({kind.example!r}, {kind.unit!r})\n"
    subprocess.run([sys.executable, "-c", text + "assert 'pint' not in sys.modules"], check=True)


def test_first_fitting_kind_of_several():
    assert quantity("2 mol/m^3", "concentration", "surface concentration") == 2.0
    assert quantity("2 mol/m^2", "concentration", "surface concentration") == 2.0
    with pytest.raises(QuantityError, match="concentration or surface concentration"):
        quantity("2 mol", "concentration", "surface concentration")


@pytest.mark.parametrize(
    ("value", "kind", "fragment"),
    [
        (7, "length", "needs a unit; write a unit, for example `7 mm`"),
        (7.5, "time", "for example `40 h`"),
        ("7", "length", "needs a unit"),
        (True, "length", "is not a length"),
        (None, "length", "is not a length"),
        ("", "length", "is not a length"),
        ("mm", "length", "is not a length"),
        ("7 m", "time", "'m' is not a unit of time"),
        ("7 mmm", "length", "did you mean `mm`"),
        ("7 m2", "length", "powers"),
        ("7,5 mm", "length", "decimal sign"),
        ("nan mm", "length", "is not a length"),
        ("1e999 mm", "length", "finite"),
        ("3 m^99^99", "length", "is not a unit"),
        ("3 m^(1/0)", "length", "divides by zero"),
        ("3 m^99 Gm^99 Gm^99 Gm^99", "length", "usable"),
        ("2**9 m", "length", "is not a unit"),
        ("3 degC", "length", "offset"),
        ("3 mm *", "length", "is not a unit"),
        ("1 " + "m " * 200, "length", "too long"),
        ("__import__('os').getcwd() m", "length", "is not a length"),
    ],
)
def test_refusals(value, kind, fragment):
    with pytest.raises(QuantityError) as caught:
        quantity(value, kind)
    assert fragment in str(caught.value)


@given(st.floats(min_value=1e-6, max_value=1e6), st.sampled_from([("mm", 1e-3), ("cm", 1e-2), ("km", 1e3)]))
@settings(max_examples=100, deadline=None)
def test_conversion_is_a_product(number, unit):
    assert quantity(f"{number!r} {unit[0]}", "length") == pytest.approx(
        number * unit[1], rel=6e-15
    )  # half of the 15th digit, and rounding


@given(st.integers(min_value=1, max_value=10**9))
@settings(max_examples=100, deadline=None)
def test_the_same_length_in_two_units_is_the_same_float(micrometres):
    millimetres = f"{micrometres // 1000}.{micrometres % 1000:03d}"
    assert quantity(f"{micrometres} um", "length") == quantity(f"{millimetres} mm", "length")


@given(st.text(max_size=30))
@settings(max_examples=100, deadline=None)
def test_any_text_gives_a_number_or_the_error(text):
    for candidate in (text, f"1 {text}"):
        with contextlib.suppress(QuantityError):
            assert math.isfinite(quantity(candidate, "length"))


def test_every_kind_accepts_its_example():
    for name, kind in KINDS.items():
        assert quantity(kind.example, name) == quantity(kind.example, kind.unit)


def test_ratio():
    assert ratio(1) == 1.0
    assert ratio("1e-5") == 1e-5
    assert ratio("36 %") == 0.36
    for wrong in (True, None, [], "7 mm", "", math.nan, math.inf, 10**400, "1e999"):
        with pytest.raises(QuantityError):
            ratio(wrong)


def test_importing_the_scene_leaves_heavy_packages_alone():
    heavy = ("pint", "numba", "gmsh", "xarray", "scipy", "matplotlib", "numpy")
    code = f"import sys, pdhe.scene; print([m for m in {heavy!r} if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
