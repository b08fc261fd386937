"""Values as formulas of place: what they are, what is refused, and bodies made with them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdhe.benchmarks.problems import lattice_nodes
from pdhe.bonds import build_bonds
from pdhe.case import build_case
from pdhe.errors import SceneError
from pdhe.formulas import FUNCTIONS, LONGEST, FormulaError, coordinates_of, value_at
from pdhe.materials import Correspondence, make_body
from pdhe.materials.constants import Orthotropic
from pdhe.plan import make_plan
from pdhe.scene import Scene, load_scene
from pdhe.scene_places import Formula
from tests.lattices import THICKNESS, lattice

PLACE = np.random.default_rng(0).uniform(0.1, 0.9, (7, 3))
X, Y, Z = PLACE.T


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2", np.full(7, 2.0)),
        (" -x + 3*y/z - 1.5e-2 ", -X + 3 * Y / Z - 1.5e-2),
        ("2**x**2", 2.0 ** (X**2)),
        ("-x**2", -(X**2)),
        ("sin(2*pi*x)*exp(-y) + atan2(y, x)", np.sin(2 * np.pi * X) * np.exp(-Y) + np.arctan2(Y, X)),
        ("where(x < 0.5, min(x, y), max(y, z))", np.where(X < 0.5, np.minimum(X, Y), np.maximum(Y, Z))),
        ("(x >= 0.5) * 3", 3.0 * (X >= 0.5)),
        ("hypot(x, y) + sqrt(abs(-z)) + log(1 + tanh(x))", np.hypot(X, Y) + np.sqrt(Z) + np.log(1 + np.tanh(X))),
    ],
)
def test_formulas_are_what_they_say(text, expected):
    # The same operations of the same doubles.
    assert np.array_equal(value_at(text, PLACE), expected)


def test_every_function_is_there_and_takes_what_it_says():
    for name, (_, count) in FUNCTIONS.items():
        assert np.isfinite(value_at(f"{name}({', '.join(['0.5'] * count)})", PLACE)).all()
        with pytest.raises(FormulaError, match=f"`{name}` {count + 1} values; it takes {count}"):
            value_at(f"{name}({', '.join(['0.5'] * (count + 1))})", PLACE)


def test_what_has_no_value_is_no_number_and_no_warning():
    for text in ("1/0", "log(-x)", "9**9**9**9", "sqrt(0 - 1)", "exp(1e6)"):
        assert not np.isfinite(value_at(text, PLACE)).any()


HOSTILE = [
    "__import__('os').system('true')", "__import__", "x.__class__", "().__class__.__bases__", "x.real",
    "[x for x in y]", "lambda: x", "f(x)", "sin.__call__(x)", "sin(x=1)", "sin(*x)", "min(*x, y)", "open(x)",
    "eval(x)", "exec(x)", "x[0]", "{x}", "(x, y)", "x if y else z", "x and y", "not x", "x; y", "x = 1", "(x := 1)",
    "'x'", '"x" * 9', "b'x'", "True", "None", "1j", "x == y", "x != y", "0 < x < 1", "x @ y", "x % 2", "x // 2",
    "x << 9", "x ^ 2", "~x", "await x", "yield", "x is y", "x in y", "sin", "pi(2)", "e", "t", "x y", "", "   ",
    "(" * 300, "-" * 400 + "x", "x\n+ y", "x\0", "\N{FULLWIDTH LATIN SMALL LETTER X}", "1" * 400, "x" * (LONGEST + 1),
    "+".join(["x"] * 150), "print(x)", "globals()", "#x", "x\\", "f'{x}'",
]  # fmt: skip


@pytest.mark.parametrize("text", HOSTILE)
def test_nothing_else_is_a_formula(text):
    for ask in (coordinates_of, lambda text: value_at(text, PLACE)):
        with pytest.raises(FormulaError) as error:
            ask(text)
        assert error.value.problem and error.value.hint


@settings(max_examples=300, deadline=None)
@given(st.text(alphabet="xyzpie0123456789.+-*/()<>=_, sincowhr", max_size=60))
def test_any_text_is_a_formula_or_refused(text):
    try:
        assert value_at(text, PLACE).shape == (7,)
    except FormulaError as error:
        assert len(str(error)) < 500


PLATE = {
    "mesh.spacing": "10 mm",
    "hydrogen": None,
    "material.orthotropic": {"youngs_modulus_2": "10 GPa", "shear_modulus_12": "5 GPa"},
    "material.critical_energy_release_rate": "0.3 kJ/m^2",
    "material.fracture_toughness": None,
}


def scene(changes):
    return load_scene("config/scenes/smoke.yaml", changes)


def case_of(changes):
    asked = scene(changes)
    assert Scene.from_resolved(asked.resolved()) == asked
    return build_case(asked, lattice_nodes(asked))


def turned_by(expression, unit, **more):
    angle = {"expression": expression, "unit": unit}
    return PLATE | {"mechanics": {"model": "correspondence", "axes": [{"angle": angle} | more]}}


def test_angles_are_formulas_of_the_place_in_their_unit():
    case = case_of(turned_by("45 + 300*x - 20*sin(2*pi*y/0.1)", "deg"))
    x, y = case.discretization.coordinates.T
    expected = np.deg2rad(45 + 300 * x - 20 * np.sin(2 * np.pi * y / 0.1))
    np.testing.assert_allclose(case.body.model.angle, expected, rtol=1e-14)
    case = case_of(turned_by("x", "rad", around=["0 mm", "0 mm"]))
    np.testing.assert_allclose(case.body.model.angle, x + np.arctan2(y, x), rtol=1e-14)


def test_a_turned_laminate_with_a_field_of_angles_is_the_laminate_in_turned_axes():
    x = lattice(11, 10) + 0.2e-3 * np.random.default_rng(0).uniform(-1, 1, (110, 2))
    turn = math.radians(30.0)
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    field = "0.3 + 80*{0} - 150*{1}**2/0.01 + 0.5*sin(400*{0})"
    angle = Formula(expression=field.format("x", "y"), unit="rad").at(x)
    # The same field seen from axes that stay: a place of the turned body is turned back first.
    back = f"({c!r}*x + {s!r}*y)", f"({c!r}*y - {s!r}*x)"
    moved = x @ rotation.T
    other = turn + Formula(expression=field.format(*back), unit="rad").at(moved)
    assert np.ptp(angle) > 1.0
    ply = Orthotropic(140e9, 10e9, 0.3, 5e9, 10e9, 0.3, 0.45)
    bodies = []
    for place, axes in ((x, angle), (moved, other)):
        volume = np.full(len(x), 1e-6 * THICKNESS)
        bonds = build_bonds(place, volume, np.full(len(x), 1e-3), THICKNESS, 3.015e-3)
        model = Correspondence(140e9, 0.3, THICKNESS, 3.015e-3, orthotropic=ply, angle=axes)
        bodies.append(make_body(bonds, model, place, volume))
    u = np.random.default_rng(1).normal(size=x.shape)
    one, turned = bodies
    # Measured 2e-13 of the largest.
    for measured, expected in (
        (turned.force(u @ rotation.T), one.force(u) @ rotation.T),
        (turned.energy(u @ rotation.T), one.energy(u)),
        (turned.stress(u @ rotation.T), rotation @ one.stress(u) @ rotation.T),
    ):
        np.testing.assert_allclose(measured, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_fracture_energies_stiffnesses_and_diffusivities_are_formulas_too():
    plain = {"mesh.spacing": "10 mm"}
    tough = {"damage.regions": [{"on": "all", "factor": {"expression": "1 + 5*x"}}]}
    case = case_of(plain | tough)
    x = case.discretization.coordinates[:, 0]
    owner, far = case.bonds.owners(), case.bonds.neighbours
    # Each end gives half of its fracture energy (theory, eq. 5.12), and it changes linearly.
    np.testing.assert_allclose(case.rule.factor() ** 2, 1 + 2.5 * (x[owner] + x[far]), rtol=1e-13)
    assert "fracture energy 1." in make_plan(case)
    given = {"expression": "where(y < 0.05, 8, 16)", "unit": "kJ/m^2"}
    energy = {"damage.regions": [{"on": "all", "critical_energy_release_rate": given}]}
    toughness = case.scene.material.toughness("stress")
    ratio = case_of(plain | energy).rule.factor() ** 2 * toughness
    assert ratio.min() == pytest.approx(8e3, rel=1e-12) and ratio.max() == pytest.approx(16e3, rel=1e-12)
    stiff = {"mechanics.regions": [{"on": "all", "youngs_modulus": {"expression": "207 + 100*x", "unit": "GPa"}}]}
    relative = case_of(plain | stiff).body.relative
    node = 1.0 + 100.0 * x / 207.0
    np.testing.assert_allclose(relative, 2.0 / (1.0 / node[owner] + 1.0 / node[far]), rtol=1e-13)
    fast = {"hydrogen.regions": [{"on": "all", "factor": {"expression": "0.5 + x"}}]}
    slow, usual = case_of(plain | fast), case_of(plain)
    assert slow.diffusion is not None and not np.array_equal(slow.diffusion.rate, usual.diffusion.rate)
    assert make_plan(slow)


@pytest.mark.parametrize(
    ("changes", "key", "text"),
    [
        (turned_by("45 + z", "deg"), "mechanics.axes.0.angle.expression", "z in the plane"),
        (turned_by("45", None), "mechanics.axes.0.angle.unit", "missing"),
        (turned_by("45", "mm"), "mechanics.axes.0.angle.unit", "not a unit of angle"),
        (turned_by("open(x)", "deg"), "mechanics.axes.0.angle.expression", "no formula has"),
        (turned_by(3, "deg"), "mechanics.axes.0.angle.expression", "must be text"),
        (turned_by("log(-x)", "deg"), "mechanics.axes.0.angle", "a number everywhere"),
        ({"damage.regions": [{"on": "all", "factor": {"expression": "x", "unit": "m"}}]},
         "damage.regions.0.factor.unit", "leave it out"),
        ({"damage.regions": [{"on": "all", "factor": {"formula": "x"}}]},
         "damage.regions.0.factor.formula", "not a known key"),
        ({"damage.regions": [{"on": "all", "factor": {"expression": "x - 0.1"}}]},
         "damage.regions.0", "at \\(5, 5\\) mm"),
        ({"damage.regions": [{"on": "all", "factor": {"expression": "1"}, "critical_energy_release_rate": "1 kJ/m^2"}]},
         "damage.regions.0", "needs either"),
        ({"damage.interfaces": [{"between": ["left", "right"], "factor": {"expression": "1"}}]},
         "damage.interfaces.0.factor", "not a number"),
    ],
)  # fmt: skip
def test_formulas_that_mean_nothing_are_refused(changes, key, text):
    with pytest.raises(SceneError, match=text) as error:
        case_of({"mesh.spacing": "10 mm"} | changes)
    assert error.value.key == key


def test_what_python_warns_of_is_refused_without_a_word(recwarn):
    with pytest.raises(FormulaError, match="is not a formula"):
        coordinates_of("1if")
    assert not recwarn.list
