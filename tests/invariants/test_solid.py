"""What bodies in space must satisfy: mechanics, failure and diffusion."""

import numpy as np
import pytest

from pdhe.damage import CRITERIA, critical_stretch, crossing_sum, stretch_squares
from pdhe.materials import MODELS
from pdhe.surfaces import Surface, crossed_by
from pdhe.transport import KERNELS, Edge, build_diffusion
from tests.solids import YOUNG, block, make_solid

pytestmark = pytest.mark.usefixtures("one_thread")

STATES = {
    "regular": {"nu": 0.2},
    "perturbed": {"perturb": 0.2, "partial": "ramp"},
    "damaged": {"perturb": 0.2, "break_share": 0.2},
    "nearly all broken": {"break_share": 0.97},
}
MODES = ("condensed rotation", "one-parameter", "state-based", "correspondence")


@pytest.fixture(params=STATES, ids=list(STATES))
def options(request):
    return STATES[request.param]


def scale_of(body, u) -> float:
    return float(np.abs(body.diagonal()).max() * np.abs(u).max())


@pytest.mark.parametrize("model", MODES)
def test_rigid_motion_is_free(model, options):
    x, body = make_solid(model=model, **options)
    assert np.all(body.force(np.ones_like(x) * [1e-3, -2e-3, 3e-3]) == 0.0)
    turned = np.cross([0.3, -0.2, 0.5], x)
    # Measured 2e-16 of the scale; relative displacements carry the round-off of the products above.
    assert np.abs(body.force(turned)).max() < 1e-13 * scale_of(body, turned)
    assert abs(body.energy(turned).sum()) < 1e-20 * body.energy(np.column_stack([x[:, 0], 0 * x[:, :2]])).sum()


@pytest.mark.parametrize("model", MODES)
def test_momentum_is_balanced_and_the_force_is_the_slope_of_the_energy(model, options):
    x, body = make_solid(model=model, **options)
    rng = np.random.default_rng(1)
    u, v = rng.normal(size=(2, *x.shape))
    force = body.force(u)
    assert np.abs(force).max() > 0.0
    # Measured 2e-17 of the sum of magnitudes, and 1e-16 with an arm of the body's length.
    assert np.abs(force.sum(axis=0)).max() < 1e-14 * np.abs(force).sum()
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-14 * np.abs(force).sum() * np.abs(x).max()
    # A quadratic energy has exact central differences: measured 1e-13.
    slope = 0.5 * (body.energy(u + v).sum() - body.energy(u - v).sum())
    assert -np.sum(force * v) == pytest.approx(slope, rel=1e-10)
    assert body.energy(u).sum() == pytest.approx(-0.5 * np.sum(force * u), rel=1e-12)


def test_one_bond_carries_no_tangential_force():
    _, body = make_solid((2, 1, 1), nu=0.1, m=1.5, surface="none")
    force = body.force(np.array([[0.0, 0.0, 0.0], [0.0, 1e-6, 2e-6]]))
    assert np.abs(force).max() < 1e-15 * body.diagonal().max() * 1e-6


@pytest.mark.parametrize(
    ("model", "nu"),
    [*(("condensed rotation", nu) for nu in (0.1, 0.25, 0.29)), ("state-based", 0.1), ("state-based", 0.4)],
)
def test_uniform_strains_have_the_energy_of_the_continuum(model, nu):
    """Where every family is whole, the fourth moments, hence all elastic constants, are nearly those of a full ball.

    Corrections change inner bonds as well, since inner nodes share bonds with outer ones. Measured, the largest
    deviation of the three strains, inside and over all: 2.4 and 3.9 % on a lattice, 2.7 and 4.0 % on perturbed nodes;
    with corrections node by node it is 25 %.
    """
    lame, shear = YOUNG * nu / ((1 + nu) * (1 - 2 * nu)), YOUNG / (2 * (1 + nu))
    for perturb, partial in ((0.0, "full"), (0.15, "ramp")):
        x, body = make_solid((16, 12, 10), model=model, nu=nu, m=3.015, perturb=perturb, partial=partial)
        for strain in (np.eye(3), np.diag([1.0, -1.0, 0.0]), np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0.0]])):
            energy = body.energy(1e-4 * x @ strain)
            expected = 0.5e-8 * (lame * np.trace(strain) ** 2 + 2 * shear * np.sum(strain**2))
            inside = (np.abs(x - x.mean(axis=0)) < [5e-3, 3e-3, 2e-3]).all(axis=1)
            assert (energy[inside] / body.volume[inside]).mean() == pytest.approx(expected, rel=0.04)
            assert energy.sum() / body.volume.sum() == pytest.approx(expected, rel=0.06)


def test_a_state_based_solid_is_never_indefinite_and_its_rows_bound_it():
    for nu, broken in ((0.45, 0.0), (0.45, 0.5), (-0.5, 0.5)):
        x, body = make_solid((5, 4, 4), nu=nu, model="state-based", perturb=0.1, break_share=broken)
        stiffness = np.stack([-body.force(unit.reshape(-1, 3)).ravel() for unit in np.eye(x.size)])
        values = np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T))
        # Measured at worst -3e-16 of the largest; six rigid motions.
        assert values[0] > -1e-12 * values[-1] and values[-1] <= body.stiffness_rows().max()
        assert broken or (values[5] < 1e-9 * values[-1] < values[6])


@pytest.mark.parametrize("criterion", ["energy", "energy density"])
@pytest.mark.parametrize(("model", "nu"), [("condensed rotation", 0.25), ("state-based", 0.25), ("state-based", 0.4)])
def test_a_plane_cut_takes_the_fracture_energy_per_area(model, nu, criterion):
    """All bonds across a plane, each at its critical stretch, hold the fracture energy times the area of the cut.

    The discrete calibration takes the mean over all places of a plane; a plane between two layers is one of them.
    Measured 1.3 % off, 0.6 % for bonds of one energy, as the corrected bonds of a block this small differ from place
    to place.
    """
    toughness, criterion = 1e4, CRITERIA[criterion]
    x, body = make_solid((16, 16, 16), nu=nu, m=3.015, model=model)
    bonds = body.bonds
    crossing = crossing_sum(bonds, body.volume, stretch_squares(bonds, criterion))
    critical = critical_stretch(body.model, crossing, toughness, "discrete", criterion)
    factor = np.sqrt(stretch_squares(bonds, criterion)) if criterion.equal_energy else np.ones(bonds.length.size)
    plane = Surface.polygon([(-1.0, 8e-3, -1.0), (-1.0, 8e-3, 1.0), (1.0, 8e-3, 1.0), (1.0, 8e-3, -1.0)])
    owner = bonds.owners()
    inside = (np.abs(x[:, [0, 2]] - 8e-3) < 4e-3).all(axis=1)  # 8 by 8 columns of nodes
    rows = np.flatnonzero(inside[owner])
    cut = rows[crossed_by(x[owner[rows]], x[bonds.neighbours[rows]], [plane])]
    # An isotropic extension: the constants are made for the energy that bonds have in it, with any model and any nu.
    measure, parts = body.measure(cut, owner[cut]), body.bond_parts(x, cut, owner[cut])
    square = measure.square(parts)
    # State-based bonds share weighted volumes of corrected families: measured 1.9 %; 9e-16 with bonds by themselves.
    assert square == pytest.approx(np.ones(cut.size), rel=0.03 if model == "state-based" else 1e-12)
    # Each breaks at the energy of its critical stretch. Seen from both ends, each bond of these columns counts twice.
    energy = 0.25 * measure.stiffness * (critical * factor[cut]) ** 2
    assert energy.sum() / (8e-3) ** 2 == pytest.approx(toughness, rel=0.03)
    # The integral over a full ball: measured 0.3 % less on this lattice, 1.6 % for bonds of one energy.
    assert critical_stretch(body.model, crossing, toughness, "continuum", criterion) == pytest.approx(
        critical, rel=0.03
    )


def test_constants_in_space_are_those_of_the_energy():
    model = MODELS["condensed rotation"](YOUNG, 0.2, 1.0, 3e-3, None)
    bulk, shear = YOUNG / (3 * (1 - 0.4)), YOUNG / 2.4
    # Theory: W = pi delta^4 k_n e^2 / 4 for an isotropic extension e, and pi delta^4 (4 k_n + 6 k_t) e^2 / 60 for a
    # pure shear of principal strains e and -e.
    assert np.pi * 3e-3**4 * model.normal / 4.0 == pytest.approx(4.5 * bulk, rel=1e-12)
    both = 4.0 * model.normal + 6.0 * model.normal * model.tangential_ratio
    assert np.pi * 3e-3**4 * both / 60.0 == pytest.approx(2.0 * shear, rel=1e-12)


FACES = {
    "left": (0, 0.0), "right": (0, 8e-3), "bottom": (1, 0.0), "top": (1, 6e-3), "front": (2, 0.0), "back": (2, 5e-3),
}  # fmt: skip


def make_diffusion(kernel: str, prescribed: tuple[str, ...], perturb: float = 0.0, m: float = 2.5):
    x, body = make_solid((8, 6, 5), m=m, perturb=perturb, partial="ramp" if perturb else "full", surface="none")
    edges = {name: Edge(*place) for name, place in FACES.items()}
    spacing = np.full(len(x), 1e-3)
    partial = "ramp" if perturb else "full"
    diffusion = build_diffusion(
        body.bonds, x, body.volume, spacing, 5e-3, 0.84e-9, kernel, partial, edges, set(prescribed)
    )
    return x, diffusion


@pytest.mark.parametrize("prescribed", [(), ("left",), ("left", "bottom", "front"), tuple(FACES)])
@pytest.mark.parametrize("kernel", KERNELS)
def test_diffusion_conserves_and_keeps_within_bounds(kernel, prescribed):
    for perturb, m in ((0.0, 2.5), (0.2, 2.5), (0.0, 2.015)):
        _, diffusion = make_diffusion(kernel, prescribed, perturb, m)
        there = diffusion.rate * diffusion.volume[diffusion.bonds.owners()]
        # The same product in another order: measured 4e-16.
        assert np.abs(there - there[diffusion.bonds.reverse]).max() < 1e-14 * there.max()
        assert diffusion.rate.max() > 0.0 and diffusion.rate.min() >= 0.0
        assert all(rate.min() >= 0.0 and rate.max() > 0.0 for rate in diffusion.exchange.values())


def test_a_linear_profile_between_two_faces_is_steady():
    """Odd images at prescribed faces, even ones at the others: exact in the interior and at every face and corner."""
    x, diffusion = make_diffusion("inverse square", ("left", "right"))
    psi = 1.0 - x[:, 0] / 8e-3
    held, new, supply = np.zeros(len(x), bool), np.empty(len(x)), np.zeros(len(x))
    diffusion.step(psi, 1.0, held, diffusion.source({"left": 1.0, "right": 0.0}), new, supply)
    # Measured 2e-17 a second at exchange rates of 1e-3 a second.
    assert np.abs(new - psi).max() < 1e-15


def test_a_block_without_images_would_not_do():
    """The image of the lattice is the lattice: with insulated faces a cosine along z decays as in an endless body."""
    x, diffusion = make_diffusion("inverse", ())
    psi = np.cos(np.pi * x[:, 2] / 5e-3)
    held, new, supply = np.zeros(len(x), bool), np.empty(len(x)), np.zeros(len(x))
    diffusion.step(psi, 1.0, held, np.zeros(len(x)), new, supply)
    inner = np.abs(psi) > 0.1
    rate = ((psi - new)[inner] / psi[inner]).mean()
    # An exact eigenmode: measured 1e-16 of the largest.
    assert np.abs(psi - new - rate * psi).max() < 1e-13 * rate
    # The symbol of the ball at k delta = 1.6 and of this lattice: measured 0.93 of that of the diffusivity.
    assert rate == pytest.approx(0.84e-9 * (np.pi / 5e-3) ** 2, rel=0.12)


def test_blocks_are_numbered_layer_by_layer():
    assert block(2, 2, 2)[[0, 1, 2, 4]].tolist() == [
        [5e-4, 5e-4, 5e-4], [15e-4, 5e-4, 5e-4], [5e-4, 15e-4, 5e-4], [5e-4, 5e-4, 15e-4],
    ]  # fmt: skip
