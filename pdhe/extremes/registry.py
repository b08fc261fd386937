"""The list of groups of extreme cases, in the order of their page; light enough for the workflow."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from pdhe.errors import PdheError

if TYPE_CHECKING:
    from pdhe.extremes.outcome import Extreme

#: Group -> module that holds ``CASES: list[Extreme]``. A new group is one line here, a new case one line in its module.
EXTREMES: dict[str, str] = {
    "elasticity": "pdhe.extremes.elasticity",
    "transport": "pdhe.extremes.transport",
    "shapes": "pdhe.extremes.shapes",
    "fracture": "pdhe.extremes.fracture",
}


def cases_of(group: str) -> list[Extreme]:
    """The cases of a group, in the order of the page.

    Raises
    ------
    PdheError
        If there is no such group.
    """
    if group not in EXTREMES:
        raise PdheError(f"no group of extremes '{group}'; there are {', '.join(EXTREMES)}")
    return import_module(EXTREMES[group]).CASES
