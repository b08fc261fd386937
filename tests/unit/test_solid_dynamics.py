"""Explicit dynamics of bodies in space: steps, tractions on faces, free motion, energy, failures, bad scenes."""

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator, eigsh

from pdhe.boundary import DisplacementConditions
from pdhe.case import build_case, edge_areas
from pdhe.diagnosis import diagnose
from pdhe.dynamics import Verlet
from pdhe.errors import SceneError
from pdhe.materials import MODELS
from pdhe.materials.body import BY_ENERGY, BY_STRETCH, BondLoad
from pdhe.plan import make_plan
from pdhe.post import energy_balance
from pdhe.results import open_result
from pdhe.scene import Scene, load_scene
from pdhe.scene_solid import SOLID_MODELS
from pdhe.simulation import simulate, solve_case
from pdhe.verification.slabs import nodes_of
from tests.solids import make_solid

pytestmark = pytest.mark.usefixtures("one_thread")

SPACE = [name for name in SOLID_MODELS if MODELS[name].objective]
SIZE = (10e-3, 8e-3, 6e-3)
BLOCK = """
geometry:
  plate: {width: 10 mm, height: 8 mm, thickness: 6 mm}
  cracks: [{name: notch, from: [0 mm, 4 mm], to: [4 mm, 4 mm]}]
mesh: {spacing: 1 mm, cells: hexahedron}
horizon: {ratio: 2.015}
material: {youngs_modulus: 65 GPa, poissons_ratio: 0.2, critical_energy_release_rate: 204 J/m^2, density: 2235 kg/m^3}
loads:
  - {on: top, traction: {y: 60 MPa, z: 5 MPa}}
  - {on: bottom, traction: {y: -60 MPa, z: -5 MPa}}
time: {end: 8 us}
stepping: {mode: dynamic}
outputs: {count: 4}
"""


def scene(tmp_path, changes=None) -> Scene:
    path = tmp_path / "scene.yaml"
    path.write_text(BLOCK)
    return load_scene(path, changes or {})


def case_of(tmp_path, changes=None):
    asked = scene(tmp_path, changes)
    return build_case(asked, nodes_of(asked))


def free(x, body, mass, **options) -> Verlet:
    return Verlet(body, mass, DisplacementConditions([], {}, x, SIZE), [], np.zeros_like(x), **options)


STATES = {
    "lattice": {},
    "irregular": {"perturb": 0.2, "partial": "ramp"},
    "damaged": {"perturb": 0.2, "break_share": 0.2},
    "nearly all broken": {"break_share": 0.97},
    "auxetic": {"nu": -0.4},
}


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("model", SOLID_MODELS)
def test_the_stable_step_is_below_the_true_limit_also_once_bonds_break(model, state):
    x, body = make_solid(model=model, **{"nu": 0.2 if model == "thesis spring" else 0.29} | STATES[state])
    mass = 2.0 * body.volume / body.volume.mean()
    root = np.sqrt(np.repeat(mass, 3))

    def product(z):
        return -body.force((z / root).reshape(x.shape).copy()).ravel() / root

    def true() -> float:
        start = np.random.default_rng(0).standard_normal(x.size)
        operator = LinearOperator((x.size,) * 2, matvec=product, dtype=float)
        return 2.0 / np.sqrt(eigsh(operator, 1, which="LA", tol=1e-6, v0=start)[0][0])

    limit, whatever = free(x, body, mass).limit, free(x, body, mass, breaks=True).limit
    # Measured 0.37 to 0.87 of it, the least where hardly any bond of a correspondence model is left.
    assert 0.3 * true() < limit <= true() and whatever <= limit
    # Correspondence families can get stiffer for what is left of them, others cannot.
    once = np.flatnonzero(body.bonds.once() & body.intact)
    body.break_bonds(np.random.default_rng(3).choice(once, once.size // 2, replace=False))
    assert whatever <= true()


HOW = {
    "energy": BY_ENERGY,
    "stretch": BY_STRETCH,
    "compression too": BondLoad(by_energy=True, tension_only=False),
    "dilatational": BondLoad(by_energy=True, split=(1.0, 0.0)),
    "deviatoric": BondLoad(by_energy=True, split=(0.0, 1.0)),
}


#: Bonds that act alone know no dilatation.
ALONE = ("condensed rotation", "one-parameter")
LOADS = [(model, how) for model in SPACE for how in HOW if HOW[how].split is None or model not in ALONE]


@pytest.mark.parametrize(("model", "how"), LOADS)
def test_one_sweep_gives_forces_and_the_nearest_bonds(model, how):
    how = HOW[how]
    x, body = make_solid(model=model, perturb=0.2, break_share=0.2)
    random = np.random.default_rng(0)
    weakness = random.uniform(1e-3, 2e-3, len(x)) ** -2.0
    weakness[::5] = 0.0
    u = random.normal(size=x.shape) * 1e-5
    out = np.empty_like(u)
    square, nodes = body.force_and_ratios(u, how, weakness, out)
    # The same terms in another order: measured 4e-16 of the largest force.
    assert np.abs(out - body.force(u)).max() < 1e-13 * np.abs(out).max()
    assert np.array_equal(nodes, body.node_parts(u))
    owner, other = body.bonds.owners(), body.bonds.neighbours
    q = np.maximum(weakness[owner], weakness[other]) * (np.minimum(weakness[owner], weakness[other]) > 0.0)
    expected = np.zeros(len(x))
    np.maximum.at(expected, owner, np.where(body.intact, body.bond_loads(u, how) ** 2 * q, 0.0))
    # Squares of shears may cancel where the tangential stiffness is negative.
    np.testing.assert_allclose(square, expected, rtol=1e-9, atol=1e-12 * expected.max())


@pytest.mark.parametrize("model", SPACE)
def test_a_free_body_flies_and_turns_without_a_force(model):
    x, body = make_solid(model=model, perturb=0.1, break_share=0.1)
    motion = free(x, body, 7850.0 * body.volume)
    start = np.array([3.0, -2.0, 1.0]) + np.cross([200.0, -100.0, 300.0], x - x.mean(axis=0))
    motion.v[:] = start
    motion.sweep(0.0)
    step = 0.8 * motion.limit
    for k in range(100):
        motion.step((k + 1) * step, step)
        motion.end(step)
    # Small rotations go on for ever (strains are linear): measured 3e-14 of the velocity.
    assert np.abs(motion.v - start).max() < 1e-11 * np.abs(start).max()
    assert np.abs(motion.u - 100 * step * start).max() < 1e-11 * np.abs(motion.u).max()
    assert motion.elastic() < 1e-20 * motion.kinetic()[0]


@pytest.mark.parametrize("model", SPACE)
def test_verlet_keeps_its_own_energy_and_both_momenta(model):
    x, body = make_solid(model=model, perturb=0.1)
    motion = free(x, body, 7850.0 * body.volume)
    motion.v[:] = np.random.default_rng(1).normal(size=x.shape)
    motion.sweep(0.0)

    def both() -> np.ndarray:
        return np.concatenate([motion.mass @ motion.v, (motion.mass[:, None] * np.cross(x, motion.v)).sum(axis=0)])

    first, kept, step = both(), [], 0.9 * motion.limit
    speeds = motion.mass @ np.abs(motion.v)
    scale = np.concatenate([speeds, np.abs(x).max() * speeds])
    for k in range(100):
        motion.step((k + 1) * step, step)
        motion.end(step)
        kept.append(motion.kinetic()[0] + motion.elastic() - motion.ripple(step))
    # Theory, eq. 7.10: measured 6e-16, and 2e-15 of the momenta's terms.
    assert np.ptp(kept) < 1e-12 * kept[0]
    assert (np.abs(both() - first) < 1e-13 * scale).all()


@pytest.mark.parametrize("cells", ["hexahedron", "tetrahedron"])
def test_tractions_pull_on_faces_with_all_of_their_force(tmp_path, cells):
    asked = scene(tmp_path, {"mesh.cells": cells})
    nodes = nodes_of(asked)
    areas = {"left": 48e-6, "right": 48e-6, "bottom": 60e-6, "top": 60e-6, "front": 80e-6, "back": 80e-6}
    for face, area in areas.items():
        who, share = edge_areas(nodes, face, SIZE)
        assert share.sum() == pytest.approx(area, rel=1e-12) and share.min() > 0.0
        assert set(who) <= set(nodes.node_sets[face])
    case = build_case(asked, nodes)
    case.dynamics.sweep(0.0)
    assert case.dynamics.force.sum(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    pull = np.abs(case.dynamics.force).sum(axis=0)
    assert pull == pytest.approx([0.0, 2 * 60e6 * 60e-6, 2 * 5e6 * 60e-6], rel=1e-12, abs=1e-9)


CHANGES = {
    "traction": {},
    "front": {
        "loads": [
            {"on": "front", "velocity": {"z": {"0 us": "0 m/s", "4 us": "5 m/s"}}, "at": "nodes"},
            {"on": "back", "displacement": {"z": "0 mm"}},
            {"on": "left", "initial_velocity": {"z": "3 m/s"}},
        ],
        "stepping.damping": "2e4 s^-1",
    },
    "state-based": {"damage": {"criterion": "energy"}, "mechanics.model": "state-based"},
    "correspondence": {"mechanics.model": "correspondence", "mesh.cells": "tetrahedron"},
    "failures": {"damage": {"criterion": "energy"}},
    "stretch": {"damage": {"criterion": "stretch"}},
}


@pytest.mark.parametrize("name", CHANGES)
def test_the_energy_balance_closes_but_for_the_ripple_of_the_steps(tmp_path, name):
    result = simulate(case_of(tmp_path, CHANGES[name]))
    balance = energy_balance(result)
    largest = max(balance["kinetic"].max(), balance["elastic"].max())
    if "damage" in CHANGES[name]:
        assert result["broken_bonds"].values[-1] > 50
    # What is left is the swing of the steps (theory, eq. 7.10): measured 3e-5 to 1.1e-3.
    error = np.abs(balance["error"]).max()
    assert error < 3e-3 * largest
    fine = simulate(case_of(tmp_path, {**CHANGES[name], "stepping.safety": 0.2}))
    # Of second order: a sixteenth, 0.0625; measured 0.055 to 0.065.
    assert np.abs(energy_balance(fine)["error"]).max() < 0.08 * error
    assert result["velocity"].shape == (5, result["volume"].size, 3)


def test_a_running_crack_in_space_keeps_the_momentum_and_is_told_about(tmp_path):
    asked = scene(tmp_path, {"damage": {"criterion": "energy"}})
    nodes = nodes_of(asked)
    plan = make_plan(build_case(asked, nodes))
    assert "with inertia, density 2235 kg/m^3" in plan and "in space" in plan and "velocity Verlet" in plan
    solve_case(asked, nodes, tmp_path / "run.nc")
    with open_result(tmp_path / "run.nc") as result:
        momentum = 2235.0 * nodes.volume @ result["velocity"].values[-1]
        scale = 2235.0 * nodes.volume @ np.abs(result["velocity"].values[-1])
        assert result["broken_bonds"].values[-1] > 50 and "crack_tip_z" in result
        assert result["traction_top_z"].values[-1] == 5e6
    # Tractions are equal and opposite; measured 3e-17.
    assert np.abs(momentum).max() < 1e-11 * scale.max()
    assert "the balance is closed" in diagnose(tmp_path / "run.nc")


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({"loads.0.on": "notch"}, "loads.0.on", "front, back"),
        ({"material.density": None}, "material.density", "inertia needs it"),
        ({"loads.1": {"on": "top", "velocity": {"z": "1 m/s"}}}, "loads.0.traction.z", "is prescribed"),
        ({"loads.1.on": "top"}, "loads.1.traction.y", "second traction"),
        ({"loads.0": {"on": "back", "displacement": {"z": "1 mm"}}}, "loads.0.displacement.z", "jump at the start"),
        ({"mesh.cells": "triangle"}, "loads.0.traction.z", "out of its plane"),
        ({"mesh.cells": "triangle", "loads.0": {"on": "front", "traction": {"y": "1 MPa"}}}, "loads.0.on", "front"),
    ],
)
def test_motions_that_cannot_be_are_refused(tmp_path, changes, key, words):
    with pytest.raises(SceneError) as error:
        scene(tmp_path, changes)
    assert error.value.key == key and words in str(error.value), str(error.value)


def test_a_step_beyond_the_stable_one_is_refused(tmp_path):
    limit = case_of(tmp_path).dynamics.limit
    with pytest.raises(SceneError, match="stable step"):
        case_of(tmp_path, {"stepping.step": f"{1.01 * limit!r} s"})
    asked = scene(tmp_path, {"stepping.step": f"{0.99 * limit!r} s"})
    assert Scene.from_resolved(asked.resolved()) == asked
