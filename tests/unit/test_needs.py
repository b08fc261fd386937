"""What is asked of a cluster: next to the plan in memory, never too little time, and quickly known."""

import itertools
import time
from pathlib import Path

import pytest

from pdhe.case import build_case
from pdhe.discretization import discretize
from pdhe.forecast import make_forecast
from pdhe.mesh import make_mesh
from pdhe.needs import MOST_THREADS, POWERS, needs_of
from pdhe.scene import load_scene
from pdhe.transport import KERNELS

SCENES = Path(__file__).parents[2] / "config/scenes"
MILLIMETRE = 1e-3

# Meshes on which they were measured, where that of the scene is larger.
MEASURED_ON = {
    "glass_branching": {"mesh": {"spacing": "0.5 mm"}, "horizon.ratio": 3.015},
    "kalthoff_winkler": {"mesh.spacing": "1 mm"},
}
# Processor time of a run on one thread, s, as measured when the estimate was made.
MEASURED = {
    "smoke": 1.01,
    "diffusion": 0.49,
    "elastic": 0.58,
    "crack_near_hole": 13.35,
    "inclined_crack": 14.04,
    "offset_cracks": 18.0,
    "mode_i_graded": 24.7,
    "mode_i": 18.6,
    "mode_i_half": 12.95,
    "glass_branching": 4.4,
    "kalthoff_winkler": 2.12,
    "mode_i_fast": 51.0,
    "mode_i_solid": 12.7,
}


def needs(name, **changes):
    return needs_of(load_scene(SCENES / f"{name}.yaml", changes).resolved())


def test_every_scene_has_a_measured_time():
    assert {path.stem for path in SCENES.glob("*.yaml")} >= set(MEASURED)


@pytest.mark.parametrize("name", MEASURED)
def test_time_is_an_upper_estimate(name):
    # 1.05 (graded) to 5.9 (main scene) times; the limit is three times that and five minutes.
    found = needs(name, **MEASURED_ON.get(name, {}))
    assert 1.0 < found.seconds / MEASURED[name] < 7.0
    assert 60.0 * found.runtime() > 300.0 + 3.0 * MEASURED[name]


@pytest.mark.parametrize("name", ["smoke", "diffusion", "elastic", "crack_near_hole"])
def test_memory_is_that_of_the_plan(name, tmp_path):
    scene = load_scene(SCENES / f"{name}.yaml")
    make_mesh(scene.geometry, scene.mesh, tmp_path / "mesh.msh")
    case = build_case(scene, discretize(tmp_path / "mesh.msh", scene.geometry, scene.mesh))
    expected = make_forecast(case, None).memory
    found = needs(name)
    # From 1.1 % below (triangles have a few more nodes and bonds) to 0.5 % above (nodes near an edge have fewer).
    assert found.memory == pytest.approx(expected, rel=0.02)
    assert found.nodes == pytest.approx(case.discretization.volume.size, rel=0.05)
    if case.diffusion is not None:
        assert found.mem_mb() * 1e6 > 1.3 * expected


def test_finer_is_more_of_everything():
    found = [needs("mode_i", **{"mesh.spacing": f"{h} mm"}) for h in (2, 1, 0.5, 0.25, 0.1)]
    for coarse, fine in itertools.pairwise(found):
        assert coarse.memory < fine.memory and coarse.seconds < fine.seconds and coarse.threads <= fine.threads
        assert coarse.mem_mb() < fine.mem_mb() and coarse.runtime() <= fine.runtime()
        assert coarse.mesh_mem_mb() < fine.mesh_mem_mb() and coarse.drawing_mem_mb() < fine.drawing_mem_mb()
    assert [need.threads for need in found] == [1, 1, 1, 6, MOST_THREADS]


def test_another_attempt_asks_for_more():
    need = needs("mode_i")
    assert [need.runtime(attempt) for attempt in (1, 2, 3)] == [need.runtime(), 2 * need.runtime(), 4 * need.runtime()]
    assert need.mem_mb() < need.mem_mb(2) < need.mem_mb(3)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("smoke", {"horizon": {"length": "15 mm"}}),
        ("smoke", {"stepping": {"mode": "fixed", "load_steps": 10, "diffusion_substeps": 100}}),
        ("smoke", {"hydrogen": None}),
        ("smoke", {"damage": None}),
        ("elastic", {}),
        ("mode_i_graded", {}),
        ("diffusion", {"hydrogen.kernel": "constant"}),
        ("diffusion", {"hydrogen.kernel": "inverse"}),
    ],
)
def test_every_kind_of_scene_has_an_estimate(name, changes):
    found = needs(name, **changes)
    assert found.seconds > 0.0 and found.runtime() >= 6 and found.mem_mb() > 1000 and found.threads == 1


BLOCK = {
    "geometry.plate": {"width": "10 mm", "height": "8 mm", "thickness": "6 mm"},
    "geometry.cracks": [{"name": "notch", "from": ["0 mm", "4 mm"], "to": ["4 mm", "4 mm"]}],
    "mesh": {"cells": "hexahedron", "spacing": "1 mm"},
}
DISC = {"name": "notch", "disc": {"centre": ["5 mm", "4 mm", "3 mm"], "normal": [0, 1, 0], "radius": "2 mm"}}
TRIANGLE = [["2 mm", "2 mm", "1 mm"], ["6 mm", "4 mm", "1 mm"], ["6 mm", "4 mm", "5 mm"]]


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"mesh": {"cells": "tetrahedron", "spacing": "1 mm"}},
        {"geometry.cracks": [DISC]},
        {"geometry.cracks": [{"name": "notch", "polygon": TRIANGLE}]},
    ],
    ids=["hexahedra", "tetrahedra", "disc", "polygon"],
)
def test_bodies_in_space_have_all_their_layers(changes, tmp_path):
    scene = load_scene(SCENES / "smoke.yaml", BLOCK | changes)
    make_mesh(scene.geometry, scene.mesh, tmp_path / "mesh.msh")
    case = build_case(scene, discretize(tmp_path / "mesh.msh", scene.geometry, scene.mesh))
    found = needs_of(scene.resolved())
    # Equal on cubes, bond for bond; 407 tetrahedra where 480 would be.
    assert found.nodes == pytest.approx(case.discretization.volume.size, rel=0.2)
    assert make_forecast(case, None).memory == pytest.approx(found.memory, rel=1e-9 if len(changes) == 0 else 0.03)
    assert found.fields == 8.0 * 5 * found.nodes * len(scene.outputs.times)
    # No plane has so many bonds: 122 a node.
    assert found.seconds > needs("smoke").seconds


def test_a_thicker_body_takes_more():
    thin, thick = (
        needs("smoke", **BLOCK | {"geometry.plate": {"width": "10 mm", "height": "8 mm", "thickness": t}})
        for t in ("6 mm", "60 mm")
    )
    assert thick.nodes == pytest.approx(10.0 * thin.nodes)
    assert thick.memory > thin.memory and thick.seconds > thin.seconds and thick.mesh_mem_mb() > thin.mesh_mem_mb()


@pytest.mark.parametrize("model", ["state-based", "correspondence"])
def test_models_without_kernels_for_lattices_take_longer(model):
    assert needs("mode_i", **{"mechanics.model": model}).seconds > 1.3 * needs("mode_i").seconds


def test_kernels_are_those_of_the_registry():
    assert POWERS == KERNELS


def test_a_thousand_cases_take_no_time():
    scene = load_scene(SCENES / "mode_i.yaml").resolved()
    start = time.process_time()
    for _ in range(1000):
        needs_of(scene)
    assert time.process_time() - start < 1.0  # 0.03 s measured
