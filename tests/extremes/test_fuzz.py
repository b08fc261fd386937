"""Random scenes: each is refused with a key and a reason before it runs, or keeps every promise of a run."""

import warnings

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pdhe.case import build_case
from pdhe.errors import PdheError, SceneError, SimulationError
from pdhe.extremes.scenes import Run, promises
from pdhe.plan import make_plan
from pdhe.scene import Scene
from pdhe.simulation import simulate
from pdhe.solvers import INDEFINITE
from pdhe.verification.slabs import nodes_of

#: Refusals by the mesh, which knows no scene: they name the place in words.
MESH_REFUSALS = ("nearly touch", "owns no cell", "lies in or on the plate", "coincide", "gmsh", "not square")


def powers(low: float, high: float):
    """Numbers whose logarithm is uniform."""
    return st.floats(low, high).map(lambda x: float(f"{10.0**x:.3g}"))


@st.composite
def histories(draw, values, end):
    """A constant, a ramp, a ramp that is held, a triangle, or steps at awkward times."""
    count = draw(st.integers(1, 4))
    if count == 1 or end == 0.0:
        return {"times": [0.0], "values": [draw(values)]}
    times = sorted(draw(st.sets(st.sampled_from([0.0, 1e-9, 0.25, 1 / 3, 0.5, 1.0, 1.5]), min_size=2, max_size=count)))
    return {"times": [end * t for t in times], "values": [draw(values) for _ in times]}


@st.composite
def scenes(draw):
    """Resolved scenes of up to 80 nodes, with anything in them that a scene can say."""
    spacing = draw(st.sampled_from([1e-3, 1e-6, 1.0]))
    # Few of them too small for any horizon.
    columns, rows = draw(st.integers(2, 9)), draw(st.integers(2, 9))
    width, height = columns * spacing, rows * spacing
    diffusivity = draw(powers(-16, -3))
    end = draw(st.sampled_from([0.0, 1e-3, 0.03, 0.3, 3.0, 300.0])) * max(width, height) ** 2 / diffusivity
    end = min(float(f"{end:.3g}"), 1e17)
    stiff = draw(powers(0, 13))
    place = st.one_of(st.integers(0, 18).map(lambda k: k / 2), st.floats(0.0, 9.0).map(lambda x: round(x, 3)))

    def point():
        return [min(draw(place) * spacing, width), min(draw(place) * spacing, height)]

    cracks = [{"name": f"crack{k}", "from": point(), "to": point()} for k in range(draw(st.sampled_from([0, 0, 1, 2])))]
    holes = []
    if draw(st.integers(0, 5)) == 0:
        holes = [{"name": "bore", "centre": point(), "radius": draw(st.sampled_from([0.9, 1.0, 1.5])) * spacing}]
    sets = ["left", "right", "bottom", "top", *(item["name"] for item in (*cracks, *holes))]
    raw = {
        "title": "random",
        "geometry": {
            "plate": {"width": width, "height": height, "thickness": draw(st.sampled_from([1e-3, 4.0])) * spacing},
            "cracks": cracks,
            "holes": holes,
        },
        "mesh": {"spacing": spacing, "cells": draw(st.sampled_from(["quadrilateral"] * 3 + ["triangle"]))},
        "horizon": {
            "ratio": min(draw(st.sampled_from([1.2, 1.42, 1.5, 1.515, 2.0, 2.9, 3.015, 4.0])), min(columns, rows) - 0.1)
        },
        "material": {
            "youngs_modulus": stiff,
            "poissons_ratio": draw(st.sampled_from([-0.9, -0.3, 0.0, 0.29, 0.29, 1 / 3, 0.4, 0.46, 0.49])),
            # A critical stretch between 1e-5 and 1.
            "critical_energy_release_rate": stiff * spacing * draw(powers(-10, 0)),
            "diffusivity": diffusivity,
        },
        "mechanics": {
            "model": draw(st.sampled_from(["condensed rotation"] * 3 + ["thesis spring"])),
            "weights": draw(st.sampled_from(["moment matched"] * 3 + ["volume", "energy", "none"])),
            "partial_volume": draw(st.sampled_from(["auto"] * 3 + ["full", "ramp", "thesis"])),
        },
        "time": {"end": end},
        "outputs": {"count": draw(st.integers(1, 5))},
        "solver": {
            "tolerance": draw(st.sampled_from([1e-3, 1e-6, 1e-6, 1e-10])),
            "precision": draw(st.sampled_from(["double"] * 3 + ["single"])),
            "max_iterations": 20_000,
        },
        "stepping": {"mode": "events", "grouping": draw(st.sampled_from([0.0, 0.05, 0.9]))},
    }
    if draw(st.integers(0, 4)) == 0:
        steps = {"load_steps": draw(st.integers(1, 20)), "diffusion_substeps": draw(st.sampled_from([1, 50, 2000]))}
        raw["stepping"] = {"mode": "fixed", **steps}
    if draw(st.integers(0, 5)):
        largest = draw(powers(-9, -0.5)) * min(width, height)
        amounts = st.sampled_from([0.0, largest, -largest, 0.3 * largest])
        # Opposite edges, or one, or sets that may share nodes and contradict each other.
        wanted = draw(st.sampled_from([["top", "bottom"]] * 3 + [["left", "right"], ["bottom"], sets[-1:], sets[:3]]))
        axes = draw(st.sampled_from(["x", "y", "y", "xy"]))
        raw["loads"] = [
            {
                "on": on,
                "at": draw(st.sampled_from(["edge", "edge", "nodes"])),
                "displacement": {axis: draw(histories(amounts, end)) for axis in axes},
            }
            for on in wanted
        ]
        if draw(st.integers(0, 3)):
            raw["damage"] = {
                "criterion": draw(st.sampled_from(["energy", "stretch"])),
                "calibration": draw(st.sampled_from(["discrete", "continuum"])),
                "no_fail": draw(st.lists(st.sampled_from(sets), max_size=1)),
            }
    if draw(st.integers(0, 2)):
        raw["hydrogen"] = {
            "kernel": draw(st.sampled_from(["inverse square", "inverse", "constant"])),
            "initial": draw(st.sampled_from([0.0, 0.0, 0.3, 1.0])),
            "boundary": [
                {"on": on, "coverage": draw(histories(st.sampled_from([0.0, 0.5, 1.0]), end))}
                for on in draw(st.sampled_from([[], ["left"], ["left"], ["left", "right"], sets[-1:], sets[-2:]]))
            ],
            "degradation": draw(st.sampled_from(["stretch", "energy"])),
            "saturation": draw(st.sampled_from(["off", {"damage": 0.36, "coverage": 1.0}, {"damage": 0.0}])),
        }
    return raw


def check(raw):
    """Run a scene; it may be refused before it runs, and else has to keep its promises."""
    try:
        scene = Scene.from_resolved(raw, "random.yaml")
        case = build_case(scene, nodes_of(scene))
        make_plan(case)
    except SceneError as error:
        assert error.file in ("random.yaml", "scene")
        assert error.problem
        return
    except PdheError as error:
        assert any(text in str(error) for text in MESH_REFUSALS), str(error)
        return
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            result = simulate(case)
        except SimulationError as error:
            # Too few bonds are left for a negative tangential stiffness: said, not gone on with.
            assert raw["material"]["poissons_ratio"] > 1 / 3, error
            assert INDEFINITE in str(error)
            return
    broken = [(row.what, row.measured) for row in promises(Run(case, result)) if not row.passed]
    assert not broken


FUZZ = {"deadline": None, "suppress_health_check": list(HealthCheck)}


@given(scenes())
@settings(max_examples=100, derandomize=True, **FUZZ)
def test_random_scenes_are_refused_or_keep_their_promises(raw):
    check(raw)


@pytest.mark.slow
@given(scenes())
@settings(max_examples=3000, **FUZZ)
def test_many_random_scenes_are_refused_or_keep_their_promises(raw):
    check(raw)
