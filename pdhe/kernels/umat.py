"""Calls of a compiled Abaqus user material (UMAT) from within the loop over nodes.

The address of the routine is an argument like any other, so that what is compiled here serves every user material and
is kept on disk. A UMAT takes 37 pointers; those of one thread always point into the same two rows of scratch, whose
places are the constants below.
"""

from __future__ import annotations

from llvmlite import ir
from numba import prange, types
from numba.extending import intrinsic

from pdhe.kernels.jit import kernel

#: Where the real arguments lie in a row of scratch.
(
    STRESS, DDSDDE, SSE, SPD, SCD, RPL, DDSDDT, DRPLDE, DRPLDT, STRAN, DSTRAN, TIME, DTIME, TEMP, DTEMP, PREDEF, DPRED,
    COORDS, DROT, PNEWDT, CELENT, DFGRD0, DFGRD1, BEHIND,
) = (
    0, 6, 42, 43, 44, 45, 46, 52, 58, 59, 65, 71, 73, 74, 75, 76, 77, 78, 81, 90, 91, 92, 101, 110,
)  # fmt: skip
#: Numbers that are not a number before the state variables, behind them, and behind the properties: a routine that
#: reads more than it was given returns them, one that writes more leaves a trace.
GUARD = 64
STATEV = BEHIND + GUARD
#: Where the integer arguments lie in theirs; JSTEP takes four.
NDI, NSHR, NTENS, NSTATV, NPROPS, NOEL, NPT, LAYER, KSPT, JSTEP, KINC, INTEGERS = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 13, 14
#: Pointers that a UMAT takes.
ARGUMENTS = 37


@intrinsic
def call(typing, address, table, length):
    """Call the routine at an address with the pointers in a table, and behind them the length of the name.

    Fortran passes the length of a text behind all other arguments; C does not look at it.
    """
    del typing

    def generate(context, builder, signature, arguments):
        del signature
        pointer, long = ir.IntType(8).as_pointer(), ir.IntType(64)
        kind = ir.FunctionType(ir.VoidType(), [pointer] * ARGUMENTS + [long])
        routine = builder.inttoptr(arguments[0], kind.as_pointer())
        rows = builder.inttoptr(arguments[1], pointer.as_pointer())
        given = [builder.load(builder.gep(rows, [ir.Constant(long, k)])) for k in range(ARGUMENTS)]
        builder.call(routine, [*given, arguments[2]])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), generate


@kernel
def advance(
    address, tables, length, starts, work, integers, before, after, coordinates, sizes, times, field, field_after,
    stress, state, energy, new_stress, new_state, new_energy, tangent, wanted, tensor,
):  # fmt: skip
    """Let a user material take every point from one displacement gradient to another.

    Parameters
    ----------
    address, tables, length
        Of the routine; of each thread's table of pointers, int64 (t,); of the name.
    starts
        The points of each thread, (t + 1,).
    work, integers
        Scratch, a row a thread.
    before, after
        Displacement gradients, row by row: (n, 4) in a plane, (n, 9) in space.
    coordinates, sizes, times
        Places, m (n, dim); characteristic lengths, m (n,); time at the start and length of the increment, s (2,).
    field, field_after
        Field variable at its start and at its end, (n,).
    stress, state, energy
        At its start: components in the order of Abaqus, Pa (n, c); state variables (n, s); energies J/m^3 (n, 3).
    new_stress, new_state, new_energy, tangent, wanted, tensor
        To write: the same at its end; DDSDDE, column by column, Pa (n, c c); PNEWDT (n,); stress tensors as
        ``after``.
    """
    for t in prange(starts.size - 1):
        w = work[t]
        size = stress.shape[1]
        direct = 3 if size > 3 else 2
        dim = 3 if size == 6 else 2
        variables = state.shape[1]
        for i in range(starts[t], starts[t + 1]):
            for k in range(DDSDDE, STRAN):
                w[k] = 0.0
            for k in range(size):
                w[STRESS + k] = stress[i, k]
            for k in range(3):
                w[SSE + k] = energy[i, k]
            for k in range(variables):
                w[STATEV + k] = state[i, k]
            for a in range(direct):
                w[STRAN + a] = before[i, a * dim + a] if a < dim else 0.0
                w[DSTRAN + a] = after[i, a * dim + a] - before[i, a * dim + a] if a < dim else 0.0
            k = direct
            for a in range(dim):
                for b in range(a + 1, dim):
                    shear = before[i, a * dim + b] + before[i, b * dim + a]
                    w[STRAN + k] = shear
                    w[DSTRAN + k] = after[i, a * dim + b] + after[i, b * dim + a] - shear
                    k += 1
            w[TIME] = times[0]
            w[TIME + 1] = times[0]
            w[DTIME] = times[1]
            for k in range(TEMP, DROT):
                w[k] = 0.0
            w[PREDEF] = field[i]
            w[DPRED] = field_after[i] - field[i]
            for a in range(dim):
                w[COORDS + a] = coordinates[i, a]
            w[PNEWDT] = 1.0
            w[CELENT] = sizes[i]
            for a in range(3):
                for b in range(3):
                    same = 1.0 if a == b else 0.0
                    inside = a < dim and b < dim
                    w[DROT + a + 3 * b] = same
                    w[DFGRD0 + a + 3 * b] = same + (before[i, a * dim + b] if inside else 0.0)
                    w[DFGRD1 + a + 3 * b] = same + (after[i, a * dim + b] if inside else 0.0)
            integers[t, NOEL] = i + 1
            call(address, tables[t], length)
            for k in range(size):
                new_stress[i, k] = w[STRESS + k]
            for k in range(3):
                new_energy[i, k] = w[SSE + k]
            for k in range(variables):
                new_state[i, k] = w[STATEV + k]
            for k in range(size * size):
                tangent[i, k] = w[DDSDDE + k]
            wanted[i] = w[PNEWDT]
            k = direct
            for a in range(dim):
                tensor[i, a * dim + a] = w[STRESS + a]
                for b in range(a + 1, dim):
                    tensor[i, a * dim + b] = w[STRESS + k]
                    tensor[i, b * dim + a] = w[STRESS + k]
                    k += 1
