"""Scenes with large strains: what is refused and told, load steps, checkpoints, halves, bodies in space."""

import contextlib
from pathlib import Path

import numpy as np
import pytest

from pdhe.benchmarks.problems import lattice_nodes
from pdhe.case import build_case
from pdhe.checkpoint import CADENCE, Keeper
from pdhe.diagnosis import diagnose
from pdhe.errors import SceneError
from pdhe.materials.finite_strain import FiniteStrainBody, FiniteStrainSolidBody
from pdhe.plan import make_plan
from pdhe.plotting.picture import Picture
from pdhe.plotting.style import Style
from pdhe.results import open_result
from pdhe.scene import Scene, load_scene
from pdhe.simulation import simulate, solve_case
from pdhe.tradeoff.own_error import own_error
from pdhe.verification.large_strains import torn
from pdhe.verification.slabs import nodes_of
from pdhe.verification.symmetry import pair_of

pytestmark = pytest.mark.usefixtures("one_thread")

SCENES = Path(__file__).parents[2] / "config/scenes"
#: A shorter strip of 5 by 40 nodes.
STRIP = {
    "geometry": {"plate": {"width": "40 mm", "height": "5 mm", "thickness": "1 mm"}},
    "mesh.spacing": "1 mm",
    "regions": [{"name": "tip", "centre": ["39.5 mm", "2.5 mm"], "radius": "0.2 mm"}],
    "loads": [
        {"on": "left", "displacement": {"x": "0 mm", "y": "0 mm"}},
        {"on": "tip", "displacement": {"y": {"0 s": "0 mm", "1 s": "20 mm"}}},
    ],
    "outputs.count": 4,
}


def strip(**changes):
    return load_scene(SCENES / "bent_strip.yaml", STRIP | {key.replace("__", "."): v for key, v in changes.items()})


BAD = {
    "another model": ({"mechanics.model": "state-based"}, "mechanics.strain", "not known to model `state-based`"),
    "damage from event to event": ({"damage": {"criterion": "energy"}}, "stepping.mode", "use mode `fixed`"),
    "energies in two parts": (
        {
            "damage": {"criterion": "energy", "split": {"deviatoric": {"factor": 1}}},
            "stepping": {"mode": "fixed", "load_steps": 4, "diffusion_substeps": 1},
        },
        "damage.split",
        "small strains alone",
    ),
    "a user material": (
        {
            "material.umat": {"source": "config/umat/elastic.c", "properties": [2e11, 0.3]},
            "stepping": {"mode": "fixed", "load_steps": 4, "diffusion_substeps": 1},
            "loads": [{"on": "left", "displacement": {"x": "0 mm"}}],
        },
        "material.umat",
        "small strains alone",
    ),
    "inertia": ({"stepping": {"mode": "dynamic"}, "time.end": "1 us"}, "stepping.mode", "small strains alone"),
    "no such strain": ({"mechanics.strain": "large"}, "mechanics.strain", "finite"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_large_strains_do_not_go_with_is_refused(name):
    changes, key, text = BAD[name]
    loads = [{"on": "tip", "displacement": {"y": {"0 us": "0 mm", "1 us": "1 mm"}}}]
    more = {"loads": loads} if name == "inertia" else {}
    with pytest.raises(SceneError) as caught:
        load_scene(SCENES / "bent_strip.yaml", STRIP | more | changes)
    assert caught.value.key == key and text in str(caught.value)


def test_the_plan_says_so():
    scene = strip()
    case = build_case(scene, lattice_nodes(scene))
    assert isinstance(case.body, FiniteStrainBody)
    plan = make_plan(case)
    assert "large strains (Saint Venant-Kirchhoff), equilibrium by Newton's method to 1e-08" in plan


def test_outputs_and_load_steps_have_equilibria_of_their_own(tmp_path):
    scene = strip()
    solve_case(scene, lattice_nodes(scene), tmp_path / "events.nc")
    with open_result(tmp_path / "events.nc") as opened:
        events = opened.load()
    fixed_scene = strip(stepping={"mode": "fixed", "load_steps": 8, "diffusion_substeps": 1})
    fixed = simulate(build_case(fixed_scene, lattice_nodes(fixed_scene)))
    # Both end in the same place, by 4 steps and by 8; measured 2e-11 and, of forces, 2e-9.
    last = [result["displacement"].values[-1] for result in (events, fixed)]
    np.testing.assert_allclose(*last, rtol=0.0, atol=1e-6 * np.abs(last[0]).max())
    force = [float(result["reaction_tip_y"].values[-1]) for result in (events, fixed)]
    assert force[0] == pytest.approx(force[1], rel=1e-6)
    # At half the load the end has not come half as far along x: a quarter, and an equilibrium is there.
    case = build_case(scene, lattice_nodes(scene))
    middle = events["displacement"].values[2]
    assert np.abs(middle - 0.5 * last[0]).max() > 0.02 * np.abs(last[0]).max()
    left = case.body.force(middle)[~case.conditions.fixed]
    assert np.linalg.norm(left) < 1e-7 * np.abs(events["reaction_tip_y"].values).max()
    # Trapezia between equilibria miss the work by the square of the step: measured 1.2 % and 0.31 %.
    errors = []
    for result, most in ((events, 0.03), (fixed, 0.008)):
        work, elastic = (float(result[name].values[-1]) for name in ("external_work", "elastic_energy"))
        errors.append(abs(work / elastic - 1.0))
        assert errors[-1] < most
    assert errors[1] < 0.35 * errors[0]
    # Pictures show the shape as it is.
    assert Picture(events, "displacement", Style()).magnification == 1.0
    assert not own_error(scene, print).values
    told = diagnose(tmp_path / "events.nc")
    assert "by the length of the load steps" in told and "the forces on free nodes are" in told


def test_small_strains_break_the_same_bonds():
    """At the stretch of a steel: one bond after the other, as under small strains."""
    found = []
    for strain in ("small", "finite"):
        scene = torn(strain, 1.0003, 10, 24e-3)
        found.append(simulate(build_case(scene, lattice_nodes(scene))))
    assert int(found[0]["broken_bonds"].values[-1]) > 80
    np.testing.assert_array_equal(found[0]["damage"].values, found[1]["damage"].values)
    for name in ("broken_bonds", "failure_rounds", "crack_extension"):
        np.testing.assert_array_equal(found[0][name].values, found[1][name].values)
    # Measured 5e-4, of the size of the strain in front of the crack.
    np.testing.assert_allclose(found[0]["fracture_energy"].values, found[1]["fracture_energy"].values, rtol=2e-3)


@pytest.mark.parametrize("name", ["bent", "torn"])
def test_a_run_goes_on_from_a_checkpoint_to_the_same_bits(name, tmp_path, monkeypatch):
    scene = strip(hydrogen={"boundary": [{"on": "left", "coverage": 1}], "initial": 0})
    if name == "torn":
        scene = torn("finite", 1.3, 4, 20e-3)
    nodes = lattice_nodes(scene)
    solve_case(scene, nodes, tmp_path / "whole.nc")
    monkeypatch.setenv(CADENCE, "0")
    count, offer = [0], Keeper.offer

    class Stop(Exception):
        pass

    def ended(self, run):
        offer(self, run)
        count[0] += 1
        if count[0] % (2 if name == "bent" else 30) == 0:
            raise Stop

    monkeypatch.setattr(Keeper, "offer", ended)
    ends = 0
    while not (tmp_path / "parts.nc").exists():
        with contextlib.suppress(Stop):
            solve_case(scene, nodes, tmp_path / "parts.nc")
            break
        ends += 1
    assert ends >= 2
    with open_result(tmp_path / "whole.nc") as one, open_result(tmp_path / "parts.nc") as other:
        assert {name for name in one if not one[name].identical(other[name])} == set()
        assert name == "bent" or int(one["broken_bonds"].values[-1]) > 80


def test_a_half_is_the_half_of_a_whole():
    scene = strip(
        geometry={"plate": {"width": "12 mm", "height": "6 mm", "thickness": "1 mm"}, "symmetry": ["bottom"]},
        regions=None, loads=[
            {"on": "left", "displacement": {"x": "0 mm"}}, {"on": "right", "displacement": {"x": "4 mm"}},
        ],
    )  # fmt: skip
    pair = pair_of(scene, lattice_nodes(scene))
    x = pair.part.discretization.coordinates
    rng = np.random.default_rng(0)
    u, v = 1e-4 * rng.normal(size=x.shape) + 0.2 * x, rng.normal(size=x.shape)
    part, whole = pair.part.body.at(u), pair.whole.body.at(pair.continued(u, vectors=True))
    for found, expected in (
        (pair.continued(part.force(), vectors=True), whole.force()),
        (pair.continued(part.energy()), whole.energy()),
        (pair.continued(part.change(v), vectors=True), whole.change(pair.continued(v, vectors=True))),
    ):
        # Measured 1e-15.
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())
    results = [simulate(case) for case in (pair.part, pair.whole)]
    for name in ("reaction_right_x", "elastic_energy", "external_work"):
        # Measured 1e-10.
        np.testing.assert_allclose(*(result[name].values[-1] for result in results), rtol=1e-6)


def test_a_block_in_space_is_stretched_by_a_half():
    scene = strip(
        geometry={"plate": {"width": "10 mm", "height": "5 mm", "thickness": "5 mm"}}, regions=None,
        mesh={"spacing": "1 mm", "cells": "hexahedron"}, outputs={"count": 2}, solver__tolerance=1e-6,
        loads=[
            {"on": "left", "displacement": {"x": "0 mm"}},
            {"on": "right", "displacement": {"x": {"0 s": "0 mm", "1 s": "5 mm"}}},
        ],
    )  # fmt: skip
    nodes = nodes_of(scene)
    case = build_case(scene, nodes)
    assert isinstance(case.body, FiniteStrainSolidBody)
    result = simulate(case)
    young, stretch = scene.material.youngs_modulus, 1.5
    expected = young * stretch * 0.5 * (stretch**2 - 1.0) * 25e-6
    # The grips of so short a block make it stiffer, under small strains as well: 7.7 % and here 8.0 %.
    small = simulate(
        build_case(Scene.from_resolved(scene.resolved() | {"mechanics": {"model": "correspondence"}}), nodes)
    )
    grips = float(small["reaction_right_x"].values[-1]) / (young * (stretch - 1.0) * 25e-6)
    assert float(result["reaction_right_x"].values[-1]) == pytest.approx(grips * expected, rel=0.02)


def test_a_block_that_may_turn_breaks_as_under_small_strains():
    """Faces held along y alone leave it free to turn about y, and so is either half in the end."""
    found = []
    for strain in ("small", "finite"):
        changes = {
            "geometry": {
                "plate": {"width": "10 mm", "height": "6 mm", "thickness": "4 mm"},
                "cracks": [{"name": "notch", "from": ["0 mm", "3 mm"], "to": ["4 mm", "3 mm"]}],
            },
            "mesh": {"spacing": "1 mm", "cells": "hexahedron"}, "horizon": {"ratio": 2.015}, "regions": None,
            "mechanics": {"model": "correspondence", "strain": strain}, "material.poissons_ratio": 0.25,
            "damage": {"criterion": "energy", "no_fail": ["top", "bottom"]}, "outputs": {"count": 4},
            "hydrogen": {"boundary": [{"on": "notch", "coverage": 1}], "initial": 0.3, "degradation": "energy"},
            "loads": [
                {"on": on, "displacement": {"y": {"0 h": "0 mm", "1 h": f"{sign}0.016 mm"}}}
                for on, sign in (("top", ""), ("bottom", "-"))
            ],
            "time.end": "1 h", "stepping": {"mode": "fixed", "load_steps": 10, "diffusion_substeps": 5},
            "solver.tolerance": 1e-5,
        }  # fmt: skip
        scene = load_scene(SCENES / "smoke.yaml", changes)
        found.append(simulate(build_case(scene, nodes_of(scene))))
    small, finite = found
    assert small["crack_extension"].values[-1] > 5e-3
    np.testing.assert_array_equal(small["damage"].values, finite["damage"].values)
    # It stays where it is: measured 4e-6 m along x and z; left to itself it would turn by some 1e-4.
    assert np.abs(finite["displacement"].values).max() < 2e-5
