"""Scenes that cannot be used: each is answered with the file, the key, the value, and what would have worked."""

import copy
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdhe.errors import SceneError
from pdhe.scene import Scene, load_scene
from pdhe.scene_reading import override
from pdhe.yamlfile import parse_yaml

GOOD = """
title: Good
geometry:
  plate: {width: 200 mm, height: 100 mm, thickness: 4 mm}
  holes: [{name: bore, centre: [140 mm, 50 mm], radius: 10 mm}]
  cracks: [{name: notch, from: [0 mm, 50 mm], to: [50 mm, 50 mm]}]
mesh: {spacing: 5 mm}
horizon: {ratio: 3.015}
material:
  youngs_modulus: 207 GPa
  poissons_ratio: 0.29
  fracture_toughness: 58.4 MPa m^0.5
  diffusivity: 0.84e-9 m^2/s
mechanics: {model: condensed rotation}
loads:
  - {on: top, displacement: {y: {0 h: 0 mm, 1 h: 0.02 mm}}}
  - {on: bottom, displacement: {y: {0 h: 0 mm, 1 h: -0.02 mm}}}
damage: {criterion: energy, no_fail: [top]}
hydrogen:
  boundary: [{on: notch, coverage: 1}]
time: {end: 6e6 s}
stepping: {mode: events}
outputs: {every: 1e5 s}
"""
DELETE = object()
THESIS_SPRING = {"mechanics.model": "thesis spring", "material.poissons_ratio": 0.34}
CRACK = {"name": "second", "from": ["0 mm", "20 mm"], "to": ["30 mm", "20 mm"]}
HOLE = {"name": "second", "centre": ["60 mm", "20 mm"], "radius": "10 mm"}


REFINE = [{"around": "notch", "spacing": "1 mm", "within": "5 mm"}]
LINE = {"from": ["50 mm", "50 mm"], "to": ["90 mm", "50 mm"], "spacing": "1 mm", "within": "5 mm"}
GRADED = {"mesh.cells": "triangle", "mesh.refine": REFINE}


def load(on, **displacement):
    return {"on": on, "displacement": displacement}


def cracks(**change):
    return {"geometry.cracks": [{"name": "notch", "from": ["0 mm", "50 mm"], "to": ["50 mm", "50 mm"]}, CRACK | change]}


def holes(**change):
    return {"geometry.holes": [{"name": "bore", "centre": ["140 mm", "50 mm"], "radius": "10 mm"}, HOLE | change]}


def ply(**changes):
    """An orthotropic block."""
    return {"material.orthotropic": {"youngs_modulus_2": "10 GPa", "shear_modulus_12": "5 GPa", **changes}}


GIVEN = {"material.critical_energy_release_rate": "0.3 kJ/m^2", "material.fracture_toughness": DELETE}


# id: (edits of the good scene, key in the message, fragments of problem and hint)
BAD = {
    # unknown and missing keys, wrong types
    "unknown top-level key": ({"dammage": {}}, "dammage", "not a known key", "did you mean `damage`"),
    "unknown nested key": ({"mesh.spacng": "1 mm"}, "mesh.spacng", "not a known key", "did you mean `spacing`"),
    "unknown key without neighbour": ({"solver.zzz": 1}, "solver.zzz", "not a known key", "`max_iterations`"),
    "time has no start": ({"time.start": "7 s"}, "time.start", "not a known key", "`end`"),
    "geometry missing": ({"geometry": DELETE}, "geometry", "is missing", "give `geometry`"),
    "plate height missing": ({"geometry.plate.height": DELETE}, "geometry.plate.height", "is missing", "`height`"),
    "time missing": ({"time": DELETE}, "time", "is missing", "give `time`"),
    "spacing empty": ({"mesh.spacing": None}, "mesh.spacing", "is missing", "give `spacing`"),
    "block is a number": ({"mesh": 5}, "mesh", "must be a block of keys", "`spacing`"),
    "block is a list": ({"time": ["6e6 s"]}, "time", "must be a block of keys", "`end`"),
    "list is a block": ({"loads": {"on": "top"}}, "loads", "must be a list", "start each entry"),
    "list is a word": ({"damage.no_fail": "top"}, "damage.no_fail", "must be a list", "[...]"),
    "title is a number": ({"title": 5}, "title", "must be text", "quote it"),
    "title is empty": ({"title": " "}, "title", "between 1 and 1000", "short text"),
    "yaml 1.1 bool": ({"hydrogen.initial": True}, "hydrogen.initial", "is not a number", "without unit"),
    "source of unknown value": (
        {"material.source": {"young_modulus": "x"}},
        "material.source.young_modulus",
        "not a key of a material",
        "did you mean `youngs_modulus`",
    ),
    # units and numbers
    "bare spacing": ({"mesh.spacing": 7}, "mesh.spacing", "needs a unit", "for example `7 mm`"),
    "bare spacing as text": ({"mesh.spacing": "7"}, "mesh.spacing", "needs a unit", "for example `7 mm`"),
    "wrong dimension": ({"mesh.spacing": "7 s"}, "mesh.spacing", "'s' is not a unit of length", "`7 mm`"),
    "unknown unit": ({"mesh.spacing": "7 mmm"}, "mesh.spacing", "not a known unit", "did you mean `mm`"),
    "toughness without root": (
        {"material.fracture_toughness": "58.4 MPa"},
        "material.fracture_toughness",
        "not a unit of fracture toughness",
        "MPa m^0.5",
    ),
    "diffusivity in m/s": ({"material.diffusivity": "1 m/s"}, "material.diffusivity", "diffusivity", "m^2/s"),
    "time in metres": ({"time.end": "6 m"}, "time.end", "not a unit of time", "`40 h`"),
    "decimal comma": ({"mesh.spacing": "7,5 mm"}, "mesh.spacing", "is not a length", "as a point"),
    "negative spacing": ({"mesh.spacing": "-5 mm"}, "mesh.spacing", "greater than zero", "`7 mm`"),
    "zero thickness": ({"geometry.plate.thickness": "0 mm"}, "geometry.plate.thickness", "greater than zero", "mm"),
    "nan with unit": ({"mesh.spacing": "nan mm"}, "mesh.spacing", "is not a length", "write a number and a unit"),
    "infinite width": ({"geometry.plate.width": "1e999 m"}, "geometry.plate.width", "not a finite", "`7 mm`"),
    "nan": ({"material.poissons_ratio": math.nan}, "material.poissons_ratio", "not a finite number", "plain number"),
    "infinity": ({"horizon.ratio": math.inf}, "horizon.ratio", "not a finite number", "plain number"),
    "megametre": ({"geometry.plate.width": "200 Mm"}, "geometry.plate.width", "is longer than", "megametre"),
    "millipascal": ({"material.youngs_modulus": "207 mPa"}, "material.youngs_modulus", "less than 1 Pa", "megapascal"),
    "negative modulus": ({"material.youngs_modulus": "-207 GPa"}, "material.youngs_modulus", "greater than zero", ""),
    "zero diffusivity": ({"material.diffusivity": "0 m^2/s"}, "material.diffusivity", "greater than zero", ""),
    "huge number": ({"stepping": {"mode": "fixed", "load_steps": 10**400}}, "stepping.load_steps", "not a finite", ""),
    # geometry
    "hole outside": (holes(centre=["300 mm", "50 mm"]), "geometry.holes.1.centre", "outside the plate", "200 x 100 mm"),
    "hole over the edge": (holes(radius="20 mm"), "geometry.holes.1.radius", "reaches the edge", "below 20 mm"),
    "holes overlap": (
        holes(centre=["130 mm", "60 mm"]),
        "geometry.holes.1.centre",
        "overlaps the hole `bore`",
        "keep material between",
    ),
    "hole below the spacing": (holes(radius="1 mm"), "geometry.holes.1.radius", "smaller than the spacing", "5 mm"),
    "point with one coordinate": (holes(centre=["3 mm"]), "geometry.holes.1.centre", "two coordinates", "[50 mm, 0"),
    "point without units": (holes(centre=[3, 4]), "geometry.holes.1.centre", "needs a unit", "`7 mm`"),
    "point is a word": (holes(centre="middle"), "geometry.holes.1.centre", "two coordinates", "[50 mm, 0"),
    "crack outside": (cracks(to=["30 mm", "120 mm"]), "geometry.cracks.1.to", "outside the plate", "end on its edge"),
    "crack starts outside": (cracks(**{"from": ["-1 mm", "2 mm"]}), "geometry.cracks.1.from", "outside the plate", ""),
    "crack without length": (cracks(to=["0 mm", "20 mm"]), "geometry.cracks.1.to", "no length", "move one end"),
    "crack too short": (cracks(to=["3 mm", "20 mm"]), "geometry.cracks.1.to", "shorter than the spacing", "refine"),
    "crack along the edge": (cracks(to=["0 mm", "90 mm"]), "geometry.cracks.1.to", "along the edge", "inside"),
    "crack repeated": (
        cracks(**{"from": ["50 mm", "50 mm"], "to": ["0 mm", "50 mm"]}),
        "geometry.cracks.1.to",
        "repeats the crack `notch`",
        "keep one",
    ),
    "crack inside a hole": (
        cracks(**{"from": ["135 mm", "50 mm"], "to": ["145 mm", "50 mm"]}),
        "geometry.cracks.1.to",
        "inside the hole `bore`",
        "move the crack",
    ),
    "names clash": (cracks(name="bore"), "geometry.cracks.1.name", "already the name", "must differ"),
    "names clash but for capitals": (cracks(name="Notch"), "geometry.cracks.1.name", "already the name", "capitals"),
    "reserved name": (cracks(name="left"), "geometry.cracks.1.name", "reserved", "`left`"),
    "reserved name in capitals": (cracks(name="All"), "geometry.cracks.1.name", "reserved", "`all`"),
    "name with a space": (cracks(name="my crack"), "geometry.cracks.1.name", "not a usable name", "underscores"),
    "name is a number": (cracks(name=1), "geometry.cracks.1.name", "must be a name", "quote it"),
    # mesh and horizon
    "spacing above the plate": ({"mesh.spacing": "150 mm"}, "mesh.spacing", "larger than the plate", "100 mm"),
    "too many nodes": ({"mesh.spacing": "10 um"}, "mesh.spacing", "2e+08 nodes", "use at least 0.0639 mm"),
    "unknown cells": ({"mesh.cells": "triangles"}, "mesh.cells", "not one of the choices", "did you mean `triangle`"),
    "horizon below 1.2 spacings": ({"horizon.ratio": 1.1}, "horizon.ratio", "1.1 spacings", "at least 1.2"),
    "horizon length too short": ({"horizon": {"length": "5 mm"}}, "horizon.length", "1 spacings", "at least 1.2"),
    "horizon above the plate": ({"horizon.ratio": 20}, "horizon.ratio", "not smaller than the plate", "smaller"),
    "horizon twice": ({"horizon.length": "15 mm"}, "horizon", "either `ratio` or `length`", "3.015"),
    "refined lattice": (
        {"mesh.refine": REFINE, "mesh.cells": "quadrilateral"},
        "mesh.refine",
        "needs triangles",
        "cells: triangle",
    ),
    "refined nowhere": (GRADED | {"mesh.refine": []}, "mesh.refine", "empty list", "leave `refine` out"),
    "refinement of two places": (
        GRADED | {"mesh.refine": [REFINE[0] | {"from": ["1 mm", "1 mm"]}]},
        "mesh.refine.0",
        "either `around` or both",
        "notch",
    ),
    "refinement of no place": (
        GRADED | {"mesh.refine": [{"spacing": "1 mm", "within": "5 mm"}]},
        "mesh.refine.0",
        "either `around` or both",
        "notch",
    ),
    "refinement without unit": (
        GRADED | {"mesh.refine": [REFINE[0] | {"within": 5}]},
        "mesh.refine.0.within",
        "needs a unit",
        "mm",
    ),
    "refinement coarser": (
        GRADED | {"mesh.refine": [REFINE[0] | {"spacing": "6 mm"}]},
        "mesh.refine.0.spacing",
        "coarser than the rest",
        "coarsest",
    ),
    "refinement around nothing": (
        GRADED | {"mesh.refine": [REFINE[0] | {"around": "notsch"}]},
        "mesh.refine.0.around",
        "not a hole or a crack",
        "`notch`",
    ),
    "refinement outside": (
        GRADED | {"mesh.refine": [LINE | {"to": ["50 mm", "110 mm"]}]},
        "mesh.refine.0.to",
        "outside the plate",
        "200 x 100",
    ),
    "growth without refinement": ({"mesh.growth": 0.1}, "mesh.growth", "nothing to grow away from", "add `refine`"),
    "growth too large": (GRADED | {"mesh.growth": 0.6}, "mesh.growth", "at most 0.5", ""),
    "horizon grows too fast": (GRADED | {"mesh.growth": 0.4}, "mesh.growth", "lets the horizon grow", "at most 0.33"),
    "one horizon for many spacings": (
        GRADED | {"horizon": {"length": "15 mm"}},
        "horizon.length",
        "one horizon for all nodes",
        "give `ratio`",
    ),
    "weights for one horizon": (
        GRADED | {"mechanics.weights": "volume"},
        "mechanics.weights",
        "made for one horizon",
        "`moment matched`",
    ),
    "too many nodes by refinement": (
        GRADED | {"mesh.refine": [LINE | {"spacing": "0.005 mm", "within": "50 mm"}]},
        "mesh.refine",
        "more than 5e+06",
        "smaller `within`",
    ),
    "horizon empty": ({"horizon": {}}, "horizon", "either `ratio` or `length`", "3.015"),
    # material and model
    "unknown material": ({"material": "AISI 4430"}, "material", "not a known material", "did you mean `aisi-4340`"),
    "material name is a path": ({"material": "../../secret"}, "material", "not a known material", "known materials"),
    "material is a number": ({"material": 4340}, "material", "must be a block of keys", "`youngs_modulus`"),
    "incompressible": ({"material.poissons_ratio": 0.5}, "material.poissons_ratio", "less than 0.5", ""),
    "strongly auxetic": ({"material.poissons_ratio": -0.95}, "material.poissons_ratio", "bond model", "at least -0.9"),
    "thesis spring above 1/3": (THESIS_SPRING, "material.poissons_ratio", "indefinite", "condensed rotation"),
    "unknown model": ({"mechanics.model": "bond"}, "mechanics.model", "not one of the choices", "`thesis spring`"),
    "thesis spring above 1/4 in plane strain": (
        {"mechanics": {"model": "thesis spring", "plane": "strain"}},
        "material.poissons_ratio",
        "above 1/4",
        "condensed rotation",
    ),
    "one parameter, other ratio": (
        {"mechanics": {"model": "one-parameter"}},
        "material.poissons_ratio",
        "which is 1/3 in plane stress",
        "give 0.3333",
    ),
    "axes of an isotropic material": (
        {"mechanics": {"model": "correspondence", "axes": [{"angle": "30 deg"}]}},
        "mechanics.axes",
        "isotropic",
        "add `material.orthotropic`",
    ),
    "axes without a unit": ({"mechanics": {"axes": [{"angle": 30}]}}, "mechanics.axes.0.angle", "needs a unit", "deg"),
    "orthotropic bonds": (ply(), "material.orthotropic", "not known to model", "correspondence"),
    "orthotropic toughness": (
        {**ply(), "mechanics.model": "correspondence"},
        "material.critical_energy_release_rate",
        "for isotropic materials only",
        "kJ/m^2",
    ),
    "orthotropic in plane strain": (
        {**ply(), **GIVEN, "mechanics.model": "correspondence", "mechanics.plane": "strain"},
        "material.orthotropic.youngs_modulus_3",
        "plane strain needs it",
        "give it",
    ),
    "ply in a mirror": (
        {**ply(), **GIVEN, "mechanics.model": "correspondence", "geometry.symmetry": ["right"]},
        "geometry.symmetry",
        "mirrors the axes",
        "whole body",
    ),
    "impossible ply": (
        {**ply(youngs_modulus_2="9000 GPa"), **GIVEN, "mechanics.model": "correspondence"},
        "material.poissons_ratio",
        "indefinite",
        "sqrt",
    ),
    "zero-energy control of another model": (
        {"mechanics": {"zero_energy": "silling"}},
        "mechanics.zero_energy",
        "belongs to model `correspondence`",
        "leave it out",
    ),
    "correction made for other models": (
        {"mechanics": {"model": "state-based", "weights": "energy"}},
        "mechanics.weights",
        "two-parameter bonds",
        "moment matched",
    ),
    "toughness of the other plane": (
        {"mechanics": {"plane": "strain"}, "material.critical_energy_release_rate": "16.476 kJ/m^2"},
        "material.critical_energy_release_rate",
        "(1-nu^2) K^2/E, plane strain",
        "one of the two",
    ),
    "contradictory toughness": (
        {"material.critical_energy_release_rate": "2 kJ/m^2"},
        "material.critical_energy_release_rate",
        "contradicts `fracture_toughness`",
        "one of the two",
    ),
    # loads
    "load on unknown set": ({"loads.0.on": "topp"}, "loads.0.on", "not a node set", "did you mean `top`"),
    "load without displacement": ({"loads.0.displacement": {}}, "loads.0.displacement", "prescribes nothing", "`x`"),
    "load along z": (
        {"loads.0.displacement": {"z": "1 mm"}},
        "loads.0.displacement.z",
        "out of its plane",
        "hexahedron",
    ),
    "no loads in the list": ({"loads": []}, "loads", "empty list", "leave `loads` out"),
    "load twice on one set": (
        {"loads": [load("top", y="1 um"), load("top", y="1 um")]},
        "loads.1.displacement.y",
        "already prescribes on `top`",
        "keep one",
    ),
    "corner conflict": (
        {"loads": [load("top", y="1 um"), load("left", y="2 um")]},
        "loads.1.displacement.y",
        "contradicts `loads.0.displacement.y`",
        "share nodes",
    ),
    "corner conflict at one time": (
        {"loads": [load("top", y={"0 s": "0 mm", "1 s": "1 um"}), load("left", y="0 mm")]},
        "loads.1.displacement.y",
        "`top` and `left` share nodes",
        "same value at every time",
    ),
    "all and an edge": (
        {"loads": [load("all", x="1 um"), load("left", x="2 um")]},
        "loads.1.displacement.x",
        "contradicts",
        "leave one out",
    ),
    "displacement in metres": ({"loads.0.displacement.y": "7 m"}, "loads.0.displacement.y", "larger than the", "unit"),
    "displacement as a list": ({"loads.0.displacement.y": ["1 mm"]}, "loads.0.displacement.y", "map of time", "{0 h"),
    "empty history": ({"loads.0.displacement.y": {}}, "loads.0.displacement.y", "has no points", "{0 h: 0 mm"),
    "times out of order": (
        {"loads.0.displacement.y": {"2 h": "0 mm", "1 h": "1 um"}},
        "loads.0.displacement.y",
        "out of order",
        "increasing",
    ),
    "one time in two units": (
        {"loads.0.displacement.y": {"1 h": "0 mm", "3600 s": "1 um"}},
        "loads.0.displacement.y",
        "3600 s twice",
        "keep one",
    ),
    "negative time": ({"loads.0.displacement.y": {"-1 h": "0 mm"}}, "loads.0.displacement.y", "negative time", "0 s"),
    "time without unit": ({"loads.0.displacement.y": {0: "0 mm"}}, "loads.0.displacement.y", "needs a unit", "40 h"),
    "unknown place of a load": ({"loads.0.at": "corner"}, "loads.0.at", "not one of the choices", "`edge`"),
    # which physics
    "nothing to compute": (
        {"loads": DELETE, "damage": DELETE, "hydrogen": DELETE},
        "",
        "nothing to compute",
        "add `loads` or `hydrogen`",
    ),
    "damage without loads": ({"loads": DELETE}, "damage", "needs loads", "leave `damage` out"),
    "damage without toughness": (
        {"material.fracture_toughness": DELETE},
        "material.fracture_toughness",
        "damage needs it",
        "`critical_energy_release_rate`",
    ),
    "hydrogen without diffusivity": (
        {"material.diffusivity": DELETE},
        "material.diffusivity",
        "hydrogen diffusion needs it",
        "0.84e-9 m^2/s",
    ),
    "no_fail on unknown set": ({"damage.no_fail": ["tops"]}, "damage.no_fail.0", "not a node set", "`top`"),
    "no_fail twice": ({"damage.no_fail": ["top", "top"]}, "damage.no_fail.1", "listed twice", "keep one"),
    "unknown criterion": ({"damage.criterion": "strain"}, "damage.criterion", "not one of the choices", "`stretch`"),
    "switch that is a word": ({"damage.tension_only": "off"}, "damage.tension_only", "on or off", "`true` or `false`"),
    # hydrogen
    "coverage above one": (
        {"hydrogen.boundary.0.coverage": 1.5},
        "hydrogen.boundary.0.coverage",
        "between 0 and 1",
        "",
    ),
    "coverage below zero": (
        {"hydrogen.boundary.0.coverage": {"0 h": 0, "1 h": -0.1}},
        "hydrogen.boundary.0.coverage",
        "between 0 and 1",
        "occupied fraction",
    ),
    "initial above one": ({"hydrogen.initial": 2}, "hydrogen.initial", "between 0 and 1", ""),
    "coverage with unit": ({"hydrogen.initial": "1 mol"}, "hydrogen.initial", "is not a number", "without unit"),
    "coverage on unknown set": ({"hydrogen.boundary.0.on": "noch"}, "hydrogen.boundary.0.on", "node set", "`notch`"),
    "coverage conflict where a crack meets an edge": (
        {"hydrogen.boundary": [{"on": "notch", "coverage": 1}, {"on": "left", "coverage": 0}]},
        "hydrogen.boundary.1.coverage",
        "`notch` and `left` share nodes",
        "leave one out",
    ),
    "coverage twice": (
        {"hydrogen.boundary": [{"on": "notch", "coverage": 1}, {"on": "notch", "coverage": 1}]},
        "hydrogen.boundary.1.coverage",
        "already prescribes on `notch`",
        "keep one",
    ),
    "unknown law": ({"hydrogen.law": "serebrinski"}, "hydrogen.law", "choices", "did you mean `serebrinsky`"),
    "unknown kernel": ({"hydrogen.kernel": "inverse-square"}, "hydrogen.kernel", "choices", "mean `inverse square`"),
    "saturation on": ({"hydrogen.saturation": "on"}, "hydrogen.saturation", "must be a block", "`damage`"),
    # time, stepping, solver, outputs
    "negative end": ({"time.end": "-1 s"}, "time.end", "must not be negative", "`40 h`"),
    "fixed without counts": ({"stepping.mode": "fixed"}, "stepping.load_steps", "is missing", "`diffusion_substeps`"),
    "method of earlier versions": (
        {"solver.method": "dynamic relaxation"},
        "solver.method",
        "is no longer a key",
        "leave it out",
    ),
    "fixed with grouping": (
        {"stepping": {"mode": "fixed", "grouping": 0.1, "load_steps": 9, "diffusion_substeps": 9}},
        "stepping.grouping",
        "belongs to mode `events`",
        "mode: events",
    ),
    "events with counts": ({"stepping.load_steps": 9}, "stepping.load_steps", "belongs to mode `fixed`", "mode: fixed"),
    "fractional steps": (
        {"stepping": {"mode": "fixed", "load_steps": 9.5, "diffusion_substeps": 9}},
        "stepping.load_steps",
        "whole number",
        "fraction",
    ),
    "unknown mode": ({"stepping.mode": "event"}, "stepping.mode", "choices", "did you mean `events`"),
    "grouping of one": ({"stepping.grouping": 1}, "stepping.grouping", "less than 1", ""),
    "zero tolerance": ({"solver.tolerance": 0}, "solver.tolerance", "between 1e-14 and 0.1", ""),
    "no iterations": ({"solver.max_iterations": 0}, "solver.max_iterations", "between 1 and", "whole number"),
    "outputs beyond the end": ({"outputs": {"times": ["7e6 s"]}}, "outputs.times", "beyond the end", "`time.end`"),
    "outputs unsorted": ({"outputs": {"times": ["2 s", "1 s"]}}, "outputs.times", "not increasing", "once"),
    "outputs repeated": ({"outputs": {"times": ["1 s", "1 s"]}}, "outputs.times", "not increasing", "once"),
    "output interval zero": ({"outputs.every": "0 s"}, "outputs.every", "greater than zero", "`40 h`"),
    "output interval negative": ({"outputs.every": "-1 h"}, "outputs.every", "greater than zero", "`40 h`"),
    "too many outputs": ({"outputs.every": "1 s"}, "outputs.every", "6e+06 outputs", "at least 600 s"),
    "count too large": ({"outputs": {"count": 20000}}, "outputs.count", "between 1 and 10000", "whole number"),
    "outputs two ways": ({"outputs.count": 3}, "outputs", "gives `every` and `count`", "one of"),
}


def edited(changes):
    raw = parse_yaml(GOOD, "good")
    for key, value in changes.items():
        if value is DELETE:
            *parents, last = key.split(".")
            place = raw
            for part in parents:
                place = place[part]
            del place[last]
        else:
            override(raw, key, copy.deepcopy(value), "good")
    return raw


def load_raw(tmp_path, raw):
    """Load a raw mapping through a file that holds the good scene: all blocks are replaced."""
    path = tmp_path / "bad.yaml"
    path.write_text(GOOD, encoding="utf-8")
    blocks = {key: raw.get(key) for key in {**parse_yaml(GOOD, "good"), **raw}}
    return load_scene(path, blocks)


def test_the_good_scene_is_good(tmp_path):
    assert load_raw(tmp_path, edited({})).title == "Good"
    assert len(BAD) >= 50


@pytest.mark.parametrize("case", BAD)
def test_bad_scene(case, tmp_path):
    changes, key, problem, hint = BAD[case]
    raw = edited(changes)
    with pytest.raises(SceneError) as caught:
        load_raw(tmp_path, raw)
    error = caught.value
    assert error.key == key
    assert error.file.endswith("bad.yaml")
    assert problem in error.problem
    assert hint in f"{error.problem}; {error.hint}"
    assert str(error).startswith(f"{error.file}: " + (f"key '{key}': " if key else ""))
    for written in changes.values():
        if isinstance(written, (str, float)) and key in changes and changes[key] is written:
            assert f"(got {written!r})" in str(error)


def test_a_resolved_scene_takes_si_numbers_only(tmp_path):
    resolved = load_raw(tmp_path, edited({})).resolved()
    for key, value, fragment in [
        ("mesh.spacing", "5 mm", "resolved form holds SI numbers"),
        ("mesh.spacing", math.nan, "finite"),
        ("mesh.spacing", 10**400, "finite"),
        ("loads.0.displacement.y", 1e-5, "times and values"),
        ("loads.0.displacement.y.times", [0.0], "has no points"),
        ("loads.0.displacement.y.times", 3, "times and values"),
    ]:
        changed = copy.deepcopy(resolved)
        override(changed, key, value, "r")
        with pytest.raises(SceneError) as caught:
            Scene.from_resolved(changed)
        assert fragment in str(caught.value)
    for junk in ({}, {"mesh": 3}, {1: 2}, [], None, 7):
        with pytest.raises(SceneError):
            Scene.from_resolved(junk)


KEYS = [
    *parse_yaml(GOOD, "good"),
    "geometry.plate.width",
    "geometry.holes",
    "geometry.holes.0.radius",
    "geometry.cracks.0.from",
    "mesh.spacing",
    "horizon.ratio",
    "material.poissons_ratio",
    "material.source",
    "loads.0",
    "loads.0.on",
    "loads.0.displacement",
    "loads.0.displacement.y",
    "damage.no_fail",
    "hydrogen.boundary.0",
    "hydrogen.boundary.0.coverage",
    "hydrogen.saturation",
    "time.end",
    "stepping.grouping",
    "outputs.every",
    "outputs.times",
]
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=10)
    | st.sampled_from(["7 mm", "1 h", "0 s", "top", "notch", "1e-5", "-3 mm", "9e99 km", "all", "fixed"])
)
JUNK = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["on", "y", "x", "name", "times", "0 h", "1 h"]) | SCALARS, inner, max_size=3)
    ),
    max_leaves=6,
)


@given(st.dictionaries(st.sampled_from(KEYS), JUNK, min_size=1, max_size=3))
@settings(max_examples=150, deadline=None)
def test_junk_gives_a_scene_or_the_error(tmp_path_factory, changes):
    path = tmp_path_factory.getbasetemp() / "junk.yaml"
    path.write_text(GOOD, encoding="utf-8")
    try:
        scene = load_scene(path, changes)
    except SceneError as error:
        assert error.problem
        return
    assert Scene.from_resolved(scene.resolved()) == scene
