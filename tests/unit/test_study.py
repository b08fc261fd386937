"""Cases, names and identities of studies."""

import dataclasses
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pdhe.errors import SceneError
from pdhe.scene import Scene, load_scene
from pdhe.study import STYLE_KEYS, load_aside, load_studies, load_study, slug

ROOT = Path(__file__).parents[2]
SCENE = ROOT / "config/scenes/smoke.yaml"


@pytest.fixture
def write(tmp_path):
    """Write a study file from its block, as JSON, which is YAML too."""

    def study_file(stem="trial", /, top=None, **block):
        path = tmp_path / f"{stem}.yaml"
        block.setdefault("scene", str(SCENE))
        path.write_text(json.dumps({"study": block, **(top or {})}))
        return path

    return study_file


def names(study):
    return [case.name for case in study.cases]


def test_bare_scene_is_a_study_of_one_case(write):
    study = load_study(write())
    assert study.name == "trial"
    assert names(study) == ["base"]
    assert study.cases[0].resolved == load_scene(SCENE).resolved()
    assert study.cases[0].pictures == ("damage", "displacement", "coverage")


def test_sweep_and_cases_give_every_combination(write):
    study = load_study(
        write(sweep={"mesh.spacing": ["5 mm", "2.5 mm"], "stepping.grouping": [0.1]}, cases={"a": {}, "b": None})
    )
    assert names(study) == [
        "a_spacing=5mm_grouping=0.1",
        "a_spacing=2.5mm_grouping=0.1",
        "b_spacing=5mm_grouping=0.1",
        "b_spacing=2.5mm_grouping=0.1",
    ]
    assert study.cases[1].resolved["mesh"]["spacing"] == 2.5e-3
    assert study.cases[0].solve_id == study.cases[2].solve_id


@pytest.mark.parametrize(
    ("block", "key"),
    [
        pytest.param({"set": {"accuracy": "2 %", "mesh.spacing": None}}, "set.accuracy", id="for all cases"),
        pytest.param(
            {"set": {"mesh.spacing": None}, "sweep": {"accuracy": ["2 %", "5 %"]}}, "sweep.accuracy", id="swept"
        ),
        pytest.param(
            {"cases": {"a": {"accuracy": "2 %", "mesh.spacing": None}, "b": {}}}, "cases.a.accuracy", id="in one case"
        ),
    ],
)
def test_an_accuracy_that_would_choose_the_spacing_of_a_case_is_refused(write, block, key):
    with pytest.raises(SceneError, match=rf"key 'study\.{re.escape(key)}'.*`pdhe choose`"):
        load_study(write(**block))


def test_cases_may_differ_in_fidelity_and_keep_an_accuracy_beside_a_spacing(write):
    study = load_study(write(set={"accuracy": "2 %"}, cases={"a": {}, "b": {"accuracy": None, "mesh.spacing": None,
                                                                           "fidelity": "draft"}}))  # fmt: skip
    assert [case.resolved.get("accuracy") for case in study.cases] == [0.02, None]
    assert [case.resolved["mesh"]["spacing"] for case in study.cases] == pytest.approx([5e-3, 25e-3 / 3])


def test_keys_that_end_alike_are_written_in_full(write):
    sweep = {"loads.0.displacement.y": ["1 um"], "loads.1.displacement.y": ["-1 um"]}
    assert names(load_study(write(sweep=sweep))) == ["loads.0.displacement.y=1um_loads.1.displacement.y=-1um"]


def test_names_are_fit_for_paths(write):
    sweep = {"material.critical_energy_release_rate": ["20 kJ/m^2"], "hydrogen.boundary": [[]], "damage": [None]}
    (name,) = names(load_study(write(sweep=sweep, set={"material.fracture_toughness": None})))
    assert re.fullmatch(r"critical_energy_release_rate=20kJ-m-2_boundary=[0-9a-f]{6}_damage=none", name)


def test_long_names_are_cut_and_stay_apart(write):
    sweep = {"title": ["x" * 200 + "1", "x" * 200 + "2"]}
    first, second = names(load_study(write(sweep=sweep)))
    assert len(first) <= 120
    assert first != second


def test_case_can_have_a_scene_of_its_own(write):
    other = ROOT / "config/scenes/elastic.yaml"
    study = load_study(write(cases={"one": {}, "two": {"scene": str(other), "mesh.spacing": "5 mm"}}))
    assert study.cases[0].scene == str(SCENE)
    assert study.cases[1].resolved == load_scene(other, {"mesh.spacing": "5 mm"}).resolved()
    assert study.cases[1].pictures == ("displacement",)


def test_scene_beside_the_study_is_found(write, tmp_path):
    (tmp_path / "here.yaml").write_text(SCENE.read_text())
    material = {"youngs_modulus": "1 GPa", "poissons_ratio": 0.3}
    path = write(scene="here.yaml", set={"material": material, "damage": None, "hydrogen": None})
    assert load_study(path).cases[0].scene == str(tmp_path / "here.yaml")


def test_case_overrides_the_set_of_the_study(write):
    study = load_study(write(set={"mesh.spacing": "5 mm", "time.end": "13 Ms"}, cases={"a": {"mesh.spacing": "4 mm"}}))
    assert study.cases[0].resolved["mesh"]["spacing"] == 4e-3
    assert study.cases[0].resolved["time"]["end"] == 1.3e7


@pytest.mark.parametrize(
    ("key", "value", "mesh_stays", "solve_stays"),
    [
        ("title", "Another name", True, True),
        ("material.source", {"density": "a handbook"}, True, True),
        ("horizon.ratio", 3.015, True, True),
        ("time.end", "12 Ms", True, True),
        ("solver.tolerance", 1e-7, True, False),
        ("material.density", "1 kg/m^3", True, False),
        ("hydrogen", None, True, False),
        ("mesh.spacing", "4 mm", False, False),
        ("geometry.cracks.0.to", ["49 mm", "50 mm"], False, False),
    ],
)
def test_identity_holds_what_a_stage_reads(key, value, mesh_stays, solve_stays, write):
    base = load_study(write("base")).cases[0]
    changed = load_study(write("changed", set={key: value})).cases[0]
    assert (changed.mesh_id == base.mesh_id) == mesh_stays
    assert (changed.solve_id == base.solve_id) == solve_stays


def test_solve_can_be_rebuilt_from_its_description(write):
    case = load_study(write()).cases[0]
    scene = Scene.from_resolved({"title": "any", **json.loads(case.solve_spec)})
    assert scene.resolved() | {"title": 0} == case.resolved | {"title": 0, "material": scene.resolved()["material"]}


def test_table_shows_what_differs(write):
    study = load_study(write(sweep={"mesh.spacing": ["5 mm", "4 mm"]}))
    header, first, second = study.table().splitlines()
    assert header == "case,scene,mesh,solve,mesh.spacing"
    assert first.startswith("spacing=5mm,")
    assert second.endswith(f"{study.cases[1].solve_id},0.004")


def test_styles_are_merged_key_by_key(write):
    path = write(top={"figures": {"dpi": 3, "hold": 3}}, figures={"dpi": 2})
    assert load_study(path, {"dpi": 1, "panels": 1}).style == {"dpi": 2, "panels": 1, "hold": 3}


def test_style_keys_are_those_of_the_figures():
    from pdhe.plotting.style import Style

    assert {field.name for field in dataclasses.fields(Style)} == set(STYLE_KEYS)


def test_pictures_and_animations_can_be_chosen(write):
    path = write()
    study = load_study(path, {"pictures": ["coverage"], "animations": False})
    assert study.cases[0].pictures == ("coverage",)
    assert not study.animations
    assert study.style == {}


@pytest.mark.parametrize(
    ("block", "key", "text"),
    [
        ({"swep": {}}, "study.swep", "did you mean 'sweep'"),
        ({"sweep": {"mesh.spacing": []}}, "study.sweep.mesh.spacing", "at least one"),
        ({"sweep": {"mesh.spacing": "5 mm"}}, "study.sweep.mesh.spacing", "list"),
        ({"sweep": {"mesh.spaceing": ["5 mm"]}}, "study.sweep.mesh.spaceing", "spacing"),
        ({"sweep": {"mesh.spacing": [5]}}, "study.sweep.mesh.spacing", "unit"),
        ({"sweep": {"mesh.spacing": ["5 mm", "5mm"]}}, "study.sweep", "same name"),
        ({"set": {"nothing.here": 1}}, "study.set.nothing", ""),
        ({"cases": {"a": {"mesh.cells": "round"}}}, "study.cases.a.mesh.cells", "quadrilateral"),
        (
            {"cases": {"a": {"mesh.spacing": "5 mm"}}, "sweep": {"mesh.spacing": ["4 mm"]}},
            "study.cases.a.mesh.spacing",
            "",
        ),
        ({"cases": {"a/b": {}}}, "study.cases.a/b", "folder"),
        ({"cases": {}}, "study.cases", "no case"),
        ({"cases": ["a"]}, "study.cases", "key: value"),
        ({"cases": {"a": {"scene": "none.yaml"}}}, "study.cases.a.scene", "no such scene file"),
        ({"scene": "none.yaml"}, "study.scene", "no such scene file"),
        ({"scene": 3}, "study.scene", "path"),
        ({"name": "a b"}, "study.name", "folder"),
        ({"name": "store"}, "study.name", "reserved"),
        ({"name": ".."}, "study.name", "folder"),
        ({"figures": {"pictures": ["dammage"]}}, "study.figures.pictures", "did you mean 'damage'"),
        ({"figures": {"dpy": 3}}, "study.figures.dpy", "did you mean 'dpi'"),
        ({"figures": {"animations": "no"}}, "study.figures.animations", "true or false"),
    ],
)
def test_mistakes_are_named_where_they_are(block, key, text, write):
    path = write(**block)
    with pytest.raises(SceneError) as caught:
        load_study(path)
    assert caught.value.file == str(path)
    assert caught.value.key.startswith(key)
    assert text in str(caught.value)


def test_configuration_lists_studies(write):
    files = [str(write("one")), str(write("two", figures={"dpi": 3}))]
    studies = load_studies({"studies": files, "figures": {"dpi": 1}})
    assert [(study.name, study.style) for study in studies] == [("one", {"dpi": 1}), ("two", {"dpi": 3})]


def test_study_given_as_configuration_runs_alone(write):
    one, two = write("one"), write("two")
    config = {"studies": [str(one)], "study": {"anything": 0}}
    assert [study.name for study in load_studies(config, [two])] == ["two"]


@pytest.mark.parametrize(
    ("config", "text"),
    [
        ({}, "list of study files"),
        ({"studies": []}, "list of study files"),
        ({"studys": ["a"]}, "did you mean 'study'|did you mean 'studies'"),
        ({"studies": ["none.yaml"]}, "no such study file"),
        ({"study": {}}, "has to come from a file"),
    ],
)
def test_bad_configuration_is_refused(config, text):
    with pytest.raises(SceneError, match=text):
        load_studies(config)


def test_two_studies_need_two_names(write):
    with pytest.raises(SceneError, match="already the name"):
        load_studies({"studies": [str(write("one", name="same")), str(write("two", name="same"))]})


def test_slug_is_plain():
    assert slug("AISI 4340 (tempered)") == "aisi-4340-tempered"


def test_thousand_cases_are_expanded_in_seconds(write):
    sweep = {"hydrogen.initial": [k / 100 for k in range(25)], "time.end": [f"{12 + k} Ms" for k in range(40)]}
    start = time.process_time()
    study = load_study(write(sweep=sweep))
    assert len({case.solve_id for case in study.cases}) == 1000
    assert len({case.mesh_id for case in study.cases}) == 1
    assert time.process_time() - start < 20.0  # measured: 1 s on an idle core, 4 s beside ten other programs


def test_reading_studies_loads_nothing_heavy():
    heavy = "{'numpy', 'numba', 'gmsh', 'xarray', 'netCDF4', 'scipy.sparse', 'matplotlib'}"
    code = f"import sys, pdhe.study; pdhe.study.load_study(sys.argv[1]); assert not {heavy} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code, str(ROOT / "config/studies/smoke.yaml")], cwd=ROOT, check=True)


def test_studies_with_a_target_of_their_own_are_apart(write):
    file = str(write("one"))
    assert [study.name for study in load_aside({"dynamics": file, "figures": {"dpi": 1}})] == ["one"]
    assert load_studies({"dynamics": file, "studies": [str(write("two"))]})[0].name == "two"
    # Whoever asks for one thing gets that alone.
    for alone in ({"study": {}}, {"check": {}}, {"tradeoff": {}}):
        assert load_aside({"dynamics": file, **alone}) == ()
    assert load_aside({}) == ()
    with pytest.raises(SceneError, match="path of a study"):
        load_aside({"dynamics": ["a"]})


@pytest.mark.parametrize(
    "text", ["study: {scene: x, figures: {pictures: [[damage]]}}", "check: {topic: [moduli]}", "study: {figures: [1]}"]
)
def test_lists_where_words_belong_are_refused(text, tmp_path, capsys):
    from pdhe import cli

    (tmp_path / "file.yaml").write_text(text)
    assert cli.main(["validate", str(tmp_path / "file.yaml")]) == 1
    assert capsys.readouterr().err.count("error: ") == 1
