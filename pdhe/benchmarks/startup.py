"""What it costs to begin: imports, the first job, a workflow with nothing to do, and many tiny cases."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from pdhe.benchmarks.timing import counted, sample_table, shown
from pdhe.errors import PdheError
from pdhe.provenance import PACKAGE, canonical
from pdhe.scene import load_scene
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.report import Report, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = PACKAGE.parent
PARTS = ("Snakefile", "workflow", "config", "profiles", "pdhe")
SCENE = "config/scenes/smoke.yaml"
#: Small enough to solve in milliseconds: 20 x 10 nodes.
TINY = {"mesh.spacing": "10 mm", "outputs.count": 2}
TITLE = "Start-up and overhead"
TEXT = """
Imports and jobs in fresh processes, in turns. "Cold" means without Python's and Numba's caches, "warm" with them;
files are in the memory of the operating system both times. The job is `pdhe run` on a plate of 200 nodes: imports,
mesh, bonds, solve, result file; the job of the workflow is `pdhe solve` on the nodes of that plate. The workflow runs
in a copy of the project with {cases} cases of that plate which share one mesh; its overhead is the part of the time on
{cores} cores in which no case is computed, measured against the same cases solved one after the other in one process.
A plan is `snakemake -n` with every history and three pictures a case.
"""


def run(cases: int = 100, planned: int = 1000, rounds: int = 5, cores: int = 2, workflow: bool = True) -> Report:
    """Measure start-up; ``workflow: false`` leaves Snakemake out, ``planned`` cases are planned and not run."""
    rows: list[Row] = []
    samples: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        project = folder / "project"
        for part in PARTS:
            source = ROOT / part
            if source.is_dir():
                shutil.copytree(source, project / part, ignore=shutil.ignore_patterns("__pycache__"))
            elif source.is_file():
                project.mkdir(exist_ok=True)
                shutil.copy2(source, project / part)
        scene = _tiny_scene(project)
        commands = {
            "import pdhe": ["-c", "import pdhe"],
            "import pdhe.scene": ["-c", "import pdhe.scene"],
            "import pdhe.simulation": ["-c", "import pdhe.simulation"],
            "pdhe --help": ["-m", "pdhe", "--help"],
            "a job": ["-m", "pdhe", "run", str(scene), "--out", str(folder / "job.nc")],
            "a job of the workflow": _solve_command(scene, folder),
        }
        for what in ("import pdhe.simulation", "a job"):
            samples[f"{what}, cold"] = [_run(commands[what], project, folder / f"cold {what}")]
        for command in commands.values():
            _run(command, project, folder / "warm")
        for _ in range(rounds):
            for what, command in commands.items():
                samples.setdefault(f"{what}, warm", []).append(_run(command, project, folder / "warm"))
        goals = {"a job, warm": 1.5, "a job of the workflow, warm": 1.5}
        rows += [shown(what, median(times), "s", goals.get(what, float("nan"))) for what, times in samples.items()]
        rows.append(counted("modules loaded by `import pdhe.study`", *_modules(project), "at most"))
        if workflow:
            rows += _workflow(project, folder, cases, min(rounds, 3), cores, samples)
            rows.append(_plan(project, folder, planned, samples))
    text = TEXT.format(cases=cases, cores=cores)
    return Report(
        "startup", TITLE, text, rows, partial(_draw, samples), {"samples": sample_table({"startup": samples})}
    )


def _environment(project: Path, caches: Path) -> dict[str, str]:
    return {
        **os.environ,
        "PYTHONPATH": str(project),
        "PYTHONPYCACHEPREFIX": str(caches / "python"),
        "NUMBA_CACHE_DIR": str(caches / "numba"),
        "PYTHONDONTWRITEBYTECODE": "",
    }


def _run(arguments: list[str], project: Path, caches: Path) -> float:
    """Seconds that Python takes with these arguments, process included."""
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, *arguments], cwd=project, env=_environment(project, caches), capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    if done.returncode:
        raise PdheError(f"{' '.join(arguments)} failed:\n{done.stderr[-2000:]}")
    return time.perf_counter() - start


def _tiny_scene(project: Path) -> Path:
    """The smoke scene on a mesh of 200 nodes, written beside it."""
    text = (project / SCENE).read_text(encoding="utf-8")
    text = re.sub(r"spacing: *5 mm", f"spacing: {TINY['mesh.spacing']}", text)
    path = project / "config/scenes/tiny.yaml"
    path.write_text(re.sub(r"count: *\d+", f"count: {TINY['outputs.count']}", text), encoding="utf-8")
    return path


def _solve_command(scene: Path, folder: Path) -> list[str]:
    """The command with which the workflow solves a scene, its nodes made beforehand."""
    from pdhe.discretization import discretize, write_discretization
    from pdhe.mesh import make_mesh

    loaded = load_scene(scene)
    make_mesh(loaded.geometry, loaded.mesh, folder / "job.msh")
    write_discretization(discretize(folder / "job.msh", loaded.geometry, loaded.mesh), folder / "nodes.nc")
    spec = {key: value for key, value in loaded.resolved().items() if key != "title"}
    files = ["--nodes", str(folder / "nodes.nc"), "--out", str(folder / "solution.nc")]
    return ["-m", "pdhe", "solve", "--spec", canonical(spec), *files]


def _modules(project: Path) -> tuple[int, int]:
    """How many heavy packages the import of what the Snakefile uses loads, and how many it may."""
    code = "import sys, pdhe.study; print(sum(m in sys.modules for m in ('numba', 'gmsh', 'xarray', 'matplotlib')))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=project, env={**os.environ, "PYTHONPATH": str(project)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return int(done.stdout), 0


def _workflow(
    project: Path, folder: Path, cases: int, rounds: int, cores: int, samples: dict[str, list[float]]
) -> list[Row]:
    """Nothing to do, for the first and for further times, and all cases from scratch."""
    _write_study(project, "tiny", cases)
    snakemake = [
        "-m", "snakemake", "--cores", str(cores), "--quiet", "all", "--configfile",
        "config/studies/tiny.yaml", "--", "results/tiny/cases.csv",
    ]  # fmt: skip
    whole = _run(snakemake, project, folder / "warm")
    idle = [_run(snakemake, project, folder / "warm") for _ in range(rounds + 1)]
    samples |= {f"{cases} tiny cases": [whole], "no-op, first": idle[:1], "no-op": idle[1:]}
    code = (
        "import time, pdhe.simulation as s; from pdhe.study import load_study; from pdhe.scene import Scene; "
        "from pdhe.benchmarks.problems import lattice_nodes; from pdhe.case import build_case; "
        "scenes = [Scene.from_resolved(c.resolved) for c in load_study('config/studies/tiny.yaml').cases]; "
        "run = lambda x: s.simulate(build_case(x, lattice_nodes(x))); run(scenes[0]); t = time.perf_counter(); "
        "[run(x) for x in scenes]; print(time.perf_counter() - t)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=project, env=_environment(project, folder / "warm"), capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise PdheError(f"tiny cases failed:\n{done.stderr[-2000:]}")
    work = float(done.stdout)
    return [
        shown("workflow with nothing to do, first call", idle[0], "s", 5.0),
        shown("workflow with nothing to do, further calls", median(idle[1:]), "s", 5.0),
        shown(f"{cases} tiny cases, time a case", whole / cases, "s"),
        shown(f"{cases} tiny cases, computing alone, time a case", work / cases, "s"),
        shown(f"{cases} tiny cases, share of overhead", 1.0 - work / (whole * cores)),
    ]


def _write_study(project: Path, name: str, cases: int) -> None:
    """Write a study of tiny cases that differ in nothing that takes time."""
    tolerances = [round(1e-6 * (1.0 + 0.001 * k), 12) for k in range(cases)]
    study = {"name": name, "scene": "config/scenes/tiny.yaml", "sweep": {"solver.tolerance": tolerances}}
    content = {"study": study | {"figures": {"animations": False}}}
    (project / f"config/studies/{name}.yaml").write_text(json.dumps(content), encoding="utf-8")


def _plan(project: Path, folder: Path, cases: int, samples: dict[str, list[float]]) -> Row:
    """Plan a large study without running it."""
    _write_study(project, "planned", cases)
    command = ["-m", "snakemake", "-n", "--cores", "2", "--quiet", "all", "--configfile", "config/studies/planned.yaml"]
    samples[f"plan of {cases} cases"] = [_run(command, project, folder / "warm")]
    return shown(f"plan of {cases} cases", samples[f"plan of {cases} cases"][0], "s", 10.0)


def _draw(samples: dict[str, list[float]], figure: Figure) -> None:
    (ax,) = panels(figure, 1)
    names = list(samples)[::-1]
    ax.barh(names, [median(samples[name]) for name in names], color=COLOURS[0])
    ax.set_xscale("log")
    label(ax, "seconds", "")
