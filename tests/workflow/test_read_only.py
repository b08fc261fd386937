"""A checkout that nobody may write to: results, logs and what Snakemake keeps lie in a folder elsewhere."""

import json
import os
import shutil
import subprocess
import sys

import pytest

STUDY = {
    "name": "elsewhere",
    "scene": "config/scenes/smoke.yaml",
    "set": {"mesh.spacing": "20 mm", "hydrogen": None, "outputs.count": 2},
    "figures": {"pictures": ["damage"], "animations": False, "dpi": 40},
}


@pytest.fixture
def as_anybody():
    """Words before a command that keep root from writing where it must not."""
    if os.geteuid() != 0:
        return []
    if not shutil.which("setpriv"):
        pytest.skip("root may write anywhere, and there is no setpriv")
    return ["setpriv", "--bounding-set=-dac_override", "--inh-caps=-dac_override"]


def contents(folder):
    return {path.relative_to(folder): path.lstat().st_mtime_ns for path in folder.rglob("*")}


# Kernels are compiled anew, as what is compiled in the checkout may not be what this machine needs: a minute.
@pytest.mark.parametrize("until", ["nodes", pytest.param("results", marks=pytest.mark.slow)])
def test_a_read_only_checkout_computes_elsewhere(until, pristine, as_anybody, tmp_path):
    project, out = pristine.copy(tmp_path / "checkout").folder, tmp_path / "out here"
    out.mkdir()
    (out / "study.yaml").write_text(json.dumps({"study": STUDY}))
    places = [project, *project.rglob("*")]
    for place in places:
        place.chmod(place.stat().st_mode & ~0o222)
    before = contents(project)
    try:
        assert subprocess.run([*as_anybody, "touch", str(project / "x")], capture_output=True, check=False).returncode
        words = ["--snakefile", str(project / "Snakefile"), "--cores", "2", "--directory", str(out)]
        words += ["--configfile", "study.yaml", "--until", until, "--", "results"]
        done = subprocess.run(
            [*as_anybody, sys.executable, "-m", "snakemake", *words],
            cwd=out,
            env={**os.environ, "PYTHONPATH": str(project), "XDG_CACHE_HOME": str(tmp_path / "cache")},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert contents(project) == before
    finally:
        for place in places:
            place.chmod(place.stat().st_mode | 0o200)
    assert len(list((out / "results/store/nodes").glob("*.nc"))) == 1 and (out / "logs").is_dir()
    if until == "nodes":
        return
    (case,) = [path for path in (out / "results/elsewhere").iterdir() if path.is_dir()]
    assert {path.name for path in case.iterdir()} == {"damage.png", "history.csv", "history.png"}
    assert len(list((out / "results/store/solve").glob("*.nc"))) == 1
