"""What a scene does not ask for costs nothing: no arrays, no sweeps, no variables; what may not fail is not asked."""

from dataclasses import fields, replace

import numpy as np
import pytest

from pdhe import damage
from pdhe.benchmarks.memory import arrays_of
from pdhe.benchmarks.problems import SCENE, lattice_nodes
from pdhe.case import build_case
from pdhe.damage import Candidates, nearest_failure
from pdhe.plan import make_plan
from pdhe.scene import Scene, load_scene
from pdhe.simulation import mesh_case, simulate

GRADED = SCENE.with_name("mode_i_graded.yaml")
NODES = 800
BLOCKS = {
    "elastic": ("loads",),
    "dry": ("loads", "damage"),
    "diffusion": ("hydrogen",),
    "coupled": ("loads", "damage", "hydrogen"),
}
COUNTS = {
    "loads": {"equilibrium_solves", "equilibrium_iterations", "force_sweeps", "elastic_energy", "displacement"},
    "damage": {"failure_rounds", "broken_bonds", "fracture_energy", "largest_load", "damage"},
    "hydrogen": {"diffusion_sweeps", "diffusion_iterations", "hydrogen_content", "coverage"},
}


@pytest.fixture(scope="module")
def cases():
    content = load_scene(SCENE, {"mesh.spacing": "5 mm", "outputs": {"count": 20}}).resolved()
    made = {}
    for name, blocks in BLOCKS.items():
        kept = {key: value for key, value in content.items() if key in blocks or key not in COUNTS}
        scene = Scene.from_resolved(kept)
        made[name] = build_case(scene, lattice_nodes(scene))
    return made


def test_arrays_are_those_of_the_physics_that_is_on(cases):
    held = {}
    for name, case in cases.items():
        bonds = case.bonds.neighbours.size
        held[name] = {key: array.nbytes / bonds for key, array in arrays_of(case) if array.size >= 0.9 * bonds}
        parts = {"loads": "equilibrium.", "damage": "rule.", "hydrogen": "diffusion."}
        for block, part in parts.items():
            assert any(key.startswith(part) for key in held[name]) == (block in BLOCKS[name]), (name, block)
        for part in ("equilibrium", "conditions", "rule", "diffusion"):
            needed = {"equilibrium": "loads", "conditions": "loads", "rule": "damage", "diffusion": "hydrogen"}[part]
            assert (getattr(case, part) is None) == (needed not in BLOCKS[name])
    total = {name: sum(sizes.values()) for name, sizes in held.items()}
    # Measured 61, 62, 22 and 70 bytes a directed bond.
    assert total["elastic"] < total["dry"] < total["coupled"]
    assert total["dry"] - total["elastic"] == pytest.approx(1.0)  # whether a bond may fail
    assert total["diffusion"] < 0.5 * total["coupled"]


def test_the_plan_names_the_fields_and_the_reasons(cases):
    named = {"loads": ("displacement", "intact"), "damage": ("damage", "may fail"), "hydrogen": ("coverage", "rate")}
    reasons = {"loads": "mechanics: on (the scene has loads)", "damage": "damage: on (the scene has a damage block)",
               "hydrogen": "hydrogen: on (the scene has a hydrogen block)"}  # fmt: skip
    for name, case in cases.items():
        plan = make_plan(case)
        (line,) = (line for line in plan.splitlines() if line.startswith("fields: "))
        for block, fields_of_it in named.items():
            for field in fields_of_it:
                assert (field in line) == (block in BLOCKS[name]), (name, field, line)
            assert (reasons[block] in plan) == (block in BLOCKS[name])


def test_what_follows_from_the_horizon_is_not_kept_a_second_time():
    """On a graded mesh critical stretches differ from bond to bond; damage still adds one byte to each."""
    case = mesh_case(load_scene(GRADED, {"mesh.refine.0.spacing": "1 mm"}))
    bonds = case.bonds.neighbours.size
    held = {key: array.nbytes / bonds for key, array in arrays_of(case) if array.size >= 0.9 * bonds}
    assert {key for key in held if key.startswith("rule.")} == {"rule.may_fail"}
    assert case.rule.squares[0] is case.bonds.fineness and case.rule.factor().max() > 1.2
    # Measured 67; 75 with the factors kept.
    assert sum(held.values()) < 69.0


def test_work_and_results_are_those_of_the_physics_that_is_on(cases):
    for name, case in cases.items():
        result = simulate(case)
        for block, variables in COUNTS.items():
            present = variables & set(result.variables)
            assert present == (variables if block in BLOCKS[name] else set()), (name, block)
        if "damage" not in BLOCKS[name] and "loads" in BLOCKS[name]:
            # At rest, and at the corner of the load: what lies between is a multiple, and what follows the same.
            assert result.equilibrium_solves.values[-1] == 2
            assert result.equilibrium_iterations.values[-1] > 5 and result.sizes["time"] == 21
            # Held after a third of the time: the energy goes with the square of the load up to there.
            share = np.minimum(result.history_time.values / 2e6, 1.0)
            energy = result.elastic_energy.values
            assert energy == pytest.approx(share**2 * energy[-1], rel=1e-9)


def test_a_region_that_may_not_fail_is_not_looked_at(cases, monkeypatch):
    """Loads of its bonds are never compared, and it adds no array: one bit array tells which bonds are asked."""
    case = cases["dry"]
    bonds, x = case.bonds, case.discretization.coordinates
    near = np.abs(x[:, 0] - 0.05) < 0.02
    rule = replace(case.rule, may_fail=case.rule.may_fail & near[bonds.owners()] & near[bonds.neighbours])
    assert 0 < rule.may_fail.sum() < 0.3 * case.rule.may_fail.sum()
    per_bond = [f.name for f in fields(rule) if getattr(getattr(rule, f.name), "size", 0) == bonds.neighbours.size]
    assert per_bond == ["may_fail"] and rule.may_fail.dtype == bool
    asked = []
    load_of = damage.load_of
    monkeypatch.setattr(damage, "load_of", lambda parts, *rest: asked.append(parts.shape[1]) or load_of(parts, *rest))
    u = 1e-4 * np.random.default_rng(0).normal(size=x.shape)
    found = Candidates(case.body, rule, u, u)
    assert 0 < found.bond.size <= rule.may_fail.sum() and np.all(rule.may_fail[found.bond])
    nearest_failure(case.body, rule, u, None)
    assert 0 < max(asked) <= rule.may_fail.sum()
    # Displacements of the region beyond, however large, are seen by no search: rotations reach two families far.
    far = np.abs(x[:, 0] - 0.05) > 0.02 + 2.5 * bonds.horizon
    assert far.any()
    wild = np.where(far[:, None], 1e3 * u, u)
    again = Candidates(case.body, rule, wild, wild)
    assert np.array_equal(again.bond, found.bond) and np.array_equal(again.load(0.0), found.load(0.0))
