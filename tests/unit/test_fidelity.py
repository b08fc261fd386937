"""Fidelities fill in what a scene leaves out, and nothing else."""

from pathlib import Path

import pytest

from pdhe.errors import SceneError
from pdhe.fidelity import LONG_RATIO, SETTINGS, smallest_feature
from pdhe.scene import Scene, load_scene
from pdhe.scene_blocks import FIDELITIES
from pdhe.scene_checks import square_cells

SCENES = Path(__file__).parents[2] / "config" / "scenes"
# Fidelities are measured on plane meshes, and refused in space.
PLATES = sorted(path.stem for path in SCENES.glob("*.yaml") if "cells: hexahedron" not in path.read_text())
KINDS = {"mode_i": "fracture", "elastic": "elastic", "diffusion": "diffusion"}
LARGE_STRAINS = {
    "hydrogen": None,
    "mechanics": {"model": "correspondence", "strain": "finite"},
    "damage": {},
    "stepping": {"mode": "fixed", "load_steps": 2, "diffusion_substeps": 1},
}


def filled(name: str, fidelity: str, **changes) -> Scene:
    return load_scene(SCENES / f"{name}.yaml", {"fidelity": fidelity, "mesh.spacing": None, **changes})


def test_every_kind_of_scene_has_every_fidelity_from_cheap_to_accurate():
    assert set(SETTINGS) == set(KINDS.values())
    for settings in SETTINGS.values():
        assert tuple(settings) == FIDELITIES
        for coarse, fine in zip(list(settings.values())[:-1], list(settings.values())[1:], strict=True):
            assert fine.cells > coarse.cells
            assert fine.tolerance <= coarse.tolerance


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("name", PLATES)
def test_spacing_suits_the_scene(name, fidelity):
    scene = filled(name, fidelity, horizon=None, **{"solver.tolerance": None})
    kind = next(kind for block, kind in (("damage", "fracture"), ("loads", "elastic"), ("time", "diffusion"))
                if getattr(scene, block) is not None)  # fmt: skip
    settings = SETTINGS[kind][fidelity]
    cells = smallest_feature(scene.geometry) / scene.mesh.spacing
    # Squares that fit are not far off; measured: at most 33 % finer (crack between rows).
    assert settings.cells * (1.0 - 1e-9) <= cells <= 1.45 * settings.cells
    assert scene.solver.tolerance == settings.tolerance
    lattice = scene.mesh.cells == "quadrilateral" and not scene.geometry.holes
    short = kind == "diffusion" or (kind == "elastic" and scene.mechanics.model == "condensed rotation")
    assert scene.horizon.ratio == (1.515 if lattice and short else 3.015)
    if lattice:
        assert not square_cells(scene.geometry.width, scene.geometry.height, scene.mesh.spacing)[2]
        for crack in scene.geometry.cracks:
            if crack.start[1] == crack.end[1]:
                assert crack.start[1] / scene.mesh.spacing == pytest.approx(round(crack.start[1] / scene.mesh.spacing))


def test_what_a_scene_says_wins():
    scene = load_scene(SCENES / "mode_i.yaml", {"fidelity": "draft", "solver.tolerance": 1e-5})
    assert scene.mesh.spacing == 1e-3 and scene.horizon.ratio == 3.015 and scene.solver.tolerance == 1e-5
    fixed = {"stepping.mode": "fixed", "stepping.load_steps": 10, "stepping.diffusion_substeps": 100}
    assert filled("mode_i", "draft", **fixed).stepping.grouping is None


def test_a_horizon_that_is_given_is_resolved():
    scene = filled("mode_i", "draft", **{"horizon": {"length": "6 mm"}})
    assert scene.horizon_length == 6e-3
    assert scene.mesh.spacing <= 6e-3 / LONG_RATIO


def test_fidelity_is_kept_with_what_it_meant():
    scene = filled("smoke", "standard")
    resolved = scene.resolved()
    assert resolved["fidelity"] == "standard" and resolved["mesh"]["spacing"] == scene.mesh.spacing
    assert Scene.from_resolved(resolved) == scene


def test_mistakes_are_named():
    with pytest.raises(SceneError, match=r"key 'fidelity'.*is not a fidelity.*`draft`"):
        filled("smoke", "quick")
    with pytest.raises(SceneError, match=r"key 'mesh\.spacing'.*missing"):
        load_scene(SCENES / "smoke.yaml", {"mesh.spacing": None})
    with pytest.raises(SceneError, match="key 'mesh'"):
        load_scene(SCENES / "smoke.yaml", {"fidelity": "draft", "mesh": "fine"})
    with pytest.raises(SceneError, match=r"geometry\.plate"):
        filled("smoke", "draft", **{"geometry.plate": None})


@pytest.mark.parametrize(
    ("name", "changes", "tolerance"),
    [
        pytest.param("smoke", {}, 3e-4, id="bonds break"),
        pytest.param("smoke", {"solver.tolerance": 1e-5}, 1e-5, id="given"),
        pytest.param("elastic", {}, 1e-4, id="nothing breaks"),
        # Bonds that break at large strains were not part of the measurement.
        pytest.param("smoke", LARGE_STRAINS, 1e-4, id="large strains"),
    ],
)
def test_the_usual_tolerance_is_looser_where_bonds_break(name, changes, tolerance):
    assert load_scene(SCENES / f"{name}.yaml", changes).solver.tolerance == tolerance
