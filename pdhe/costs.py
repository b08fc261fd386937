"""What bonds and sweeps cost, measured: for the plan of a run, and for what a cluster is asked for."""

#: Bytes of a process before it has bonds (measured 2.1e8 to 2.4e8, up to 3.5e8 with other versions of the libraries),
#: and at its peak per directed bond: diffusion alone (98 to 106), mechanics (105 to 138), both
#: (136 to 157), measured on lattices and triangles of 2e4 and 8e4 nodes.
PROCESS, DIFFUSION, MECHANICS, BOTH = 2.4e8, 100.0, 122.0, 145.0
#: The same per directed bond of a body in space (94 to 98, 136 to 152 and 160 to 163, measured with each model on 3840
#: and 30,720 cubes).
SOLID_DIFFUSION, SOLID_MECHANICS, SOLID_BOTH = 97.0, 143.0, 161.0
#: Copies of the fields of all outputs that exist while the result is put together and written (measured 2.4 to 3).
COPIES = 2.7
#: Time of an iteration of the equilibrium, and of the search for failures after it, in force sweeps; of a diffusion
#: sweep inside a run, in bare ones (measured 2.8, 4 and 1.4 at 20,000 nodes).
ITERATION, SEARCH, STEP = 2.8, 4.0, 1.4
#: Time of a step with inertia in force sweeps: with the search for failures (measured 1.2 on lattices, 1.8 on
#: triangles, 2.3 on mirrored halves of 10,000 nodes, 1.8 in space, 1.8 to 2.7 state-based), with one in sweeps of its
#: own, as of correspondence models (2.4 to 4 in turns, up to 5 within runs), and without it.
MOTION, MOTION_APART, MOTION_ALONE = 1.6, 4.0, 1.1
#: Seconds to start, build a preconditioner and write results, beside the sweeps; and to build a directed bond in space,
#: with its correction (2.2e-6 to 2.7e-6) or without one, for diffusion alone.
OVERHEAD, BUILD, BUILD_PLAIN = 1.5, 2.4e-6, 5e-7
#: How far beyond the horizon bonds reach with partial volumes, in spacings (theory, eq. 3.2).
RAMP = 0.5


def bond_reach(ratio: float, partial: str, lattice: bool) -> float:
    """How far bonds reach in spacings, given the horizon's: farther where volumes that it cuts count in part."""
    return ratio + (RAMP if partial == "ramp" or (partial == "auto" and not lattice) else 0.0)


def bytes_of_bond(axes: int, mechanics: bool, hydrogen: bool) -> float:
    """Memory of a directed bond at the peak of a run in the plane or in space."""
    diffusion, alone, both = (
        (DIFFUSION, MECHANICS, BOTH) if axes == 2 else (SOLID_DIFFUSION, SOLID_MECHANICS, SOLID_BOTH)
    )
    return both if mechanics and hydrogen else alone if mechanics else diffusion


def seconds_before(axes: int, mechanics: bool, bonds: float) -> float:
    """Processor time of everything but sweeps, s."""
    return OVERHEAD + (0.0 if axes == 2 else (BUILD if mechanics else BUILD_PLAIN) * bonds)
