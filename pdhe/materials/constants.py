"""Elastic constants in plane stress, plane strain and three dimensions (theory, eqs. 2.2 and 2.3)."""

from __future__ import annotations

from dataclasses import dataclass

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


def mandel(stiffness: np.ndarray) -> np.ndarray:
    """Stiffness as symmetric matrices (..., 3, 3), in space (..., 6, 6), whose eigenvalues are those of the tensor."""
    twice = np.array([1.0, 1.0, 2.0] if stiffness.shape[-1] == 3 else [1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    return stiffness * np.sqrt(np.outer(twice, twice))


def turned(stiffness: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Stiffness (3, 3) of a material whose axes are turned by some angles, rad (n,), as (n, 3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    cross = np.sqrt(2.0) * c * s
    # How strains xx, yy and sqrt(2) xy look in the axes of the material.
    rows = [[c * c, s * s, cross], [s * s, c * c, -cross], [-cross, cross, c * c - s * s]]
    turn = np.moveaxis(np.array(rows), -1, 0)
    return turn.transpose(0, 2, 1) @ mandel(stiffness) @ turn / mandel(np.ones((3, 3)))


#: Rows and columns of the six entries of a symmetric tensor in space: xx, yy, zz, yz, xz, xy.
ROWS, COLUMNS = np.array([0, 1, 2, 1, 0, 0]), np.array([0, 1, 2, 2, 2, 1])


def turned_in_space(stiffness: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Stiffness (6, 6) of a material in the axes of space, as (n, 6, 6).

    Parameters
    ----------
    stiffness
        For the strains 11, 22, 33 and engineering 23, 13, 12 in the axes of the material, Pa.
    frame
        These axes as unit vectors, one a row, (n, 3, 3).
    """
    one, two = frame[:, ROWS], frame[:, COLUMNS]
    both = one[:, :, ROWS] * two[:, :, COLUMNS] + one[:, :, COLUMNS] * two[:, :, ROWS]
    # How strains, those of shear times the root of 2, look in the axes of the material.
    turn = 0.5 * mandel(both)
    return turn.transpose(0, 2, 1) @ mandel(stiffness) @ turn / mandel(np.ones((6, 6)))


@dataclass(frozen=True)
class Orthotropic:
    """Engineering constants along material axes 1 and 2 in the plane and 3 across it; moduli in Pa.

    ``poissons_ratio_12`` is the contraction along 2 under tension along 1. Moduli and ratios of axis 3 are for plane
    strain and bodies in space, its shear moduli for the latter.
    """

    youngs_modulus_1: float
    youngs_modulus_2: float
    poissons_ratio_12: float
    shear_modulus_12: float
    youngs_modulus_3: float | None = None
    poissons_ratio_13: float | None = None
    poissons_ratio_23: float | None = None
    shear_modulus_13: float | None = None
    shear_modulus_23: float | None = None

    def in_space(self) -> np.ndarray:
        """Stiffness in the axes of the material, Pa (6, 6), for the strains 11, 22, 33 and engineering 23, 13, 12."""
        moduli = self.youngs_modulus_1, self.youngs_modulus_2, self.youngs_modulus_3
        compliance = np.diag([1.0 / modulus for modulus in moduli])
        ratios = {(0, 1): self.poissons_ratio_12, (0, 2): self.poissons_ratio_13, (1, 2): self.poissons_ratio_23}
        for (a, b), ratio in ratios.items():
            compliance[a, b] = compliance[b, a] = -ratio / moduli[a]
        whole = np.diag([0.0, 0.0, 0.0, self.shear_modulus_23, self.shear_modulus_13, self.shear_modulus_12])
        whole[:3, :3] = np.linalg.inv(compliance)
        return whole

    def stiffness(self, plane: str) -> np.ndarray:
        """Stiffness in the axes of the material, Pa (3, 3), for the strains 11, 22 and engineering 12."""
        e1, e2, nu = self.youngs_modulus_1, self.youngs_modulus_2, self.poissons_ratio_12
        compliance = np.array([[1.0 / e1, -nu / e1], [-nu / e1, 1.0 / e2]])
        if plane == "strain":
            across = np.array([-self.poissons_ratio_13 / e1, -self.poissons_ratio_23 / e2])
            # No strain across: the stress there is what the other two make it.
            compliance = compliance - self.youngs_modulus_3 * np.outer(across, across)
        whole = np.zeros((3, 3))
        whole[:2, :2], whole[2, 2] = np.linalg.inv(compliance), self.shear_modulus_12
        return whole
