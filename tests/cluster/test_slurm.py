"""A study on a real Slurm: jobs that are killed, cancelled or out of time go on, and the results are the local ones."""

import contextlib
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from pdhe.netcdf import read_netcdf
from pdhe.study import load_study

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(Path(__file__).parent))
import one_node  # noqa: E402

# The name of the folder is what a shell must not see: it would make a file.
FOLDER, STUDY = "Rißprüfung $(touch made) `touch made`;", "config/studies/Größe 'a' $(touch made).yaml"
CASES = 8
APT_SECONDS, RUN_SECONDS = 60.0, 300.0

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Slurm is for Linux"),
    pytest.mark.skipif(
        importlib.util.find_spec("snakemake_executor_plugin_slurm") is None,
        reason="the plugin is not installed: python3 run.py setup slurm",
    ),
]


def project(folder: Path) -> Path:
    """A copy of the project with the study, asking for the least time that Slurm knows: a minute."""
    folder.mkdir(parents=True)
    for part in ("workflow", "config", "profiles", "pdhe"):
        shutil.copytree(ROOT / part, folder / part)
    shutil.copy2(ROOT / "Snakefile", folder)
    needs = folder / "pdhe/needs.py"
    text = needs.read_text()
    assert "1.3, 8e8, 300.0" in text
    needs.write_text(text.replace("1.3, 8e8, 300.0", "1.3, 8e8, 0.0"))
    # Stands in for the set-up, which is that of the tests.
    arguments = f"[{sys.executable!r}, '-m', 'snakemake', *sys.argv[1:]]"
    (folder / "run.py").write_text(f"import os, sys\nos.execv({sys.executable!r}, {arguments})\n")
    study = {
        "name": "eight",
        "scene": "config/scenes/smoke.yaml",
        "set": {"outputs.count": 4, "title": "Quote ' and \" and $(touch made) and; touch made"},
        "sweep": {"solver.tolerance": [1e-5, 3e-6, 1e-6, 3e-7]},
        "cases": {"wet": {}, "wetter": {"hydrogen.saturation.damage": 0.3}},
        "figures": {"pictures": [], "animations": False},
    }
    (folder / STUDY).write_text(json.dumps({"study": study}))
    return folder


def snakemake(folder: Path, *arguments: str, **variables: str) -> tuple[list[str], dict]:
    """Command and settings of a Snakemake that runs in a folder with the package that lies there."""
    command = [sys.executable, "-m", "snakemake", "--configfile", STUDY, *arguments, "--", "solutions"]
    return command, {"cwd": folder, "env": {**os.environ, "PYTHONPATH": str(folder), **variables}}


def solver_of(solve_id: str) -> int | None:
    """Number of the process that solves a case; the shells and Snakemakes around it name the case as well."""
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            words = entry.read_bytes().split(b"\0")
            if words[1:4] == [b"-m", b"pdhe", b"solve"] and any(solve_id.encode() in word for word in words):
                return int(entry.parent.name)
    return None


def job_of(process: int) -> str:
    """Number of the job of Slurm that a process belongs to."""
    variables = Path(f"/proc/{process}/environ").read_bytes().split(b"\0")
    return next(text.partition(b"=")[2].decode() for text in variables if text.startswith(b"SLURM_JOB_ID="))


def disturb(store: Path, running: subprocess.Popen, environment: dict[str, str]) -> dict[str, str]:
    """Stop three solves that have a checkpoint; kill one, cancel the job of another, let the third run out of time."""
    victims: dict[str, str] = {}
    left = ["out of time", "cancelled", "killed"]
    end = time.monotonic() + RUN_SECONDS
    while left and running.poll() is None and time.monotonic() < end:
        for checkpoint in store.glob("*.nc.checkpoint"):
            name = checkpoint.name.removesuffix(".nc.checkpoint")
            process = solver_of(name)
            if not left or name in victims or process is None:
                continue
            with contextlib.suppress(OSError, StopIteration):
                job = job_of(process)
                os.kill(process, signal.SIGSTOP)  # however fast the machine, it gets no further
                if not checkpoint.exists():
                    os.kill(process, signal.SIGCONT)
                    continue
                victims[name] = left.pop(0)
                if victims[name] == "killed":
                    os.kill(process, signal.SIGKILL)
                elif victims[name] == "cancelled":
                    subprocess.run(["scancel", job], env=environment, check=True)
        time.sleep(0.01)
    return victims


@pytest.fixture(scope="module")
def cluster():
    """The daemons, in a folder of their own with a short name."""
    with tempfile.TemporaryDirectory(prefix="pdhe-slurm-") as folder:
        try:
            if one_node.missing():
                one_node.install(APT_SECONDS)
            with one_node.one_node(Path(folder, "node"), cores=4) as environment:
                yield environment
        except one_node.Missing as error:
            pytest.skip(str(error))


@pytest.fixture(scope="module")
def computed(cluster, tmp_path_factory):
    """The study on the cluster and locally, and as one job: folders, what was done to which solve, jobs that ended."""
    base = tmp_path_factory.mktemp("slurm")
    there, local, one_job = (project(base / name / FOLDER) for name in ("there", "local", "one"))
    command, settings = snakemake(there, "--profile", "profiles/slurm", PDHE_CHECKPOINT="0")
    settings["env"] |= {name: cluster[name] for name in ("PATH", "SLURM_CONF")}
    log = base / "there.log"
    with log.open("wb") as stream, subprocess.Popen(command, stdout=stream, stderr=stream, **settings) as running:
        try:
            victims = disturb(there / "results/store/solve", running, cluster)
            # While one waits for its time limit.
            words = ["sbatch", "--parsable", "--wait", "--cpus-per-task=2", "--mem-per-cpu=1000", "--time=10"]
            script = [*words, "profiles/slurm/one-job.sh", "--configfile", STUDY, "--", "solutions"]
            variables = {**cluster, "PYTHONPATH": str(one_job)}
            whole = subprocess.run(script, cwd=one_job, env=variables, capture_output=True, text=True, check=False)
            command, settings = snakemake(local, "--cores", "2", PDHE_CHECKPOINT="off")
            done = subprocess.run(command, capture_output=True, text=True, check=False, **settings)
            running.wait(RUN_SECONDS)
        finally:
            if running.poll() is None:
                running.terminate()
    output = log.read_text()
    assert running.returncode == 0, output[-8000:]
    assert done.returncode == 0, done.stdout + done.stderr
    assert whole.returncode == 0, whole.stderr + "".join(p.read_text() for p in one_job.glob("pdhe-*.log"))
    finished = Path(cluster["SLURM_CONF"]).with_name("finished.txt").read_text().splitlines()
    jobs = [dict(re.findall(r"(\w+)=(\S*)", line)) for line in finished]
    return {"there": there, "local": local, "one job": one_job, "victims": victims, "jobs": jobs, "log": output}


def test_every_case_was_a_job_and_three_went_wrong(computed):
    assert sorted(computed["victims"].values()) == ["cancelled", "killed", "out of time"]
    states = [job["JobState"] for job in computed["jobs"]]
    assert states.count("TIMEOUT") >= 1
    assert states.count("CANCELLED") >= 1
    assert states.count("FAILED") >= 1
    assert states.count("COMPLETED") >= CASES + 2  # and a mesh and its nodes


def test_jobs_ask_for_what_is_foretold_and_for_more_time_again(computed, monkeypatch):
    monkeypatch.chdir(computed["there"])
    limits = {job["TimeLimit"] for job in computed["jobs"]}
    assert {"1", "2"} <= limits  # minutes, first and second attempt
    assert "Trying to restart job" in computed["log"]


def test_disturbed_solves_went_on_from_their_checkpoints(computed):
    for name, what in computed["victims"].items():
        text = (computed["there"] / f"logs/solve/{name}.log").read_text()
        assert "going on from t = " in text, what
    assert not list((computed["there"] / "results").rglob("*.checkpoint"))


@pytest.mark.parametrize("other", ["local", "one job"])
def test_results_are_the_same_to_the_bit(other, computed, monkeypatch):
    monkeypatch.chdir(computed["there"])
    names = {case.solve_id for case in load_study(STUDY).cases}
    assert len(names) == CASES
    for name in names:
        arrays, attributes = read_netcdf(computed["there"] / f"results/store/solve/{name}.nc")
        expected, described = read_netcdf(computed[other] / f"results/store/solve/{name}.nc")
        assert attributes == described
        assert arrays.keys() == expected.keys()
        for key, array in arrays.items():
            # Text is kept as objects, numbers are compared by their bytes.
            bits = [a.tolist() if a.dtype == object else a.tobytes() for a in (array, expected[key])]
            assert bits[0] == bits[1], f"{name}: {key}"


def test_a_local_call_finds_nothing_left_to_do(computed):
    command, settings = snakemake(computed["there"], "--cores", "2", "--dry-run")
    done = subprocess.run(command, capture_output=True, text=True, check=False, **settings)
    assert done.returncode == 0 and "Nothing to be done" in done.stdout + done.stderr


def test_a_place_that_snakemake_would_quote_wrongly_is_refused(cluster, tmp_path):
    folder = project(tmp_path / "it's $(touch made)")
    command, settings = snakemake(folder, "--profile", "profiles/slurm")
    settings["env"] |= {name: cluster[name] for name in ("PATH", "SLURM_CONF")}
    done = subprocess.run(command, capture_output=True, text=True, check=False, **settings)
    assert done.returncode != 0
    assert "leave out what needs quoting" in done.stderr
    assert not list(tmp_path.rglob("made"))


def test_no_name_was_a_command(computed):
    assert not [path for name in ("there", "local", "one job") for path in computed[name].parent.rglob("made")]
