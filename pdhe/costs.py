"""What bonds and sweeps cost, measured: for the plan of a run, and for what a cluster is asked for."""

#: Bytes of a process before it has bonds (measured 2.1e8 to 2.4e8, up to 3.5e8 with other versions of the libraries),
#: and at its peak per directed bond: diffusion alone (98 to 106), mechanics (105 to 138), both
#: (136 to 157), measured on lattices and triangles of 2e4 and 8e4 nodes.
PROCESS, DIFFUSION, MECHANICS, BOTH = 2.4e8, 100.0, 122.0, 145.0
#: Copies of the fields of all outputs that exist while the result is put together and written (measured 2.4 to 3).
COPIES = 2.7
#: Time of an iteration of the equilibrium, and of the search for failures after it, in force sweeps; of a diffusion
#: sweep inside a run, in bare ones (measured 2.8, 4 and 1.4 at 20,000 nodes).
ITERATION, SEARCH, STEP = 2.8, 4.0, 1.4
#: Time of a step with inertia in force sweeps, the search for failures included (measured 1.2 on lattices, 1.8 on
#: triangles, 2.3 on mirrored halves of 10,000 nodes).
MOTION = 1.6
#: Seconds to start, build a preconditioner and write results, beside the sweeps.
OVERHEAD = 1.5
