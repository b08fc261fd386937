"""The one decorator that holds every compiler option, and the one gate that arrays pass on their way into a kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a parallel kernel (``prange`` allowed) and cache it on disk.

    ``fastmath`` stays off: it would make ``isnan`` false, and it slows the gather sweeps down.
    """
    return numba.njit(parallel=True, cache=True, error_model="numpy")(function)


def serial_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel that runs on one thread, for loops that are sequential or small."""
    return numba.njit(cache=True, error_model="numpy")(function)


def thread_count() -> int:
    """Threads that the parallel kernels use now (set by ``NUMBA_NUM_THREADS``)."""
    return numba.get_num_threads()


def as_float(array: Any, shape: tuple[int, ...] | None = None) -> np.ndarray:
    """Return ``array`` as contiguous float64, of ``shape`` where given; raise ``ValueError`` on any other shape."""
    result = np.ascontiguousarray(array, dtype=np.float64)
    if shape is not None and result.shape != shape:
        raise ValueError(f"expected an array of shape {shape}, got {result.shape}")
    return result


def as_index(array: Any) -> np.ndarray:
    """Return ``array`` as contiguous int32; raise ``ValueError`` if a value does not fit."""
    result = np.ascontiguousarray(array)
    if result.size and (result.min() < -(2**31) or result.max() >= 2**31):
        raise ValueError("an index does not fit into 32 bits")
    return result.astype(np.int32, copy=False)
