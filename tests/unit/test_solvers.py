"""Equilibrium solvers: the same answer from each, singular bodies, failure."""

import numpy as np
import pytest

from pdhe.errors import SimulationError
from pdhe.relaxation import DynamicRelaxation, fictitious_mass
from pdhe.solvers import Equilibrium
from tests.lattices import make_body

SOLVERS = {"conjugate gradients": Equilibrium, "dynamic relaxation": DynamicRelaxation}


def pulled(body, x, method, tolerance=1e-8, most=20000):
    """A body whose top and bottom rows are pulled apart."""
    top, bottom = x[:, 1] > x[:, 1].max() - 0.5e-3, x[:, 1] < x[:, 1].min() + 0.5e-3
    fixed = np.zeros(x.shape, bool)
    fixed[top | bottom, 1] = True
    values = np.zeros(x.shape)
    values[top, 1], values[bottom, 1] = 1e-6, -1e-6
    return SOLVERS[method](body, fixed, x, np.full(len(x), 1e-3), tolerance, most), values


def test_every_solver_finds_the_same_equilibrium():
    results, work = [], []
    for method in SOLVERS:
        x, body = make_body(30, 20, cracks=[((0, 10e-3), (12e-3, 10e-3))])
        solver, values = pulled(body, x, method)
        u, force = solver.solve(np.zeros_like(x), values)
        assert np.abs(force[~solver.fixed]).max() < 1e-6 * np.abs(force[solver.fixed]).max()
        results.append(u - [u[:, 0].mean(), 0.0])  # free along x
        work.append(solver.work.equilibrium_iterations)
    # Both stop at a residual of 1e-8; measured difference 4e-9 of the largest displacement.
    np.testing.assert_allclose(results[1], results[0], rtol=0, atol=1e-6 * np.abs(results[0]).max())
    assert 5 < work[0] < 40, "conjugate gradients"
    assert work[1] > 5 * work[0], "relaxation takes many more sweeps"


@pytest.mark.parametrize("nu", [-0.5, 0.0, 0.29, 0.45])
@pytest.mark.parametrize("broken", [0.0, 0.3])
def test_fictitious_mass_is_enough(nu, broken):
    """The largest eigenvalue of the mass-scaled stiffness stays below 4, the limit of a unit step."""
    x, body = make_body(9, 8, nu=nu, perturb=0.1, break_share=broken)
    mass = fictitious_mass(body).reshape(-1)
    columns = [-body.force(unit.reshape(-1, 2)).reshape(-1) for unit in np.eye(x.size)]
    root = np.sqrt(mass)
    largest = np.linalg.eigvalsh(np.array(columns) / root[:, None] / root).max()
    # Measured 1.7 to 2.4.
    assert 1.0 < largest < 4.0


@pytest.mark.parametrize("method", SOLVERS)
def test_fragments_and_isolated_nodes_stay_where_they_are(method):
    x, body = make_body(12, 12)
    b = body.bonds
    owner = b.owners()
    # A band of bonds across the middle goes, and so does everything that held one node.
    across = (x[owner, 1] - 6e-3) * (x[b.neighbours, 1] - 6e-3) < 0
    alone = 20
    body.break_bonds(np.flatnonzero(across | (owner == alone) | (b.neighbours == alone)))
    solver, values = pulled(body, x, method)
    u, _ = solver.solve(np.zeros_like(x), values)
    assert np.all(np.isfinite(u))
    assert np.all(u[alone] == 0.0)
    # Each half follows its row as a rigid body: no strain anywhere, to the tolerance.
    others = np.arange(len(x)) != alone
    assert np.abs(u[others & (x[:, 1] > 6e-3), 1] - 1e-6).max() < 1e-11
    assert np.abs(u[others & (x[:, 1] < 6e-3), 1] + 1e-6).max() < 1e-11


@pytest.mark.parametrize("method", SOLVERS)
def test_nothing_prescribed_takes_no_iterations(method):
    x, body = make_body(10, 10)
    solver, values = pulled(body, x, method)
    u, _ = solver.solve(np.zeros_like(x), 0 * values)
    assert np.all(u == 0.0)
    assert solver.work.equilibrium_iterations == 0


@pytest.mark.parametrize("method", SOLVERS)
def test_too_few_iterations_name_the_node(method):
    x, body = make_body(20, 20)
    solver, values = pulled(body, x, method, most=2)
    with pytest.raises(SimulationError, match=r"after 2 iterations .* node \d+, x = "):
        solver.solve(np.zeros_like(x), values)


def test_iterations_do_not_depend_on_the_spacing():
    """The two-level preconditioner: measured 10 and 11 iterations to 1e-6 where Jacobi alone needs twice as many."""
    iterations = []
    for size in (40, 80):
        x, body = make_body(2 * size, size, cracks=[((0, size / 2 * 1e-3), (size / 2 * 1e-3, size / 2 * 1e-3))])
        solver, values = pulled(body, x, "conjugate gradients", 1e-6)
        solver.solve(np.zeros_like(x), values)
        iterations.append(solver.work.equilibrium_iterations)
    assert iterations[1] <= iterations[0] + 3 <= 18


def test_a_tolerance_below_round_off_is_named_as_such():
    x, body = make_body(30, 20)
    solver, values = pulled(body, x, "conjugate gradients", tolerance=1e-16)
    with pytest.raises(SimulationError, match=r"round-off allows no less: raise solver\.tolerance"):
        solver.solve(np.zeros_like(x), values)
