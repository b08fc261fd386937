"""Scenes with compiled user materials: closed forms, histories in results, identity, and what goes wrong beforehand."""

import json
import shutil
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml

from pdhe import cli
from pdhe.benchmarks.problems import lattice_nodes
from pdhe.case import build_case
from pdhe.discretization import discretize, write_discretization
from pdhe.errors import SceneError, SimulationError
from pdhe.histories import user_material
from pdhe.materials.umat import COMPILERS, UserMaterial, UserPoints, build, drive
from pdhe.mesh import make_mesh
from pdhe.netcdf import read_netcdf
from pdhe.plan import make_plan
from pdhe.provenance import canonical
from pdhe.results import open_result
from pdhe.scene import Scene, load_scene
from pdhe.scene_umat import SOURCES, content_of
from pdhe.simulation import simulate, solve_case
from pdhe.store import unused
from pdhe.study import load_study
from pdhe.whole import whole_result

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "config/scenes/plastic_hole.yaml"
YOUNG, NU, YIELD, HARDENING = 200e9, 0.3, 250e6, 2e9
#: Strains of a bar at the end of equal steps: elastic, yielding, unloading, yielding the other way.
PATH = np.array([1e-3, 2e-3, 4e-3, 6e-3, 4e-3, 2e-3, -1e-3, -4e-3])
J2 = {"source": "config/umat/j2.c", "properties": [YOUNG, NU, YIELD, HARDENING], "states": ["plastic_strain"]}
ELASTIC = {"source": "config/umat/elastic.c", "name": "ELASTIC", "properties": [YOUNG, NU]}

if shutil.which("cc") is None:
    pytest.skip("no cc here", allow_module_level=True)


@pytest.fixture(autouse=True)
def kept(tmp_path_factory, monkeypatch):
    """Libraries of these tests lie in a folder of their own, and the paths of sources are those of the project."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
    monkeypatch.chdir(ROOT)


def bar(umat, height=8, width=4, path=PATH, **changes):
    """A bar in plane strain whose ends are moved along y; strains of the whole at equal steps."""
    length = height * 1e-3
    times = {f"{k} s": f"{float(strain * length)!r} m" for k, strain in enumerate([0.0, *path])}
    scene = {
        "geometry": {"plate": {"width": f"{width} mm", "height": f"{height} mm", "thickness": "1 mm"}},
        "mesh": {"spacing": "1 mm"},
        "horizon": {"ratio": 1.515},
        "material": {"youngs_modulus": "200 GPa", "poissons_ratio": NU, **({"umat": umat} if umat else {})},
        "mechanics": {"model": "correspondence", "plane": "strain"},
        "loads": [
            {"on": "top", "displacement": {"y": times}},
            {"on": "bottom", "displacement": {"x": "0 m", "y": "0 m"}},
        ],
        "time": {"end": f"{len(path)} s"},
        "stepping": {"mode": "fixed", "load_steps": len(path), "diffusion_substeps": 1},
        "solver": {"tolerance": 1e-10},
        "outputs": {"count": len(path)},
    }  # fmt: skip
    for key, value in changes.items():
        place, *parents, last = scene, *key.split("__")
        for part in parents:
            place = place[part]
        place[last] = value
    return scene


def loaded(scene, folder):
    file = Path(folder, "scene.yaml")
    file.write_text(yaml.safe_dump(scene, sort_keys=False))
    return load_scene(file)


def in_space(umat, width, height, thickness, **changes):
    """The same bar as a block of cubes, its end held in all directions."""
    scene = bar(umat, height, width, mesh__cells="hexahedron", **changes)
    scene["geometry"]["plate"]["thickness"] = f"{thickness} mm"
    scene["loads"][1]["displacement"]["z"] = "0 m"
    del scene["mechanics"]["plane"]
    return scene


def run(scene):
    if not scene.mesh.solid:
        return simulate(build_case(scene, lattice_nodes(scene)))
    with tempfile.TemporaryDirectory() as folder:
        make_mesh(scene.geometry, scene.mesh, Path(folder, "block.msh"))
        return simulate(build_case(scene, discretize(Path(folder, "block.msh"), scene.geometry, scene.mesh)))


def uniaxial_strain(path, left=None):
    """Stresses along and across, and plastic strain, where nothing moves across: the deviator is a bar of 2 G.

    ``left`` is the share of yield stress and hardening that is there at the end of each step.
    """
    shear, bulk = YOUNG / (2 + 2 * NU), YOUNG / (3 - 6 * NU)
    plastic, total, found = 0.0, 0.0, []
    for strain, share in zip(path, np.ones(len(path)) if left is None else left, strict=True):
        trial = 2 * shear * strain - 3 * shear * plastic
        more = max(abs(trial) - share * (YIELD + HARDENING * total), 0.0) / (3 * shear + share * HARDENING)
        plastic, total = plastic + np.sign(trial) * more, total + more
        mises = 2 * shear * strain - 3 * shear * plastic
        found.append((bulk * strain + 2 / 3 * mises, bulk * strain - mises / 3, total))
    return np.array(found).T


@pytest.mark.parametrize("plane", ["strain", "stress"])
def test_an_elastic_user_material_gives_the_result_that_is_built_in(plane, tmp_path):
    changes = {"mechanics__plane": plane, "solver__tolerance": 1e-13, "horizon__ratio": 3.015}
    given, built_in = (run(loaded(bar(umat, path=[1e-3, 2e-3], **changes), tmp_path)) for umat in (ELASTIC, None))
    assert np.abs(built_in["displacement"]).max() > 1e-5
    for name in ("displacement", "reaction_top_y", "reaction_bottom_x", "elastic_energy", "external_work"):
        expected = built_in[name].values
        scale = np.abs(built_in[name.replace("bottom_x", "top_y")]).max()
        # Measured 3e-14: what the solvers leave at a residual of 1e-13.
        assert np.abs(given[name].values - expected).max() <= 1e-12 * scale, name
    assert not given["plastic_dissipation"].any() and "state_plastic_strain" not in given


def test_in_space_too_an_elastic_user_material_gives_the_result_that_is_built_in(tmp_path):
    changes = {"path": [1e-3, 2e-3], "solver__tolerance": 1e-13, "horizon__ratio": 2.015}
    given, built_in = (run(loaded(in_space(umat, 4, 6, 4, **changes), tmp_path)) for umat in (ELASTIC, None))
    for name in ("displacement", "reaction_top_y", "reaction_bottom_z", "elastic_energy", "external_work"):
        expected = built_in[name].values
        scale = np.abs(built_in[name.replace("bottom_z", "top_y")]).max()
        # Measured 7e-14: what the solvers leave at a residual of 1e-13.
        assert np.abs(given[name].values - expected).max() <= 1e-12 * scale, name


def test_a_block_yields_and_unloads_by_its_closed_form(tmp_path):
    scene = in_space(J2, 2, 2, 2)
    scene["loads"][1]["displacement"] = {"y": "0 m"}
    scene["loads"].append({"on": "all", "displacement": {"x": "0 m", "z": "0 m"}})
    result = run(loaded(scene, tmp_path))
    along, across, total = uniaxial_strain(PATH)
    assert result["entry"].values.tolist() == ["11", "22", "33", "12", "13", "23"]
    # Measured 2e-15.
    for entry, expected in (("22", along), ("11", across), ("33", across)):
        np.testing.assert_allclose(result["stress"][1:].sel(entry=entry), np.tile(expected[:, None], 8), rtol=1e-12)
    np.testing.assert_allclose(result["state_plastic_strain"][1:], np.tile(total[:, None], 8), rtol=1e-12)


def test_a_block_in_equilibrium_balances_its_books(tmp_path):
    path = np.linspace(0.0, 4e-3, 11)[1:]
    result = run(loaded(in_space(J2, 4, 6, 4, path=path, horizon__ratio=2.015), tmp_path))
    top, bottom = (result[f"reaction_{end}_y"].values for end in ("top", "bottom"))
    np.testing.assert_allclose(top, -bottom, rtol=0.0, atol=1e-8 * top.max())
    work, lost = result["external_work"].values[-1], result["plastic_dissipation"].values[-1]
    assert lost > 0.5 * work
    # Measured 0.2 %: trapezia.
    assert abs(work - lost - result["elastic_energy"].values[-1]) < 0.01 * work


def test_a_plate_yields_and_unloads_by_its_closed_form(tmp_path):
    # Two by two nodes, all of them held: the strain is the same everywhere, and nothing else decides on the stress.
    scene = bar(J2, height=2, width=2)
    scene["loads"].append({"on": "top", "displacement": {"x": "0 m"}})
    result = run(loaded(scene, tmp_path))
    along, across, total = uniaxial_strain(PATH)
    assert total[-1] > total[3] == total[4] > 0.0
    stress = result["stress"][1:]
    # Measured 2e-15.
    for entry, expected in (("22", along), ("11", across), ("33", across)):
        np.testing.assert_allclose(stress.sel(entry=entry), np.tile(expected[:, None], 4), rtol=1e-12)
    np.testing.assert_allclose(result["state_plastic_strain"][1:], np.tile(total[:, None], 4), rtol=1e-12)
    assert result["state_plastic_strain"].attrs["units"] == "1" and result["stress"].attrs["units"] == "Pa"
    # Plastic strain times the stress that it flows at, which grows in proportion to it.
    lost = total * (YIELD + 0.5 * HARDENING * total) * float(result["volume"].sum())
    np.testing.assert_allclose(result["plastic_dissipation"][1:], lost, rtol=1e-12)


def test_a_bar_in_equilibrium_has_the_history_of_one_point(tmp_path):
    scene = bar(J2, height=24, width=8)
    # What resists zero-energy modes does not yield: at its usual strength the bar carries up to 5 % more.
    scene["mechanics"]["zero_energy_strength"] = 0.1
    result = run(loaded(scene, tmp_path))
    # The strain that the middle of the bar really has; across it is free.
    y = result["node_y"].values
    middle = abs(y - 12e-3) < 2e-3
    upper, lower = (middle & (y > 12e-3), middle & (y < 12e-3))
    u = result["displacement"].values[1:, :, 1]
    strains = np.zeros((len(PATH), 4))
    strains[:, 1] = (u[:, upper].mean(axis=1) - u[:, lower].mean(axis=1)) / (y[upper].mean() - y[lower].mean())
    material = UserMaterial(build(ROOT / J2["source"]), "MATERIAL", tuple(J2["properties"]), (0.0,), "strain")
    points = UserPoints(material, np.zeros((1, 2)), np.ones(1))
    expected, totals = [], []
    for strain in strains:
        expected.append(drive(points, strain, free=(0,))[0, 1, 1])
        totals.append(points.state[0, 0])
    found = result["stress"].sel(entry="22").values[1:, middle].mean(axis=1)
    # Measured 1.8 % and 0.6 %: beside the free edges gradients see other things than in the middle.
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=0.03 * np.abs(expected).max())
    total = result["state_plastic_strain"].values[1:, middle].mean(axis=1)
    np.testing.assert_allclose(total, totals, rtol=0.0, atol=0.03 * max(totals))
    # Forces through both ends are the same, and those through the middle.
    top, bottom = (result[f"reaction_{end}_y"].values[1:] for end in ("top", "bottom"))
    np.testing.assert_allclose(top, -bottom, rtol=0.0, atol=1e-8 * np.abs(top).max())
    np.testing.assert_allclose(top / 8e-6, found, rtol=0.0, atol=0.03 * np.abs(found).max())


def test_a_quarter_has_the_history_of_the_whole(tmp_path):
    found = []
    for whole in (True, False):
        scene = bar(J2, height=6, width=4, horizon__ratio=3.015)
        times = scene["loads"][0]["displacement"]["y"]
        scene["loads"] = [{"on": "top", "displacement": {"x": "0 m", "y": times}}]
        if whole:
            scene["geometry"]["plate"] |= {"height": "12 mm", "width": "8 mm"}
            other = {t: f"{-float(value.split()[0])!r} m" for t, value in times.items()}
            scene["loads"].append({"on": "bottom", "displacement": {"x": "0 m", "y": other}})
        else:
            scene["geometry"]["symmetry"] = ["left", "bottom"]
        scene = loaded(scene, tmp_path)
        solve_case(scene, lattice_nodes(scene), tmp_path / "part.nc")
        with open_result(tmp_path / "part.nc") as part:
            result = whole_result(part.load())
        x, y = (result[name].values - result[name].values.min() for name in ("node_x", "node_y"))
        found.append(result.isel(node=np.lexsort((x.round(9), y.round(9)))))
    whole, part = found
    assert np.abs(whole["stress"].sel(entry="12")).max() > 1e8 and whole["state_plastic_strain"].max() > 3e-3
    for name in ("displacement", "stress", "state_plastic_strain", "external_work", "elastic_energy",
                 "plastic_dissipation", "reaction_top_y"):  # fmt: skip
        scale = np.abs(whole[name].values).max()
        # Measured 5e-13: round-off, summed up over the increments.
        assert np.abs(part[name].values - whole[name].values).max() <= 1e-10 * scale, name


def test_what_is_put_in_is_stored_or_lost_the_better_the_shorter_the_steps(tmp_path):
    errors = []
    for parts in (1, 4):
        ends = [0.0, *PATH[:5]]
        path = np.concatenate([np.linspace(a, b, parts + 1)[1:] for a, b in pairwise(ends)])
        result = run(loaded(bar(J2, path=path), tmp_path))
        left = (result["external_work"] - result["elastic_energy"] - result["plastic_dissipation"]).values[-1]
        errors.append(abs(left) / float(result["external_work"].max()))
    # Measured 1.1 % and 0.08 %: trapezia, second order.
    assert errors[0] < 0.03 and errors[1] < 0.125 * errors[0]
    assert result.sizes["step"] == len(path) + 1


def test_the_plan_tells_of_the_history_and_of_corners_that_it_misses(tmp_path):
    scene = loaded(bar(J2), tmp_path)
    plan = make_plan(build_case(scene, lattice_nodes(scene)))
    # 32 nodes: twice (4 + 4 + 1 + 3 + 1) numbers and a tangent of 16.
    assert "user material: MATERIAL of j2.c, 4 properties, 1 state variable (plastic_strain [1])" in plan
    assert f"history {32 * 8 * (2 * 13 + 16) / 1e6:.3g} MB" in plan
    assert "warning" not in plan and "increments by Newton's method to 1e-10" in plan
    missed = loaded(bar(J2, stepping__load_steps=12), tmp_path)
    assert "loads turn between two load steps, at 1, 3, 5, 7 s" in make_plan(build_case(missed, lattice_nodes(missed)))


def test_state_variables_have_names_units_and_values_at_the_start(tmp_path):
    code = "for (int k = 0; k < 4; k++) { stress[k] += 1e11 * dstran[k]; ddsdde[5 * k] = 1e11; } statev[1] += *dtime;"
    states = [{"name": "hardness", "unit": "MPa", "initial": "3 MPa"}, "age"]
    own = write_source(tmp_path / "two.c", code)
    result = run(loaded(bar({"source": own, "states": states}, path=[1e-3, 1e-3]), tmp_path))
    assert result["state_hardness"].attrs["units"] == "MPa" and (result["state_hardness"] == 3e6).all()
    np.testing.assert_array_equal(result["state_age"].values[:, 0], [0.0, 1.0, 2.0])
    nameless = run(loaded(bar({"source": own, "states": 2}, path=[1e-3, 1e-3]), tmp_path))
    np.testing.assert_array_equal(nameless["state_2"], result["state_age"])


#: A stiffness that falls with the coverage at the end of an increment; it notes what it was told of coverages.
SOFTENED = """
    const double left = props[0] * (1.0 - 0.8 * (predef[0] + dpred[0]));
    for (int k = 0; k < 4; k++) { stress[k] = left * (stran[k] + dstran[k]); ddsdde[5 * k] = left; }
    statev[0] = predef[0]; statev[1] += dpred[0]; statev[2] += 1.0;
    if (dpred[0] > props[1]) *pnewdt = 0.5;
"""
HYDROGEN = {"initial": 0.1, "boundary": [{"on": "all", "coverage": {"0 s": 0.1, "4 s": 0.9, "8 s": 0.3}}]}


@pytest.mark.parametrize("longest", [1.0, 0.15])
def test_a_routine_is_told_the_coverage_at_both_ends_of_an_increment(longest, tmp_path):
    umat = {"source": write_source(tmp_path / "softened.c", SOFTENED), "properties": [1e11, longest], "states": 3}
    scene = bar(umat, hydrogen=HYDROGEN, material__diffusivity="1e-9 m^2/s", outputs__count=8)
    scene = loaded(scene, tmp_path)
    case = build_case(scene, lattice_nodes(scene))
    assert "it is told the coverage as PREDEF(1)" in make_plan(case)
    result = simulate(case)
    coverage = np.array([0.1, 0.3, 0.5, 0.7, 0.9, 0.75, 0.6, 0.45, 0.3])
    np.testing.assert_allclose(result["coverage"].values, np.tile(coverage[:, None], 32), rtol=1e-6)
    # Increments of more than 0.15 are taken in two halves, with the coverage on a straight line.
    parts = np.where(np.diff(coverage) > longest, 2, 1)
    np.testing.assert_array_equal(result["state_3"].values[1:, 0], np.cumsum(parts))
    before = coverage[1:] - np.diff(coverage) / parts
    np.testing.assert_allclose(result["state_1"].values[1:], np.tile(before[:, None], 32), rtol=1e-12)
    np.testing.assert_allclose(result["state_2"].values[1:], np.tile(coverage[1:, None] - 0.1, 32), rtol=1e-12)
    # The same bar, dry and of the stiffness that is left, carries the same at the end.
    left = float(1e11 * (1.0 - 0.8 * coverage[-1]))
    dry = {
        **umat,
        "source": write_source(tmp_path / "dry.c", SOFTENED.replace("0.8", "0.0")),
        "properties": [left, 1.0],
    }
    dry = run(loaded(bar(dry), tmp_path))
    # Measured 7e-15: both are linear, and one Newton step leaves far less than the residual of 1e-10 that is asked for.
    np.testing.assert_allclose(result["stress"][-1], dry["stress"][-1], rtol=0.0, atol=1e-9 * left * 4e-3)
    np.testing.assert_allclose(result["reaction_top_y"][-1], dry["reaction_top_y"][-1], rtol=1e-9)


def test_hydrogen_softens_a_plate_by_the_closed_form(tmp_path):
    umat = {**J2, "source": "config/umat/j2_hydrogen.c", "properties": [*J2["properties"], 0.4]}
    # Loaded dry, held while hydrogen comes in, and let go: it yields under a constant strain.
    path, coverage = [4e-3, 4e-3, 4e-3, 3e-3], [0.0, 0.5, 1.0, 1.0]
    history = {f"{k} s": value for k, value in enumerate([0.0, *coverage])}
    hydrogen = {"boundary": [{"on": "all", "coverage": history}], "saturation": "off"}
    scene = bar(umat, 2, 2, path=path, hydrogen=hydrogen, material__diffusivity="1e-12 m^2/s")
    scene["loads"].append({"on": "top", "displacement": {"x": "0 m"}})
    result = run(loaded(scene, tmp_path))
    along, _, total = uniaxial_strain(path, 1.0 - 0.4 * np.array(coverage))
    assert along[2] < along[1] < along[0] and total[0] < total[1] < total[2] == total[3]
    # Measured 1e-15.
    np.testing.assert_allclose(result["stress"][1:].sel(entry="22"), np.tile(along[:, None], 4), rtol=1e-12)
    np.testing.assert_allclose(result["state_plastic_strain"][1:], np.tile(total[:, None], 4), rtol=1e-12)


def write_source(path, code, symbol="umat_"):
    names = (
        "double *stress, double *statev, double *ddsdde, double *sse, double *spd, double *scd, double *rpl, "
        "double *ddsddt, double *drplde, double *drpldt, double *stran, double *dstran, double *time, double *dtime, "
        "double *temp, double *dtemp, double *predef, double *dpred, char *cmname, int *ndi, int *nshr, int *ntens, "
        "int *nstatv, double *props, int *nprops, double *coords, double *drot, double *pnewdt"
    )
    path.write_text(f"void {symbol}({names}) {{ {code} }}\n")
    return str(path)


GOOD = "for (int k = 0; k < 4; k++) { stress[k] += 1e11 * dstran[k]; ddsdde[5 * k] = 1e11; }"


@pytest.mark.parametrize(
    ("change", "key", "said"),
    [
        ({"source": "j3.c"}, "source", "is not a file (got 'j3.c'); give its path from where you start"),
        ({"source": None, "library": "none.so"}, "library", "is not a file (got 'none.so')"),
        ({"source": "config/scene.schema.json"}, "source", "cannot be compiled (got"),
        ({"library": "some.so"}, "library", "is not a file"),
        ({"source": None}, "", "needs either `source` or `library`"),
        ({"content": "0123456789abcdef"}, "content", "is not that of config/umat/j2.c"),
        ({"properties": "200 GPa"}, "properties", "must be a list"),
        ({"properties": ["200 GPA"]}, "properties.0", "not a known unit"),
        ({"properties": [True]}, "properties.0", "is not a number"),
        ({"states": -1}, "states", "must be between 0 and 1000"),
        ({"states": ["one", "one"]}, "states.1.name", "is listed twice"),
        ({"states": ["with blank"]}, "states.0.name", "is not a usable name"),
        ({"states": ["variables"]}, "states.0.name", "is not a usable name"),
        ({"name": "1"}, "name", "is not the name of a material"),
        ({"symbol": "a b"}, "symbol", "is not the name of a routine"),
        ({"propertys": []}, "propertys", "did you mean `properties`?"),
    ],
)
def test_a_bad_block_is_refused_when_the_scene_is_read(change, key, said, tmp_path):
    umat = {name: value for name, value in {**J2, **change}.items() if value is not None}
    with pytest.raises(SceneError) as error:
        loaded(bar(umat), tmp_path)
    assert error.value.key == f"material.umat.{key}".strip(".") and said in str(error.value)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"mechanics__model": "condensed rotation"}, "mechanics.model"),
        ({"material__orthotropic": {"youngs_modulus_2": "9 GPa", "shear_modulus_12": "4 GPa"},
          "mechanics": {"model": "correspondence"}}, "material.orthotropic"),
        ({"solver__precision": "single"}, "solver.precision"),
        ({"accuracy": "1 %"}, "accuracy"),
        ({"stepping": {"mode": "events"}}, "stepping.mode"),
        ({"time__end": "0 s"}, "time.end"),
        ({"damage": {}, "material__critical_energy_release_rate": "1 kJ/m^2"}, "damage"),
        ({"loads": [{"on": "top", "displacement": {"y": "0.01 mm"}}]}, "loads.0.displacement.y"),
    ],
)  # fmt: skip
def test_what_user_materials_do_not_go_with_is_refused(change, key, tmp_path):
    with pytest.raises(SceneError) as error:
        loaded(bar(J2, **change), tmp_path)
    assert error.value.key == key and error.value.hint


@pytest.mark.parametrize(
    ("change", "key", "said"),
    [
        ({"symbol": "umat"}, "symbol", "has no routine 'umat' (got 'umat'); it has 'umat_'"),
        ({"properties": [YOUNG]}, "properties", "needs 4 properties"),
        ({"properties": [YOUNG, NU, YIELD, HARDENING, 1.0]}, "properties", "needs 4 properties"),
        ({"states": 3}, "properties", "1 state variable and NDI = 3, not 4, 3 and 3"),
        ({"properties": [-YOUNG, NU, YIELD, HARDENING]}, "properties", "DDSDDE that is not positive"),
    ],
)
def test_a_routine_is_tried_before_anything_runs(change, key, said, tmp_path):
    scene = loaded(bar({**J2, **change}), tmp_path)
    with pytest.raises(SceneError) as error:
        user_material(scene, "scene.yaml")
    assert error.value.key == f"material.umat.{key}" and error.value.file == "scene.yaml"
    assert said in str(error.value)
    with pytest.raises(SceneError):
        build_case(scene, lattice_nodes(scene))


def test_no_compiler_a_bad_source_and_a_bad_library_are_said(tmp_path, monkeypatch, capsys):
    own = Path(write_source(tmp_path / "own.c", GOOD))
    scene = bar({"source": str(own)})
    file = tmp_path / "scene.yaml"

    def refused(scene):
        file.write_text(yaml.safe_dump(scene))
        assert cli.main(["run", str(file), "--out", str(tmp_path / "run.nc")]) == 1
        # Before anything: there is not even a mesh.
        assert not list(tmp_path.glob("run.*"))
        return capsys.readouterr().err

    with monkeypatch.context() as patch:
        patch.setenv("CC", "no-such-compiler")
        said = refused(scene)
    assert "scene.yaml: key 'material.umat.source': no compiler for it (no-such-compiler)" in said
    assert "install one, name it in CC, or give a compiled library" in said
    own.write_text("void umat_( { }\n")
    assert "does not compile it" in refused(scene) and "own.c" in said
    own.with_suffix(".so").write_text("no library\n")
    said = refused(bar({"library": str(own.with_suffix(".so"))}))
    assert "key 'material.umat.library': cannot be loaded" in said
    if sys.platform.startswith("linux"):
        # The loader of Linux would end the process by SIGBUS.
        other = tmp_path / "cut.so"
        whole = build(ROOT / "config/umat/j2.c", tmp_path).read_bytes()
        other.write_bytes(whole[: len(whole) // 2])
        said = refused(bar({"library": str(other)}))
        assert "key 'material.umat.library': is damaged" in said and "delete it" in said
    write_source(own, GOOD, "material")
    said = refused(scene)
    assert "key 'material.umat.symbol': has no routine 'umat_' (got 'umat_')" in said


def test_a_source_that_changes_after_the_scene_was_read_is_refused(tmp_path):
    own = Path(write_source(tmp_path / "own.c", GOOD))
    scene = loaded(bar({"source": str(own)}), tmp_path)
    user_material(scene)
    own.write_text(own.read_text() + "\n")
    with pytest.raises(SceneError, match="has changed since the scene was read"):
        user_material(scene)
    assert cli.main(["umat-build", str(own), "--content", scene.material.umat.content, "--out", "none.so"]) == 1


def test_a_run_that_cannot_go_on_leaves_its_history_so_far(tmp_path):
    code = GOOD + " if (stran[1] + dstran[1] > 3e-3) stress[1] = 0.0 / 0.0;"
    scene = loaded(bar({"source": write_source(tmp_path / "falls.c", code)}, path=[2e-3, 4e-3, 6e-3]), tmp_path)
    with pytest.raises(SimulationError, match="gives a stress or state variable that is not finite") as error:
        solve_case(scene, lattice_nodes(scene), tmp_path / "run.nc")
    assert "at t = 2 s, step 2" in str(error.value) and "likely reason" not in str(error.value)
    arrays, attributes = read_netcdf(tmp_path / "run.nc.incomplete")
    assert attributes["status"].startswith("incomplete: at t = 2 s") and not (tmp_path / "run.nc").exists()
    np.testing.assert_allclose(arrays["stress"][1].max(), 2e8, rtol=0.5)


@pytest.mark.skipif(shutil.which("gfortran") is None, reason="no gfortran here")
def test_fortran_gives_what_c_gives(tmp_path):
    one, other = (run(loaded(bar({**J2, "source": f"config/umat/j2.{end}"}), tmp_path)) for end in ("c", "f"))
    for name in ("displacement", "stress", "state_plastic_strain", "plastic_dissipation", "reaction_top_y"):
        scale = np.abs(one[name].values).max()
        # Measured 2e-13: the same operations in another order, and what the solver leaves.
        assert np.abs(one[name].values - other[name].values).max() <= 1e-9 * scale, name


def test_libraries_that_no_study_refers_to_can_be_removed(tmp_path):
    loaded(bar(J2), tmp_path)
    study = tmp_path / "study.yaml"
    study.write_text(json.dumps({"study": {"scene": str(tmp_path / "scene.yaml")}}))
    (case,) = load_study(study).cases
    libraries = tmp_path / "results/store/umat"
    libraries.mkdir(parents=True)
    for name in (case.user_material[0], "old_c-0123456789abcdef"):
        (libraries / f"{name}.so").write_text("library")
    assert unused(tmp_path / "results", [study]) == [libraries / "old_c-0123456789abcdef.so"]


def test_endings_are_those_that_have_compilers():
    assert set(SOURCES) == set(COMPILERS)


def test_a_solution_is_known_by_the_content_of_its_material(tmp_path):
    own = Path(write_source(tmp_path / "own.c", f'#include "law.h"\n{GOOD}'.partition("\n")[2]))
    own.write_text('#include "law.h"\n' + own.read_text())
    (tmp_path / "law.h").write_text("/* one */\n")

    def identity(path=own):
        (tmp_path / "scene.yaml").write_text(yaml.safe_dump(bar({"source": str(path)})))
        (tmp_path / "study.yaml").write_text(json.dumps({"study": {"scene": str(tmp_path / "scene.yaml")}}))
        (case,) = load_study(tmp_path / "study.yaml").cases
        assert case.user_material[1] == str(path) and str(tmp_path) not in case.solve_spec
        assert case.user_material[0].endswith(content_of(path)) and case.user_material[0].startswith("own_c-")
        return case.solve_id

    first = identity()
    (tmp_path / "elsewhere").mkdir()
    for name in ("own.c", "law.h"):
        shutil.copy(tmp_path / name, tmp_path / "elsewhere" / name)
    assert identity(tmp_path / "elsewhere/own.c") == first
    (tmp_path / "law.h").write_text("/* two */\n")
    second = identity()
    own.write_text(own.read_text() + "/* another */\n")
    assert len({first, second, identity()}) == 3


def test_the_steps_of_the_workflow_give_what_a_run_gives(tmp_path, capsys):
    scene = loaded(bar(J2, path=PATH[:4]), tmp_path)
    (tmp_path / "study.yaml").write_text(json.dumps({"study": {"scene": str(tmp_path / "scene.yaml")}}))
    (case,) = load_study(tmp_path / "study.yaml").cases
    nodes, out, library = tmp_path / "nodes.nc", tmp_path / f"{case.solve_id}.nc", tmp_path / "made.so"
    write_discretization(lattice_nodes(scene), nodes)
    name, source = case.user_material
    assert cli.main(["umat-build", source, "--content", name.rpartition("-")[2], "--out", str(library)]) == 0
    words = ["solve", "--spec", case.solve_spec, "--nodes", str(nodes), "--out", str(out)]
    assert cli.main(words) == 1
    assert "`--umat`" in capsys.readouterr().err
    assert cli.main([*words, "--umat", str(library)]) == 0
    arrays, attributes = read_netcdf(out)
    expected = run(scene)
    for name in ("displacement", "stress", "state_plastic_strain", "reaction_top_y", "external_work"):
        assert arrays[name].tobytes() == expected[name].values.tobytes(), name
    # What the result holds belongs to the name that it has, and can be explained.
    again = Scene.from_resolved(json.loads(attributes["scene"]))
    assert canonical(again.resolved()["material"]["umat"]["properties"]) == canonical(J2["properties"])
    assert cli.main(["diagnose", str(out)]) == 0
    assert "J of plastic" in capsys.readouterr().out
    with open_result(out) as result:
        assert result["plastic_dissipation"].attrs["units"] == "J"


def test_the_example_is_whole(capsys):
    assert cli.main(["validate", str(EXAMPLE)]) == 0
    assert "Plate with a hole" in capsys.readouterr().out
