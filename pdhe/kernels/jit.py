"""The one decorator that holds every compiler option, and the one gate that arrays pass on their way into a kernel."""

from __future__ import annotations

import contextlib
import functools
import os
import types
from collections.abc import Callable, Iterator
from typing import Any

import numba
import numpy as np

# OpenMP's threads spin while they wait for each other, which on a machine with other work makes two threads many times
# slower than one; Numba's own pool sleeps. Whoever sets the variable decides.
if "NUMBA_THREADING_LAYER" not in os.environ:
    numba.config.THREADING_LAYER = "workqueue"

#: Directed bonds that keep one thread busy. With half as many a second thread is worth nothing: waiting for each other
#: after every sweep costs what it gains (measured at 20,000 nodes, 550,000 bonds).
BONDS_PER_THREAD = 500_000


class Kernel:
    """A loop over nodes compiled for one thread and for several, each when first called.

    One thread runs a plain loop: handing a sweep to the pool and waiting for it takes 25 us, as much as a sweep over a
    thousand nodes, and a job on one thread never loads what belongs to the pool. Both do the same operations in the
    same order, so that results are the same to the bit.

    ``fastmath`` stays off: it would make ``isnan`` false, and contraction alone would let the two differ in the last
    digit.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)
        self._serial = numba.njit(cache=True, error_model="numpy")(_named(function, "serial"))
        self._parallel = numba.njit(parallel=True, cache=True, error_model="numpy")(_named(function, "parallel"))

    def __call__(self, *arguments: Any) -> None:
        """Run on as many threads as Numba is set to."""
        (self._serial if numba.get_num_threads() == 1 else self._parallel)(*arguments)


def _named(function: Callable[..., Any], suffix: str) -> types.FunctionType:
    """Copy a function under a longer name: the cache on disk tells functions apart by name, not by how they compile."""
    twin = types.FunctionType(function.__code__, function.__globals__, f"{function.__name__}_{suffix}")
    twin.__qualname__, twin.__module__ = twin.__name__, function.__module__
    return twin


def kernel(function: Callable[..., Any]) -> Kernel:
    """Compile a kernel whose outermost loop is a ``prange`` and cache it on disk; it returns nothing."""
    return Kernel(function)


def serial_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel that runs on one thread, for loops that are sequential or small."""
    return numba.njit(cache=True, error_model="numpy")(function)


@contextlib.contextmanager
def threads_for(bonds: int) -> Iterator[None]:
    """Use no more threads than so many directed bonds keep busy: starting them costs as much as a small sweep."""
    before = numba.get_num_threads()
    numba.set_num_threads(max(1, min(before, bonds // BONDS_PER_THREAD)))
    try:
        yield
    finally:
        numba.set_num_threads(before)


def as_float(array: Any, shape: tuple[int, ...] | None = None) -> np.ndarray:
    """Return ``array`` as contiguous float64, of ``shape`` where given; raise ``ValueError`` on any other shape."""
    result = np.ascontiguousarray(array, dtype=np.float64)
    if shape is not None and result.shape != shape:
        raise ValueError(f"expected an array of shape {shape}, got {result.shape}")
    return result
