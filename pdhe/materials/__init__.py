"""Elastic models, one file each, and the bodies that carry their forces (theory, section 2)."""

from __future__ import annotations

import numpy as np

from pdhe.bonds import Bonds
from pdhe.materials.body import BY_ENERGY, BY_STRETCH, Body, BondLoad, Measure, Model
from pdhe.materials.bond import BondBody, CondensedRotation, OneParameter, ThesisSpring
from pdhe.materials.correspondence import Correspondence, CorrespondenceBody
from pdhe.materials.finite_strain import FiniteStrain, FiniteStrainBody, FiniteStrainSolidBody
from pdhe.materials.state_based import StateBased, StateBasedBody

__all__ = [
    "BY_ENERGY",
    "BY_STRETCH",
    "MODELS",
    "Body",
    "BondBody",
    "BondLoad",
    "CondensedRotation",
    "Correspondence",
    "CorrespondenceBody",
    "FiniteStrain",
    "Measure",
    "Model",
    "OneParameter",
    "StateBased",
    "StateBasedBody",
    "ThesisSpring",
    "make_body",
]

#: Models by the name that scenes use.
MODELS: dict[str, type[Model]] = {
    "condensed rotation": CondensedRotation,
    "thesis spring": ThesisSpring,
    "one-parameter": OneParameter,
    "state-based": StateBased,
    "correspondence": Correspondence,
}


def make_body(
    bonds: Bonds,
    model: Model,
    coordinates: np.ndarray,
    volume: np.ndarray,
    precision: type = np.float64,
    relative: np.ndarray | None = None,
) -> Body:
    """Put bonds and a model together: the body of the model's own kind; arguments as for :class:`Body`.

    Only :class:`BondBody` can be given ``relative``.
    """
    kind = model.body if bonds.dimension == 2 else model.solid_body
    if isinstance(model, Correspondence) and model.strain == "finite":
        kind = FiniteStrainBody if bonds.dimension == 2 else FiniteStrainSolidBody
    own = () if relative is None else (relative,)
    return kind(bonds, model, coordinates, volume, precision, *own)
