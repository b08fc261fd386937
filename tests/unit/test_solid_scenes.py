"""Scenes in space: read, refused, meshed and run."""

from types import SimpleNamespace

import meshio
import numpy as np
import pytest

from pdhe.case import build_case
from pdhe.diagnosis import diagnose
from pdhe.discretization import discretize, read_discretization, write_discretization
from pdhe.errors import PdheError, SceneError
from pdhe.mesh import make_mesh
from pdhe.plan import make_plan
from pdhe.results import open_result
from pdhe.scene import Crack, Scene, load_scene
from pdhe.scene_reading import override
from pdhe.simulation import solve_case
from pdhe.surfaces import surface_of
from pdhe.verification.slabs import nodes_of
from pdhe.yamlfile import parse_yaml

pytestmark = pytest.mark.usefixtures("one_thread")

BLOCK = """
geometry:
  plate: {width: 10 mm, height: 8 mm, thickness: 6 mm}
  cracks: [{name: notch, from: [0 mm, 4 mm], to: [4 mm, 4 mm]}]
mesh: {spacing: 1 mm, cells: hexahedron}
horizon: {ratio: 2.015}
material:
  youngs_modulus: 207 GPa
  poissons_ratio: 0.25
  fracture_toughness: 58.4 MPa m^0.5
  diffusivity: 0.84e-9 m^2/s
loads:
  - {on: top, displacement: {y: {0 h: 0 mm, 1 h: 0.015 mm}}}
  - {on: bottom, displacement: {y: {0 h: 0 mm, 1 h: -0.015 mm}}}
damage: {no_fail: [top, bottom]}
hydrogen:
  boundary: [{on: notch, coverage: 1}]
time: {end: 1 h}
stepping: {mode: events, grouping: 0.3}
solver: {tolerance: 1e-4}
outputs: {count: 2}
"""
DISC = {"name": "penny", "disc": {"centre": ["5 mm", "4 mm", "3 mm"], "normal": [0, 1, 0], "radius": "2 mm"}}
TILTED = {"name": "flaw", "polygon": [["2 mm", "2 mm", "1 mm"], ["6 mm", "4 mm", "1 mm"], ["6 mm", "4 mm", "5 mm"]]}


def scene(tmp_path, **changes) -> Scene:
    """The block with entries changed by their dotted keys, written with two underscores."""
    raw = parse_yaml(BLOCK, "block")
    for key, value in changes.items():
        override(raw, key.replace("__", "."), value, "block")
    path = tmp_path / "scene.yaml"
    path.write_text(__import__("json").dumps(raw), encoding="utf-8")
    return load_scene(path)


BAD = {
    "moved out of the plane": (
        {"mesh__cells": "quadrilateral", "loads__0__displacement": {"z": "1 mm"}},
        "loads.0.displacement.z", "out of its plane", "hexahedron",
    ),
    "disc in the plane": (
        {"mesh__cells": "triangle", "geometry__cracks": [DISC]}, "geometry.cracks.0.disc", "in space", "hexahedron",
    ),
    "disc in a graded plane": (
        {
            "mesh": {"spacing": "1 mm", "cells": "triangle", "refine": [
                {"around": "penny", "spacing": "0.5 mm", "within": "1 mm"}
            ]},
            "geometry__cracks": [DISC],
        }, "geometry.cracks.0.disc", "in space", "hexahedron",
    ),
    "polygon in a plane with a fidelity": (
        {"mesh": {"cells": "triangle"}, "fidelity": "draft", "geometry__cracks": [TILTED]},
        "geometry.cracks.0.polygon", "in space", "hexahedron",
    ),
    "two shapes": (
        {"geometry__cracks": [DISC | {"polygon": TILTED["polygon"]}]}, "geometry.cracks.0.polygon", "two ways", "disc",
    ),
    "no shape": ({"geometry__cracks": [{"name": "a"}]}, "geometry.cracks.0.from", "is missing", "give `from`"),
    "disc without direction": (
        {"geometry__cracks": [{"name": "a", "disc": DISC["disc"] | {"normal": [0, 0, 0]}}]},
        "geometry.cracks.0.disc.normal", "has no direction", "[0, 1, 0]",
    ),
    "disc outside": (
        {"geometry__cracks": [{"name": "a", "disc": DISC["disc"] | {"centre": ["5 mm", "9 mm", "3 mm"]}}]},
        "geometry.cracks.0.disc.centre", "outside the body", "10 x 8 x 6 mm",
    ),
    "disc below the spacing": (
        {"geometry__cracks": [{"name": "a", "disc": DISC["disc"] | {"radius": "0.5 mm"}}]},
        "geometry.cracks.0.disc.radius", "smaller than the spacing", "refine",
    ),
    "warped polygon": (
        {"geometry__cracks": [{"name": "a", "polygon": [*TILTED["polygon"], ["2 mm", "3 mm", "5 mm"]]}]},
        "geometry.cracks.0.polygon", "is not plane", "triangles",
    ),
    "polygon of two corners": (
        {"geometry__cracks": [{"name": "a", "polygon": TILTED["polygon"][:2]}]},
        "geometry.cracks.0.polygon", "has 2 corners", "three",
    ),
    "polygon outside": (
        {"geometry__cracks": [{"name": "a", "polygon": [*TILTED["polygon"][:2], ["6 mm", "4 mm", "7 mm"]]}]},
        "geometry.cracks.0.polygon.2", "outside the body", "10 x 8 x 6 mm",
    ),
    "polygon without area": (
        {"geometry__cracks": [{"name": "a", "polygon": [["1 mm", "1 mm", "1 mm"]] * 3}]},
        "geometry.cracks.0.polygon", "has an area of 0", "in order",
    ),
    "hole in hexahedra": (
        {"geometry__holes": [{"name": "bore", "centre": ["7 mm", "4 mm"], "radius": "2 mm"}]},
        "mesh.cells", "cannot follow holes", "tetrahedron",
    ),
    "cells no cubes": ({"mesh__spacing": "1.4 mm"}, "mesh.spacing", "not cubes", "for example"),
    "spacing above the thickness": ({"mesh__spacing": "7 mm"}, "mesh.spacing", "larger than the body", "6 mm"),
    "too many nodes": ({"mesh__spacing": "0.01 mm"}, "mesh.spacing", "4.8e+08 nodes", "use at least"),
    "horizon above the thickness": ({"horizon__ratio": 6.5}, "horizon.ratio", "not smaller", "thin plate"),
    "a face as a name": (
        {"geometry__cracks": [DISC | {"name": "front"}]}, "geometry.cracks.0.name", "reserved", "`front`",
    ),
    "energy correction": ({"mechanics__weights": "energy"}, "mechanics.weights", "made for plates", "moment matched"),
    "plane strain": ({"mechanics__plane": "strain"}, "mechanics.plane", "state of plates", "leave it out"),
    "orthotropic": (
        {
            "mechanics__model": "correspondence", "material__fracture_toughness": None,
            "material__critical_energy_release_rate": "2 kJ/m^2",
            "material__orthotropic": {"youngs_modulus_2": "100 GPa", "shear_modulus_12": "50 GPa"},
        },
        "material.orthotropic.youngs_modulus_3", "a body in space needs it", "give it",
    ),
    "mirror lines": ({"geometry__symmetry": ["right"]}, "geometry.symmetry", "plates alone", "whole body"),
    "fidelity": ({"fidelity": "fine"}, "fidelity", "plane meshes", "mesh.spacing"),
    "graded": (
        {"mesh__refine": [{"around": "notch", "spacing": "0.5 mm", "within": "1 mm"}]}, "mesh.refine", "triangles", "",
    ),
    "contradicting faces": (
        {"loads__0": {"on": "front", "displacement": {"y": "1 um"}}, "loads__1__displacement": {"y": "2 um"}},
        "loads.1.displacement.y", "`front` and `bottom` share nodes", "same value",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD, ids=list(BAD))
def test_what_cannot_be_used_is_refused(tmp_path, case):
    changes, key, text, hint = BAD[case]
    with pytest.raises(SceneError) as caught:
        scene(tmp_path, **changes)
    message = str(caught.value)
    assert f"'{key}'" in message and text in message and hint in message, message


def test_a_resolved_scene_is_read_back(tmp_path):
    one = scene(tmp_path, geometry__cracks=[DISC, TILTED], hydrogen__boundary=[{"on": "penny", "coverage": 1}])
    assert Scene.from_resolved(one.resolved()) == one
    assert one.node_sets[:7] == ("left", "right", "bottom", "top", "all", "front", "back")
    assert [crack.length for crack in one.geometry.cracks] == pytest.approx([4e-3, 6e-3])


def test_front_and_back_are_names_like_others_in_the_plane(tmp_path):
    crack = {"name": "front", "from": ["0 mm", "4 mm"], "to": ["4 mm", "4 mm"]}
    changes = {"mesh__cells": "quadrilateral", "geometry__cracks": [crack], "hydrogen": None, "damage": None}
    one = scene(tmp_path, **changes, loads__0={"on": "front", "displacement": {"x": "1 um"}})
    assert one.node_sets == ("left", "right", "bottom", "top", "all", "front")
    case = build_case(one, nodes_of(one))
    assert case.conditions.values(0.0)[case.discretization.node_sets["front"], 0] == pytest.approx(1e-6)


def nodes(tmp_path, cells="tetrahedron", holes=(), cracks=(), size=(10e-3, 8e-3, 6e-3)):
    """Nodes of a block with a spacing of 1 mm."""
    geometry = SimpleNamespace(
        width=size[0], height=size[1], thickness=size[2], cracks=cracks, symmetry=(),
        holes=tuple(SimpleNamespace(name=n, centre=c, radius=r) for n, c, r in holes),
    )  # fmt: skip
    spec = SimpleNamespace(spacing=1e-3, cells=cells, refine=None)
    make_mesh(geometry, spec, tmp_path / "block.msh")
    return discretize(tmp_path / "block.msh", geometry, spec)


def crack(name, **shape) -> Crack:
    return Crack.model_validate({"name": name, **shape}, context={"si": True})


def test_hexahedra_are_cubes_layer_by_layer(tmp_path):
    d = nodes(tmp_path, "hexahedron", cracks=(crack("notch", **{"from": [0.0, 4e-3], "to": [5e-3, 4e-3]}),))
    assert d.regular and d.dimension == 3 and d.cells.shape == (480, 8)
    assert np.ptp(d.volume) == 0.0 and d.volume.sum() == pytest.approx(480e-9, rel=1e-12)
    z, y, x = np.meshgrid(*((np.arange(k) + 0.5) * 1e-3 for k in (6, 8, 10)), indexing="ij")
    assert d.coordinates == pytest.approx(np.column_stack([x.ravel(), y.ravel(), z.ravel()]), rel=1e-12)
    assert {name: nodes.size for name, nodes in d.node_sets.items()} == {
        "bottom": 60, "right": 48, "top": 60, "left": 48, "front": 80, "back": 80, "notch": 60, "all": 480,
    }  # fmt: skip
    assert d.coordinates[d.node_sets["back"], 2].min() == pytest.approx(5.5e-3)
    assert np.abs(d.coordinates[d.node_sets["notch"], 1] - 4e-3).max() == pytest.approx(0.5e-3)
    again = read_back(d, tmp_path)
    assert np.array_equal(again.cells, d.cells) and again.dimension == 3


def read_back(d, tmp_path):
    write_discretization(d, tmp_path / "nodes.nc")
    return read_discretization(tmp_path / "nodes.nc")


def test_tetrahedra_fill_the_block_and_follow_its_cracks(tmp_path):
    cracks = (
        crack("notch", **{"from": [0.0, 4e-3], "to": [4e-3, 4e-3]}),
        crack("penny", disc={"centre": [6e-3, 4e-3, 3e-3], "normal": [0.2, 1.0, 0.0], "radius": 1.6e-3}),
        crack("flaw", polygon=[[7e-3, 1e-3, 1e-3], [9e-3, 3e-3, 1e-3], [9e-3, 3e-3, 5e-3]]),
    )
    d = nodes(tmp_path, cracks=cracks)
    assert d.volume.sum() == pytest.approx(480e-9, rel=1e-9)
    assert d.volume.mean() == pytest.approx(1e-9, rel=0.1)  # measured 0.92e-9: cracks take smaller cells
    corners = d.vertices[d.cells]
    assert np.abs(corners.mean(axis=1) - d.coordinates).max() < 1e-12
    for item in cracks:
        surface, cells = surface_of(item, 6e-3), d.node_sets[item.name]
        # Every cell of the set has three vertices on the surface, and the cells lie on both of its sides.
        on = surface.distance(corners[cells].reshape(-1, 3)).reshape(-1, 4) < 1e-9
        assert (on.sum(axis=1) == 3).all() and cells.size > 5
        side = surface.height(d.coordinates[cells]) > 0.0
        assert abs(side.mean() - 0.5) < 1e-9
        # The facets on one side cover the crack: measured exact for polygons, 13 % less for the chords of a small disc.
        facets = [corners[c][row] for c, row in zip(cells[side], on[side], strict=True)]
        area = sum(0.5 * np.linalg.norm(np.cross(b - a, c - a)) for a, b, c in facets)
        assert area == pytest.approx(surface.area, rel=0.15 if item.disc else 1e-9)


def test_tetrahedra_follow_holes(tmp_path):
    d = nodes(tmp_path, holes=[("bore", (6e-3, 4e-3), 2e-3)])
    whole = 480e-9 - np.pi * 4e-6 * 6e-3
    assert d.volume.sum() == pytest.approx(whole, rel=0.05)  # chords: measured 3 % more
    away = np.hypot(*(d.coordinates[d.node_sets["bore"], :2] - [6e-3, 4e-3]).T)
    assert away.min() > 2e-3 and away.max() < 3.2e-3
    assert set(meshio.gmsh.read(tmp_path / "block.msh").cell_sets) >= {"plate", "bore", "front", "back"}


def test_a_crack_outside_is_told(tmp_path):
    with pytest.raises(PdheError, match="no part of 'crack:penny'"):
        nodes(
            tmp_path, cracks=(crack("penny", disc={"centre": [5e-3, 9e-3, 3e-3], "normal": [0, 1, 0], "radius": 5e-4}),)
        )


def test_hydrogen_enters_a_block_as_the_series_says(tmp_path):
    """Faces without a prescribed coverage are sealed, so that the profile is that of one dimension."""
    changes = {"loads": None, "damage": None, "geometry__cracks": None, "time__end": "5e3 s"}
    for cells, tolerance in (("hexahedron", 1e-2), ("tetrahedron", 3e-2)):  # measured 7.0e-3 and 1.35e-2
        one = scene(tmp_path, **changes, mesh__cells=cells, hydrogen={"boundary": [{"on": "front", "coverage": 1}]})
        d = nodes_of(one)
        solve_case(one, d, tmp_path / "slab.nc")
        with open_result(tmp_path / "slab.nc") as result:
            psi, content = result["coverage"].values[-1], result["hydrogen_content"].values
            assert content[-1] == pytest.approx(result["hydrogen_influx"].values[-1], rel=1e-12)
            z = result["node_z"].values
        decay = [(k + 0.5) * np.pi for k in range(60)]
        tau = 0.84e-9 * 5e3 / 6e-3**2
        exact = 1.0 - sum(2.0 / k * np.sin(k * z / 6e-3) * np.exp(-k * k * tau) for k in decay)
        assert exact.min() < 0.3
        assert np.sqrt(np.average((psi - exact) ** 2, weights=d.volume)) < tolerance


@pytest.mark.parametrize("model", ["condensed rotation", "correspondence"])
def test_a_crack_grows_through_the_thickness(tmp_path, model):
    one = scene(tmp_path, mechanics__model=model)
    d = nodes_of(one)
    case = build_case(one, d)
    assert "6 mm" not in make_plan(case) and "bonds cut by pre-cracks" in make_plan(case)
    assert f"{model}, in space, weights" in make_plan(case)
    solve_case(one, d, tmp_path / "block.nc")
    with open_result(tmp_path / "block.nc") as result:
        assert result["broken_bonds"].values[-1] > 100
        tip = [result[f"crack_tip_{axis}"].values[-1] for axis in "xyz"]
        assert tip[0] > 5e-3 and tip[1] == pytest.approx(4e-3, abs=1.1e-3)
        # The block and its loads are symmetric about z = 3 mm; so is the opening. Measured 5e-5 of the largest at an
        # equilibrium to 1e-4. Along x and z the block floats as it likes.
        opening = result["displacement"].values[-1][:, 1].reshape(6, 8, 10)
        assert np.abs(opening - opening[::-1]).max() < 1e-3 * np.abs(opening).max()
        broken = 0.5 * (d.coordinates[result["broken_i"].values] + d.coordinates[result["broken_j"].values])
        assert np.abs(broken[:, 1] - 4e-3).max() < 1.6e-3
        assert np.ptp(broken[:, 2]) > 4e-3
    told = diagnose(tmp_path / "block.nc")
    assert "cannot be built again" not in told and "the crack grew by" in told


def test_nodes_with_all_bonds_in_a_plane_are_refused_by_correspondence_models(tmp_path):
    """Two cracks that leave one layer of nodes between them."""
    layers = [
        {
            "name": f"slit_{z}",
            "polygon": [[f"{x} mm", f"{y} mm", f"{z} mm"] for x, y in ((0, 0), (10, 0), (10, 8), (0, 8))],
        }
        for z in (2, 3)
    ]
    changes = {"geometry__cracks": layers, "hydrogen": None, "mechanics__model": "correspondence"}
    one = scene(tmp_path, **changes, damage=None)
    with pytest.raises(SceneError, match="all three directions, but those of 80 nodes lie in a plane") as caught:
        build_case(one, nodes_of(one))
    assert "finer mesh" in str(caught.value)
