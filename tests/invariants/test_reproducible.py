"""The same scene gives the same bits: on any number of threads, and every time."""

import os
import subprocess
import sys

import numba
import numpy as np
import pytest

from pdhe.case import build_case
from pdhe.discretization import discretize, read_discretization, write_discretization
from pdhe.mesh import make_mesh
from pdhe.provenance import canonical
from pdhe.scene import load_scene
from pdhe.simulation import simulate, solve_case

SCENES = {
    "regular": {"time.end": "6e6 s", "outputs.count": 4},
    "triangles": {"mesh.cells": "triangle", "time.end": "4e6 s", "outputs.count": 4},
}


@pytest.mark.parametrize("name", SCENES)
def test_same_bits_on_one_and_two_threads_and_again(name, tmp_path, monkeypatch):
    monkeypatch.setattr("pdhe.kernels.jit.BONDS_PER_THREAD", 1)
    scene = load_scene("config/scenes/smoke.yaml", SCENES[name])
    make_mesh(scene.geometry, scene.mesh, tmp_path / "a.msh")
    d = discretize(tmp_path / "a.msh", scene.geometry, scene.mesh)
    threads = [1, min(2, numba.config.NUMBA_NUM_THREADS), 1]
    results = []
    for count in threads:
        numba.set_num_threads(count)
        results.append(simulate(build_case(scene, d)))
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    assert results[0].broken_bonds.values[-1] > 0
    for other in results[1:]:
        for variable in results[0].variables:
            assert np.array_equal(
                results[0][variable].values, other[variable].values, equal_nan=variable.startswith("crack")
            )


def test_same_bytes_in_any_order_of_jobs(tmp_path):
    """What one process did before leaves no trace in a result, a mesh or a file of nodes."""
    scenes = {
        name: load_scene("config/scenes/smoke.yaml", {"mesh.spacing": "20 mm", **SCENES[name]}) for name in SCENES
    }
    for folder, order in (("there", list(SCENES)), ("back", list(SCENES)[::-1])):
        (tmp_path / folder).mkdir()
        for name in order:
            mesh, nodes, result = (tmp_path / folder / f"{name}.{end}" for end in ("msh", "nodes", "nc"))
            make_mesh(scenes[name].geometry, scenes[name].mesh, mesh)
            write_discretization(discretize(mesh, scenes[name].geometry, scenes[name].mesh), nodes)
            solve_case(scenes[name], read_discretization(nodes), result)
    files = sorted(path.name for path in (tmp_path / "there").iterdir())
    assert len(files) == 3 * len(SCENES)
    assert all((tmp_path / "there" / name).read_bytes() == (tmp_path / "back" / name).read_bytes() for name in files)


@pytest.mark.slow
def test_same_bytes_from_a_cold_cache_of_kernels(tmp_path):
    """Compiled anew, in a process of its own; the warm one is that of all tests."""
    scene = load_scene("config/scenes/smoke.yaml", {"mesh.spacing": "20 mm", **SCENES["regular"]})
    make_mesh(scene.geometry, scene.mesh, tmp_path / "a.msh")
    write_discretization(discretize(tmp_path / "a.msh", scene.geometry, scene.mesh), tmp_path / "a.nc")
    spec = canonical(scene.resolved())
    words = ["solve", "--spec", spec, "--nodes", str(tmp_path / "a.nc"), "--out", str(tmp_path / "r.nc")]
    written = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-m", "pdhe", *words],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        written.append((tmp_path / "r.nc").read_bytes())
        (tmp_path / "r.nc").unlink()
    assert written[0] == written[1] and any((tmp_path / "cache").rglob("*.nbc"))
