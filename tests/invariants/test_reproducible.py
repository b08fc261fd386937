"""The same scene gives the same bits: on any number of threads, and every time."""

import numba
import numpy as np
import pytest

from pdhe.case import build_case
from pdhe.discretization import discretize
from pdhe.mesh import make_mesh
from pdhe.scene import load_scene
from pdhe.simulation import simulate

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
