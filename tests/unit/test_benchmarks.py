"""Benchmarks: every one runs on tiny settings, times carry no verdict, and two runs can be compared."""

import copy
import json
import math

import numpy as np
import pytest

from pdhe import cli
from pdhe.benchmarks import compiled, machine, page, problems, timing
from pdhe.benchmarks.registry import BENCHMARKS, configured, run_benchmark
from pdhe.errors import PdheError, SceneError

TINY = {
    "thesis_loop": {"columns": 40, "rounds": 2, "least": 0.01},
    "same_answer": {"nodes": 200, "load_steps": 10, "substeps": 2, "own_nodes": 0, "rounds": 1,
                    "overrides": {"time.end": "1e6 s", "outputs.every": "5e5 s"}},
    "throughput": {"nodes": [500], "ratios": [3], "rounds": 2, "least": 0.002, "model_nodes": 100},
    "choices": {"spacing": 1e-2, "nodes": 800, "rounds": 1, "least": 0.002},
    "scaling": {"nodes": [400, 800], "rounds": 1, "thread_nodes": []},
    "memory": {"nodes": 1500},
    "foretold": {"scenes": ["smoke"]},
    "startup": {"cases": 1, "rounds": 1, "workflow": False},
    "peers": {"nodes": 500, "steps": 2, "rounds": 1},
}  # fmt: skip


# What more threads are worth is measured, not tested.
pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name == "startup" else ()) for name in BENCHMARKS]
)
def test_benchmark_runs_and_its_counts_hold(name, tmp_path):
    assert cli.main(["benchmark", name, "--settings", json.dumps(TINY[name]), "--out", str(tmp_path)]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["rows"]
    for row in report["rows"]:
        assert math.isfinite(row["measured"]), row["what"]
        assert row["unit"] not in ("s", "bonds/s") or row["kind"] == "shown", "a time must not fail a run"
    if name != "same_answer":  # a coarse plate with ten steps is no test of the method
        assert report["passed"], [row["what"] for row in report["rows"] if not row["passed"]]
    assert (tmp_path / "figure.png").stat().st_size > 0
    assert json.loads((tmp_path / "machine.json").read_text())["settings"] == TINY[name]


def test_settings_are_checked(tmp_path):
    with pytest.raises(PdheError, match="no benchmark 'speed'"):
        run_benchmark("speed")
    with pytest.raises(PdheError, match="no setting 'size'"):
        run_benchmark("memory", {"size": 3})
    with pytest.raises(SceneError, match="no such benchmark"):
        configured({"benchmarks": {"speed": {}}})
    assert list(configured({"benchmarks": {"memory": None, "scaling": {"rounds": 1}}})) == ["scaling", "memory"]


def test_thesis_loop_gives_the_same_numbers():
    if compiled.compiler("thesis_loop.cpp") is None:
        pytest.skip("no C++ compiler")
    rows = {row.what: row for row in run_benchmark("thesis_loop", TINY["thesis_loop"]).rows}
    assert rows["largest difference of coverage, C++ and here"].measured < 1e-14
    assert rows["largest difference of force over largest force, C++ and here"].measured < 1e-12


def test_without_a_compiler_the_report_says_so(monkeypatch):
    monkeypatch.setattr(compiled.shutil, "which", lambda name: None)
    for name in ("thesis_loop", "throughput"):
        report = run_benchmark(name, TINY[name])
        assert any("no compiler" in row.what for row in report.rows)
        assert report.passed


def test_machine_is_described_without_its_name():
    import platform

    described = machine.describe()
    assert described["processor"] and described["cores"] >= 1
    assert platform.node() not in json.dumps(described) or len(platform.node()) < 4
    assert machine.peak_memory() > 1e7


def test_lattice_nodes_are_those_of_a_mesh(tmp_path):
    from pdhe.discretization import discretize
    from pdhe.mesh import make_mesh

    made = problems.mode_i(800)
    make_mesh(made.scene.geometry, made.scene.mesh, tmp_path / "plate.msh")
    meshed = discretize(tmp_path / "plate.msh", made.scene.geometry, made.scene.mesh)
    ours = made.discretization
    np.testing.assert_allclose(ours.coordinates, meshed.coordinates, atol=1e-12)
    np.testing.assert_allclose(ours.volume, meshed.volume, rtol=1e-9)
    np.testing.assert_allclose(ours.vertices[ours.cells].mean(axis=1), ours.coordinates, atol=1e-12)
    assert ours.regular and meshed.regular
    assert set(ours.node_sets) == set(meshed.node_sets)
    for name, nodes in meshed.node_sets.items():
        np.testing.assert_array_equal(np.sort(ours.node_sets[name]), nodes, err_msg=name)


def test_both_layouts_of_a_bare_sweep_agree():
    for what in ("diffusion", "force"):
        results = []
        for layout in ("lattice", "gather"):
            sweep = problems.bare_sweep(what, layout, 600, 3)
            sweep.run()
            arguments = sweep.calls[-1][1]
            if what == "diffusion":
                results.append(arguments[-2])
            else:
                results.append(np.column_stack(arguments[-2:]) if layout == "lattice" else arguments[-1])
        np.testing.assert_allclose(results[0], results[1], rtol=1e-12, atol=1e-15)


def test_rounds_take_turns():
    order = []
    samples = timing.in_turns({name: lambda name=name: order.append(name) for name in "ab"}, 3, least=0.0)
    assert {name: len(times) for name, times in samples.items()} == {"a": 3, "b": 3}
    assert order == list("aabb" + "ab" + "ba" + "ab")  # once to compile, once to see how long it takes
    assert timing.ratio({"a": [2.0, 9.0, 4.0], "b": [1.0, 3.0, 2.0]}, "a", "b") == 2.0


def test_runs_are_gathered_and_compared(tmp_path, capsys):
    folder = tmp_path / "memory"
    assert cli.main(["benchmark", "memory", "--settings", '{"nodes": 800}', "--out", str(folder)]) == 0
    old = tmp_path / "old.json"
    html, tables = tmp_path / "index.html", tmp_path / "tables.md"
    arguments = ["benchmark-page", str(folder), "--out", str(html), "--json", str(old), "--markdown", str(tables)]
    assert cli.main(arguments) == 0
    content = json.loads(old.read_text())
    assert "<table>" in html.read_text() and "| all arrays of bonds |" in tables.read_text()
    changed = copy.deepcopy(content)
    rows = changed["benchmarks"]["memory"]["rows"]
    rows[0]["measured"] *= 2.0
    rows.append({**rows[1], "what": "something else"})
    new = tmp_path / "new.json"
    new.write_text(json.dumps(changed))
    capsys.readouterr()
    assert cli.main(["benchmark-compare", str(old), str(new)]) == 0
    text = capsys.readouterr().out
    assert f"{rows[0]['what']}: 4 -> 8 B, x 2" in text
    assert "something else" in text and "new" in text
    assert cli.main(["benchmark-page", str(tmp_path / "nothing"), "--out", str(html), "--json", str(old)]) == 1


def test_times_and_rates_are_marked_in_opposite_senses():
    row = {"what": "x", "unit": "s", "measured": 1.0, "judged": None}
    assert page._change(row, {**row, "measured": 2.0}).endswith("worse")
    row["unit"] = "bonds/s"
    assert page._change(row, {**row, "measured": 2.0}).endswith("better")
    assert page._change(row, {**row, "measured": 1.05}).endswith("x 1.05")
