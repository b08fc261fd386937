"""Diffusivities that differ from one part of the plate to another: resistances in a row, nothing lost or overshot."""

import numpy as np
import pytest
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import spsolve

from pdhe.errors import SceneError
from pdhe.verification.slabs import DIFFUSIVITY, LENGTH, case_of, plate_scene, rate_of_change, strip_scene


def layered(columns, factor, boundary, **own):
    """A slab whose right half has another diffusivity."""
    right = {"name": "slow", "from": [0.5 * LENGTH, 0.0], "to": [LENGTH, LENGTH]}
    hydrogen = {"regions": [{"on": "slow", **(own or {"factor": factor})}]}
    return case_of(strip_scene(columns, boundary, 1.0, regions=[right], hydrogen=hydrogen))


def steady(case, coverage):
    """Coverage of the steady state, and the flow in through the left edge over its area, m/s."""
    diffusion = case.diffusion
    bonds, n = diffusion.bonds, diffusion.volume.size
    rate = coo_matrix((diffusion.rate, (bonds.owners(), bonds.neighbours)), (n, n)).tocsr()
    matrix = rate - diags(np.asarray(rate.sum(axis=1)).ravel() + diffusion.sink())
    psi = spsolve(matrix.tocsc(), -diffusion.source(coverage))
    flow = float((diffusion.exchange["left"] * (coverage["left"] - psi) * diffusion.volume).sum())
    d = case.discretization
    return psi, flow / (case.scene.geometry.height * d.thickness)


EDGES = {"left": 1.0, "right": 0.0}


@pytest.mark.parametrize("factor", [0.2, 5.0, 1e-6, 1e6])
def test_the_steady_flux_is_that_of_resistances_in_a_row(factor):
    flux = DIFFUSIVITY / (0.5 * LENGTH * (1.0 + 1.0 / factor))
    found = [steady(layered(columns, factor, EDGES), EDGES) for columns in (20, 40)]
    errors = [abs(measured / flux - 1.0) for _, measured in found]
    # The border is as sharp as the horizon: measured 0.69 % and 0.34 % for 5, 1.59 % and 0.79 % for 1e6 and either way.
    assert errors[0] < 0.02 and errors[1] < 0.55 * errors[0]
    psi = found[1][0]
    assert psi.min() > 0.0 and psi.max() < 1.0


@pytest.mark.parametrize("factor", [0.2, 1e6])
def test_nothing_is_lost_and_a_uniform_coverage_stays(factor):
    case = layered(20, factor, {})
    diffusion = case.diffusion
    psi = np.random.default_rng(0).uniform(size=diffusion.volume.size)
    change = diffusion.volume * rate_of_change(diffusion, psi)
    assert abs(change.sum()) < 1e-13 * np.abs(change).sum()
    assert np.array_equal(rate_of_change(diffusion, np.ones_like(psi)), np.zeros_like(psi))
    assert np.all(diffusion.rate >= 0.0)


def test_a_value_is_the_factor_that_it_makes():
    one, other = layered(20, 0.25, EDGES).diffusion, layered(20, None, EDGES, diffusivity=0.25 * DIFFUSIVITY).diffusion
    assert np.array_equal(one.rate, other.rate) and np.array_equal(one.exchange["right"], other.exchange["right"])


@pytest.mark.parametrize(
    ("regions", "key", "text"),
    [
        ([], "hydrogen.regions", "empty list"),
        ([{"on": "slow"}], "hydrogen.regions.0", "needs either"),
        ([{"on": "slow", "factor": 1.0, "diffusivity": 1.0}], "hydrogen.regions.0", "needs either"),
        ([{"on": "slow", "factor": 1e9}], "hydrogen.regions.0.factor", "between"),
        ([{"on": "slwo", "factor": 2.0}], "hydrogen.regions.0.on", "did you mean `slow`"),
        ([{"on": "slow", "factor": 2.0}] * 2, "hydrogen.regions.1.on", "listed twice"),
    ],
)
def test_contradictions_are_refused(regions, key, text):
    slow = {"name": "slow", "from": [0.5 * LENGTH, 0.0], "to": [LENGTH, LENGTH]}
    with pytest.raises(SceneError) as caught:
        strip_scene(20, EDGES, 1.0, regions=[slow], hydrogen={"regions": regions})
    assert caught.value.key == key and text in str(caught.value)


def test_the_sweep_over_a_lattice_takes_the_rates_of_every_bond():
    slow = {"name": "slow", "from": [0.0, 0.0], "to": [0.01, 0.02]}
    hydrogen = {"regions": [{"on": "slow", "factor": 0.1}]}
    case = case_of(plate_scene(0.03, 0.03, 1e-3, EDGES, 1.0, regions=[slow], hydrogen=hydrogen))
    diffusion, n = case.diffusion, case.diffusion.volume.size
    assert diffusion.bonds.lattice is not None
    psi, new, held = np.random.default_rng(0).uniform(size=n), np.empty(n), np.zeros(n, bool)
    step, source = diffusion.stable_step(held), diffusion.source(EDGES)
    diffusion.step(psi, step, held, source, new, np.zeros(n))
    # The same sums in another order: measured 2e-16.
    np.testing.assert_allclose(
        new, psi + step * (rate_of_change(diffusion, psi) + source - diffusion.sink() * psi), rtol=0.0, atol=1e-14
    )
