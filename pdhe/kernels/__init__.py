"""Numba loops over plain arrays.

Each file holds one group of kernels together with every helper they call, because Numba's on-disk cache watches only
the file in which a kernel is written. Kernels gather: a node sums its own family from the directed bond list, so
nothing races and the sums come out the same to the bit on any number of threads.
"""

from pdhe.kernels.jit import as_float, threads_for

__all__ = ["as_float", "threads_for"]
