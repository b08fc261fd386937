"""The plan: expected memory and work, and warnings about what is likely not meant."""

import subprocess
import sys

import pytest

from pdhe.benchmarks.problems import SCENE, lattice_nodes, mode_i
from pdhe.case import build_case
from pdhe.forecast import PILOT_NODES, make_forecast, pilot_scene
from pdhe.plan import make_plan, warnings
from pdhe.scene import Scene, load_scene
from pdhe.simulation import fly_pilot, simulate


@pytest.fixture(scope="module")
def flown():
    """The main scene at 3 mm and its pilot at 5 mm."""
    case = mode_i(3200)
    return case, fly_pilot(case.scene, case.discretization.volume.size)


def test_a_pilot_is_coarser_or_there_is_none():
    scene = load_scene(SCENE)
    assert pilot_scene(scene, 20_000).mesh.spacing == pytest.approx(scene.mesh.spacing * 5.0)
    assert pilot_scene(scene, 3 * PILOT_NODES) is None


def test_a_pilot_that_is_too_coarse_for_the_scene_is_no_error():
    scene = load_scene(SCENE, {"geometry.holes": [{"name": "pin", "centre": ["150 mm", "50 mm"], "radius": "3 mm"}],
                               "mesh.cells": "triangle"})  # fmt: skip
    fly_pilot(scene, 20_000)


def test_work_is_foretold_from_the_pilot(flown):
    case, pilot = flown
    expected = make_forecast(case, pilot)
    result = simulate(mode_i(3200))
    found = {name: float(result[name][-1]) for name in ("diffusion_sweeps", "force_sweeps")}
    # Measured 1.17: the steps are mostly those of the stability limit.
    assert expected.diffusion_sweeps == pytest.approx(found["diffusion_sweeps"], rel=0.5)
    # How often a crack fails on 800 nodes is chance: measured 1.7.
    assert 1 / 3 < expected.force_sweeps / found["force_sweeps"] < 3
    assert expected.seconds > 0.0
    text = make_plan(case, pilot)
    assert "expected work" in text
    assert "expected work" not in make_plan(case)


def test_a_forecast_that_is_there_is_not_made_again(flown, monkeypatch):
    case, pilot = flown
    expected = make_forecast(case, pilot)
    text = make_plan(case, pilot)
    monkeypatch.setattr("pdhe.plan.make_forecast", None)
    assert make_plan(case, pilot, expected) == text


FORETELL = """
import sys
from pdhe.benchmarks.problems import lattice_nodes
from pdhe.case import build_case
from pdhe.forecast import make_forecast
from pdhe.scene import load_scene
scene = load_scene(sys.argv[1], {"time.end": "1e6 s", "outputs": {"every": "5e4 s"}})
print(make_forecast(build_case(scene, lattice_nodes(scene)), None).memory)
"""
PEAK = """
import sys
from pdhe.benchmarks.machine import peak_memory
from pdhe.benchmarks.problems import lattice_nodes
from pdhe.scene import load_scene
from pdhe.simulation import solve_case
scene = load_scene(sys.argv[1], {"time.end": "1e6 s", "outputs": {"every": "5e4 s"}})
solve_case(scene, lattice_nodes(scene), sys.argv[2])
print(peak_memory())
"""


def test_memory_is_foretold_within_a_fifth(tmp_path):
    def number(code):
        command = [sys.executable, "-c", code, str(SCENE), str(tmp_path / "result.nc")]
        return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)

    number(PEAK)  # compiles what is not in the cache, which takes memory of its own
    # Measured 1.10, and 1.00 with 120 outputs. What a process needs before it has bonds differs between versions
    # of the libraries.
    assert number(FORETELL) == pytest.approx(number(PEAK), rel=0.2)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"geometry.cracks": [{"name": "flaw", "from": ["0 mm", "50 mm"], "to": ["15 mm", "50 mm"]}],
          "hydrogen.boundary": [{"on": "flaw", "coverage": 1}]}, "crack 'flaw' is 1.2 horizons long"),
        ({"time.end": "1 s", "outputs": {"count": 1}, "loads": [{"on": "top", "displacement": {"y": "0.02 mm"}}]},
         "nothing arrives"),
        ({"time.end": "1e4 s", "outputs": {"count": 1}, "loads": [{"on": "top", "displacement": {"y": "0.02 mm"}}]},
         "front is not resolved"),
    ],
)  # fmt: skip
def test_warnings(overrides, words):
    scene = load_scene(SCENE, {"mesh.spacing": "4 mm", **overrides})
    case = build_case(scene, lattice_nodes(scene))
    (found,) = warnings(case)
    assert words in found
    assert f"warning: {found}" in make_plan(case)


def test_a_scene_whose_loads_break_nothing_is_warned_about():
    scene = load_scene(SCENE, {"mesh.spacing": "1 mm", "time.end": "3e4 s", "outputs": {"count": 1}})
    content = scene.resolved()
    del content["hydrogen"]
    case = build_case(Scene.from_resolved(content), lattice_nodes(scene))
    pilot = fly_pilot(case.scene, case.discretization.volume.size)
    (found,) = warnings(case, pilot)
    assert "nothing breaks in a pilot on 800 nodes" in found


def test_the_main_scene_has_no_warnings(flown):
    assert warnings(*flown) == []
