"""Bond energies of state-based models in two parts, and bonds that break by them."""

import numpy as np
import pytest

from pdhe.benchmarks.problems import mode_i
from pdhe.damage import nearest_failure
from pdhe.errors import PdheError, SceneError
from pdhe.materials import BY_ENERGY, Body, BondLoad, StateBased
from pdhe.materials.constants import bulk_modulus
from pdhe.plan import make_plan
from pdhe.simulation import simulate
from tests.lattices import make_body
from tests.solids import make_solid

BODIES = {
    "plane stress": (make_body, {}),
    "plane strain": (make_body, {"plane": "strain"}),
    "damaged": (make_body, {"perturb": 0.2, "break_share": 0.2}),
    "nu of one parameter": (make_body, {"nu": 1.0 / 3.0}),
    "auxetic": (make_body, {"nu": -0.4}),
    "space": (make_solid, {"perturb": 0.2, "break_share": 0.2}),
}


MODELS = ("state-based", "correspondence")


@pytest.fixture(params=[(model, name) for model in MODELS for name in BODIES], ids=", ".join)
def solid(request):
    model, name = request.param
    make, options = BODIES[name]
    return make(model=model, **options)


def parts_of(body, u):
    """Dilatational and deviatoric energy of every directed bond, J (2, b), and its whole one; of broken ones none."""
    bond, owner = np.arange(body.intact.size), body.bonds.owners()
    measure, parts = body.measure(bond, owner), body.bond_parts(u, bond, owner)
    half = 0.5 * measure.stiffness * body.intact
    return half * measure.split(parts), half * measure.square(parts)


def volumetric_energy(body, u):
    """Energy of the mean stress of all nodes on their dilatation, J."""
    plane = body.model.plane
    bulk = bulk_modulus(body.model.youngs_modulus, body.model.poissons_ratio, plane)
    if isinstance(body.model, StateBased):
        return 0.5 * bulk * float(np.sum(body.volume * body.dilatation(u) ** 2))
    trace = np.trace(body.displacement_gradient(u), axis1=1, axis2=2)
    return 0.5 * bulk * float(np.sum(body.volume * body.share * trace**2))


def test_both_parts_together_are_the_energy_of_each_bond_and_of_the_body(solid):
    x, body = solid
    u = np.random.default_rng(0).normal(size=x.shape)
    (swollen, sheared), whole = parts_of(body, u)
    # One more rounding: measured 2e-16 of the largest.
    assert np.abs(swollen + sheared - whole).max() < 1e-15 * np.abs(whole).max()
    # Nodes have these energies (theory, eqs. 2.11 and 2.16): round-off, measured 4e-16.
    volumetric = volumetric_energy(body, u)
    assert 0.5 * swollen.sum() == pytest.approx(volumetric, rel=1e-12)
    assert 0.5 * sheared.sum() == pytest.approx(body.energy(u).sum() - volumetric, rel=1e-12)
    assert volumetric > 0.0 and sheared.sum() > 0.0


WHOLE = {
    "plane stress": lambda: make_body(20, 20, model="state-based"),
    "plane strain": lambda: make_body(20, 20, model="state-based", plane="strain"),
    "space": lambda: make_solid((11, 11, 11), m=2.015, model="state-based", surface="none"),
}


def test_a_homogeneous_strain_has_its_parts_at_every_node_of_a_correspondence_body():
    """Its gradients are exact at edges and beside broken bonds too."""
    for make, options in BODIES.values():
        x, body = make(model="correspondence", **options)
        (swollen, sheared), whole = parts_of(body, 1e-3 * x)
        # Gradients are inverses times sums: measured 4e-15 and 2e-16 of the largest.
        assert np.abs(sheared).max() < 1e-12 * np.abs(whole).max() and np.abs(swollen).max() > 0.0
        (swollen, sheared), whole = parts_of(body, 1e-3 * np.roll(x[:, :2], 1, axis=1) @ np.eye(2, x.shape[1]))
        assert np.abs(swollen).max() < 1e-12 * np.abs(whole).max() and np.abs(sheared).max() > 0.0


@pytest.mark.parametrize("body", WHOLE)
def test_a_dilatation_has_one_part_only_and_a_shear_the_other(body):
    x, body = WHOLE[body]()
    (swollen, sheared), whole = parts_of(body, 1e-3 * x)
    # At every node, those of edges included: measured 5e-16, and 2e-15 of each bond.
    assert np.abs(sheared).max() < 1e-12 * np.abs(whole).max()
    assert swollen == pytest.approx(whole, rel=1e-11)
    middle = np.all(np.abs(x - x.mean(axis=0)) < 1.1e-3, axis=1)[body.bonds.owners()]
    both = middle & middle[body.bonds.reverse]
    (swollen, sheared), whole = parts_of(body, 1e-3 * x[:, [1, 0, 2][: x.shape[1]]] * [1.0, 1.0, 0.0][: x.shape[1]])
    # Two horizons inside, families are symmetric: dilatations cancel. Measured 7e-18 of the largest energy.
    assert both.sum() >= 12 and np.abs(swollen[both]).max() < 1e-12 * np.abs(whole).max()
    assert sheared[both].max() > 0.1 * np.abs(whole).max()


def test_what_each_part_counts_goes_into_the_load(solid):
    x, body = solid
    u = np.random.default_rng(1).normal(size=x.shape) * 1e-6
    swollen, sheared = parts_of(body, u)[0]
    measure = body.measure(np.arange(body.intact.size), body.bonds.owners())
    stretched = body.bond_loads(u, BondLoad(False)) > 0.0
    for weights in ((1.0, 0.0), (0.0, 1.0), (0.4, 2.5)):
        counted = np.maximum(2.0 * (weights[0] * swollen + weights[1] * sheared) / measure.stiffness, 0.0) ** 0.5
        load = body.bond_loads(u, BondLoad(True, split=weights))
        expected = np.where(stretched, counted, 0.0)[body.intact]
        np.testing.assert_allclose(load[body.intact], expected, rtol=1e-9, atol=1e-9 * expected.max())
    whole = body.bond_loads(u, BY_ENERGY)
    np.testing.assert_allclose(body.bond_loads(u, BondLoad(True, split=(1.0, 1.0))), whole, atol=1e-12 * whole.max())


def test_the_search_node_by_node_sees_every_split_load(solid):
    x, body = solid
    random = np.random.default_rng(2)
    u, resistance = random.normal(size=x.shape) * 1e-6, random.uniform(1.0, 2.0, len(x))
    for weights in ((1.0, 0.0), (0.0, 1.0), (0.4, 2.5)):
        for tension_only in (True, False):
            load = BondLoad(True, tension_only, weights)
            top, _ = body.largest_ratios(u, load, body.intact, resistance)
            expected, _ = Body.largest_ratios(body, u, load, body.intact, resistance)
            assert np.count_nonzero(expected) > 0.8 * len(x)
            np.testing.assert_allclose(top, expected, rtol=1e-9)


MODEL = {"mechanics.model": "state-based", "hydrogen.boundary": [{"on": "notch", "coverage": 1.0}]}
MATERIAL = 58.4e6**2 / 207e9


def split(**parts):
    return MODEL | {"damage": {"criterion": "energy", "split": parts}}


def test_fracture_energies_of_the_parts_are_those_of_the_scene():
    case = mode_i(800, split(dilatational={"factor": 4.0}, deviatoric={"critical_energy_release_rate": "8 kJ/m^2"}))
    assert case.rule.load.split == pytest.approx((0.25, MATERIAL / 8e3), rel=1e-12)
    assert "dilatational energy 0.25 times" in make_plan(case)
    assert mode_i(800, split(deviatoric={"factor": 2.0})).rule.load.split == (0.0, 0.5)


@pytest.mark.parametrize("criterion", ["energy", "energy density"])
@pytest.mark.parametrize("model", MODELS)
def test_parts_of_one_fracture_energy_are_no_parts_with_hydrogen_too(model, criterion):
    """A quarter as tough in both parts is a quarter as tough, at any coverage: twice all loads."""
    base = MODEL | {"damage.criterion": criterion, "mechanics.model": model}
    parts = {"damage.split": {"dilatational": {"factor": 0.25}, "deviatoric": {"factor": 0.25}}}
    one, other = mode_i(800, base), mode_i(800, base | parts)
    random = np.random.default_rng(3)
    u, psi = random.normal(size=one.discretization.coordinates.shape) * 1e-6, random.uniform(size=len(one.body.volume))
    plain = nearest_failure(one.body, one.rule, u, psi)
    assert nearest_failure(other.body, other.rule, u, psi) == pytest.approx(2.0 * plain, rel=1e-12)
    weaker = mode_i(800, base | {"damage.regions": [{"on": "all", "factor": 0.25}]})
    results = [simulate(case) for case in (other, weaker)]
    broken = [result["broken_bonds"].values[-1] for result in results]
    assert broken[0] == broken[1] > 0


def test_a_crack_runs_earlier_the_less_either_part_takes():
    def start(**parts):
        case = mode_i(800, split(**parts))
        u = case.equilibrium.solve(case.conditions.values(1e7), case.conditions.values(1e7))[0]
        return nearest_failure(case.body, case.rule, u, None)

    whole = {"factor": 1.0}
    both = start(dilatational=whole, deviatoric=whole)
    swollen, sheared = start(dilatational=whole), start(deviatoric=whole)
    # At the tip both parts drive the bond ahead: measured 0.55 and 0.84 of both.
    assert 0.3 * both < min(swollen, sheared) < max(swollen, sheared) < both
    assert start(dilatational=whole, deviatoric={"factor": 0.25}) > both


@pytest.mark.parametrize(
    ("changes", "key", "text"),
    [
        ({"damage.split": {}}, "damage.split", "needs `dilatational` or `deviatoric`"),
        ({"damage.split": {"deviatoric": {}}}, "damage.split.deviatoric", "needs either"),
        ({"damage.split": {"shear": {"factor": 1.0}}}, "damage.split.shear", "not a known key"),
        ({"damage.split": {"deviatoric": {"factor": 1.0}}, "mechanics.model": "condensed rotation"},
         "damage.split", "no dilatation"),
        ({"damage.split": {"deviatoric": {"factor": 1.0}}, "damage.criterion": "stretch"},
         "damage.split", "splits energies"),
        ({"damage.split": {"deviatoric": {"factor": 1.0}}, "mechanics.model": "correspondence",
          "material.orthotropic": {"youngs_modulus_2": "100 GPa", "shear_modulus_12": "50 GPa"},
          "material.critical_energy_release_rate": "10 kJ/m^2", "material.fracture_toughness": None},
         "damage.split", "isotropic materials"),
        ({"damage.split": {"deviatoric": {"factor": 1.0}}, "stepping": {"mode": "fixed", "load_steps": 4,
          "diffusion_substeps": 1}, "mechanics": {"model": "correspondence", "strain": "finite"}, "hydrogen": None},
         "damage.split", "small strains alone"),
    ],
)  # fmt: skip
def test_splits_that_mean_nothing_are_refused(changes, key, text):
    with pytest.raises(SceneError, match=text) as error:
        mode_i(800, MODEL | {"damage.criterion": "energy"} | changes)
    assert error.value.key == key


def test_bonds_that_know_no_parts_say_so():
    x, body = make_body(6, 6)
    with pytest.raises(PdheError, match="not known in two parts"):
        Body.bond_loads(body, x, BondLoad(True, split=(1.0, 2.0)))
