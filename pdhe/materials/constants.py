"""Elastic constants in plane stress, plane strain and three dimensions (theory, eqs. 2.2 and 2.3)."""

from __future__ import annotations

import numpy as np

#: What keeps the third direction: no stress (``stress``), no strain (``strain``), or there is nothing to keep (None).
PLANES = ("stress", "strain", None)
#: Poisson's ratio of bonds with one constant.
ONE_PARAMETER = {"stress": 1.0 / 3.0, "strain": 1.0 / 4.0, None: 1.0 / 4.0}


def shear_modulus(young: float, poisson: float) -> float:
    """Shear modulus, Pa."""
    return young / (2.0 * (1.0 + poisson))


def bulk_modulus(young: float, poisson: float, plane: str | None) -> float:
    """Isotropic stress over the trace of an isotropic strain, in the plane or in space, Pa."""
    if plane == "stress":
        return young / (2.0 * (1.0 - poisson))
    if plane == "strain":
        return young / (2.0 * (1.0 + poisson) * (1.0 - 2.0 * poisson))
    return young / (3.0 * (1.0 - 2.0 * poisson))


def micromodulus(young: float, poisson: float, plane: str | None, thickness: float, horizon: float) -> float:
    """Normal micromodulus of the bonds that have the energy of an isotropic extension, N/m^6 (theory, eq. 2.2)."""
    if plane == "stress":
        return 6.0 * young / (np.pi * thickness * horizon**3 * (1.0 - poisson))
    bulk = bulk_modulus(young, poisson, plane)
    return 18.0 * bulk / (np.pi * horizon**4) if plane is None else 12.0 * bulk / (np.pi * thickness * horizon**3)


def tangential_ratio(poisson: float, plane: str | None) -> float:
    """Tangential over normal micromodulus of a bond with two constants (theory, eq. 2.3)."""
    if plane == "stress":
        return (1.0 - 3.0 * poisson) / (1.0 + poisson)
    return 1.0 - 4.0 * poisson if plane == "strain" else (1.0 - 4.0 * poisson) / (1.0 + poisson)


def stiffness_tensor(young: float, poisson: float, plane: str) -> np.ndarray:
    """Stiffness of an isotropic plate, Pa (3, 3), for the strains xx, yy and engineering xy."""
    bulk, shear = bulk_modulus(young, poisson, plane), shear_modulus(young, poisson)
    return np.array([[bulk + shear, bulk - shear, 0.0], [bulk - shear, bulk + shear, 0.0], [0.0, 0.0, shear]])
