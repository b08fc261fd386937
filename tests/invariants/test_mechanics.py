"""What every bond model must satisfy, whatever its parameters; loops over the registry."""

import numpy as np
import pytest

from pdhe.materials import BY_ENERGY, MODELS
from tests.lattices import make_body

STATES = {
    "regular": {},
    "perturbed": {"perturb": 0.2},
    "damaged": {"perturb": 0.2, "break_share": 0.2},
    "negative tangential": {"nu": 0.42, "perturb": 0.1, "break_share": 0.1},
    "auxetic": {"nu": -0.5, "perturb": 0.1},
}
OBJECTIVE = [name for name, model in MODELS.items() if model.objective]


def scale_of(body, u) -> float:
    """Force that the bonds of a node would carry one by one: the elastic scale against which zero is judged."""
    return float(np.abs(body.diagonal()).max() * np.abs(u).max())


@pytest.fixture(params=STATES, ids=list(STATES))
def options(request):
    return STATES[request.param]


@pytest.mark.parametrize("model", MODELS)
def test_no_force_at_rest_and_none_under_translation(model, options):
    x, body = make_body(model=model, **options)
    assert np.all(body.force(np.zeros_like(x)) == 0.0)
    u = np.ones_like(x) * [1e-3, -2e-3]
    # Relative displacements vanish exactly, so the force is exactly zero.
    assert np.all(body.force(u) == 0.0)


@pytest.mark.parametrize("model", OBJECTIVE)
def test_rotation_costs_no_energy_and_no_force(model, options):
    x, body = make_body(model=model, **options)
    u = np.column_stack([-x[:, 1], x[:, 0]])
    stretched = np.column_stack([x[:, 0], 0 * x[:, 1]])
    # Measured 1e-15 of the scale; round-off of sums over 28 bonds.
    assert np.abs(body.force(u)).max() < 1e-12 * scale_of(body, u)
    assert abs(body.energy(u).sum()) < 1e-12 * body.energy(stretched).sum()


def test_the_thesis_spring_is_not_objective():
    x, body = make_body(16, 16, model="thesis spring")
    u = np.column_stack([-x[:, 1], x[:, 0]])
    # Theory, eq. 2.8: pi h delta^3 k_t / 6 per volume for a unit rotation, in the interior.
    expected = np.pi * body.model.thickness * body.model.horizon**3 * body.tangential / 6
    centre = np.argmin(np.hypot(*(x - x.mean(axis=0)).T))
    assert body.energy(u)[centre] / body.volume[centre] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_linear_momentum_is_balanced(model, options):
    x, body = make_body(model=model, **options)
    u = np.random.default_rng(1).normal(size=x.shape)
    force = body.force(u)
    assert np.abs(force).max() > 0.0
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * np.abs(force).sum()


@pytest.mark.parametrize("model", OBJECTIVE)
def test_angular_momentum_is_balanced(model, options):
    x, body = make_body(model=model, **options)
    force = body.force(np.random.default_rng(2).normal(size=x.shape))
    moments = x[:, 0] * force[:, 1] - x[:, 1] * force[:, 0]
    assert np.abs(moments).max() > 0.0
    assert abs(moments.sum()) < 1e-13 * np.abs(moments).sum()


@pytest.mark.parametrize("model", MODELS)
def test_force_is_minus_the_derivative_of_the_energy(model, options):
    x, body = make_body(8, 7, model=model, **options)
    rng = np.random.default_rng(3)
    u, d = rng.normal(size=x.shape), rng.normal(size=x.shape)
    slope = body.energy(u + d).sum() - body.energy(u - d).sum()  # exact for a quadratic energy
    assert -2.0 * np.vdot(body.force(u), d) == pytest.approx(slope, rel=1e-11)


@pytest.mark.parametrize("model", MODELS)
def test_stiffness_is_symmetric(model, options):
    x, body = make_body(8, 7, model=model, **options)
    rng = np.random.default_rng(4)
    u, v = rng.normal(size=x.shape), rng.normal(size=x.shape)
    assert np.vdot(v, body.force(u)) == pytest.approx(np.vdot(u, body.force(v)), rel=1e-11)


@pytest.mark.parametrize("model", [name for name in OBJECTIVE if name != "one-parameter"])
@pytest.mark.parametrize(
    ("nu", "broken"), [(-0.9, 0.0), (0.0, 0.3), (0.29, 0.5), (1 / 3, 0.5), (0.45, 0.3), (0.45, 0.8), (0.49, 0.1)]
)
def test_objective_model_is_never_indefinite(model, nu, broken):
    x, body = make_body(10, 9, model=model, nu=nu, perturb=0.1, break_share=broken)
    n = x.size
    stiffness = np.empty((n, n))
    for k in range(n):
        unit = np.zeros(n)
        unit[k] = 1.0
        stiffness[:, k] = -body.force(unit.reshape(-1, 2)).reshape(-1)
    values = np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T))
    # Measured at worst -2e-16 of the largest.
    assert values[0] > -1e-12 * values[-1]
    if broken == 0.0:
        assert np.sum(values < 1e-9 * values[-1]) == 3, "exactly the rigid motions are free"


def test_thesis_spring_is_indefinite_above_one_third():
    x, body = make_body(10, 9, nu=0.4, model="thesis spring")
    u = np.column_stack([-x[:, 1], x[:, 0]])
    assert body.energy(u).sum() < 0.0


def test_damage_never_heals_and_counts_volume():
    _, body = make_body(perturb=0.1)
    once = np.flatnonzero(body.bonds.owners() < body.bonds.neighbours)
    before = body.damage()
    assert np.all(before == 0.0)
    body.break_bonds(once[:50])
    first = body.damage()
    body.break_bonds(once[20:80])
    assert np.all(body.damage() >= first)
    assert np.sum(~body.intact) == 2 * 80


@pytest.mark.parametrize("model", MODELS)
def test_what_is_broken_decides_not_in_which_pieces(model):
    """Checkpoints break the bonds of a fresh body again: it must come out the same to the bit."""
    x, one = make_body(perturb=0.1, model=model)
    _, other = make_body(perturb=0.1, model=model)
    chosen = np.random.default_rng(5).choice(one.bonds.length.size, 200, replace=False)
    one.break_bonds(chosen)
    for piece in np.split(chosen, 4):
        other.break_bonds(piece)
    u = np.random.default_rng(6).normal(size=x.shape)
    assert np.array_equal(one.force(u), other.force(u)) and np.array_equal(one.energy(u), other.energy(u))
    assert np.array_equal(one.bond_loads(u, BY_ENERGY), other.bond_loads(u, BY_ENERGY))
    assert np.array_equal(one.stiffness_rows(), other.stiffness_rows())
    assert np.linalg.norm(one.force(u) - make_body(perturb=0.1, model=model)[1].force(u)) > 0.0
