"""Explicit diffusion sweeps over directed bonds (theory, section 4); indices unsigned as in the mechanics."""

from __future__ import annotations

from numba import prange
from numpy import uint32, uint64

from pdhe.kernels.jit import kernel


@kernel
def diffuse(offsets, neighbours, rate, sink, source, held, volume, dt, psi, new, supply):
    """One forward Euler step of the coverage, ``psi`` to ``new`` (theory, eq. 4.5).

    ``rate`` 1/s per bond; ``sink`` 1/s and ``source`` (sink times outside coverage, 1/s) exchange with prescribed
    edges; held nodes keep their value. ``supply`` gathers what enters through each node from outside, m^3: through the
    edge, or, at a held node, whatever keeps it from changing.
    """
    for i in prange(psi.size):
        here = psi[i]
        total = 0.0
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            total += rate[k] * (psi[uint32(neighbours[k])] - here)
        if held[i]:
            new[i] = here
            supply[i] -= dt * volume[i] * total
        else:
            through_edge = source[i] - sink[i] * here
            new[i] = here + dt * (total + through_edge)
            supply[i] += dt * volume[i] * through_edge


@kernel
def outflow_rate(offsets, rate, sink, held, total):
    """Write the sum of the rates that leave each node, 1/s; its inverse bounds the explicit step. Zero where held."""
    for i in prange(total.size):
        value = sink[i]
        for k in range(uint64(offsets[i]), uint64(offsets[i + 1])):
            value += rate[k]
        total[i] = 0.0 if held[i] else value
