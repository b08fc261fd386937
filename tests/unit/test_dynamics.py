"""Explicit dynamics: sweeps, steps, prescribed motion, tractions, damping, failures, and what a scene may ask for."""

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator, eigsh

from pdhe import post
from pdhe.benchmarks.problems import lattice_nodes
from pdhe.boundary import DisplacementConditions
from pdhe.case import build_case, edge_areas
from pdhe.diagnosis import diagnose
from pdhe.discretization import discretize
from pdhe.dynamics import Verlet
from pdhe.errors import SceneError
from pdhe.kernels import verlet
from pdhe.materials import BY_ENERGY, BY_STRETCH, MODELS, Body, BondLoad
from pdhe.mesh import make_mesh
from pdhe.plan import make_plan
from pdhe.post import energy_balance
from pdhe.scene import PiecewiseLinear, Scene, load_scene
from pdhe.simulation import simulate, solve_case
from tests.lattices import make_body

PLATE = """
geometry:
  plate: {width: 40 mm, height: 20 mm, thickness: 2 mm}
  cracks: [{name: notch, from: [0 mm, 10 mm], to: [20 mm, 10 mm]}]
mesh: {spacing: 1 mm}
material: {youngs_modulus: 65 GPa, poissons_ratio: 0.2, critical_energy_release_rate: 204 J/m^2, density: 2235 kg/m^3}
loads:
  - {on: top, traction: {y: 20 MPa}}
  - {on: bottom, traction: {y: -20 MPa}}
time: {end: 20 us}
stepping: {mode: dynamic}
outputs: {count: 10}
"""


def scene(tmp_path, changes=None):
    path = tmp_path / "scene.yaml"
    path.write_text(PLATE)
    return load_scene(path, changes or {})


def case_of(tmp_path, changes=None):
    asked = scene(tmp_path, changes)
    return build_case(asked, lattice_nodes(asked))


STATES = {
    "lattice": {},
    "irregular": {"perturb": 0.2},
    "damaged": {"break_share": 0.2},
    "negative tangential": {"nu": 0.42, "perturb": 0.1, "break_share": 0.1},
    "auxetic": {"nu": -0.5},
}


@pytest.fixture(params=STATES)
def options(request):
    return STATES[request.param]


@pytest.mark.parametrize("load", [BY_ENERGY, BY_STRETCH, BondLoad(True, False), BondLoad(False, False)])
@pytest.mark.parametrize("model", MODELS)
def test_one_sweep_gives_forces_and_the_nearest_bonds(model, options, load):
    x, body = make_body(model=model, **options)
    random = np.random.default_rng(0)
    n = len(x)
    resistance = random.uniform(1e-3, 2e-3, n)
    weakness = resistance**-2.0
    weakness[random.integers(0, n, n // 5)] = 0.0
    u = random.normal(size=x.shape) * 1e-5
    for order in "CF":
        out = np.empty_like(u, order=order)
        square, nodes = body.force_and_ratios(np.array(u, order="C" if order == "C" else "F"), load, weakness, out)
        # Sums of the same terms, grouped differently: measured 5e-16 of the largest force.
        assert np.abs(out - body.force(u)).max() < 1e-13 * np.abs(out).max()
        assert np.array_equal(nodes, body.node_parts(u))
        owner, other = body.bonds.owners(), body.bonds.neighbours
        q = np.maximum(weakness[owner], weakness[other]) * (np.minimum(weakness[owner], weakness[other]) > 0.0)
        expected = np.zeros(n)
        np.maximum.at(expected, owner, np.where(body.intact, body.bond_loads(u, load) ** 2 * q, 0.0))
        # Squares of shears may cancel with a negative tangential stiffness: measured 2e-13.
        np.testing.assert_allclose(square, expected, rtol=1e-9, atol=1e-12 * expected.max())


@pytest.mark.parametrize("model", MODELS)
def test_the_nearest_bonds_follow_what_breaks_and_what_may_break(model):
    x, body = make_body(model=model)
    u = np.random.default_rng(0).normal(size=x.shape) * 1e-5
    all_may, out = np.full(len(x), 1e5), np.empty_like(u)
    before = body.force_and_ratios(u, BY_ENERGY, all_may, out)[0]
    worst = int(before.argmax())
    few_may = np.where(np.arange(len(x)) == worst, 0.0, all_may)
    assert body.force_and_ratios(u, BY_ENERGY, few_may, out)[0][worst] == 0.0
    assert np.array_equal(body.force_and_ratios(u, BY_ENERGY, all_may, out)[0], before)
    own = slice(body.bonds.offsets[worst], body.bonds.offsets[worst + 1])
    body.break_bonds(np.arange(len(body.intact))[own])
    assert body.force_and_ratios(u, BY_ENERGY, all_may, out)[0][worst] == 0.0


@pytest.mark.parametrize("model", ["condensed rotation", "state-based"])
@pytest.mark.parametrize("cells", ["quadrilateral", "triangle"])
def test_one_sweep_does_for_mirrored_halves_too(tmp_path, cells, model):
    half = {
        "geometry.cracks": [],
        "geometry.symmetry": ["bottom"],
        "loads.1": {"on": "left", "velocity": {"x": "1 m/s"}},
    }
    asked = scene(tmp_path, {**half, "mesh.cells": cells, "mechanics": {"model": model}})
    make_mesh(asked.geometry, asked.mesh, tmp_path / "plate.msh")
    body = build_case(asked, discretize(tmp_path / "plate.msh", asked.geometry, asked.mesh)).body
    random = np.random.default_rng(1)
    u = random.normal(size=body.coordinates.shape) * 1e-5
    weakness = random.uniform(1e5, 1e6, len(u)) * (random.random(len(u)) > 0.2)
    out, plain = np.empty_like(u), np.empty_like(u)
    square, nodes = body.force_and_ratios(u, BY_ENERGY, weakness, out)
    expected, parts = Body.force_and_ratios(body, u, BY_ENERGY, weakness, plain)
    assert np.abs(out - plain).max() < 1e-13 * np.abs(out).max()
    np.testing.assert_allclose(square, expected, rtol=1e-9)
    assert np.array_equal(nodes, parts) and nodes.size > len(u)


def test_a_mirrored_half_moves_as_the_whole(tmp_path):
    whole = {"damage": {"criterion": "energy"}, "time.end": "16 us"}
    half = {
        **whole,
        "geometry.plate.height": "10 mm",
        "geometry.cracks.0.from": ["0 mm", "0 mm"],
        "geometry.cracks.0.to": ["20 mm", "0 mm"],
        "geometry.symmetry": ["bottom"],
        "loads": [{"on": "top", "traction": {"y": "20 MPa"}}],
    }
    one, other = (simulate(case_of(tmp_path, changes)) for changes in (whole, half))
    assert one["broken_bonds"].values[-1] == other["broken_bonds"].values[-1] > 50
    upper = one["displacement"].values[-1].reshape(20, 40, 2)[10:].reshape(-1, 2)
    # The same sums in another order, through 100 steps: measured 4e-13.
    assert np.abs(upper - other["displacement"].values[-1]).max() < 1e-10 * np.abs(upper).max()
    for name in ("kinetic_energy", "elastic_energy", "external_work", "fracture_energy"):
        assert one[name].values[-1] == pytest.approx(other[name].values[-1], rel=1e-9)


def test_two_half_kicks_in_one_pass_are_the_same_to_the_bit():
    random = np.random.default_rng(3)
    u, v, force, mass = random.normal(size=(4, 3001))
    inverse, lost = 1.0 / np.abs(mass), np.zeros(3)
    u2, v2 = u.copy(), v.copy()
    verlet.end_step(v, force, 0.1, inverse, 1.0, mass, lost)
    verlet.begin_step(u, v, force, 0.1, inverse, 0.2, 1.0, mass, lost)
    verlet.end_and_begin_step(u2, v2, force, 0.1, inverse, 0.2)
    assert np.array_equal(u, u2) and np.array_equal(v, v2)


@pytest.mark.parametrize("model", MODELS)
def test_the_stable_step_is_below_the_true_limit(model, options):
    x, body = make_body(model=model, **options)
    mass = np.full(len(x), 2.0) * body.volume / body.volume.mean()
    fixed = DisplacementConditions([], {}, x, (1.0, 1.0))
    limit = Verlet(body, mass, fixed, [], np.zeros_like(x)).limit
    root = np.sqrt(np.repeat(mass, 2))
    operator = LinearOperator(
        (2 * len(x),) * 2, matvec=lambda z: -body.force((z / root).reshape(x.shape).copy()).ravel() / root, dtype=float
    )
    true = 2.0 / np.sqrt(eigsh(operator, 1, which="LA", tol=1e-8)[0][0])
    # Measured 0.56 to 0.80 of it: Gershgorin adds magnitudes where the shortest waves cancel.
    assert 0.5 * true < limit <= true


def test_integrals_of_histories_are_exact():
    history = PiecewiseLinear(times=(1.0, 2.0, 4.0), values=(2.0, 4.0, 0.0))
    # 2 until 1; 3 on average until 2; 4 to 0 until 4, then nothing.
    assert [history.integral(t) for t in (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 9.0)] == [0.0, 1.0, 2.0, 5.0, 8.0, 9.0, 9.0]
    assert PiecewiseLinear(times=(0.0,), values=(3.0,)).integral(2.0) == 6.0


def test_tractions_pull_with_all_of_their_force(tmp_path):
    for mesh in ({}, {"mesh.cells": "triangle"}):
        asked = scene(tmp_path, {**mesh, "geometry.cracks": []})
        make_mesh(asked.geometry, asked.mesh, tmp_path / "plate.msh")
        nodes = discretize(tmp_path / "plate.msh", asked.geometry, asked.mesh)
        for edge, area in (("top", 80e-6), ("bottom", 80e-6), ("left", 40e-6), ("right", 40e-6)):
            who, share = edge_areas(nodes, edge, (40e-3, 20e-3))
            assert share.sum() == pytest.approx(area, rel=1e-12)
            assert set(who) <= set(nodes.node_sets[edge])
        case = build_case(asked, nodes)
        case.dynamics.sweep(0.0)
        assert case.dynamics.force.sum(axis=0) == pytest.approx([0.0, 0.0], abs=1e-9)
        assert np.abs(case.dynamics.force[:, 1]).sum() == pytest.approx(2 * 20e6 * 80e-6, rel=1e-12)


def test_a_free_plate_flies_on_and_damping_slows_it_as_it_should(tmp_path):
    flight = {"loads": [{"on": "all", "initial_velocity": {"x": "3 m/s", "y": "-2 m/s"}}], "outputs.count": 3}
    result = simulate(case_of(tmp_path, flight))
    # Forces of a translated body vanish to the last digit of its displacements: measured 2e-16 of the energy.
    assert np.allclose(result["displacement"].values[-1], 20e-6 * np.array([3.0, -2.0]), rtol=1e-12)
    assert result["elastic_energy"].values[-1] < 1e-20 * result["kinetic_energy"].values[-1]
    result = simulate(case_of(tmp_path, {**flight, "stepping.damping": "1e5 s^-1"}))
    kinetic = result["kinetic_energy"].values
    # Velocities fall by exp(-c t), exactly at any step; measured 2e-13 after 64 steps.
    assert kinetic == pytest.approx(kinetic[0] * np.exp(-2e5 * result["history_time"].values), rel=1e-11)
    assert kinetic + result["damping_loss"].values == pytest.approx(np.full(4, kinetic[0]), rel=1e-11)


@pytest.mark.parametrize("changes", [
    {},
    {"mesh.cells": "quadrilateral", "loads": [
        {"on": "top", "velocity": {"y": {"0 us": "0 m/s", "10 us": "5 m/s"}}, "at": "nodes"},
        {"on": "bottom", "displacement": {"y": "0 mm"}}]},
    {"loads": [{"on": "left", "displacement": {"x": {"0 us": "0 mm", "8 us": "0.02 mm"}}},
               {"on": "right", "initial_velocity": {"x": "4 m/s"}}], "stepping.damping": "2e4 s^-1"},
    {"damage": {"criterion": "energy"}, "horizon.ratio": 3.5},
    {"damage": {"criterion": "stretch"}, "time.end": "15 us"},
], ids=["traction", "velocity", "damped", "failures", "stretch"])  # fmt: skip
def test_the_energy_balance_closes_but_for_the_ripple_of_the_steps(tmp_path, changes):
    case = case_of(tmp_path, changes)
    result = simulate(case)
    balance = energy_balance(result)
    largest = max(balance["kinetic"].max(), balance["elastic"].max())
    if "damage" in changes:
        assert result["broken_bonds"].values[-1] > 50
    # What is left is the swing of the steps (theory, eq. 7.10): measured 6e-6 to 4.1e-3.
    assert np.abs(balance["error"]).max() < 8e-3 * largest
    fine = simulate(case_of(tmp_path, {**changes, "stepping.safety": 0.2}))
    smaller = np.abs(energy_balance(fine)["error"]).max() / np.abs(balance["error"]).max()
    # Of second order: a sixteenth, 0.0625; measured 0.056 to 0.073.
    assert smaller < 0.09


def test_without_failures_verlet_keeps_its_own_energy_to_round_off(tmp_path):
    case = case_of(tmp_path, {"loads": [{"on": "left", "initial_velocity": {"x": "4 m/s", "y": "1 m/s"}}],
                              "outputs.count": 1})  # fmt: skip
    motion, step = case.dynamics, 0.9 * case.dynamics.limit
    motion.sweep(0.0)
    kept = []
    for k in range(200):
        motion.step((k + 1) * step, step)
        motion.end(step)
        kept.append(motion.kinetic()[0] + motion.elastic() - motion.ripple(step))
    # Theory, eq. 7.10: measured 3e-15.
    assert np.ptp(kept) < 1e-12 * kept[0]


def test_momentum_is_kept_while_bonds_break(tmp_path):
    case = case_of(tmp_path, {"damage": {"criterion": "energy"}})
    result = simulate(case)
    assert result["broken_bonds"].values[-1] > 50
    momentum = case.dynamics.mass @ result["velocity"].values[-1]
    scale = case.dynamics.mass @ np.abs(result["velocity"].values[-1])
    # Both tractions are equal and opposite; measured 1e-14.
    assert np.abs(momentum).max() < 1e-11 * scale.max()


def test_the_crack_of_a_symmetric_scene_is_symmetric(tmp_path):
    result = simulate(case_of(tmp_path, {"damage": {"criterion": "energy"}}))
    damage = result["damage"].values[-1].reshape(20, 40)
    assert result["crack_extension"].values[-1] > 5e-3
    assert np.array_equal(damage, damage[::-1])


def test_prescribed_motion_is_followed_and_outputs_come_at_their_times(tmp_path):
    times = [1e-6, 3.3e-6, 7.7e-6]
    changes = {
        "regions": [{"name": "corner", "from": ["0 mm", "0 mm"], "to": ["3 mm", "2.4 mm"]}],
        "loads": [{"on": "corner", "velocity": {"x": {"0 us": "0 m/s", "4 us": "8 m/s"}}, "at": "nodes"}],
        "outputs": {"times": [f"{t!r} s" for t in times]},
        "time.end": "10 us",
    }
    case = case_of(tmp_path, changes)
    assert case.discretization.node_sets["corner"].tolist() == [0, 1, 2, 40, 41, 42]
    result = simulate(case)
    assert result["time"].values.tolist() == [0.0, *times, 1e-5]
    moved = result["displacement"].values[:, 0, 0]
    assert moved == pytest.approx([0.0, 1e-6, 1e6 * 3.3e-6**2, 16e-6 + 8 * 3.7e-6, 16e-6 + 8 * 6e-6], rel=1e-12)
    assert result["applied_corner_x"].values[-1] == pytest.approx(moved[-1], rel=1e-12)
    # Velocities of held nodes are means over the last step, 0.15 us.
    assert result["velocity"].values[-1, 0, 0] == pytest.approx(8.0, rel=1e-9)


def test_coverage_weakens_bonds_in_motion(tmp_path):
    changes = {"damage": {"criterion": "energy"}, "material.diffusivity": "1e-9 m^2/s", "time.end": "12 us"}
    dry = simulate(case_of(tmp_path, changes))
    wet = simulate(case_of(tmp_path, {**changes, "hydrogen": {"initial": 0.5}}))
    assert wet["broken_bonds"].values[-1] > 1.2 * dry["broken_bonds"].values[-1]
    assert post.growth(wet)[0] < post.growth(dry)[0]
    # Fresh crack faces are saturated at the next output.
    saturated = (wet["coverage"].values == 1.0).sum(axis=1)
    assert saturated[0] == 38 and saturated[-1] > 50


def test_protected_bonds_hold(tmp_path):
    case = case_of(tmp_path, {"damage": {"criterion": "energy", "no_fail": ["notch"]}})
    result = simulate(case)
    lips = set(case.discretization.node_sets["notch"].tolist())
    assert not lips & {*result["broken_i"].values.tolist(), *result["broken_j"].values.tolist()}


def test_a_motion_is_planned_and_explained(tmp_path):
    asked = scene(tmp_path, {"damage": {"criterion": "energy"}})
    nodes = lattice_nodes(asked)
    plan = make_plan(build_case(asked, nodes))
    assert "with inertia, density 2235 kg/m^3" in plan and "velocity Verlet, steps of at most" in plan
    assert "expected work:" in plan
    solve_case(asked, nodes, tmp_path / "run.nc")
    told = diagnose(tmp_path / "run.nc")
    assert "the balance is closed" in told and "kinetic energy 0 J at the start" in told and "steps" in told


def test_nothing_of_motion_without_inertia(tmp_path):
    still = {"stepping": {"mode": "events"}, "loads": [{"on": "top", "displacement": {"y": "0.001 mm"}},
                                                        {"on": "bottom", "displacement": {"y": "0 mm"}}]}  # fmt: skip
    case = case_of(tmp_path, still)
    assert case.dynamics is None
    result = simulate(case)
    assert "velocity" not in result and "kinetic_energy" not in result
    assert "safety" not in scene(tmp_path, still).resolved()["stepping"]


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({"material.density": None}, "material.density", "inertia needs it"),
        ({"stepping.safety": 1.5}, "stepping.safety", "at most 1"),
        ({"stepping.safety": 0.5, "stepping.step": "10 ns"}, "stepping.safety", "as well as `step`"),
        ({"stepping.damping": "-1 s^-1"}, "stepping.damping", "not be negative"),
        ({"stepping.damping": "1 s"}, "stepping.damping", "s^-1"),
        ({"stepping.mode": "events"}, "loads.0.traction", "needs inertia"),
        ({"stepping": {"mode": "events", "safety": 0.8}}, "stepping.safety", "belongs to mode `dynamic`"),
        ({"stepping.grouping": 0.1}, "stepping.grouping", "belongs to mode `events`"),
        ({"loads.0.on": "notch"}, "loads.0.on", "no surface"),
        ({"loads.0.velocity": {"y": "1 m/s"}}, "loads.0.traction", "`velocity` and `traction`"),
        ({"loads.0": {"on": "top"}}, "loads.0.displacement", "is missing"),
        ({"loads.0.traction": {}}, "loads.0.traction", "prescribes nothing"),
        ({"loads.0": {"on": "top", "displacement": {"y": "1 mm"}}}, "loads.0.displacement.y", "jump at the start"),
        ({"loads.1.on": "top"}, "loads.1.traction.y", "second traction"),
        ({"loads.1": {"on": "top", "velocity": {"y": "1 m/s"}}}, "loads.0.traction.y", "is prescribed"),
        ({"loads.1": {"on": "left", "velocity": {"y": "1 m"}}}, "loads.1.velocity.y", "velocity"),
        ({"time.end": "0 s"}, "time.end", "no time"),
        ({"loads": None, "hydrogen": {"initial": 1}, "material.diffusivity": "1e-9 m^2/s"}, "stepping.mode", "moves"),
        ({"regions": []}, "regions", "empty"),
        ({"regions": [{"name": "a", "from": ["0 mm", "0 mm"], "to": ["0 mm", "5 mm"]}]}, "regions.0.to", "area"),
        ({"regions": [{"name": "a", "from": ["-9 mm", "0 mm"], "to": ["-1 mm", "5 mm"]}]}, "regions.0.from", "outside"),
        ({"regions": [{"name": "notch", "from": ["0 mm"] * 2, "to": ["1 mm"] * 2}]}, "regions.0.name", "already"),
    ],
)  # fmt: skip
def test_scenes_that_ask_for_what_cannot_be(tmp_path, changes, key, words):
    with pytest.raises(SceneError) as error:
        scene(tmp_path, changes)
    assert error.value.key == key and words in str(error.value), str(error.value)


def test_regions_that_contradict_what_they_share_are_refused(tmp_path):
    region = {"name": "impact", "from": ["0 mm", "0 mm"], "to": ["1 mm", "8 mm"]}
    loads = [{"on": "impact", "velocity": {"y": "1 m/s"}}, {"on": "bottom", "displacement": {"y": "0 mm"}}]
    with pytest.raises(SceneError, match="share nodes"):
        scene(tmp_path, {"regions": [region], "loads": loads})
    apart = {**region, "from": ["0 mm", "3 mm"]}
    assert scene(tmp_path, {"regions": [apart], "loads": loads}).node_sets[-1] == "impact"
    # A standstill is a standstill, whether as a displacement or as a velocity.
    loads[0] = {"on": "impact", "velocity": {"y": "0 m/s"}}
    scene(tmp_path, {"regions": [region], "loads": loads})


def test_a_step_beyond_the_stable_one_is_refused(tmp_path):
    limit = case_of(tmp_path).dynamics.limit
    with pytest.raises(SceneError, match="stable step"):
        case_of(tmp_path, {"stepping.step": f"{1.01 * limit!r} s"})
    case = case_of(tmp_path, {"stepping.step": f"{0.99 * limit!r} s"})
    assert simulate(case)["time_steps"].values[-1] == pytest.approx(20e-6 / (0.99 * limit), abs=12)


def test_a_scene_with_inertia_survives_being_written(tmp_path):
    asked = scene(tmp_path, {"regions": [{"name": "a", "from": ["0 mm", "0 mm"], "to": ["1 mm", "5 mm"]}]})
    again = Scene.from_resolved(asked.resolved())
    assert again == asked and again.stepping.safety == 0.8 and again.stepping.damping == 0.0
