"""Fracture energies that differ from one part of the plate to another, and those of interfaces."""

import json

import numpy as np
import pytest

from pdhe.case import build_case
from pdhe.errors import SceneError
from pdhe.plan import make_plan
from pdhe.scene import Scene
from pdhe.simulation import simulate
from pdhe.verification.slabs import nodes_of, plate_scene

SPACING, SIDE, THICKNESS = 1e-3, 16, 4e-3
HALF = 0.5 * SIDE * SPACING
TOUGHNESS = 1000.0
LOWER = {"name": "lower", "from": [0.0, 0.0], "to": [SIDE * SPACING, HALF]}
UPPER = {"name": "upper", "from": [0.0, HALF], "to": [SIDE * SPACING, SIDE * SPACING]}
WEAK = {"between": ["lower", "upper"], "factor": 0.1}


def ramp(**largest):
    return {axis: {"times": [0.0, 1.0], "values": [0.0, value]} for axis, value in largest.items()}


def scene_of(damage=None, pull=(2e-6, 2e-6), **blocks):
    loads = [
        {"on": on, "displacement": ramp(x=sign * pull[0], y=sign * pull[1])}
        for on, sign in (("top", 1), ("bottom", -1))
    ]
    scene = plate_scene(SIDE * SPACING, SIDE * SPACING, SPACING, {}, 1.0, loads=loads, regions=[LOWER, UPPER],
                        damage=damage or {}, **blocks)  # fmt: skip
    plain = scene.resolved()
    plain.pop("hydrogen")
    material = plain["material"]
    del material["fracture_toughness"]
    material["critical_energy_release_rate"] = TOUGHNESS
    return Scene.from_resolved(plain)


def case_of(damage=None, **blocks):
    scene = scene_of(damage, **blocks)
    return build_case(scene, nodes_of(scene))


def test_without_them_there_is_no_array():
    assert case_of().rule.squares == ()


def test_each_end_of_a_bond_gives_half_of_its_fracture_energy():
    own = {"on": "lower", "critical_energy_release_rate": 0.25 * TOUGHNESS}
    case = case_of({"regions": [{"on": "all", "factor": 4.0}, own]})
    y = case.discretization.coordinates[:, 1]
    node = np.where(y < HALF, 0.25, 4.0)
    owner = case.bonds.owners()
    expected = 0.5 * (node[owner] + node[case.bonds.neighbours])
    assert case.rule.factor() ** 2 == pytest.approx(expected, rel=1e-13)
    assert case.rule.critical == case_of().rule.critical
    assert "fracture energy 0.25 to 4 times that of the material" in make_plan(case)


def work_of_separation(case):
    """Energy of the bonds across the middle of the plate at their critical stretch, over the area they cross.

    Those whose middle lies in the inner columns: as many per column as in an endless plate.
    """
    b, x = case.bonds, case.discretization.coordinates
    owner, far = b.owners(), b.neighbours
    across = (x[owner, 1] < HALF) & (x[far, 1] > HALF)
    middle = 0.5 * (x[owner, 0] + x[far, 0]) / SPACING
    inner = np.flatnonzero(across & (middle > 4.25) & (middle < 12.25))
    stretch = np.broadcast_to(case.rule.resistance_at(None, inner), inner.shape)
    energy = 0.5 * case.body.normal * b.weight[inner] * b.length[inner] * stretch**2
    return float(energy.sum() / (8 * SPACING * THICKNESS))


def test_an_interface_takes_the_energy_of_the_table():
    # All bonds alike: moment matching makes those near the edges of so small a plate count in the calibration.
    bare, table = {"mechanics": {"weights": "none"}}, 120.0
    interface = {"between": ["lower", "upper"], "critical_energy_release_rate": table}
    plain, found = work_of_separation(case_of(**bare)), work_of_separation(case_of({"interfaces": [interface]}, **bare))
    # Cracks along rows take a little more than those in the weakest direction of the lattice: measured 1.8 %.
    assert found == pytest.approx(table, rel=0.03)
    assert found / plain == pytest.approx(table / TOUGHNESS, rel=1e-13)


def test_the_order_of_the_two_sides_does_not_matter_and_all_is_what_is_outside():
    factors = [
        case_of({"interfaces": [{"between": pair, "factor": 0.1}]}).rule.factor()
        for pair in (["lower", "upper"], ["upper", "lower"], ["lower", "all"], ["all", "upper"])
    ]
    assert all(np.array_equal(factors[0], other) for other in factors[1:])
    assert 0 < np.count_nonzero(factors[0] < 0.5) < factors[0].size


NOTCH = {"cracks": [{"name": "notch", "from": [0.0, HALF], "to": [5 * SPACING, HALF]}]}


def broken_away_from_the_interface(damage):
    # No bond at the grips breaks. Shear beside tension turns the crack of a plain plate off the line of the notch.
    damage = {"no_fail": ["top", "bottom"], **damage}
    scene = scene_of(damage, pull=(1.2e-5, 1.2e-5), geometry=NOTCH)
    case = build_case(scene, nodes_of(scene))
    result = simulate(case)
    owner, y = case.bonds.owners(), case.discretization.coordinates[:, 1]
    broken = np.concatenate(case.body.broken)
    beside = (y[owner[broken]] - HALF) * (y[case.bonds.neighbours[broken]] - HALF) > 0
    return broken.size, int(beside.sum()), result


def test_a_crack_follows_a_weak_interface():
    plain = broken_away_from_the_interface({})
    broken, beside, result = broken_away_from_the_interface({"interfaces": [WEAK]})
    area = (SIDE - 5) * SPACING * THICKNESS
    taken = float(result["fracture_energy"].values[-1]) / (area * TOUGHNESS * WEAK["factor"])
    # Bonds with both ends on one side of the line: 24 of 206 without the interface, none of 182 with it.
    assert plain[1] > 0.1 * plain[0]
    assert beside == 0 and broken > 0
    # The plate comes apart, and that takes what the table says: measured 1.006, where bonds break in groups of 5 %.
    assert taken == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("damage", "key", "text"),
    [
        ({"regions": [{"on": "weld", "factor": 0.5}]}, "damage.regions.0.on", "not a node set"),
        ({"regions": [{"on": "lower"}]}, "damage.regions.0", "needs either"),
        ({"regions": [{"on": "all", "factor": 2, "critical_energy_release_rate": 1.0}]}, "damage.regions.0", "either"),
        ({"regions": [{"on": "lower", "factor": 0.0}]}, "damage.regions.0.factor", "between 1e-6 and 1e6"),
        ({"regions": [{"on": "lower", "factor": 2.0}] * 2}, "damage.regions.1.on", "listed twice"),
        ({"regions": []}, "damage.regions", "empty list"),
        ({"interfaces": []}, "damage.interfaces", "empty list"),
        ({"interfaces": [{"between": ["lower"], "factor": 2.0}]}, "damage.interfaces.0.between", "two node sets"),
        ({"interfaces": [{"between": ["lower", "lower"], "factor": 2.0}]}, "damage.interfaces.0.between", "twice"),
        ({"interfaces": [{"between": ["all", "weld"], "factor": 2}]}, "damage.interfaces.0.between", "not a node set"),
        (
            {"interfaces": [WEAK, WEAK | {"between": ["upper", "lower"]}]},
            "damage.interfaces.1.between",
            "listed twice",
        ),
    ],
)  # fmt: skip
def test_contradictions_are_refused_when_the_scene_is_read(damage, key, text):
    with pytest.raises(SceneError) as caught:
        scene_of(damage)
    assert caught.value.key == key and text in str(caught.value), json.dumps(str(caught.value))


@pytest.mark.parametrize(
    ("interface", "text"),
    [
        ({"between": ["bottom", "lower"], "factor": 0.5}, f"share {SIDE} nodes"),
        ({"between": ["bottom", "top"], "factor": 0.5}, "no bond leads"),
    ],
)
def test_interfaces_that_this_mesh_cannot_have_are_refused(interface, text):
    with pytest.raises(SceneError, match=text) as caught:
        case_of({"interfaces": [interface]})
    assert caught.value.key == "damage.interfaces.0.between"


def test_sets_without_nodes_are_refused():
    thin = {"name": "thin", "from": [0.0, 1.1 * SPACING], "to": [HALF, 1.2 * SPACING]}
    scene = scene_of({}).resolved()
    scene["regions"].append(thin)
    scene["damage"]["regions"] = [{"on": "thin", "factor": 0.5}]
    scene = Scene.from_resolved(scene)
    with pytest.raises(SceneError, match="node set is empty"):
        build_case(scene, nodes_of(scene))


def test_a_disc_names_the_nodes_inside_it_and_has_an_interface():
    plain = scene_of().resolved()
    plain["regions"].append({"name": "grain", "centre": [HALF, HALF], "radius": 3.6 * SPACING})
    plain["damage"]["interfaces"] = [{"between": ["grain", "all"], "factor": 0.1}]
    scene = Scene.from_resolved(plain)
    assert Scene.from_resolved(scene.resolved()) == scene
    case = build_case(scene, nodes_of(scene))
    inside = np.hypot(*(case.discretization.coordinates - HALF).T) <= 3.6 * SPACING
    assert np.array_equal(case.discretization.node_sets["grain"], np.flatnonzero(inside))
    across = inside[case.bonds.owners()] != inside[case.bonds.neighbours]
    assert case.rule.factor() ** 2 == pytest.approx(np.where(across, 0.1, 1.0), rel=1e-13)


@pytest.mark.parametrize(
    "shape", [{"centre": [HALF, HALF]}, {"radius": HALF}, {"radius": HALF, "from": [0.0, 0.0]}, {}]
)
def test_half_a_shape_is_refused(shape):
    plain = scene_of().resolved()
    plain["regions"].append({"name": "grain", **shape})
    with pytest.raises(SceneError, match="needs either `from` and `to` or"):
        Scene.from_resolved(plain)
