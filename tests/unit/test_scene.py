"""Scenes: what is read, completed, resolved and rebuilt."""

import json
import math
from pathlib import Path

import pytest
from pydantic import ValidationError

from pdhe.errors import SceneError
from pdhe.scene import Outputs, PiecewiseLinear, Scene, load_scene, scene_json_schema
from pdhe.yamlfile import read_yaml

ROOT = Path(__file__).parents[2]
SCENES = sorted((ROOT / "config" / "scenes").glob("*.yaml"))
MATERIALS = sorted((ROOT / "config" / "materials").glob("*.yaml"))
MINIMAL = """
geometry: {plate: {width: 200 mm, height: 100 mm, thickness: 4 mm}}
mesh: {spacing: 5 mm}
material: {youngs_modulus: 207 GPa, poissons_ratio: 0.29}
loads: [{on: top, displacement: {y: 0.02 mm}}]
time: {end: 10 s}
"""


def scene_from(tmp_path, text=MINIMAL, **overrides):
    path = tmp_path / "scene.yaml"
    path.write_text(text, encoding="utf-8")
    return load_scene(path, {key.replace("__", "."): value for key, value in overrides.items()})


def test_there_are_scenes_and_materials():
    assert len(SCENES) >= 5
    assert len(MATERIALS) >= 1


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_round_trip_of_every_shipped_scene(path):
    scene = load_scene(path)
    resolved = json.loads(json.dumps(scene.resolved(), allow_nan=False))
    again = Scene.from_resolved(resolved)
    assert again == scene
    assert hash(again) == hash(scene)
    assert again.resolved() == scene.resolved() == resolved


@pytest.mark.parametrize("path", MATERIALS, ids=lambda path: path.stem)
def test_every_shipped_material_names_the_source_of_each_value(path, tmp_path):
    material = scene_from(tmp_path, material=read_yaml(path)["name"]).material
    values = material.model_dump(exclude={"name", "source"}, exclude_none=True)
    assert set(material.source) == set(values)
    assert material.toughness("stress") >= material.toughness("strain") > 0.0


def test_mode_i_in_si():
    scene = load_scene(ROOT / "config/scenes/mode_i.yaml")
    geometry = scene.geometry
    assert (geometry.width, geometry.height, geometry.thickness) == (0.2, 0.1, 0.004)
    assert geometry.cracks[0].start == (0.0, 0.05)
    assert geometry.cracks[0].end == (0.05, 0.05)
    assert scene.mesh.spacing == 0.001
    assert scene.horizon_length == 0.003015
    assert scene.material.diffusivity == 0.84e-9
    assert scene.material.toughness("stress") == pytest.approx(58.4e6**2 / 207e9)  # K^2/E
    assert scene.node_sets == ("left", "right", "bottom", "top", "all", "notch")
    top = scene.loads[0]
    assert (top.on, top.at, top.displacement.x) == ("top", "edge", None)
    assert [top.displacement.y(t) for t in (0.0, 1e6, 2e6, 9e9)] == [0.0, 1e-5, 2e-5, 2e-5]
    assert scene.hydrogen.boundary[0].coverage(5.0) == 1.0
    assert len(scene.outputs.times) == 61
    assert scene.outputs.times[-1] == scene.time.end == 6e6


def test_absent_blocks_are_none_and_defaults_are_those_given(tmp_path):
    scene = scene_from(tmp_path)
    assert scene.damage is None
    assert scene.hydrogen is None
    assert not {"damage", "hydrogen"} & set(scene.resolved())
    given = {
        "horizon": {"ratio": 1.515},
        "mechanics": {"model": "condensed rotation", "weights": "moment matched", "partial_volume": "auto"},
        "mesh.cells": "quadrilateral",
        "geometry.cracks": [],
        "loads.0.at": "edge",
        "stepping": {"mode": "events", "grouping": 0.01},
        "solver": {"tolerance": "1e-4", "max_iterations": 5000},
        "outputs": {"count": 40},
        "damage": None,
    }
    for key, value in given.items():
        written = load_scene(tmp_path / "scene.yaml", {key: value})
        assert written.resolved() == scene.resolved(), key


@pytest.mark.parametrize(
    ("changes", "ratio"),
    [
        pytest.param({}, 1.515, id="nothing breaks"),
        pytest.param({"damage": {}}, 3.015, id="bonds break"),
        pytest.param({"mechanics.model": "thesis spring"}, 3.015, id="another model"),
        pytest.param({"mesh.cells": "triangle"}, 3.015, id="irregular nodes"),
        pytest.param(
            {"geometry.holes": [{"name": "pin", "centre": ["50 mm", "50 mm"], "radius": "10 mm"}]}, 3.015, id="hole"
        ),
        # 4 cells of 25 mm where 22.4 mm were asked for: 1.515 times that would leave their diagonals out.
        pytest.param(
            {"geometry.plate.width": "100 mm", "mesh.spacing": "22.4 mm"}, 3.015, id="does not divide the sides"
        ),
        pytest.param({"horizon": {"ratio": 2.5}}, 2.5, id="given"),
    ],
)
def test_the_usual_horizon_is_short_where_nothing_breaks_on_a_lattice(changes, ratio, tmp_path):
    scene = load_scene(ROOT / "config/scenes/elastic.yaml", changes)
    assert scene.horizon.ratio == ratio
    assert Scene.from_resolved(scene.resolved()) == scene


def test_the_same_quantity_in_other_units_is_the_same_scene(tmp_path):
    other = scene_from(
        tmp_path,
        mesh__spacing="0.5 cm",
        geometry__plate__width="0.2 m",
        material__youngs_modulus="207e3 MPa",
        loads__0__displacement__y="20 um",
        time__end="1e4 ms",
    )
    assert other.resolved() == scene_from(tmp_path).resolved()


def test_saturation_switched_off_survives_the_round_trip(tmp_path):
    hydrogen = {"boundary": [{"on": "left", "coverage": {"0 h": 0, "1 h": "50 %"}}]}
    on = scene_from(tmp_path, material="AISI 4340", hydrogen=hydrogen)
    assert on.hydrogen.saturation.damage == 0.36
    for off in (None, "off", False):
        scene = scene_from(tmp_path, material="AISI 4340", hydrogen={**hydrogen, "saturation": off})
        assert scene.hydrogen.saturation is None
        assert Scene.from_resolved(scene.resolved()) == scene
        assert scene != on


def test_scenes_are_frozen_and_hashable(tmp_path):
    scene = scene_from(tmp_path)
    with pytest.raises(ValidationError):
        scene.mesh.spacing = 1.0
    assert {scene, scene_from(tmp_path)} == {scene}


def test_overrides(tmp_path):
    scene = scene_from(tmp_path, material="AISI 4340", material__poissons_ratio=0.3, horizon__length="16 mm")
    assert scene.material.name == "AISI 4340"
    assert scene.material.poissons_ratio == 0.3
    assert scene.horizon_length == 0.016
    damaged = scene_from(tmp_path, material="AISI 4340", damage__criterion="stretch")
    assert damaged.damage.criterion == "stretch"
    for key, fragment in [
        ("loads.1.on", "not an entry of `loads`"),
        ("time.end.value", "`time.end` is a single value"),
        ("mesh..spacing", "is not a dotted key"),
    ]:
        with pytest.raises(SceneError) as caught:
            load_scene(tmp_path / "scene.yaml", {key: "1 mm"})
        assert fragment in str(caught.value)
    with pytest.raises(SceneError, match="set from outside the file"):
        scene_from(tmp_path, mesh__spacing=5)


def test_material_folder(tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "my-steel.yaml").write_text("{youngs_modulus: 200 GPa, poissons_ratio: 0.25}", encoding="utf-8")
    (folder / "bad.yaml").write_text("{youngs_modulus: 200, poissons_ratio: 0.25}", encoding="utf-8")
    path = tmp_path / "scene.yaml"
    path.write_text(MINIMAL, encoding="utf-8")
    assert load_scene(path, {"material": "My steel"}, folder).material.youngs_modulus == 200e9
    with pytest.raises(SceneError) as caught:
        load_scene(path, {"material": "bad"}, folder)
    assert caught.value.file == str(folder / "bad.yaml")
    assert caught.value.key == "youngs_modulus"
    with pytest.raises(SceneError, match="known materials: `bad`, `my-steel`"):
        load_scene(path, {"material": "AISI 4340"}, folder)


@pytest.mark.parametrize(
    ("request_", "end", "expected"),
    [
        ({}, 40.0, tuple(float(k) for k in range(41))),
        ({"count": 4}, 1.0, (0.0, 0.25, 0.5, 0.75, 1.0)),
        ({"every": "4 s"}, 10.0, (0.0, 4.0, 8.0, 10.0)),
        ({"every": "0.1 s"}, 0.3, (0.0, 0.1, 0.2, 0.3)),
        ({"every": "20 s"}, 10.0, (0.0, 10.0)),
        ({"times": ["1 s", "2 s"]}, 3.0, (0.0, 1.0, 2.0, 3.0)),
        ({"times": []}, 3.0, (0.0, 3.0)),
        ({}, 0.0, (0.0,)),
        ({"every": "1 s"}, 0.0, (0.0,)),
    ],
)
def test_output_times(request_, end, expected):
    assert Outputs.model_validate(request_).at(end) == expected


def test_piecewise_linear():
    ramp = PiecewiseLinear(times=(1.0, 2.0, 4.0), values=(0.0, 3.0, -1.0))
    assert [ramp(t) for t in (-1.0, 1.0, 1.5, 2.0, 3.0, 4.0, 9.0)] == [0.0, 0.0, 1.5, 3.0, 1.0, -1.0, -1.0]
    assert ramp.corners == (1.0, 2.0, 4.0)
    constant = PiecewiseLinear(times=(0.0,), values=(7.0,))
    assert constant(0.0) == constant(math.inf) == 7.0
    assert constant.corners == ()


def test_edges_that_meet_may_prescribe_different_components_or_the_same_value(tmp_path):
    for extra in ({"x": "1 um"}, {"y": "0.02 mm"}, {"y": {"5 s": "20 um", "6 s": "20 um"}}):
        loads = [{"on": "top", "displacement": {"y": "0.02 mm"}}, {"on": "left", "displacement": extra}]
        assert len(scene_from(tmp_path, loads=loads).loads) == 2
    opposite = [{"on": s, "displacement": {"y": v}} for s, v in (("top", "1 um"), ("bottom", "2 um"))]
    assert len(scene_from(tmp_path, loads=opposite).loads) == 2


def test_cracks_may_end_on_the_boundary_and_start_at_a_hole(tmp_path):
    holes = [{"name": "bore", "centre": ["60 mm", "50 mm"], "radius": "10 mm"}]
    cracks = [
        {"name": "a", "from": ["70 mm", "50 mm"], "to": ["200 mm", "100 mm"]},
        {"name": "b", "from": ["0 mm", "10 mm"], "to": ["30 mm", "0 mm"]},
    ]
    scene = scene_from(tmp_path, geometry__holes=holes, geometry__cracks=cracks)
    assert scene.node_sets[-3:] == ("bore", "a", "b")
    assert Scene.from_resolved(scene.resolved()) == scene


def test_json_schema_is_the_committed_one():
    committed = json.loads((ROOT / "config/scene.schema.json").read_text(encoding="utf-8"))
    assert committed == scene_json_schema(), "run `pdhe schema --out config/scene.schema.json`"
    assert set(committed["properties"]) == set(Scene.model_fields)
    spacing = committed["$defs"]["Mesh"]["properties"]["spacing"]
    assert spacing["type"] == "string"
    assert "7 mm" in spacing["description"]
