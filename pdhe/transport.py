"""Nonlocal diffusion of hydrogen: rates of the right constant, mirror images at plane edges (theory, section 4)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdhe.bonds import Families, partial_volume, two_sided_volume
from pdhe.corrections import WEIGHT_LIMITS
from pdhe.kernels import diffusion as kernels
from pdhe.kernels import lattice

#: Exponent of the bond length in the kernel ``1 / r^p`` by the name that scenes use.
KERNELS = {"constant": 0, "inverse": 1, "inverse square": 2}

#: Share of the largest step with a maximum principle that the explicit scheme takes.
STEP_SAFETY = 0.9

#: Largest change of a coverage in one stable step that is round-off: from there on nothing changes any more.
STEADY = 1e-15


@dataclass(frozen=True)
class Edge:
    """A straight edge of the plate, a plane face of a body: ``coordinate[axis] = position``; images are taken in it."""

    axis: int
    position: float


@dataclass(frozen=True)
class Diffusion:
    """Rates of exchange between nodes and with prescribed edges.

    Attributes
    ----------
    rate
        1/s per directed bond (b,); ``rate * V_owner`` is symmetric, so hydrogen is conserved.
    exchange
        For each prescribed edge by name: 1/s per node (n,), to be multiplied with (edge coverage - node coverage).
    """

    bonds: Families
    volume: np.ndarray
    rate: np.ndarray
    exchange: dict[str, np.ndarray]

    def stable_step(self, held: np.ndarray) -> float:
        """Largest explicit step, s, that keeps every coverage within the bounds of the data (theory, eq. 4.6)."""
        total = np.empty(self.volume.size)
        kernels.outflow_rate(self.bonds.offsets, self.rate, self.sink(), held, total)
        fastest = float(total.max(initial=0.0))
        return np.inf if fastest == 0.0 else 1.0 / fastest

    def step(
        self,
        psi: np.ndarray,
        dt: float,
        held: np.ndarray,
        source: np.ndarray,
        new: np.ndarray,
        supply: np.ndarray,
    ) -> None:
        """Take one forward Euler step of dt seconds, ``psi`` to ``new`` (theory, eq. 4.5).

        ``held`` nodes keep their value; ``source`` from :meth:`source`; ``supply`` (n,) gathers what entered, m^3.
        """
        b = self.bonds
        if b.lattice is not None:
            lattice.diffuse(
                b.lattice.step, self._by_offset, self._sink, source, held, self.volume, dt, psi, new, supply
            )
        else:
            kernels.diffuse(
                b.offsets, b.neighbours, self.rate, self._sink, source, held, self.volume, dt, psi, new, supply
            )

    def stored_by_bond(self) -> dict[str, int]:
        """Bytes of what is kept bond by bond, by name, with what steps on a lattice make of the rates."""
        grid = self.bonds.lattice
        by_offset = {} if grid is None else {"rate by offset": grid.arranged(self.rate.dtype)}
        return {"rate": self.rate.nbytes} | by_offset

    @cached_property
    def _by_offset(self) -> np.ndarray:
        return self.bonds.lattice.arrange(self.rate, self.bonds.owners())

    @cached_property
    def _sink(self) -> np.ndarray:
        return self.sink()

    def sink(self) -> np.ndarray:
        """Sum of the edge exchange rates, 1/s (n,)."""
        return sum(self.exchange.values(), np.zeros(self.volume.size))

    def source(self, coverage: dict[str, float]) -> np.ndarray:
        """Edge exchange rates times the edges' coverages, 1/s (n,)."""
        return sum((self.exchange[name] * value for name, value in coverage.items()), np.zeros(self.volume.size))


class DiffusionStep:
    """One step of second order, with the coverage at any instant inside it (theory, eq. 4.7).

    Two forward Euler stages give the exact second-order Taylor polynomial of the linear problem. At the end of the step
    it is the mean of the start and of two Euler steps in a row: a mean of values that keep within the bounds of the
    data, so that the step keeps within them at the same stable length as a single Euler step.

    Parameters
    ----------
    diffusion
        The rates.
    psi
        Coverage at the start (n,); kept, not changed.
    dt
        Length, s; at most :meth:`Diffusion.stable_step`.
    held, source
        As in :meth:`Diffusion.step`.
    """

    sweeps = 2

    def __init__(self, diffusion: Diffusion, psi: np.ndarray, dt: float, held: np.ndarray, source: np.ndarray) -> None:
        self.start, first, second = psi, np.empty_like(psi), np.empty_like(psi)
        self._supply0, self._supply1 = np.zeros_like(psi), np.zeros_like(psi)
        diffusion.step(psi, dt, held, source, first, self._supply0)
        diffusion.step(first, dt, held, source, second, self._supply1)
        self.slope = first - psi
        self.bend = second - first - self.slope

    def coverage(self, share: float, nodes: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Coverage of some nodes after a share of the step."""
        return self.start[nodes] + share * self.slope[nodes] + (0.5 * share**2) * self.bend[nodes]

    def supply(self, share: float) -> np.ndarray:
        """What entered through each node from outside during a share of the step, m^3 (n,)."""
        return share * self._supply0 + (0.5 * share**2) * (self._supply1 - self._supply0)

    def curvature_at(self, i: np.ndarray, j: np.ndarray) -> float:
        """Largest second-order over largest first-order term of the step, in the mean coverage of two nodes."""
        slope = np.abs(self.slope[i] + self.slope[j]).max(initial=0.0)
        bend = 0.5 * np.abs(self.bend[i] + self.bend[j]).max(initial=0.0)
        # Of round-off, one is as large as the other however short the step.
        return float(bend / slope) if bend > STEADY and slope > 0.0 else 0.0

    @property
    def settled(self) -> bool:
        """Whether nothing changes but for round-off."""
        return float(np.abs(self.slope).max(initial=0.0)) <= STEADY

    def at_rest(self, times: float) -> None:
        """Make a settled step that many times as long."""
        self.slope, self.bend = np.zeros_like(self.start), np.zeros_like(self.start)
        self._supply0 = self._supply1 = times * steady_flux(self._supply0)


def steady_flux(flux: np.ndarray) -> np.ndarray:
    """Flow in through each node of a body that no longer changes, (n,): what enters leaves elsewhere.

    The round-off in the sum is taken off in proportion to the flows, as it would grow with time.
    """
    gross = float(np.abs(flux).sum())
    return flux - np.abs(flux) * (float(flux.sum()) / gross) if gross > 0.0 else flux


def build_diffusion(
    bonds: Families,
    coordinates: np.ndarray,
    volume: np.ndarray,
    spacing: np.ndarray,
    thickness: float,
    diffusivity: float,
    kernel: str,
    partial: str,
    edges: dict[str, Edge],
    prescribed: set[str],
    relative: np.ndarray | None = None,
) -> Diffusion:
    """Build the rates for a diffusivity in m^2/s.

    Each plane edge acts as a mirror: nodes beyond it carry the same coverage (insulated) or the odd continuation about
    the prescribed value. Both are folded into the bonds of the real nodes: an image of j seen from i is never nearer
    than j itself, so no coefficient is negative and the maximum principle holds. The rates are scaled, node by node and
    then averaged over the two ends, so that the second moment of each family, images included, is that of the
    diffusivity.

    Where nodes have diffusivities of their own, ``relative`` (n,) times that one, a bond has the harmonic mean of its
    two ends, as resistances in a row have (theory, eq. 4.18).
    """
    owner, other = bonds.owners(), bonds.neighbours
    power = KERNELS[kernel]
    size = 0.5 * (spacing[owner] + spacing[other])
    horizons = bonds.horizons

    def counted(i: np.ndarray, j: np.ndarray, distance: np.ndarray, width: np.ndarray) -> np.ndarray:
        """Share of the volume of nodes j, or of their images, that nodes i at a distance exchange with."""
        if horizons is None:
            return partial_volume(distance, bonds.horizon, width, partial)
        # The constant of a kernel goes with the horizon to p - 4 in the plane (theory, eq. 4.2).
        return two_sided_volume(distance, (horizons[i], horizons[j]), bonds.horizon, width, partial, 4 - power)[0]

    base = counted(owner, other, bonds.length, size) * volume[other] / bonds.length**power
    moment = bonds.sum_by_node(base * bonds.length**2)
    even = np.zeros_like(base)
    exchange = {name: np.zeros(volume.size) for name in prescribed}
    everyone = np.arange(volume.size, dtype=np.int32)

    def seen(i: np.ndarray, j: np.ndarray, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Coefficient and distance of the images of nodes j in some edges as seen from nodes i."""
        image = coordinates[j].copy()
        for name in names:
            image[:, edges[name].axis] = 2.0 * edges[name].position - image[:, edges[name].axis]
        apart = image - coordinates[i]
        distance = np.hypot(*apart.T) if apart.shape[1] == 2 else np.linalg.norm(apart, axis=1)
        width = 0.5 * (spacing[i] + spacing[j])
        return counted(i, j, distance, width) * volume[j] / distance**power, distance

    for names in _reflections(edges):
        odd = sum(name in prescribed for name in names) % 2 == 1
        via = next((name for name in names if name in prescribed), None)
        near = np.ones(volume.size, bool)
        for name in names:
            reach = bonds.horizon if horizons is None else horizons.max()
            near &= np.abs(coordinates[:, edges[name].axis] - edges[name].position) <= reach + spacing
        rows = np.flatnonzero(near[owner] & near[other])
        for i, j, bond in ((owner[rows], other[rows], rows), (everyone[near], everyone[near], None)):
            value, distance = seen(i, j, names)
            moment += np.bincount(i, value * distance**2, volume.size)
            if bond is not None:
                even[bond] += -value if odd else value
            if odd:
                exchange[via] += np.bincount(i, 2.0 * value, volume.size)
    # Next to one prescribed edge base + even is never negative. In the corner of two it may be, for a few bonds; the
    # part of their images that is too much then carries the edge's coverage itself, not the odd continuation about it.
    excess = np.flatnonzero(base + even < 0.0)
    if excess.size:
        i, j, deficit = owner[excess], other[excess], -(base + even)[excess]
        even[excess] = -base[excess]
        parts = {name: seen(i, j, (name,))[0] for name in prescribed}
        share = deficit / np.maximum(sum(parts.values()), np.finfo(float).tiny)
        for name, part in parts.items():
            exchange[name] -= np.bincount(i, share * part, volume.size)
    # A family's second moment is that of the diffusivity when sum base r^2 = 4 D (two axes, a factor of one half); in
    # space 6 D.
    scale = 2.0 * coordinates.shape[1] * diffusivity / np.where(moment > 0.0, moment, np.inf)
    typical = np.median(scale[scale > 0.0]) if (scale > 0.0).any() else 1.0
    scale = np.clip(scale, WEIGHT_LIMITS[0] * typical, WEIGHT_LIMITS[1] * typical)
    rate = 0.5 * (scale[owner] + scale[other]) * (base + even)
    exchange = {name: scale * value for name, value in exchange.items()}
    if relative is not None:
        rate *= 2.0 / (1.0 / relative[owner] + 1.0 / relative[other])
        exchange = {name: relative * value for name, value in exchange.items()}
    return Diffusion(bonds, volume, rate, exchange)


def _reflections(edges: dict[str, Edge]) -> list[tuple[str, ...]]:
    """Single reflections in each edge, double ones where two edges meet, and triple ones in the corners of a body."""
    single = [(name,) for name in edges]
    double = [(a, b) for a in edges for b in edges if edges[a].axis < edges[b].axis]
    triple = [(a, b, c) for a, b in double for c in edges if edges[b].axis < edges[c].axis]
    return single + double + triple
