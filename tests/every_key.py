"""Scenes that together have every key there is, which those of the project have not: for tests that spoil scenes."""

TEXT = """\
title: Blocks
fidelity: standard
geometry:
  plate: {width: 200 mm, height: 100 mm, thickness: 4 mm}
  holes: [{name: bore, centre: [140 mm, 50 mm], radius: 10 mm}]
  cracks: [{name: notch, from: [0 mm, 50 mm], to: [50 mm, 50 mm]}]
regions:
  - {name: weld, from: [80 mm, 0 mm], to: [120 mm, 100 mm]}
  - {name: inclusion, centre: [170 mm, 50 mm], radius: 12 mm}
mesh:
  spacing: 10 mm
  cells: triangle
  growth: 0.2
  refine:
    - {around: notch, spacing: 5 mm, within: 5 mm}
    - {from: [50 mm, 50 mm], to: [60 mm, 50 mm], spacing: 6 mm, within: 2 mm}
horizon: {ratio: 3.015}
material:
  name: steel
  youngs_modulus: 207 GPa
  poissons_ratio: 0.29
  fracture_toughness: 58.4 MPa m^0.5
  density: 7850 kg/m^3
  diffusivity: 0.84e-9 m^2/s
  saturation_concentration: 2.65e-5 mol/m^2
  source: {density: customary}
mechanics:
  model: condensed rotation
  plane: stress
  weights: moment matched
  partial_volume: auto
  regions:
    - {on: weld, factor: {expression: 1 + x}}
    - {on: inclusion, youngs_modulus: {expression: 400 + y, unit: GPa}}
loads:
  - {on: top, at: nodes, displacement: {x: 0 mm, y: {0 h: 0 mm, 1 h: 0.02 mm}}}
  - {on: bottom, displacement: {y: 0 mm}}
damage:
  criterion: energy
  tension_only: true
  calibration: discrete
  no_fail: [top, bottom]
  regions:
    - {on: weld, factor: {expression: "where(y > 0.05, 1, 0.25)"}}
    - {on: inclusion, critical_energy_release_rate: {expression: 20 + x, unit: kJ/m^2}}
  interfaces:
    - {between: [weld, all], factor: 0.5}
    - {between: [inclusion, weld], critical_energy_release_rate: 1 kJ/m^2}
hydrogen:
  kernel: inverse
  initial: 0.1
  boundary: [{on: notch, coverage: {0 h: 0.1, 1 h: 1}}]
  law: linear nickel
  degradation: energy
  saturation: {damage: 0.3, coverage: 0.9}
  regions:
    - {on: weld, factor: {expression: exp(-y)}}
    - {on: inclusion, diffusivity: {expression: 1e-12*(1 + x), unit: m^2/s}}
time: {end: 1e6 s}
stepping: {mode: events, grouping: 0.05}
solver: {tolerance: 1e-5, max_iterations: 5000, precision: single}
outputs: {times: [0 s, 5e5 s], error_estimate: off}
---
title: Ply in plane strain
accuracy: 5 %
geometry:
  plate: {width: 80 mm, height: 40 mm, thickness: 4 mm}
mesh: {spacing: 4 mm}
horizon: {length: 12.06 mm}
material:
  youngs_modulus: 140 GPa
  poissons_ratio: 0.3
  critical_energy_release_rate: 0.3 kJ/m^2
  orthotropic:
    youngs_modulus_2: 10 GPa
    shear_modulus_12: 5 GPa
    youngs_modulus_3: 10 GPa
    poissons_ratio_13: 0.3
    poissons_ratio_23: 0.4
mechanics:
  model: correspondence
  plane: strain
  zero_energy: silling
  zero_energy_strength: 2
  axes: [{on: all, angle: {expression: 10*x, unit: deg}}, {on: left, angle: 0 deg, around: [40 mm, 20 mm]}]
loads:
  - {on: right, displacement: {x: 0.01 mm}}
  - {on: left, displacement: {x: 0 mm}}
damage: {criterion: energy density}
time: {end: 1 s}
stepping: {mode: fixed, load_steps: 10, diffusion_substeps: 1}
outputs: {every: 0.5 s}
---
title: Blow
geometry:
  plate: {width: 80 mm, height: 40 mm, thickness: 4 mm}
  symmetry: [left]
regions: [{name: struck, from: [60 mm, 0 mm], to: [80 mm, 5 mm]}]
mesh: {spacing: 4 mm, cells: quadrilateral}
material: 18Ni1900
mechanics: {model: state-based}
loads:
  - {on: struck, velocity: {x: {0 us: 0 m/s, 1 us: -5 m/s}, y: 1 m/s}}
  - {on: top, traction: {y: {0 us: 0 MPa, 5 us: 12 MPa}}}
  - {on: right, traction: {x: 1 MPa}}
  - {on: bottom, initial_velocity: {y: 2 m/s}}
damage: {criterion: stretch, calibration: continuum}
time: {end: 20 us}
stepping: {mode: dynamic, step: 0.1 us, damping: 1e3 s^-1}
outputs: {count: 2}
---
title: Blow in steps of its own
geometry: {plate: {width: 80 mm, height: 40 mm, thickness: 4 mm}}
mesh: {spacing: 4 mm}
material: Duran 50
loads: [{on: top, traction: {y: 12 MPa}}, {on: right, initial_velocity: {x: 1 m/s}}]
time: {end: 20 us}
stepping: {mode: dynamic, safety: 0.5}
---
title: Body
geometry:
  plate: {width: 20 mm, height: 12 mm, thickness: 8 mm}
  cracks:
    - {name: penny, disc: {centre: [10 mm, 6 mm, 4 mm], normal: [0, 1, 0], radius: 3 mm}}
    - {name: corner, polygon: [[0 mm, 6 mm, 0 mm], [3 mm, 6 mm, 0 mm], [0 mm, 6 mm, 3 mm]]}
mesh: {spacing: 2 mm, cells: hexahedron}
material: AISI 4340
mechanics: {model: state-based}
loads:
  - {on: top, displacement: {x: 0 mm, y: 0.01 mm, z: 0 mm}}
  - {on: bottom, displacement: {y: 0 mm}}
damage: {criterion: energy, no_fail: [front]}
hydrogen: {boundary: [{on: back, coverage: 1}], saturation: "off"}
time: {end: 1 h}
---
title: Body of plies
geometry: {plate: {width: 20 mm, height: 12 mm, thickness: 8 mm}}
mesh: {spacing: 2 mm, cells: hexahedron}
material:
  youngs_modulus: 140 GPa
  poissons_ratio: 0.3
  orthotropic:
    youngs_modulus_2: 10 GPa
    shear_modulus_12: 5 GPa
    youngs_modulus_3: 10 GPa
    poissons_ratio_13: 0.3
    poissons_ratio_23: 0.4
    shear_modulus_13: 5 GPa
    shear_modulus_23: 3.5 GPa
mechanics:
  model: correspondence
  axes: [{on: all, axis_1: [1, 0, 1], axis_2: [0, 1, 0]}]
loads:
  - {on: top, displacement: {y: 0.01 mm}}
  - {on: bottom, displacement: {y: 0 mm}}
time: {end: 1 s}
---
title: Split
geometry: {plate: {width: 80 mm, height: 40 mm, thickness: 4 mm}}
mesh: {spacing: 4 mm}
material: AISI 4340
mechanics: {model: state-based}
loads:
  - {on: top, displacement: {y: 0.01 mm}}
  - {on: bottom, displacement: {y: 0 mm}}
damage:
  split: {dilatational: {critical_energy_release_rate: 10 kJ/m^2}, deviatoric: {factor: 3}}
time: {end: 1 s}
---
title: Split the other way
geometry: {plate: {width: 80 mm, height: 40 mm, thickness: 4 mm}}
mesh: {spacing: 4 mm}
material: AISI 4340
mechanics: {model: state-based}
loads: [{on: top, displacement: {y: 0.01 mm}}, {on: bottom, displacement: {y: 0 mm}}]
damage:
  split: {dilatational: {factor: 1}, deviatoric: {critical_energy_release_rate: 20 kJ/m^2}}
time: {end: 1 s}
---
title: Tables
geometry: {plate: {width: 80 mm, height: 40 mm, thickness: 4 mm}}
mesh: {spacing: 4 mm}
material: AISI 4340
mechanics:
  regions:
    - {on: left, factor: {table: tests/table.csv}}
    - {on: right, youngs_modulus: {table: tests/table.csv, unit: GPa}}
loads: [{on: top, displacement: {y: 0.01 mm}}, {on: bottom, displacement: {y: 0 mm}}]
damage:
  regions:
    - {on: left, factor: {table: tests/table.csv}}
    - {on: right, critical_energy_release_rate: {table: tests/table.csv, unit: kJ/m^2}}
hydrogen:
  boundary: [{on: left, coverage: 1}]
  regions:
    - {on: left, factor: {table: tests/table.csv}}
    - {on: right, diffusivity: {table: tests/table.csv, unit: mm^2/h}}
time: {end: 1 s}
---
title: Table of angles
geometry: {plate: {width: 80 mm, height: 40 mm, thickness: 4 mm}}
mesh: {spacing: 4 mm}
material:
  youngs_modulus: 140 GPa
  poissons_ratio: 0.3
  orthotropic: {youngs_modulus_2: 10 GPa, shear_modulus_12: 5 GPa}
mechanics: {model: correspondence, axes: [{angle: {table: tests/table.csv, unit: deg}}]}
loads: [{on: top, displacement: {y: 0.01 mm}}, {on: bottom, displacement: {y: 0 mm}}]
time: {end: 1 s}
---
title: Blow on a body
geometry: {plate: {width: 20 mm, height: 12 mm, thickness: 8 mm}}
mesh: {spacing: 2 mm, cells: hexahedron}
material: AISI 4340
loads:
  - {on: front, velocity: {z: 1 m/s}}
  - {on: back, initial_velocity: {z: 1 m/s}}
  - {on: top, traction: {z: 1 MPa}}
time: {end: 5 us}
stepping: {mode: dynamic}
"""
SCENES = TEXT.split("---\n")
