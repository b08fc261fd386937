"""Elastic constants of every model in plane stress and plane strain: energies of homogeneous strains."""

import numpy as np
import pytest

from pdhe.materials import MODELS
from pdhe.materials.constants import (
    ONE_PARAMETER,
    bulk_modulus,
    micromodulus,
    shear_modulus,
    stiffness_tensor,
    tangential_ratio,
)
from pdhe.scene import load_scene
from tests.lattices import YOUNG, make_body

#: Strains xx, yy and xy: isotropic, shear along and between the axes, and one of everything.
STRAINS = {"isotropic": (1.0, 1.0, 0.0), "shear": (0.0, 0.0, 0.5), "stretch": (1.0, -1.0, 0.0), "mix": (0.7, -0.2, 0.4)}


@pytest.mark.parametrize("plane", ["stress", "strain"])
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("nu", [-0.3, 0.2, 0.29, 0.4])
def test_energies_of_homogeneous_strains(model, plane, nu):
    if model == "one-parameter":
        nu = ONE_PARAMETER[plane]
    x, body = make_body(20, 20, model=model, plane=plane, nu=nu)
    centre = int(np.argmin(np.hypot(*(x - x.mean(axis=0)).T)))
    law = stiffness_tensor(YOUNG, nu, plane)
    for name, (xx, yy, xy) in STRAINS.items():
        energy = body.energy(x @ np.array([[xx, xy], [xy, yy]]))[centre] / body.volume[centre]
        strain = np.array([xx, yy, 2.0 * xy])
        # Moment-matched bonds are exact where the family is whole; measured 4e-15.
        assert energy == pytest.approx(0.5 * strain @ law @ strain, rel=1e-12), name


@pytest.mark.parametrize("plane", ["stress", "strain", None])
def test_constants_of_bonds_follow_from_two_energies(plane):
    """Theory, eqs. 2.2 and 2.3, against quadrature over the disc or the ball, exact for the quartics that occur."""
    young, nu, delta, h = 207e9, 0.29, 3e-3, 4e-3
    angle = np.arange(12) * np.pi / 6
    if plane is None:
        height, weight = np.polynomial.legendre.leggauss(4)
        a, z = np.meshgrid(angle, height)
        flat = np.sqrt(1.0 - z**2)
        n = np.stack([flat * np.cos(a), flat * np.sin(a), z], axis=-1).reshape(-1, 3)
        weight = np.repeat(weight, angle.size)
        moment = np.pi * delta**4  # of r over the ball
    else:
        n, weight = np.column_stack([np.cos(angle), np.sin(angle)]), np.ones(angle.size)
        moment = 2.0 * np.pi * h * delta**3 / 3.0
    normal = micromodulus(young, nu, plane, h, delta)
    tangential = normal * tangential_ratio(nu, plane)

    def energy(strain):
        along = np.einsum("ka,ab,kb->k", n, strain, n)
        across = np.einsum("ka,ab,bc,kc->k", n, strain, strain, n) - along**2
        return 0.25 * moment * np.average(normal * along**2 + tangential * across, weights=weight)

    size = n.shape[1]
    isotropic, shear = np.eye(size), np.diag([1.0, -1.0, 0.0][:size])
    assert energy(isotropic) == pytest.approx(0.5 * bulk_modulus(young, nu, plane) * size**2, rel=1e-13)
    assert energy(shear) == pytest.approx(2.0 * shear_modulus(young, nu), rel=1e-13)


def test_toughness_in_plane_strain_is_irwins():
    stress, strain = (load_scene("config/scenes/smoke.yaml", {"mechanics.plane": p}) for p in ("stress", "strain"))
    g = [scene.material.toughness(scene.mechanics.plane) for scene in (stress, strain)]
    assert g[1] / g[0] == pytest.approx(1.0 - 0.29**2, rel=1e-12)
