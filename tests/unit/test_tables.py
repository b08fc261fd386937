"""Values of scenes at points of a table: what is read, what lies between, what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from pdhe.benchmarks.problems import lattice_nodes
from pdhe.case import build_case
from pdhe.errors import SceneError
from pdhe.scene import Scene, load_scene
from pdhe.scene_tables import MOST_POINTS, interpolated
from tests.unit.test_formulas import PLATE


def grid(function, *axes):
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    order = np.random.default_rng(0).permutation(len(points))
    return points[order], function(*points[order].T)


@pytest.mark.parametrize("axes", [([0.0, 0.3, 1.0], [0.0, 1.0]), ([0.0, 1.0], [0.0, 0.4, 1.0], [0.0, 1.0])])
def test_a_grid_is_linear_in_each_coordinate_and_constant_beyond(axes):
    points, values = grid(lambda x, y, *z: 1.0 + 2.0 * x - 3.0 * y + 4.0 * x * y + sum(z) * x, *map(np.array, axes))
    place = np.random.default_rng(1).uniform(0.0, 1.0, (50, len(axes)))
    x, y, *z = place.T
    # Sums of products of shares: measured 9e-16.
    found = interpolated(points, values, place)
    np.testing.assert_allclose(found, 1.0 + 2.0 * x - 3.0 * y + 4.0 * x * y + sum(z) * x, rtol=0, atol=1e-13)
    beyond = place + np.where(place > 0.5, 1.0, -1.0)
    np.testing.assert_allclose(
        interpolated(points, values, beyond), interpolated(points, values, place.round()), atol=1e-13
    )
    assert np.array_equal(interpolated(points, values, points), values)


def test_points_that_are_no_grid_give_the_nearest():
    points = np.array([[0.0, 0.0], [1.0, 0.1], [0.2, 1.0]])
    found = interpolated(points, np.array([1.0, 2.0, 3.0]), np.array([[0.1, 0.2], [0.8, 0.3], [0.3, 5.0]]))
    assert found.tolist() == [1.0, 2.0, 3.0]
    one = interpolated(np.array([[0.3, 0.3]]), np.array([7.0]), np.array([[9.0, -1.0]]))
    assert one.tolist() == [7.0]


def scene(folder, text, changes=None, unit="deg"):
    (folder / "angles.csv").write_text(text)
    angle = {"table": str(folder / "angles.csv"), "unit": unit}
    if unit is None:
        del angle["unit"]
    axes = {"mechanics": {"model": "correspondence", "axes": [{"angle": angle}]}}
    return load_scene("config/scenes/smoke.yaml", PLATE | axes | (changes or {}))


CORNERS = "x,y,value\n0,0,10\n0.2,0,50\n0,0.1,-30\n0.2,0.1,10\n"


def test_a_field_of_angles_is_read_with_the_scene(tmp_path):
    asked = scene(tmp_path, CORNERS)
    (tmp_path / "angles.csv").unlink()
    assert Scene.from_resolved(json.loads(json.dumps(asked.resolved()))) == asked
    case = build_case(asked, lattice_nodes(asked))
    x, y = case.discretization.coordinates.T
    np.testing.assert_allclose(case.body.model.angle, np.deg2rad(10 + 200 * x - 400 * y), rtol=0, atol=1e-14)


def test_a_table_beside_the_scene_is_found(tmp_path):
    (tmp_path / "tough.csv").write_text("x,y,value\n0,0,1\n0.2,0,3\n")
    (tmp_path / "scene.yaml").write_text(Path("config/scenes/smoke.yaml").read_text())
    given = {"damage.regions": [{"on": "all", "factor": {"table": "tough.csv"}}], "mesh.spacing": "10 mm"}
    asked = load_scene(tmp_path / "scene.yaml", given, "config/materials")
    case = build_case(asked, lattice_nodes(asked))
    x = case.discretization.coordinates[:, 0]
    owner, far = case.bonds.owners(), case.bonds.neighbours
    np.testing.assert_allclose(case.rule.factor() ** 2, 1.0 + 5.0 * (x[owner] + x[far]), rtol=1e-13)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "begin like a table"),
        ("x,y\n0,0\n", "begin like a table"),
        ("x,y,value\n", "begin like a table"),
        ("x,y,value\n0,0\n", "no 3 numbers in line 2"),
        ("x,y,value\n0,0,1\n0,1,__import__('os')\n", "no 3 numbers in line 3"),
        ("x,y,value\n0,0,nan\n", "no 3 numbers in line 2"),
        ("x,y,value\n0,0,1e999\n", "not a finite number"),
        ("x,y,value\n0,0,1\n0,0,2\n", "a point twice"),
        ("x,y,z,value\n0,0,0,1\n", "asks for z in the plane"),
        ("x,y,value\n" + "".join(f"{k},0,1\n" for k in range(MOST_POINTS + 1)), "more than 1000 points"),
        ("x" * 200_000, "more than 1000 points"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path, text, words):
    with pytest.raises(SceneError, match=words) as error:
        scene(tmp_path, text)
    assert error.value.key.startswith("mechanics.axes.0.angle")


def test_all_tables_of_a_scene_fit_a_command_line(tmp_path):
    lines = [f"{k / 3!r},{k / 7!r},{k / 11!r}" for k in range(1, MOST_POINTS + 1)]
    (tmp_path / "most.csv").write_text("\n".join(["x,y,value", *lines]))
    given = {"damage.regions": [{"on": "all", "factor": {"table": str(tmp_path / "most.csv")}}]}
    one = load_scene("config/scenes/smoke.yaml", given)
    # The longest argument of a program on Linux is 128 KiB.
    assert len(json.dumps(one.resolved())) < 100_000
    with pytest.raises(SceneError, match="more than 1000 points of all tables together"):
        scene(tmp_path, CORNERS, {"damage": {"criterion": "energy", **{"regions": given["damage.regions"]}}})


def test_tables_have_units_and_files(tmp_path):
    for unit, words in ((None, "missing"), ("mm", "not a unit of angle")):
        with pytest.raises(SceneError, match=words):
            scene(tmp_path, CORNERS, unit=unit)
    for name in ("nowhere.csv", str(tmp_path), "angles\0.csv"):
        given = {"mechanics": {"model": "correspondence", "axes": [{"angle": {"table": name, "unit": "deg"}}]}}
        with pytest.raises(SceneError, match="is not a file") as error:
            load_scene("config/scenes/smoke.yaml", PLATE | given)
        assert error.value.key == "mechanics.axes.0.angle.table"
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    given = {"damage.regions": [{"on": "all", "factor": {"table": str(tmp_path / "bytes.csv")}}]}
    with pytest.raises(SceneError, match="cannot be read"):
        load_scene("config/scenes/smoke.yaml", given)
