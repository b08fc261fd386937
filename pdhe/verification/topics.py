"""The list of topics, in the order of the page."""

from __future__ import annotations

from importlib import import_module
from inspect import signature
from typing import TYPE_CHECKING, Any

from pdhe.errors import PdheError

if TYPE_CHECKING:
    from pdhe.verification.report import Report

#: Topic -> module that holds ``run(settings) -> Report``. A new topic is one line here.
TOPICS: dict[str, str] = {
    "operators": "pdhe.verification.operators",
    "boundary": "pdhe.verification.boundary",
    "decoupled": "pdhe.verification.decoupled",
    "moduli": "pdhe.verification.moduli",
    "elastic_models": "pdhe.verification.elastic_models",
    "large_strains": "pdhe.verification.large_strains",
    "compliance": "pdhe.verification.compliance",
    "convergence_mechanics": "pdhe.verification.convergence_mechanics",
    "toughness": "pdhe.verification.toughness",
    "graded": "pdhe.verification.graded",
    "symmetry": "pdhe.verification.symmetry",
    "three_dimensions": "pdhe.verification.three_dimensions",
    "waves": "pdhe.verification.waves",
    "verlet": "pdhe.verification.verlet",
    "external_mechanics": "pdhe.verification.external_mechanics",
    "diffusion_slab": "pdhe.verification.diffusion_slab",
    "diffusion_operator": "pdhe.verification.diffusion_operator",
    "time_step": "pdhe.verification.time_step",
    "hydrogen_balance": "pdhe.verification.hydrogen_balance",
    "convergence_diffusion": "pdhe.verification.convergence_diffusion",
    "permeation": "pdhe.verification.permeation",
    "embrittlement": "pdhe.verification.embrittlement",
    "saturation_time": "pdhe.verification.saturation_time",
    "pair": "pdhe.verification.pair",
    "bond_failure": "pdhe.verification.bond_failure",
    "crack_path_mode_i": "pdhe.verification.crack_path_mode_i",
    "growth_velocity": "pdhe.verification.growth_velocity",
    "kink_angle": "pdhe.verification.kink_angle",
    "crack_scenes": "pdhe.verification.crack_scenes",
    "timing": "pdhe.verification.timing",
}


def run_topic(topic: str, settings: dict[str, Any] | None = None) -> Report:
    """Run one topic; settings override the topic's own defaults.

    Raises
    ------
    PdheError
        If there is no such topic, or it does not know one of the settings.
    """
    if topic not in TOPICS:
        raise PdheError(f"no topic '{topic}'; there are {', '.join(TOPICS)}")
    known = signature(import_module(TOPICS[topic]).run).parameters
    for key in settings or {}:
        if key not in known:
            raise PdheError(f"topic '{topic}' has no setting '{key}'; it has {', '.join(known)}")
    return import_module(TOPICS[topic]).run(**(settings or {}))
