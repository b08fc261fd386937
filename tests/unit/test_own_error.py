"""The error that every result tells of itself, held against what finer meshes find."""

import json
from pathlib import Path

import pytest

from pdhe import cli
from pdhe.fidelity import spacing_for
from pdhe.forecast import coarser
from pdhe.results import open_result
from pdhe.scene import Scene, load_scene
from pdhe.simulation import compute, mesh_case
from pdhe.tradeoff.own_error import OwnError, coarser_scenes, own_error, quantities
from pdhe.tradeoff.quantities import limit_of

SCENES = Path(__file__).parents[2] / "config" / "scenes"


def plate(width: int, height: int, more: str = "") -> str:
    return f"geometry:\n  plate: {{width: {width} mm, height: {height} mm, thickness: 4 mm}}\n{more}"


def crack(y: int, length: int) -> str:
    return f"  cracks: [{{name: notch, from: [0 mm, {y} mm], to: [{length} mm, {y} mm]}}]\n"


PULLED = "loads: [{on: top, displacement: {y: 0.02 mm}}, {on: bottom, displacement: {y: -0.02 mm}}]\ntime: {end: 0 s}\n"
HOLE = "  holes: [{name: hole, centre: [50 mm, 30 mm], radius: 10 mm}]\n"
LEFT = "hydrogen: {boundary: [{on: left, coverage: 1}]}\ntime: {end: 2e6 s}\n"
WET = "hydrogen: {%sboundary: [{on: notch, coverage: 1}]}\ntime: {end: %s}\n"
GRADED = "mesh: {spacing: %s mm, cells: triangle, refine: [{%s, spacing: %s mm, within: 2 mm}]}\n"


def ramp(end: str, pull: str) -> str:
    sides = ((on, f"{{0 s: 0 mm, {end}: {sign}{pull}}}") for on, sign in (("top", ""), ("bottom", "-")))
    return "loads:\n" + "".join(f"  - {{on: {on}, displacement: {{y: {y}}}}}\n" for on, y in sides) + "damage: {}\n"


TALL = plate(60, 100, crack(50, 30)) + PULLED
TIP = "from: [30 mm, 50 mm], to: [30 mm, 50 mm]"
CRACKED = plate(80, 60, crack(30, 24))
DRY = CRACKED + ramp("1000 s", "0.08 mm") + "time: {end: 1000 s}\n"
# Name -> factor that is promised, scene; none is in the study of speed against accuracy. The slabs on triangles and the
# graded fracture changed a rule each after they had been held back (docs/tradeoff.md).
HELD_BACK = {
    "long notch, 240 nodes": (3, TALL + "mesh: {spacing: 5 mm}\n"),
    "long notch, 1500 nodes": (2, TALL + "mesh: {spacing: 2 mm}\n"),
    "notch in triangles": (2, TALL + "mesh: {spacing: 2 mm, cells: triangle}\n"),
    "hole": (2, plate(100, 60, HOLE) + PULLED + "mesh: {spacing: 1.25 mm, cells: triangle}\n"),
    "graded notch": (2, TALL + GRADED % (4, TIP, 0.8)),
    "graded hole": (2, plate(100, 60, HOLE) + PULLED + GRADED % (4, "around: hole", 0.8)),
    "slab": (2, plate(80, 40) + LEFT + "mesh: {spacing: 2.5 mm}\n"),
    "slab in triangles": (None, plate(80, 40) + LEFT + "mesh: {spacing: 2 mm, cells: triangle}\n"),
    "graded slab": (None, plate(80, 40) + LEFT + GRADED % (4, "from: [0 mm, 0 mm], to: [0 mm, 40 mm]", 0.8)),
    "hydrogen from a crack": (2, plate(60, 60, crack(30, 40)) + WET % ("", "1e6 s") + "mesh: {spacing: 1.5 mm}\n"),
    "fixed horizon": (2, TALL + "mesh: {spacing: 2 mm}\nhorizon: {length: 7 mm}\n"),
    "dry fracture": (3, DRY + "mesh: {spacing: 2 mm}\n"),
    "fracture in hydrogen": (
        3,
        CRACKED + ramp("2e5 s", "0.02 mm") + WET % ("saturation: off, ", "4e6 s") + "mesh: {spacing: 2 mm}\n",
    ),
    # Chance: 3.05 with 2 mm that are fine, 2.3 and 0.64 there with spacings of 1.6 and 1.4 mm.
    "graded fracture": (
        3,
        (DRY + GRADED % (5, "from: [24 mm, 30 mm], to: [50 mm, 30 mm]", 1.5)).replace("within: 2 mm", "within: 4 mm"),
    ),
}
SLOW = ("dry fracture", "fracture in hydrogen", "graded fracture")


def loaded(folder: Path, text: str) -> Scene:
    path = folder / "scene.yaml"
    path.write_text(f"title: held back\nmaterial: AISI 4340\n{text}")
    return load_scene(path)


def told_and_found(scene: Scene, shares=(0.8, 2 / 3, 0.5, 0.4)) -> tuple[dict[str, float], dict[str, float], OwnError]:
    """Errors that the run tells, and those against the limit of finer meshes."""
    own, values = own_error(scene, lambda text: None), quantities(compute(mesh_case(scene)), scene)
    lattice = scene.mesh.cells == "quadrilateral" and not scene.geometry.holes
    if lattice:
        spacings = [spacing_for(scene.geometry, share * scene.mesh.spacing, True) for share in shares]
        shares = sorted({spacing / scene.mesh.spacing for spacing in spacings}, reverse=True)
    finer = [coarser(scene, share, with_horizon=True) for share in shares]
    rows = [quantities(compute(mesh_case(fine)), fine) for fine in finer]
    limits = {name: limit_of(shares, [row[name] for row in rows]) for name in values}
    return own.errors(values), {name: limits[name].error(value) for name, value in values.items()}, own


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in HELD_BACK]
)
def test_errors_found_are_within_the_factor_that_is_told(name, tmp_path):
    factor, text = HELD_BACK[name]
    scene = loaded(tmp_path, text)
    told, found, own = told_and_found(scene)
    assert set(told) == set(found)
    ratio = max(told.values()) / max(found.values())
    # Measured, in this order: 1.03, 1.01, 1.04, 1.36, 1.45, 1.12, 1.01, 1.93, 0.53, 0.52, 1.10, 0.87, 1.10, 2.4.
    if factor is None:
        assert ratio > 0.5 and "errors found were at most twice that" in own.basis()
    else:
        assert 1 / factor < ratio < factor, (own.basis(), told, found)
        assert f"right within a factor of {factor}" in own.basis()


def test_every_shipped_scene_tells_its_error_or_why_not():
    for path in sorted(SCENES.glob("*.yaml")):
        scene = load_scene(path)
        assert any(coarser_scenes(scene)), path


def test_what_has_no_limit_tells_what_the_mesh_changes(tmp_path, capsys):
    assert cli.main(["run", str(SCENES / "smoke.yaml"), "--out", str(tmp_path / "smoke.nc")]) == 0
    with open_result(tmp_path / "smoke.nc") as result:
        errors, basis = json.loads(result.attrs["predicted_errors"]), result.attrs["error_basis"]
        assert result.attrs["predicted_error"] == max(errors.values())
    assert {"crack", "mean_coverage", "reaction_top_y"} <= set(errors) and min(errors.values()) > 0.0
    assert "200 nodes" in basis and "no errors but changes" in basis
    told = capsys.readouterr().out.splitlines()[-1]
    assert told.startswith("expected error of the mesh: ") and told.endswith(basis)


def test_a_scene_that_is_too_coarse_already_says_that_nothing_is_estimated(tmp_path):
    scene = loaded(tmp_path, plate(60, 100, crack(50, 8)) + PULLED + "mesh: {spacing: 6 mm}\n")
    told = own_error(scene, lambda text: None).attributes(compute(mesh_case(scene)))
    assert set(told) == {"error_basis"}
    assert told["error_basis"].startswith("not estimated: ")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        pytest.param(plate(3, 3) + PULLED + "mesh: {spacing: 1 mm}\n", "fewer than 3 cells", id="few cells"),
        pytest.param(plate(16, 12) + PULLED + "mesh: {spacing: 1 mm, cells: tetrahedron}\n", "tetrahedra", id="space"),
    ],
)
def test_what_was_never_measured_is_said(text, why, tmp_path):
    scene = loaded(tmp_path, text)
    basis = OwnError(scene, 1.5, 10).basis()
    assert "right by an unknown factor" in basis and why in basis


def test_a_scene_can_do_without(tmp_path, capsys):
    path = tmp_path / "scene.yaml"
    path.write_text(
        f"title: plain\nmaterial: AISI 4340\n{TALL}mesh: {{spacing: 5 mm}}\noutputs: {{error_estimate: off}}\n"
    )
    assert cli.main(["run", str(path), "--out", str(tmp_path / "result.nc")]) == 0
    assert "error estimate" not in capsys.readouterr().err
    with open_result(tmp_path / "result.nc") as result:
        assert result.attrs["error_basis"] == "not estimated: `outputs.error_estimate` is off"
        assert "predicted_error" not in result.attrs


def test_openings_count_with_nodes_on_both_sides_alone(tmp_path):
    # At 6 mm the notch runs along a row of nodes, which is the only one it counts.
    row = loaded(tmp_path, plate(60, 108, crack(51, 30)) + PULLED + "mesh: {spacing: 6 mm}\n")
    between = loaded(tmp_path, plate(60, 108, crack(54, 30)) + PULLED + "mesh: {spacing: 6 mm}\n")
    for scene, there in ((row, False), (between, True)):
        assert ("opening of notch" in quantities(compute(mesh_case(scene)), scene)) is there
