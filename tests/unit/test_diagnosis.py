"""Runs explained: what is said is what holds."""

import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from pdhe import cli
from pdhe.benchmarks.problems import lattice_nodes
from pdhe.diagnosis import diagnose, nearest_to_failure, rebuild
from pdhe.discretization import discretize
from pdhe.errors import PdheError
from pdhe.mesh import make_mesh
from pdhe.results import open_result
from pdhe.scene import load_scene
from pdhe.simulation import solve_case

SCENE = Path(__file__).parents[2] / "config/scenes/smoke.yaml"
COARSE = {"mesh.spacing": "10 mm", "outputs.count": 3}


def solved(path, **changes):
    scene = load_scene(SCENE, {**COARSE, **changes})
    solve_case(scene, lattice_nodes(scene), path, command="pdhe solve")
    with open_result(path) as result:
        return result.load()


@pytest.fixture(scope="module")
def wet(tmp_path_factory):
    path = tmp_path_factory.mktemp("wet") / "wet.nc"
    return path, solved(path)


@pytest.fixture(scope="module")
def dry(tmp_path_factory):
    path = tmp_path_factory.mktemp("dry") / "dry.nc"
    return path, solved(path, hydrogen=None)


def test_a_crack_that_grew(wet, capsys):
    path, result = wet
    assert cli.main(["diagnose", str(path)]) == 0
    told = capsys.readouterr().out
    assert f"{int(result.broken_bonds[-1])} bonds broke between" in told
    assert f"the crack grew by {1e3 * float(result.crack_extension[-1]):.4g} mm" in told
    assert "held by bonds as they broke" in told and "the balance is closed: error" in told
    assert f"{int(result.equilibrium_solves[-1])} equilibria" in told and "pdhe solve" in told
    entries, failures, outputs, corners = map(int, re.findall(r"(\d+)(?: history| ended| by an| by a c)", told))
    assert entries == result.sizes["step"] == failures + outputs + corners


def test_the_rebuilt_case_is_the_one_that_ran(wet, dry):
    for _, result in (wet, dry):
        near = nearest_to_failure(result, rebuild(result))
        # The history has it from the coverage in double precision; the result holds single precision, 6e-8.
        assert near.ratio == pytest.approx(float(result.largest_load[-1]), rel=1e-6)
    # The solver's tolerance is relative to the largest forces in equilibrium; the last ones may be smaller than those.
    forces = re.search(r"forces on free nodes are (\S+) of", diagnose(wet[0]))
    assert float(forces[1]) < 2.0 * rebuild(wet[1]).scene.solver.tolerance


def test_irregular_meshes_are_rebuilt_as_well(tmp_path):
    scene = load_scene(SCENE, COARSE | {"mesh.cells": "triangle"})
    make_mesh(scene.geometry, scene.mesh, tmp_path / "plate.msh")
    solve_case(scene, discretize(tmp_path / "plate.msh", scene.geometry, scene.mesh), tmp_path / "result.nc")
    with open_result(tmp_path / "result.nc") as result:
        near = nearest_to_failure(result.load(), rebuild(result))
        assert near.ratio == pytest.approx(float(result.largest_load[-1]), rel=1e-6)


def test_the_load_that_would_break_a_bond_breaks_it(dry, tmp_path):
    path, result = dry
    told = diagnose(path)
    assert "nothing broke" in told
    factor = float(re.search(r"it breaks at (\S+) times the load", told)[1])
    assert factor == pytest.approx(1.0 / float(result.largest_load[-1]), rel=1e-3)  # four digits are shown
    top = float(result.applied_top_y[-1])
    for share, broke in ((0.999, False), (1.001, True)):
        value = f"{share * factor * top!r} m"
        loads = {f"loads.{k}.displacement.y": sign + value for k, sign in enumerate(("", "-"))}
        again = solved(tmp_path / f"{broke}.nc", hydrogen=None, **loads)
        assert (int(again.broken_bonds[-1]) > 0) is broke


def test_the_coverage_that_would_break_a_bond_breaks_it(tmp_path):
    """Hydrogen everywhere alike: one number decides."""
    still = {"hydrogen.boundary": [], "hydrogen.saturation": None}
    result = solved(tmp_path / "low.nc", **still, **{"hydrogen.initial": 0.1})
    near = nearest_to_failure(result, rebuild(result))
    assert int(result.broken_bonds[-1]) == 0 and near.coverage == pytest.approx(0.1, abs=1e-7)
    for change, broke in ((-1e-4, False), (1e-4, True)):
        again = solved(tmp_path / f"{broke}.nc", **still, **{"hydrogen.initial": near.needed + change})
        assert (int(again.broken_bonds[-1]) > 0) is broke


def test_absent_physics_is_said(tmp_path):
    solved(tmp_path / "dry.nc", damage=None, hydrogen=None)
    told = diagnose(tmp_path / "dry.nc")
    assert "bonds cannot break" in told and "the balance is closed" in told and "hydrogen:" not in told
    solved(tmp_path / "still.nc", loads=None, damage=None)
    told = diagnose(tmp_path / "still.nc")
    assert "energy:" not in told and "entered through edges" in told


def test_damage_of_other_code_is_told(wet, tmp_path):
    changed = wet[1].copy(deep=True)
    changed["damage"].values[-1, 3] += 1e-3
    with pytest.raises(PdheError, match="the damage of its bonds differs by 0\\.001"):
        rebuild(changed)
    changed.attrs.pop("content_sha256", None)
    changed.to_netcdf(tmp_path / "changed.nc")
    assert "the bonds at the end cannot be built again: the damage" in diagnose(tmp_path / "changed.nc")


def test_open_balances_are_told(wet, tmp_path):
    changed = wet[1].copy(deep=True)
    changed["hydrogen_influx"].values[-1] *= 1.01
    changed["external_work"].values[-1] *= 0.9
    changed.attrs.pop("content_sha256", None)
    changed.to_netcdf(tmp_path / "open.nc")
    told = diagnose(tmp_path / "open.nc")
    assert told.count("the balance is open") == 2
    with pytest.raises(PdheError, match="no such result"):
        diagnose(tmp_path / "none.nc")
    assert isinstance(changed, xr.Dataset) and np.isfinite(changed["damage"]).all()
