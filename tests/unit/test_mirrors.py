"""Halves and quarters of symmetric bodies: what is refused, what is told, and how results show the whole body."""

import json

import numpy as np
import pytest
import scipy.sparse as sp

from pdhe.benchmarks.problems import lattice_nodes
from pdhe.case import build_case
from pdhe.diagnosis import diagnose, rebuild
from pdhe.discretization import discretize
from pdhe.errors import SceneError
from pdhe.materials import MODELS
from pdhe.mesh import make_mesh
from pdhe.mirrors import Symmetry
from pdhe.plan import make_plan
from pdhe.plotting import draw
from pdhe.post import crack_path, facets_of, summary
from pdhe.results import open_result, write_dataset
from pdhe.scene import Scene, load_scene
from pdhe.simulation import simulate, solve_case
from pdhe.solvers import _continuation
from pdhe.verification.slabs import nodes_of
from pdhe.verification.symmetry import operator_errors, pair_of, part_scene
from pdhe.whole import whole_result

SCENE = "config/scenes/mode_i_half.yaml"
COARSE = {"solver.tolerance": 1e-5, "mesh.spacing": "5 mm", "outputs": {"count": 3}}
WHOLE = "config/scenes/mode_i.yaml"


def loads(**displacement):
    return [{"on": "top", "displacement": displacement}]


def crack(start, end):
    return [{"name": "notch", "from": start, "to": end}]


#: id: (changes of the half scene, key in the message, fragment of it)
BAD = {
    "no edge": ({"geometry.symmetry": []}, "geometry.symmetry", "empty list"),
    "not an edge": ({"geometry.symmetry": ["botom"]}, "geometry.symmetry.0", "did you mean `bottom`"),
    "a word": ({"geometry.symmetry": "bottom"}, "geometry.symmetry", "must be a list"),
    "twice": ({"geometry.symmetry": ["bottom", "bottom"]}, "geometry.symmetry", "names `bottom` twice"),
    "two parallel mirrors": ({"geometry.symmetry": ["bottom", "top"]}, "geometry.symmetry", "repeat itself for ever"),
    "load on a mirror": (
        {"loads": [{"on": "bottom", "displacement": {"y": "1 mm"}}]}, "loads.0.on", "is a mirror line",
    ),
    "coverage on a mirror": (
        {"hydrogen.boundary": [{"on": "bottom", "coverage": 1}]}, "hydrogen.boundary.0.on", "is a mirror line",
    ),
    "no failure on a mirror": ({"damage.no_fail": ["bottom"]}, "damage.no_fail.0", "is a mirror line"),
    "load across a mirror": (
        {"geometry.symmetry": ["bottom", "left"], "loads": loads(x="1 mm", y="1 mm")},
        "loads.0.displacement.x",
        "moves `top` across the mirror line `left`",
    ),
    "crack pulled across a mirror": (
        {"loads": [{"on": "notch", "displacement": {"y": "1 um"}}]}, "loads.0.displacement.y", "moves `notch` across",
    ),
    "kinked crack": (
        {"geometry.cracks": crack(["50 mm", "0 mm"], ["80 mm", "30 mm"])}, "geometry.cracks.0.from", "a kink there",
    ),
    "hole beside a mirror line": (
        {"geometry.holes": [{"name": "bore", "centre": ["100 mm", "5 mm"], "radius": "10 mm"}]},
        "geometry.holes.0.radius",
        "or put the centre on the mirror line",
    ),
    "hole pulled across a mirror": (
        {"geometry.holes": [{"name": "bore", "centre": ["100 mm", "0 mm"], "radius": "10 mm"}],
         "loads": [{"on": "bore", "displacement": {"y": "1 um"}}]},
        "loads.0.displacement.y",
        "moves `bore` across",
    ),
    "fracture energy on a mirror": (
        {"damage.regions": [{"on": "bottom", "factor": 0.5}]}, "damage.regions.0.on", "is a mirror line",
    ),
    "diffusivity on a mirror": (
        {"hydrogen.regions": [{"on": "bottom", "factor": 0.5}]}, "hydrogen.regions.0.on", "is a mirror line",
    ),
    "interface at a mirror": (
        {"damage.interfaces": [{"between": ["all", "bottom"], "factor": 0.5}]},
        "damage.interfaces.0.between",
        "is a mirror line",
    ),
    "crack along an edge that is none": (
        {"geometry.symmetry": ["left"], "loads": loads(y="0.02 mm")}, "geometry.cracks.0.to", "cuts nothing",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_contradicts_a_mirror_line_is_refused(name):
    changes, key, fragment = BAD[name]
    with pytest.raises(SceneError) as caught:
        load_scene(SCENE, changes)
    assert caught.value.key == key
    assert fragment in str(caught.value)


def test_the_order_of_mirror_lines_does_not_matter():
    one, other = (
        load_scene(SCENE, {"geometry.symmetry": edges, "loads": loads(x="0 mm", y="0.02 mm")})
        for edges in (["bottom", "left"], ["left", "bottom"])
    )
    assert one == other
    assert "symmetry" not in load_scene(WHOLE).resolved()["geometry"]


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """The main scene as a half and as a whole, coarse: files of results."""
    folder, files = tmp_path_factory.mktemp("mirrors"), []
    for name in (SCENE, WHOLE):
        scene = load_scene(name, COARSE)
        files.append(folder / f"{len(files)}.nc")
        solve_case(scene, lattice_nodes(scene), files[-1])
    return files


def test_the_half_of_the_main_scene_gives_what_the_whole_gives(solved):
    with open_result(solved[0]) as half, open_result(solved[1]) as whole:
        one, other = summary(half), summary(whole)
        assert one["broken_bonds"] == other["broken_bonds"] > 0.0
        for name in ("crack_length", "crack_extension", "mean_damage", "hydrogen_content", "growth_start",
                     "energy_work", "energy_elastic", "energy_fracture"):  # fmt: skip
            # The solver's tolerance is 1e-5; measured 3e-6 and less.
            assert one[name] == pytest.approx(other[name], rel=2e-5), name
        np.testing.assert_allclose(half["reaction_top_y"].values, whole["reaction_top_y"].values, rtol=2e-5)
        assert float(half["force_sweeps"][-1]) == pytest.approx(float(whole["force_sweeps"][-1]), rel=0.3)


def test_the_whole_body_of_a_half_is_that_of_the_whole_scene(solved):
    with open_result(solved[0]) as half, open_result(solved[1]) as whole:
        shown = whole_result(half)
        assert whole_result(whole) is whole
        places = [np.column_stack([r["node_x"], r["node_y"] - level]) for r, level in ((shown, 0.0), (whole, 0.05))]
        orders = [np.lexsort(p.round(9).T) for p in places]
        np.testing.assert_allclose(places[0][orders[0]], places[1][orders[1]], atol=1e-12)
        damage, coverage = ([r[name].values[-1][o] for r, o in zip((shown, whole), orders, strict=True)]
                            for name in ("damage", "coverage"))  # fmt: skip
        assert np.array_equal(*damage)
        np.testing.assert_allclose(*coverage, atol=1e-5)
        u = [r["displacement"].values[-1][o, 1] for r, o in zip((shown, whole), orders, strict=True)]
        np.testing.assert_allclose(*u, atol=1e-5 * np.abs(u[1]).max())
        # Every facet of the whole mesh is there, inner ones across the mirror line too.
        assert len(facets_of(shown).broken) == len(facets_of(whole).broken)
        assert shown.sizes["broken"] == whole.sizes["broken"]
        cells = shown["vertices"].values[shown["cells"].values]
        ahead = np.roll(cells, -1, axis=1)
        area = 0.5 * (cells[..., 0] * ahead[..., 1] - cells[..., 1] * ahead[..., 0]).sum(axis=1)
        np.testing.assert_allclose(area, 25e-6, rtol=1e-9)
        middles = [np.sort(crack_path(r, np.inf).mean(axis=1), axis=0) for r in (half, whole)]
        np.testing.assert_allclose(middles[0] + (0.0, 0.05), middles[1], atol=1e-9)
        np.testing.assert_allclose(middles[0][:, 1], 0.0, atol=1e-9)


def test_pictures_show_the_whole_body(solved, tmp_path):
    for kind in ("damage", "displacement"):
        draw(kind, solved[0], {"panels": 1, "dpi": 60}, tmp_path / f"{kind}.png")
        assert (tmp_path / f"{kind}.png").stat().st_size > 3000


def test_a_half_is_explained(solved):
    text = diagnose(solved[0])
    assert "the bond nearest to failure carries" in text
    with open_result(solved[0]) as half:
        case = rebuild(half.load())
        assert "a half of the body, mirrored at its bottom edge" in half.attrs["plan"]
        assert case.body.broken_weight > 0.0
    assert "symmetry" not in make_plan(build_case(load_scene(WHOLE, COARSE), lattice_nodes(load_scene(WHOLE, COARSE))))


def test_a_quarter_mirrored_at_its_upper_right_corner():
    corner = ((0.06, 0.05), ("right", "top"), ((0.04, 0.05), (0.06, 0.05)), 5e-3, 1e4)
    for cells in ("quadrilateral", "triangle"):
        errors = operator_errors(pair_of(part_scene(*corner, cells=cells)))
        # Round-off; measured 5e-15.
        assert max(errors.values()) < 1e-12, errors


def test_the_coarse_stiffness_of_a_part_is_that_of_the_whole_body():
    pair = pair_of(part_scene((0.06, 0.05), ("left", "bottom"), ((0.0, 0.0), (0.02, 0.0)), 5e-3, 1e4, cells="triangle"))
    images, forces = pair.part.bonds.images, []
    u = np.random.default_rng(0).standard_normal((images.nodes, 2))
    for case, field in ((pair.part, u), (pair.whole, pair.continued(u, vectors=True))):
        n, d = len(field), case.discretization
        starts, column, value = case.body.short_stiffness(0.8 * d.spacing, np.ones((n, 2)))
        columns = n if case.bonds.images is None else len(images.positions)
        matrix = sp.bsr_matrix((value, column, starts), shape=(2 * n, 2 * columns))
        if case.bonds.images is not None:
            matrix = matrix @ _continuation(images)
            assert abs(matrix - matrix.T).max() < 1e-15 * abs(matrix).max()
        forces.append((matrix @ field.ravel()).reshape(n, 2))
    # Round-off; measured 3e-15.
    np.testing.assert_allclose(pair.continued(forces[0], True), forces[1], atol=1e-13 * np.abs(forces[1]).max())


@pytest.mark.parametrize("model", MODELS)
def test_every_model_is_the_same_on_a_part_or_refuses_it(model):
    changed = part_scene((0.06, 0.05), ("left", "bottom"), ((0.0, 0.0), (0.02, 0.0)), 5e-3, 1e4).resolved()
    changed["mechanics"] = {"model": model}
    changed["material"]["poissons_ratio"] = 1.0 / 3.0
    if not MODELS[model].body.sees_images:
        with pytest.raises(SceneError, match="is not there for"):
            pair_of(Scene.from_resolved(changed))
        return
    # Round-off; measured 4e-15.
    assert max(operator_errors(pair_of(Scene.from_resolved(changed))).values()) < 1e-12


def test_a_load_on_half_a_hole():
    changed = part_scene((0.06, 0.05), ("left",), ((0.04, 0.02), (0.06, 0.02)), 5e-3, 1e4, cells="triangle", wet=None)
    changed = changed.resolved() | {"damage": None}
    changed["geometry"]["holes"] = [{"name": "bore", "centre": [0.0, 0.025], "radius": 0.01}]
    changed["loads"] = [
        {"on": "bore", "displacement": {"y": {"times": [0.0], "values": [1e-6]}}},
        {"on": "top", "displacement": {"y": {"times": [0.0], "values": [0.0]}}},
    ]
    scene = Scene.from_resolved({key: value for key, value in changed.items() if value is not None})
    result = simulate(build_case(scene, nodes_of(scene)))
    # What goes in on the hole comes out on the edge, of either the whole amount; the solver's tolerance is 1e-9.
    pushed, held = (float(result[f"reaction_{name}_y"][-1]) for name in ("bore", "top"))
    assert pushed == pytest.approx(-held, rel=1e-6)
    # Twice the work of the part: half of the force on the whole hole times its displacement.
    assert float(result["external_work"][-1]) == pytest.approx(0.5 * pushed * 1e-6, rel=1e-6)


def test_the_force_on_an_edge_that_meets_a_mirror_line_is_that_of_the_whole_edge():
    quarter = ((0.06, 0.05), ("left", "bottom"), ((0.0, 0.0), (0.02, 0.0)), 5e-3, 1e4)
    pair = pair_of(part_scene(*quarter, wet=None, pull=1e-6, ramp=0.0))
    part, whole = simulate(pair.part), simulate(pair.whole)
    # Solver tolerance 1e-9; measured 3e-11.
    assert float(part["reaction_top_y"][-1]) == pytest.approx(float(whole["reaction_top_y"][-1]), rel=1e-7)
    assert float(part["reaction_top_x"][-1]) == 0.0
    assert abs(float(whole["reaction_top_x"][-1])) < 1e-6 * abs(float(whole["reaction_top_y"][-1]))


@pytest.mark.parametrize("solver", [{"tolerance": 1e-8}, {"precision": "single"}])
def test_a_half_in_other_solvers(solver):
    scene = load_scene(SCENE, {"hydrogen": None, "damage": None, "mesh.spacing": "10 mm", "time.end": "2e6 s"})
    usual = simulate(build_case(scene, lattice_nodes(scene)))
    changed = load_scene(SCENE, {"hydrogen": None, "damage": None, "mesh.spacing": "10 mm", "time.end": "2e6 s",
                                 "solver": solver})  # fmt: skip
    other = simulate(build_case(changed, lattice_nodes(changed)))
    # Both stop at 1e-5 of the force; single precision rounds stiffnesses by 6e-8.
    assert float(other["elastic_energy"][-1]) == pytest.approx(float(usual["elastic_energy"][-1]), rel=1e-4)


def test_diffusion_alone_takes_a_mirror_line_for_an_insulated_edge():
    changes = {"mesh.spacing": "5 mm", "geometry.symmetry": ["bottom"], "outputs": {"count": 2}}
    half = load_scene("config/scenes/diffusion.yaml", changes)
    slab = load_scene("config/scenes/diffusion.yaml", {**changes, "geometry.symmetry": None})
    one, other = (simulate(build_case(scene, lattice_nodes(scene))) for scene in (half, slab))
    assert np.array_equal(one["coverage"].values, other["coverage"].values)
    np.testing.assert_array_equal(one["hydrogen_content"].values, 2.0 * other["hydrogen_content"].values)


def test_cracks_go_on_as_their_images(tmp_path):
    symmetry = Symmetry.along(("left", "bottom"), 0.1, 0.1)
    on, across = ((0.0, 0.0), (0.03, 0.0)), ((0.0, 0.02), (0.03, 0.02))
    assert symmetry.cracks([on]) == [((-0.03, 0.0), (0.03, 0.0))]
    # A node on a crack lies on its left: the image of a line keeps the image of its left there.
    assert symmetry.cracks([across]) == [((-0.03, 0.02), (0.03, 0.02)), ((0.03, -0.02), (-0.03, -0.02))]
    assert len(symmetry.cracks([((0.02, 0.02), (0.03, 0.05))])) == 4
    with pytest.raises(AttributeError):
        symmetry.axes = ()


def test_a_mesh_of_triangles_follows_a_crack_along_the_mirror_line(tmp_path):
    scene = load_scene(SCENE, {**COARSE, "mesh.cells": "triangle"})
    make_mesh(scene.geometry, scene.mesh, tmp_path / "plate.msh")
    nodes = discretize(tmp_path / "plate.msh", scene.geometry, scene.mesh)
    lips = nodes.coordinates[nodes.node_sets["notch"]]
    assert lips[:, 0].max() < 0.05 and lips[:, 1].max() < 5e-3
    case = build_case(scene, nodes)
    # Bonds across the notch are cut, those across the mirror line beyond it are not.
    across = case.bonds.neighbours >= case.bonds.node_count
    x = case.bonds.middles(nodes.coordinates, case.bonds.owners(), slice(None))[:, 0]
    assert case.bonds.cut[across & (x < 0.04)].all() and not case.bonds.cut[across & (x > 0.06)].any()


def test_unfolded_results_can_be_written(solved, tmp_path):
    with open_result(solved[0]) as half:
        write_dataset(whole_result(half.load()), tmp_path / "whole.nc")
    with open_result(tmp_path / "whole.nc") as written:
        assert json.loads(written.attrs["scene"])["geometry"].get("symmetry") is None
        assert written.sizes["node"] == 800
