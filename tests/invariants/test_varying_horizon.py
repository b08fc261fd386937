"""What must hold where the horizon varies: balances, rest under rigid motions, a patch, conservation of hydrogen."""

import numpy as np
import pytest

from pdhe.bonds import NEGLIGIBLE, Grading, build_bonds, two_sided_volume
from pdhe.case import build_case
from pdhe.damage import crossing_sum, nearest_failure
from pdhe.discretization import discretize
from pdhe.materials import MODELS, make_body
from pdhe.mesh import make_mesh
from pdhe.scene import Scene
from pdhe.transport import KERNELS, Edge, build_diffusion
from pdhe.verification.graded import bond_strain_error
from pdhe.verification.plates import POISSON, THICKNESS, YOUNG, graded_plate, plate_body
from tests.lattices import lattice

RATIO = 3.015
WIDTH, HEIGHT = 0.06, 0.05
MESH = {
    "spacing": 4e-3,
    "growth": 0.2,
    "refine": [{"from": [0.02, 0.02], "to": [0.04, 0.03], "spacing": 1e-3, "within": 4e-3}],
}


@pytest.fixture(scope="module")
def graded():
    plate, reference, grading = graded_plate(WIDTH, HEIGHT, RATIO, MESH)
    assert 0.26 > grading.horizons.min() / grading.horizons.max() >= 0.25
    return plate, reference, grading


@pytest.fixture(scope="module", params=["whole", "damaged"])
def body(request, graded):
    plate, reference, grading = graded
    body = plate_body(plate, reference, partial="ramp", grading=grading)
    if request.param == "damaged":
        once = np.flatnonzero(body.bonds.owners() < body.bonds.neighbours)
        body.break_bonds(np.random.default_rng(0).choice(once, once.size // 5, replace=False))
    return body


def test_forces_and_torques_balance(body):
    x = body.coordinates
    force = body.force(np.random.default_rng(1).normal(size=x.shape))
    moments = x[:, 0] * force[:, 1] - x[:, 1] * force[:, 0]
    # Measured 2e-17 and 2e-16: round-off.
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * np.abs(force).sum()
    assert abs(moments.sum()) < 1e-13 * np.abs(moments).sum()


def test_families_hold_every_node_that_an_end_sees_a_share_of(graded):
    plate, reference, grading = graded
    bonds = plate_body(plate, reference, partial="ramp", grading=grading).bonds
    i, j = np.triu_indices(len(plate.coordinates), k=1)
    apart = np.hypot(*(plate.coordinates[i] - plate.coordinates[j]).T)
    ends, size = (grading.horizons[i], grading.horizons[j]), 0.5 * (plate.spacing[i] + plate.spacing[j])
    share, _ = two_sided_volume(apart, ends, reference, size, "ramp", 3)
    once = bonds.owners() < bonds.neighbours
    seen = share > NEGLIGIBLE
    # A search by the larger horizon and half a cell of its own misses two of these 16,000 bonds.
    assert np.array_equal(np.column_stack([bonds.owners(), bonds.neighbours])[once], np.column_stack([i, j])[seen])


def test_rigid_motions_cost_nothing(body):
    x = body.coordinates
    turn, stretch = np.column_stack([-x[:, 1], x[:, 0]]), np.column_stack([x[:, 0], 0 * x[:, 1]])
    scale = float(np.abs(body.diagonal()).max() * np.abs(turn).max())
    assert np.abs(body.force(np.ones_like(x))).max() == 0.0
    # Measured 1e-16.
    assert np.abs(body.force(turn)).max() < 1e-12 * scale
    assert abs(body.energy(turn).sum()) < 1e-12 * body.energy(stretch).sum()


def test_force_is_minus_the_derivative_of_the_energy(body):
    rng = np.random.default_rng(3)
    u, d = rng.normal(size=(2, *body.coordinates.shape))
    slope = body.energy(u + d).sum() - body.energy(u - d).sum()
    assert -2.0 * np.vdot(body.force(u), d) == pytest.approx(slope, rel=1e-11)


@pytest.mark.parametrize("nu", [-0.5, 0.29, 0.45])
def test_only_the_rigid_motions_are_free(nu):
    mesh = MESH | {"spacing": 5e-3, "growth": 0.3, "refine": [MESH["refine"][0] | {"spacing": 2e-3}]}
    plate, reference, grading = graded_plate(WIDTH, HEIGHT, RATIO, mesh)
    body = plate_body(plate, reference, partial="ramp", grading=grading, nu=nu)
    n = body.coordinates.size
    stiffness = np.array([-body.force(row.reshape(-1, 2)).ravel() for row in np.eye(n)])
    values = np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T))
    # Measured: the fourth is 1e-4 of the largest, the first three 1e-16.
    assert values[0] > -1e-12 * values[-1]
    assert np.sum(values < 1e-9 * values[-1]) == 3


def test_a_homogeneous_strain_is_an_equilibrium(graded):
    """A patch at rest stays homogeneous far better than with the correction that uniform meshes have."""
    plate, reference, grading = graded
    together = bond_strain_error(plate_body(plate, reference, partial="ramp", grading=grading), plate, grading)
    bare = bond_strain_error(
        plate_body(plate, reference, partial="ramp", weights="none", grading=grading), plate, grading
    )
    # Measured 0.0255 and 0.063, 0.020 to 0.029 where the fine part is 3.5 to 5 mm wide; uniform triangles of 1 mm,
    # corrected node by node, have 0.043 (topic graded).
    assert together < 0.030
    assert together < 0.5 * bare


def test_equal_horizons_are_those_of_a_uniform_mesh():
    spacing = 1e-3
    x = lattice(14, 12, spacing) + np.random.default_rng(0).uniform(-0.2e-3, 0.2e-3, (14 * 12, 2))
    volume, sizes = np.full(len(x), spacing**2 * THICKNESS), np.full(len(x), spacing)
    same = Grading(np.full(len(x), RATIO * spacing), np.full(len(x), np.inf))
    one, other = (
        build_bonds(x, volume, sizes, THICKNESS, RATIO * spacing, partial="ramp", surface="none", grading=grading)
        for grading in (None, same)
    )
    assert np.array_equal(one.neighbours, other.neighbours)
    assert other.weight == pytest.approx(one.weight, rel=1e-14)
    assert other.fineness == pytest.approx(np.ones(one.length.size), rel=1e-14)
    assert one.fineness is None and one.horizons is None


def test_the_reference_horizon_is_a_matter_of_units(graded):
    """Forces do not depend on the horizon that the constants are made for."""
    plate, reference, grading = graded
    u = np.random.default_rng(5).normal(size=plate.coordinates.shape)
    forces = []
    for scale in (1.0, 0.25):
        model = MODELS["condensed rotation"](YOUNG, POISSON, THICKNESS, scale * reference)
        bonds = build_bonds(
            plate.coordinates, plate.volume, plate.spacing, THICKNESS, scale * reference, partial="ramp",
            tangential_ratio=model.tangential_ratio, grading=grading,
        )  # fmt: skip
        forces.append(make_body(bonds, model, plate.coordinates, plate.volume).force(u))
    # Measured 1e-10: the conjugate gradients of the correction stop a little differently.
    assert np.abs(forces[1] - forces[0]).max() < 1e-6 * np.abs(forces[0]).max()


def make_diffusion(graded, kernel, prescribed):
    plate, reference, grading = graded
    bonds = build_bonds(
        plate.coordinates, plate.volume, plate.spacing, THICKNESS, reference, partial="ramp", surface="none",
        grading=grading,
    )  # fmt: skip
    edges = {"left": Edge(0, 0.0), "right": Edge(0, WIDTH), "bottom": Edge(1, 0.0), "top": Edge(1, HEIGHT)}
    return build_diffusion(
        bonds, plate.coordinates, plate.volume, plate.spacing, THICKNESS, 0.84e-9, kernel, "ramp", edges,
        set(prescribed),
    )  # fmt: skip


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("prescribed", [(), ("left",), ("left", "bottom")])
def test_hydrogen_is_conserved_and_keeps_its_bounds(graded, kernel, prescribed):
    plate, diffusion = graded[0], make_diffusion(graded, kernel, prescribed)
    bonds = diffusion.bonds
    exchanged = diffusion.rate * plate.volume[bonds.owners()]
    assert exchanged.min() >= 0.0
    assert exchanged[bonds.reverse] == pytest.approx(exchanged, rel=1e-12)
    assert all(values.min() >= -1e-12 * values.max() for values in diffusion.exchange.values())
    psi, held = np.random.default_rng(2).uniform(size=plate.volume.size), np.zeros(plate.volume.size, bool)
    new, supply = np.empty_like(psi), np.zeros_like(psi)
    source = diffusion.source(dict.fromkeys(prescribed, 0.5))
    diffusion.step(psi, diffusion.stable_step(held), held, source, new, supply)
    assert new.min() >= 0.0 and new.max() <= 1.0
    content = float(np.sum(psi * plate.volume))
    # Measured 1e-16.
    assert float(np.sum(new * plate.volume)) - content == pytest.approx(supply.sum(), abs=1e-13 * content)


def test_a_linear_coverage_stays(graded):
    """The flux between edges of 0 and 1 through fine and coarse parts: the steady state is nearly the straight line."""
    plate, diffusion = graded[0], make_diffusion(graded, "inverse square", ("left", "right"))
    bonds = diffusion.bonds
    matrix = np.diag(-diffusion.sink() - np.bincount(bonds.owners(), diffusion.rate, plate.volume.size))
    matrix[bonds.owners(), bonds.neighbours] += diffusion.rate
    psi = np.linalg.solve(matrix, -diffusion.source({"left": 0.0, "right": 1.0}))
    # Measured 0.0085; on uniform triangles of 4 mm it is 0.012.
    assert np.abs(psi - plate.coordinates[:, 0] / WIDTH).max() < 0.015


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    history = {"times": [0.0, 1.0], "values": [0.0, 1e-5]}
    scene = Scene.from_resolved(
        {
            "title": "graded",
            "geometry": {
                "plate": {"width": WIDTH, "height": HEIGHT, "thickness": THICKNESS},
                "cracks": [{"name": "notch", "from": [0.0, 0.02], "to": [0.02, 0.02]}],
            },
            "mesh": MESH | {"cells": "triangle"},
            "horizon": {"ratio": RATIO},
            "material": {
                "youngs_modulus": YOUNG, "poissons_ratio": POISSON, "fracture_toughness": 58.4e6,
                "diffusivity": 0.84e-9,
            },
            "loads": [{"on": "top", "displacement": {"y": history}}, {"on": "bottom", "displacement": {"y": {
                "times": [0.0], "values": [0.0]}}}],
            "damage": {},
            "hydrogen": {"boundary": [{"on": "notch", "coverage": {"times": [0.0], "values": [1.0]}}]},
            "time": {"end": 1.0},
        }
    )  # fmt: skip
    path = tmp_path_factory.mktemp("graded") / "plate.msh"
    make_mesh(scene.geometry, scene.mesh, path)
    return build_case(scene, discretize(path, scene.geometry, scene.mesh))


def test_bonds_break_at_a_stretch_that_goes_with_their_horizon(case):
    bonds, rule, local = case.bonds, case.rule, case.bonds.horizons
    owner = bonds.owners()
    # Two nodes of equal horizon have the stretch of that horizon; others lie between their ends.
    low, high = (np.sqrt(bonds.horizon / f(local[owner], local[bonds.neighbours])) for f in (np.maximum, np.minimum))
    assert np.all(rule.factor() >= low * (1 - 1e-12)) and np.all(rule.factor() <= high * (1 + 1e-12))
    assert rule.factor().max() == pytest.approx(2.0, rel=1e-9)
    assert rule.resistance_at(None, np.arange(owner.size)) == pytest.approx(rule.critical * rule.factor())


@pytest.mark.parametrize("wet", [False, True])
def test_nearest_failure_finds_the_weakest_bond(case, wet):
    random = np.random.default_rng(3)
    u = 2e-6 * random.normal(size=case.discretization.coordinates.shape)
    psi = random.uniform(size=len(u)) if wet else None
    bonds, owner = case.bonds, case.bonds.owners()
    mean = 0.5 * (psi[owner] + psi[bonds.neighbours]) if wet else None
    load = np.where(case.rule.may_fail & case.body.intact, case.body.bond_loads(u, case.rule.load), 0.0)
    expected = (load / case.rule.resistance_at(mean, np.arange(owner.size))).max()
    assert nearest_failure(case.body, case.rule, u, psi) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("ratio", [RATIO, 4.0])
def test_the_calibration_does_not_depend_on_how_a_mesh_becomes_coarser(ratio):
    """A strip so low that coarse families are hardly ever whole, with the same fine part each time."""
    path = {"from": [0.028, 0.02], "to": [0.048, 0.02], "spacing": 1e-3, "within": 4.5e-3}
    found = []
    for coarse, growth in ((2.5e-3, 0.1), (2.5e-3, 0.2), (3e-3, 0.2)):
        plate, reference, grading = graded_plate(
            0.06, 0.04, ratio, {"spacing": coarse, "growth": growth, "refine": [path]}
        )
        bonds = plate_body(plate, reference, partial="ramp", grading=grading).bonds
        # Over the integral over a full disc, h delta^4 / 2 (eqs. 5.3 and 5.4).
        found.append(crossing_sum(bonds, plate.volume) / (0.5 * THICKNESS * reference**4))
    # Measured 0.008 and 0.022; 0.017 and 0.039 with families chosen by their size and counted by their volume.
    assert np.ptp(found) < 0.03, found
    assert min(found) > 0.98 and max(found) < 1.06, found  # uniform triangles have 1.05 and 1.03
