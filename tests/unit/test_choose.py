"""Settings from an accuracy: what is chosen, what is refused, and predictions held against what is found."""

import json
import re
from pathlib import Path

import pytest

from pdhe import cli
from pdhe.case import build_case
from pdhe.errors import SceneError
from pdhe.fidelity import spacing_for
from pdhe.results import open_result
from pdhe.scene import load_scene
from pdhe.simulation import simulate
from pdhe.tradeoff.choose import MODELS, TOLERANCE, choose, estimate
from pdhe.tradeoff.quantities import limit_of, standard_values
from pdhe.verification.slabs import nodes_of

SCENES = Path(__file__).parents[2] / "config" / "scenes"
PULLED = "loads: [{on: top, displacement: {y: %s}}, {on: bottom, displacement: {y: -%s}}]\n"
NOTCH = "  cracks: [{name: notch, from: [0 mm, %s mm], to: [%s mm, %s mm]}]\n"


def plate(width: int, height: int, notch: str = "") -> str:
    return f"geometry:\n  plate: {{width: {width} mm, height: {height} mm, thickness: 4 mm}}\n{notch}"


def ramp(end: str, pull: str) -> str:
    sides = ((on, f"{{0 s: 0 mm, {end}: {sign}{pull}}}") for on, sign in (("top", ""), ("bottom", "-")))
    return "loads:\n" + "".join(f"  - {{on: {on}, displacement: {{y: {y}}}}}\n" for on, y in sides)


def crack(y: int, length: int) -> str:
    return NOTCH % (y, length, y)


# None of these is in the study. Name -> accuracy, scene.
HELD_BACK = {
    "deep notch": ("3 %", plate(80, 60, crack(30, 40)) + PULLED % ("0.02 mm", "0.02 mm") + "time: {end: 0 s}\n"),
    "two notches": (
        "3 %",
        plate(100, 100)
        + "  cracks:\n    - {name: a, from: [0 mm, 40 mm], to: [30 mm, 40 mm]}\n"
        + "    - {name: b, from: [100 mm, 60 mm], to: [70 mm, 60 mm]}\n"
        + PULLED % ("0.02 mm", "0.02 mm")
        + "time: {end: 0 s}\n",
    ),
    "wide slab": ("0.1 %", plate(100, 50) + "hydrogen: {boundary: [{on: left, coverage: 1}]}\ntime: {end: 2e6 s}\n"),
    "corner": (
        "0.2 %",
        plate(60, 60) + "hydrogen: {boundary: [{on: left, coverage: 1}, {on: top, coverage: 1}]}\ntime: {end: 1e6 s}\n",
    ),
    "source in the middle": (
        "3 %",
        plate(60, 60, crack(30, 30)) + "hydrogen: {boundary: [{on: notch, coverage: 1}]}\ntime: {end: 1e6 s}\n",
    ),
    "dry crack": (
        "10 %",
        plate(60, 60, crack(30, 20)) + ramp("1000 s", "0.1 mm") + "damage: {}\ntime: {end: 1000 s}\n",
    ),
    "short dry crack": (
        "10 %",
        plate(80, 40, crack(20, 12)) + ramp("1000 s", "0.08 mm") + "damage: {}\ntime: {end: 1000 s}\n",
    ),
    "crack in hydrogen": (
        "10 %",
        plate(60, 60, crack(30, 20))
        + ramp("2e5 s", "0.02 mm")
        + "damage: {}\nhydrogen: {saturation: off, boundary: [{on: notch, coverage: 1}]}\ntime: {end: 3e6 s}\n",
    ),
    "short crack in hydrogen": (
        "10 %",
        plate(80, 40, crack(20, 16))
        + ramp("2e5 s", "0.015 mm")
        + "damage: {}\nhydrogen: {saturation: off, boundary: [{on: notch, coverage: 1}]}\ntime: {end: 3e6 s}\n",
    ),
    "hydrogen from the crack and the edge": (
        "10 %",
        plate(80, 40, crack(20, 24))
        + ramp("2e5 s", "0.02 mm")
        + "damage: {}\nhydrogen: {saturation: off, boundary: [{on: notch, coverage: 1}, {on: left, coverage: 1}]}\n"
        + "time: {end: 3e6 s}\n",
    ),
}
WET = {"boundary": [{"on": "notch", "coverage": 1}]}
SLOW = (
    "dry crack",
    "short dry crack",
    "crack in hydrogen",
    "short crack in hydrogen",
    "hydrogen from the crack and the edge",
)


def written(folder: Path, accuracy: str, text: str) -> Path:
    path = folder / "scene.yaml"
    path.write_text(f"title: held back\naccuracy: {accuracy}\nmaterial: AISI 4340\n{text}")
    return path


def found(path: Path, changes: dict) -> dict[str, float]:
    """Errors of the run that was chosen, against limits from finer meshes with tight equilibria."""
    scene = load_scene(path, changes)
    values = standard_values(simulate(build_case(scene, nodes_of(scene))), scene)
    shares = (0.8, 0.7, 0.6, 0.5, 0.4)
    spacings = sorted({spacing_for(scene.geometry, share * scene.mesh.spacing, True) for share in shares}, reverse=True)
    ladder = []
    for spacing in spacings:
        fine = load_scene(path, changes | {"mesh.spacing": f"{spacing!r} m", "solver.tolerance": 1e-7})
        ladder.append(standard_values(simulate(build_case(fine, nodes_of(fine))), fine))
    return {name: limit_of(spacings, [row[name] for row in ladder]).error(value) for name, value in values.items()}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in HELD_BACK]
)
def test_predictions_are_within_a_factor_of_two(name, tmp_path):
    path = written(tmp_path, *HELD_BACK[name])
    choice = choose(path)
    errors = found(path, choice.changes)
    ratio = choice.predicted / max(errors.values())
    # Measured, in this order: 1.01, 1.07, 1.08, 1.19, 0.74, 0.83, 2.23, 1.07, 1.06, 1.19. That of the short dry crack
    # is on the safe side, and its error, 1.6 %, is itself known to 0.5 % only.
    assert 0.5 < ratio < (3.0 if name == "short dry crack" else 2.0), (choice.text(), errors)
    # What was wanted is met but for the margin of the prediction; measured: at most 0.98 times the accuracy.
    assert max(errors.values()) < 1.2 * choice.accuracy


@pytest.mark.slow
def test_an_accuracy_that_pilot_runs_scatter_by_is_refused(tmp_path):
    long = plate(80, 40, crack(20, 40)) + ramp("1000 s", "0.08 mm") + "damage: {}\ntime: {end: 1000 s}\n"
    # Measured: 9.8 %.
    with pytest.raises(SceneError, match="errors of pilot runs scatter by"):
        choose(written(tmp_path, "10 %", long))


def test_choice_is_run_told_and_stored(tmp_path, capsys):
    path = written(tmp_path, *HELD_BACK["corner"])
    assert cli.main(["choose", str(path)]) == 0
    told = capsys.readouterr().out
    assert told.count("pilot run at") == 3 and "0.2 % wanted" in told
    assert cli.main(["run", str(path), "--out", str(tmp_path / "result.nc")]) == 0
    assert told.splitlines()[-1] in capsys.readouterr().out
    with open_result(tmp_path / "result.nc") as result:
        scene = json.loads(result.attrs["scene"])
        assert result.attrs["choice"] == told.splitlines()[-1]
        assert 0.0005 < result.attrs["predicted_error"] <= 0.002
        assert set(json.loads(result.attrs["predicted_errors"])) == {"mean_coverage"}
    assert scene["accuracy"] == 0.002 and scene["horizon"] == {"ratio": 1.515}
    assert cli.main(["validate", str(path)]) == 0
    assert "settings left to its accuracy" in capsys.readouterr().out
    assert cli.main(["plan", str(path)]) == 0
    planned = capsys.readouterr().out
    assert "nodes:" in planned and "expected error of the mesh: mean_coverage 0.1" in planned


def test_more_accuracy_takes_finer_meshes_and_equilibria(tmp_path):
    text = HELD_BACK["deep notch"][1]
    coarse, fine = (choose(written(tmp_path, accuracy, text)) for accuracy in ("8 %", "4 %"))
    spacing = [float(choice.changes["mesh.spacing"].split()[0]) for choice in (coarse, fine)]
    assert spacing[1] < spacing[0]
    assert fine.changes["solver.tolerance"] == TOLERANCE * 0.04
    assert fine.predicted < coarse.predicted and fine.predicted < 0.04


def test_results_carry_an_estimate_of_their_error(tmp_path, capsys):
    text = HELD_BACK["deep notch"][1] + "mesh: {spacing: 0.625 mm}\nhorizon: {ratio: 1.515}\n"
    path = written(tmp_path, "50 %", text)  # an accuracy beside a spacing is a note
    assert cli.main(["run", str(path), "--out", str(tmp_path / "result.nc")]) == 0
    errors = found(path, {"mesh.spacing": "0.625 mm"})
    with open_result(tmp_path / "result.nc") as result:
        told = json.loads(result.attrs["predicted_errors"])
        assert result.attrs["predicted_error"] == max(told.values())
    assert set(told) == set(errors)
    # Measured: 1.7 % expected, 1.6 % found.
    assert 0.5 < max(told.values()) / max(errors.values()) < 2.0
    assert cli.main(["plan", str(path)]) == 0
    assert "expected error of the mesh: reaction_top_y" in capsys.readouterr().out


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"mesh.spacing": "2.5 mm"}, id="hardly finer than a pilot run"),
        pytest.param({"mesh.spacing": "0.5 mm", "horizon": {"length": "3 mm"}}, id="horizon that stays"),
        pytest.param({"mesh.spacing": "0.5 mm", "damage": {}, "hydrogen": WET}, id="no limit"),
    ],
)
def test_nothing_is_estimated_where_nothing_can_be_said(changes, tmp_path):
    path = written(tmp_path, "50 %", HELD_BACK["deep notch"][1])
    assert estimate(load_scene(path, changes)) == {}


def test_a_tolerance_that_is_given_stays(tmp_path):
    path = written(tmp_path, "8 %", HELD_BACK["deep notch"][1] + "solver: {tolerance: 1e-7}\n")
    choice = choose(path)
    assert "solver.tolerance" not in choice.changes
    assert load_scene(path, choice.changes).solver.tolerance == 1e-7


def test_what_cannot_be_promised_is_refused(tmp_path):
    wet = HELD_BACK["crack in hydrogen"][1].replace("saturation: off, ", "")
    with pytest.raises(SceneError, match="the faster the finer the mesh"):
        choose(written(tmp_path, "5 %", wet))
    with pytest.raises(SceneError, match="scatter by"):
        choose(written(tmp_path, "1 %", HELD_BACK["dry crack"][1]))  # they scatter by 1.7 %
    with pytest.raises(SceneError, match=r"between 0\.01 % and 50 %"):
        choose(written(tmp_path, "90 %", wet))
    with pytest.raises(SceneError, match=r"key 'accuracy'.*is missing"):
        choose(SCENES / "smoke.yaml")


@pytest.mark.parametrize(
    ("accuracy", "more", "why"),
    [
        ("0 %", "", r"key 'accuracy': must be between .* \(got '0 %'\)"),
        ("good", "", r"key 'accuracy': is not a number \(got 'good'\)"),
        ("2 %", "fidelity: draft\n", r"key 'accuracy': and `fidelity` are both given"),
        ("2 %", "mesh: {cells: triangle, refine: []}\n", "on a graded mesh"),
        ("2 %", "mesh: {cells: tetrahedron}\n", "one in space"),
        ("2 %", "mechanics: {model: correspondence, strain: finite}\n", "under large strains"),
        ("2 %", "regions: [{name: weld, from: [0 mm, 0 mm], to: [9 mm, 9 mm]}]\n"
                "mechanics: {regions: [{on: weld, factor: 2}]}\n", "Young's modulus differs by place"),
    ],
)  # fmt: skip
def test_what_no_pilot_run_is_needed_for_is_refused_before_any(accuracy, more, why, tmp_path, capsys):
    path = written(tmp_path, accuracy, HELD_BACK["deep notch"][1] + more)
    for command in (["validate"], ["plan"], ["choose"], ["run", "--out", str(tmp_path / "result.nc")]):
        assert cli.main([command[0], str(path), *command[1:]]) == 1
        out, told = capsys.readouterr()
        assert re.search(why, told) and "pilot run" not in out + told
    assert not (tmp_path / "result.nc").exists()


def test_reading_a_scene_runs_nothing(tmp_path):
    path = written(tmp_path, *HELD_BACK["corner"])
    with pytest.raises(SceneError, match=r"key 'accuracy'.*`pdhe choose`"):
        load_scene(path)
    with pytest.raises(SceneError, match="both given"):
        load_scene(path, {"fidelity": "draft"})
    assert load_scene(path, {"mesh.spacing": "5 mm"}).accuracy == 0.002


def test_models_name_every_kind():
    from pdhe.fidelity import SETTINGS

    models = json.loads(MODELS.read_text())
    assert models["version"] == 1 and set(models["kinds"]) == set(SETTINGS)
    for kind in models["kinds"].values():
        assert 0.5 <= kind["order"] <= 3.0 and kind["order"] in kind["orders"].values()
