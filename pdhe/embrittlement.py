"""Embrittlement laws: what hydrogen coverage leaves of a bond's resistance (theory, eqs. 5.5 to 5.7 and 5.14)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class EmbrittlementLaw:
    """A law with its source.

    Attributes
    ----------
    factor
        Function of the coverage (0 to 1, array): what is left of the resistance; 1 without hydrogen, falling.
    source
        Where it comes from.
    """

    factor: Callable[[np.ndarray], np.ndarray]
    source: str


def linear(slope: float) -> Callable[[np.ndarray], np.ndarray]:
    """Law that falls in proportion to coverage, by ``slope`` at full coverage (theory, eq. 5.14)."""
    return lambda psi: 1.0 - slope * psi


_LINEAR = "slope in Martinez-Paneda, Golahmar and Niordson (2018), Comput. Methods Appl. Mech. Eng. 342, 742: "

#: Laws by the name that scenes use. A new law is one line here.
LAWS = {
    "serebrinsky": EmbrittlementLaw(
        lambda psi: 1.0 - 1.0467 * psi + 0.1687 * psi**2,
        "Serebrinsky, Carter and Ortiz (2004), J. Mech. Phys. Solids 52, 2403: ideal fracture energy of Fe(110)",
    ),
    "linear iron": EmbrittlementLaw(linear(0.89), _LINEAR + "surface energy of iron"),
    "linear nickel": EmbrittlementLaw(linear(0.41), _LINEAR + "surface energy of nickel"),
    "linear aluminium": EmbrittlementLaw(linear(0.67), _LINEAR + "surface energy of aluminium"),
}


def resistance(law: EmbrittlementLaw, degradation: str, psi: np.ndarray) -> np.ndarray:
    """Critical stretch over its dry value at coverage ``psi`` (theory, eqs. 5.6 and 5.7).

    ``degradation`` says what the law's factor multiplies: the critical ``stretch``, or the fracture ``energy``, whose
    square root the stretch follows.
    """
    factor = law.factor(np.asarray(psi))
    return factor if degradation == "stretch" else np.sqrt(factor)
