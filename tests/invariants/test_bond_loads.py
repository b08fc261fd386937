"""What decides on failure: stretches or energies, of stretched bonds alone or of shortened ones too."""

import numpy as np
import pytest

from pdhe.benchmarks.problems import mode_i
from pdhe.damage import Candidates, FailureRule
from pdhe.materials import MODELS, Body, BondLoad
from pdhe.simulation import simulate
from tests.lattices import make_body
from tests.solids import make_solid

LOADS = {
    "energy": BondLoad(True),
    "stretch": BondLoad(False),
    "energy, compression too": BondLoad(True, tension_only=False),
    "stretch, compression too": BondLoad(False, tension_only=False),
}
SOLID = ("condensed rotation", "state-based", "correspondence")
BODIES = [(name, make_body) for name in MODELS] + [(name, make_solid) for name in SOLID]
EACH_BODY = pytest.mark.parametrize(
    ("model", "make"), BODIES, ids=[f"{name}, {make.__name__}" for name, make in BODIES]
)


@EACH_BODY
def test_the_search_node_by_node_sees_the_load_of_every_bond(model, make):
    x, body = make(model=model, perturb=0.1, break_share=0.1)
    random = np.random.default_rng(0)
    u, resistance = random.normal(size=x.shape) * 1e-6, random.uniform(1.0, 2.0, len(x))
    breakable = body.intact & (np.arange(body.intact.size) % 3 > 0)
    for load in LOADS.values():
        top, _ = body.largest_ratios(u, load, breakable, resistance)
        expected, _ = Body.largest_ratios(body, u, load, breakable, resistance)
        assert np.count_nonzero(expected) > 0.9 * len(x)
        # The same terms in another order, and squares that nearly cancel: measured 1e-12.
        np.testing.assert_allclose(top, expected, rtol=1e-9)


@EACH_BODY
def test_shortened_bonds_have_the_loads_of_stretched_ones_or_none(model, make):
    x, body = make(model=model, perturb=0.1, break_share=0.1)
    u = np.random.default_rng(0).normal(size=x.shape) * 1e-6
    for kind in ("energy", "stretch"):
        tension, both = LOADS[kind], LOADS[f"{kind}, compression too"]
        pulled, pushed = body.bond_loads(u, tension), body.bond_loads(-u, tension)
        assert not (pulled * pushed).any() and (pulled > 0.0).any() and (pushed > 0.0).any()
        # All signs turn at once, and squares stay: no rounding in between.
        assert np.array_equal(body.bond_loads(u, both), pulled + pushed)
        assert np.array_equal(body.bond_loads(-u, both), body.bond_loads(u, both))


def test_no_failure_is_missed_where_shortened_bonds_count():
    """Loads are norms of what is linear in the displacements, hence convex in between, whatever the path."""
    x, body = make_body(nu=0.2, perturb=0.1)
    u0, u1 = np.random.default_rng(4).normal(size=(2, *x.shape)) * 1e-6
    may = body.bonds.once()
    for kind in ("energy", "stretch"):
        load = LOADS[f"{kind}, compression too"]
        between = np.max([body.bond_loads((1.0 - t) * u0 + t * u1, load) for t in np.linspace(0.0, 1.0, 41)], axis=0)
        rule = FailureRule(float(np.quantile(between, 0.7)), 1.0, load, None, may)
        beyond = np.flatnonzero(may & (between >= rule.critical * (1.0 + 1e-12)))
        assert beyond.size > 100
        assert set(beyond) <= set(Candidates(body, rule, u0, u1).bond)


DRY = {"hydrogen": None, "time.end": "1 h", "stepping.grouping": 0.1}


def pulled(way, changes):
    loads = [
        {"on": edge, "displacement": {"y": {"0 h": "0 mm", "1 h": f"{sign * way} mm"}}}
        for edge, sign in (("top", 1.0), ("bottom", -1.0))
    ]
    return simulate(mode_i(800, DRY | {"loads": loads} | changes))


@pytest.mark.parametrize("criterion", ["energy", "stretch"])
def test_a_plate_that_may_break_under_compression_breaks_as_under_tension(criterion):
    off = {"damage.criterion": criterion, "damage.tension_only": False}
    opened, closed = (pulled(way, off) for way in (0.09, -0.09))
    assert 10 < opened["broken_bonds"].values[-1] == closed["broken_bonds"].values[-1]
    assert np.array_equal(opened["displacement"].values, -closed["displacement"].values)
    usual = {"damage.criterion": criterion}
    assert pulled(-0.09, usual)["broken_bonds"].values[-1] == 0
    assert pulled(0.09, usual)["broken_bonds"].values[-1] > 10
