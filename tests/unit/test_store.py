"""Results that no longer match what made them, and results that nothing refers to."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import netCDF4
import pytest
from PIL import Image

from pdhe import cli, store, wholefile
from pdhe.benchmarks.problems import lattice_nodes
from pdhe.discretization import read_discretization, write_discretization
from pdhe.errors import PdheError
from pdhe.plotting import animate, draw, draw_history
from pdhe.provenance import fingerprint
from pdhe.scene import Scene
from pdhe.simulation import solve_case
from pdhe.study import load_study

SCENE = str(Path(__file__).parents[2] / "config/scenes/smoke.yaml")


@pytest.fixture(scope="module")
def computed(tmp_path_factory):
    """Two cases of one study with nodes, meshes and figures, as the workflow leaves them."""
    folder = tmp_path_factory.mktemp("store")
    block = {
        "name": "pair",
        "scene": SCENE,
        "set": {"mesh.spacing": "20 mm"},
        "cases": {"wet": {}, "dry": {"hydrogen": None}},
    }
    (folder / "pair.yaml").write_text(json.dumps({"study": block}))
    place = folder / "results/store"
    for case in load_study(folder / "pair.yaml").cases:
        scene = Scene.from_resolved(case.resolved)
        nodes = lattice_nodes(scene)
        write_discretization(nodes, place / f"nodes/{case.mesh_id}.nc")
        solve_case(scene, nodes, place / f"solve/{case.solve_id}.nc", command="pdhe solve")
        (place / "mesh").mkdir(exist_ok=True)
        wholefile.write_text(place / f"mesh/{case.mesh_id}.msh", "mesh\n")
        wholefile.seal(place / f"mesh/{case.mesh_id}.msh")
        (folder / "results/pair" / case.name).mkdir(parents=True)
        (folder / "results/pair" / case.name / "history.csv").write_text("history")
    (folder / "results/pair/cases.csv").write_text("cases")
    return folder


@pytest.fixture
def project(computed, tmp_path, monkeypatch):
    shutil.copytree(computed, tmp_path / "project")
    monkeypatch.chdir(tmp_path / "project")
    return Path()


def solutions(project):
    return sorted((project / "results/store/solve").glob("*.nc"))


def problems(project):
    return {path.name: list(store.check(path)) for path in store.stored(project / "results")}


def rewrite(path, attribute, value):
    with netCDF4.Dataset(path, "a") as file:
        file.setncattr(attribute, value)


def without_digest(path):
    with netCDF4.Dataset(path, "a") as file:
        file.delncattr("content_sha256")


def test_untouched_results_match(project, capsys):
    assert set(map(tuple, problems(project).values())) == {()}
    assert cli.main(["verify"]) == 0
    assert capsys.readouterr().out == "4 file(s) match\n"


def test_every_changed_byte_of_an_array_is_found(project):
    path = solutions(project)[0]
    with netCDF4.Dataset(path, "a") as file:
        file["displacement"][0, 3, 1] += 1e-300
        file["displacement"][-1, 3, 1] = -file["displacement"][-1, 3, 1]
    assert problems(project)[path.name] == [
        "cannot be read or is damaged (its content has changed since it was written)"
    ]
    nodes = next((project / "results/store/nodes").glob("*.nc"))
    with netCDF4.Dataset(nodes, "a") as file:
        file["volume"][0] *= 1.0 + 1e-15
    with pytest.raises(PdheError, match=r"not a usable file .*has changed.*delete it and run again"):
        read_discretization(nodes)


def test_truncated_and_foreign_files_are_named(project, capsys):
    first, second = solutions(project)
    first.write_bytes(first.read_bytes()[:3000])
    second.write_text("nothing of the kind")
    next((project / "results/store/mesh").glob("*.msh")).write_text("half a mesh")
    assert cli.main(["verify", "results"]) == 1
    told = capsys.readouterr()
    assert told.out.count("cannot be read or is damaged") == 2
    assert told.out.count(".msh: is damaged") == 1
    assert "error: 3 mismatch(es) in 4 file(s)" in told.err


@pytest.mark.parametrize(
    ("attribute", "value", "problem"),
    [
        ("code_fingerprint", "0" * 12, "made by other code (000000000000, now "),
        ("versions", "{}", "made with other versions ("),
        ("scene_hash", "0", "its scene has the hash "),
        ("status", "incomplete: no convergence", "is incomplete"),
    ],
)
def test_what_made_a_result_is_compared(project, attribute, value, problem):
    path = solutions(project)[0]
    without_digest(path)
    rewrite(path, attribute, value)
    first, second = problems(project)[path.name]
    assert first.startswith("holds no digest") and second.startswith(problem)


def test_a_renamed_result_is_found(project):
    path = solutions(project)[0]
    path.rename(path.with_stem("200x100mm-elsewhere"))
    (found,) = problems(project)["200x100mm-elsewhere.nc"]
    assert found == f"its scene belongs to {path.stem}"


def test_nothing_is_unused_while_a_study_refers_to_it(project):
    assert store.unused(project / "results", ["pair.yaml"]) == []


def test_what_a_study_no_longer_refers_to_is_listed_and_removed(project, capsys):
    content = json.loads(Path("pair.yaml").read_text())
    content["study"]["cases"] = {"wet": {}}
    Path("pair.yaml").write_text(json.dumps(content))
    place = project / "results/store"
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    (place / f"solve/.x.nc.{gone.pid}.1.part").write_text("half")
    (place / f"solve/.x.nc.{os.getpid()}.1.part").write_text("being written")
    (place / "notes.txt").write_text("kept")
    old = project / "results/old/case"
    old.mkdir(parents=True)
    (old / "damage.png").write_text("picture")
    mine = project / "results/mine"
    mine.mkdir()
    (mine / "thesis.tex").write_text("kept")
    kept = load_study("pair.yaml").cases[0].solve_id
    expected = {f".x.nc.{gone.pid}.1.part", "old", "dry", next(p.name for p in solutions(project) if p.stem != kept)}
    assert cli.main(["gc", "--study", "pair.yaml"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in expected) and "4 place(s) could be removed with --remove" in listed
    assert {path.name for path in store.unused(Path("results"), ["pair.yaml"])} == expected
    assert cli.main(["gc", "--study", "pair.yaml", "--remove"]) == 0
    assert store.unused(Path("results"), ["pair.yaml"]) == []
    assert [path.stem for path in solutions(project)] == [kept]
    assert (mine / "thesis.tex").is_file() and (place / "notes.txt").is_file()
    assert (project / "results/pair/wet/history.csv").is_file() and (
        place / f"solve/.x.nc.{os.getpid()}.1.part"
    ).is_file()


def test_checkpoints_and_incomplete_results_stay_while_something_goes_on_from_them(project):
    first, second = solutions(project)
    ends = (".nc.checkpoint", ".nc.incomplete")
    left = [path.with_name(path.stem + end) for path in (first, second) for end in ends]
    for path in left:
        path.write_text("left")
    second.unlink()
    elsewhere = first.with_name("of-no-study.nc.checkpoint")
    elsewhere.write_text("left")
    assert sorted(store.unused(Path("results"), ["pair.yaml"])) == sorted([*left[:2], elsewhere])


def test_a_link_is_removed_and_not_what_it_points_to(project, tmp_path):
    (tmp_path / "far/case").mkdir(parents=True)
    (tmp_path / "far/case/damage.png").write_text("picture")
    link = project / "results/linked"
    link.symlink_to(tmp_path / "far")
    store.remove([link])
    assert not link.exists() and (tmp_path / "far/case/damage.png").is_file()


def test_studies_of_the_configuration_and_others_beside_it(project):
    with pytest.raises(PdheError, match="name them with --study"):
        store.configured_studies()
    studies = Path("config/studies")
    studies.mkdir(parents=True)
    for name in ("one", "two"):
        shutil.copy("pair.yaml", studies / f"{name}.yaml")
    (studies / "check.yaml").write_text("check: {topic: pair}\n")
    shutil.copy("pair.yaml", "aside.yaml")
    Path("config/config.yaml").write_text("studies: [pair.yaml, config/studies/one.yaml]\ndynamics: aside.yaml\n")
    assert [str(path) for path in store.configured_studies()] == [
        "pair.yaml",
        "config/studies/one.yaml",
        "aside.yaml",
        "config/studies/two.yaml",
    ]


def test_a_study_that_cannot_be_read_stops_the_removal(project):
    Path("broken.yaml").write_text("study: {scene: none.yaml}\n")
    assert cli.main(["gc", "--study", "broken.yaml", "--remove"]) == 1
    assert len(solutions(project)) == 2
    assert cli.main(["gc", "elsewhere", "--study", "pair.yaml"]) == 1


def test_pictures_say_what_made_them(project):
    path = solutions(project)[0]
    with netCDF4.Dataset(path) as file:
        made = {name: file.getncattr(name) for name in file.ncattrs()}
    assert made["command"] == "pdhe solve" and "Python" in made["machine"]
    draw("damage", path, {"dpi": 40}, "damage.png")
    animate("damage", path, {"frames": 2, "frame_width": 200}, "damage.gif")
    draw_history(path, "history.png")
    for file, key in (("damage.png", "Source"), ("damage.gif", "comment"), ("history.png", "Source")):
        with Image.open(file) as picture:
            text = picture.info[key]
        told = json.loads(text if isinstance(text, str) else text.decode())
        names = ("content_sha256", "scene", "scene_hash", "code_fingerprint", "versions", "machine", "command")
        drawn = {"drawn_by": fingerprint("pdhe.plotting"), "drawn_with": made["versions"]}
        assert told == {name: made[name] for name in names} | drawn
    for ending in ("pdf", "svg"):
        draw("damage", path, None, f"damage.{ending}")
        assert made["content_sha256"].encode() in Path(f"damage.{ending}").read_bytes()
