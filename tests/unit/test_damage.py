"""The search for bonds that could fail, against looking at every bond."""

import numpy as np
import pytest

from pdhe.benchmarks.problems import mode_i
from pdhe.damage import Candidates, nearest_failure


@pytest.fixture(scope="module", params=["stretch", "energy"])
def case(request):
    return mode_i(800, {"damage.criterion": request.param})


def every_bond(case, u, psi):
    """Load and resistance of every bond that may break."""
    b = case.bonds
    owner = b.owners()
    load = case.body.bond_loads(u, case.rule.by_energy)
    mean = None if psi is None else 0.5 * (psi[owner] + psi[b.neighbours])
    return np.where(case.rule.may_fail & case.body.intact, load, 0.0), case.rule.resistance_at(mean)


@pytest.fixture(scope="module")
def fields(case):
    random = np.random.default_rng(3)
    n = case.discretization.volume.size
    u = [scale * random.normal(size=(n, 2)) for scale in (2e-6, 3e-6)]
    return *u, random.uniform(size=n)


def test_candidates_are_the_bonds_whose_load_reaches_the_least_resistance(case, fields):
    u0, u1, psi = fields
    loads = [every_bond(case, u, psi)[0] for u in (u0, u1)]
    held, moving = Candidates(case.body, case.rule, u0, u0), Candidates(case.body, case.rule, u0, u1)
    assert 0 < held.bond.size < np.count_nonzero(loads[0])
    assert np.array_equal(held.bond, np.flatnonzero(loads[0] >= case.rule.weakest))
    assert np.array_equal(moving.bond, np.flatnonzero(np.maximum(*loads) >= case.rule.weakest))
    assert moving.load(1.0) == pytest.approx(loads[1][moving.bond], rel=1e-9, abs=1e-12)


def test_candidates_at_a_coverage_hold_every_critical_bond(case, fields):
    u, _, psi = fields
    load, resistance = every_bond(case, u, psi)
    few = Candidates(case.body, case.rule, u, u, psi)
    critical = np.flatnonzero(load >= resistance)
    assert critical.size > 0
    assert set(critical) <= set(few.bond)
    assert few.bond.size < Candidates(case.body, case.rule, u, u).bond.size


@pytest.mark.parametrize("scale", [1e-6, 1.0])
@pytest.mark.parametrize("wet", [False, True])
def test_nearest_failure_is_the_largest_load_over_resistance(case, fields, scale, wet):
    psi = fields[2] if wet else None
    load, resistance = every_bond(case, scale * fields[0], psi)
    found = nearest_failure(case.body, case.rule, scale * fields[0], psi)
    # The same sums in another order: measured 4e-15.
    assert found == pytest.approx((load / resistance).max(), rel=1e-12)
