"""Boundary conditions: which degrees of freedom are prescribed, and their values in time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

#: Edge pairs between which prescribed displacements are interpolated to the cell centroids: edge -> (opposite, axis).
OPPOSITE = {
    "left": ("right", 0), "right": ("left", 0), "bottom": ("top", 1), "top": ("bottom", 1), "front": ("back", 2),
    "back": ("front", 2),
}  # fmt: skip
#: Those at the upper end of their axis.
UPPER = ("right", "top", "back")


@dataclass(frozen=True)
class Prescribed:
    """One prescribed displacement component of one node set.

    Attributes
    ----------
    on, component
        Node set, and 0 for x, 1 for y or 2 for z.
    value
        Displacement of the edge, m, as a function of time, s.
    corners
        Times at which the function has a corner, s.
    """

    on: str
    component: int
    value: Callable[[float], float]
    corners: tuple[float, ...]
    at: str = "edge"


class DisplacementConditions:
    """All prescribed displacements of a scene.

    An edge's displacement belongs to the edge, but the outermost nodes sit half a cell inside it. Where the opposite
    edge prescribes the same component, the nodes take the value that a uniform strain between both edges has at their
    place; without this the strain would be too large by spacing over plate size. ``at: nodes`` switches that off.
    Opposite a mirror line the other edge is the image of this one.

    Parameters
    ----------
    mirrors
        Edges that are mirror lines.
    times
        By what forces on a set along a component are multiplied to be those of the whole body, where not by 1.

    Attributes
    ----------
    fixed
        Degrees of freedom with a prescribed value, bool (n, dim).
    """

    def __init__(
        self,
        prescribed: list[Prescribed],
        node_sets: dict[str, np.ndarray],
        coordinates: np.ndarray,
        size: tuple[float, ...],
        mirrors: tuple[str, ...] = (),
        times: Mapping[tuple[str, int], float] | None = None,
    ) -> None:
        self.prescribed, self.node_sets = prescribed, node_sets
        self.times = dict(times or {})
        self.shape = coordinates.shape
        self.fixed = np.zeros(self.shape, bool)
        self._patterns: list[tuple[int, int, np.ndarray, np.ndarray]] = []  # (load, component, nodes, factor)
        for index, load in enumerate(prescribed):
            # A corner node of two sets belongs to the condition that comes first; the scene's check saw them agree.
            nodes = node_sets[load.on][~self.fixed[node_sets[load.on], load.component]]
            self.fixed[nodes, load.component] = True
            partner = self._partner(load)
            opposite, axis = OPPOSITE.get(load.on, ("", 0))
            if opposite in mirrors and axis == load.component and load.at == "edge":
                # The image moves the other way, so that a uniform strain leaves the mirror line at rest.
                place = coordinates[nodes, axis] / size[axis]
                self._patterns.append((index, axis, nodes, place if load.on in UPPER else 1.0 - place))
                continue
            if partner is None:
                self._patterns.append((index, load.component, nodes, np.ones(nodes.size)))
                continue
            place = coordinates[nodes, axis] / size[axis]
            own = place if load.on in UPPER else 1.0 - place
            self._patterns.append((index, load.component, nodes, own))
            self._patterns.append((prescribed.index(partner), load.component, nodes, 1.0 - own))
        self.corners = sorted({t for load in prescribed for t in load.corners})

    def _partner(self, load: Prescribed) -> Prescribed | None:
        # In the plane `front` and `back` are names like others.
        if load.at != "edge" or OPPOSITE.get(load.on, ("", self.shape[1]))[1] >= self.shape[1]:
            return None
        opposite = OPPOSITE[load.on][0]
        found = [p for p in self.prescribed if p.on == opposite and p.component == load.component and p.at == "edge"]
        return found[0] if found else None

    def values(self, t: float) -> np.ndarray:
        """Prescribed displacements at time t, m (n, dim); zero where nothing is prescribed."""
        result = np.zeros(self.shape)
        amount = [load.value(t) for load in self.prescribed]
        for index, component, nodes, factor in self._patterns:
            result[nodes, component] += factor * amount[index]
        return result

    def sparse(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return what :meth:`values` does for the fixed degrees of freedom alone, in the order of ``nonzero(fixed)``.

        Returns
        -------
        node, component, load, factor
            (m,), (m,), (m, 2) and (m, 2): a value is the sum of both factors times the amounts of both loads.
        """
        node, component = np.nonzero(self.fixed)
        load, factor = np.zeros((*self.shape, 2), np.int64), np.zeros((*self.shape, 2))
        taken = np.zeros(self.shape, np.int64)
        for index, axis, nodes, share in self._patterns:
            slot = taken[nodes, axis]
            load[nodes, axis, slot], factor[nodes, axis, slot] = index, share
            taken[nodes, axis] += 1
        return node, component, load[node, component], factor[node, component]

    def changes(self, t0: float, t1: float) -> bool:
        """Tell whether any prescribed displacement differs between two times."""
        return any(load.value(t0) != load.value(t1) for load in self.prescribed)

    def reactions(self, force: np.ndarray) -> dict[str, float]:
        """Force that holds each prescribed set, N: minus the internal force summed over its nodes."""
        found = {}
        for on, component in [(load.on, load.component) for load in self.prescribed]:
            held = -float(force[self.node_sets[on], component].sum())
            found[f"reaction_{on}_{'xyz'[component]}"] = self.times.get((on, component), 1.0) * held
        return found
