"""Copies of the project that the tests may edit and run."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("Snakefile", "workflow", "config", "profiles", "pdhe")

# Stands in for pdhe/cli.py, which belongs to no fingerprint: all that Snakemake decides on is the real thing.
STUB = """
import pathlib

def main(words):
    for option, value in zip(words, words[1:]):
        if option.startswith("--out"):
            pathlib.Path(value).write_text(" ".join(words))
    return 0
"""

# Imports Snakemake once and runs it in a fork for every line it reads; the import takes most of a dry run.
SERVER = """
import json, os, sys
import snakemake.cli
import snakemake.api, snakemake.workflow, snakemake.dag, snakemake.scheduling.job_scheduler, pandas, pulp

for line in sys.stdin:
    folder, log, arguments = json.loads(line)
    child = os.fork()
    if child == 0:
        file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, 1)
        os.dup2(file, 2)
        os.chdir(folder)
        sys.path.insert(0, folder)
        try:
            snakemake.cli.main(arguments)
        except SystemExit as stop:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(stop.code if isinstance(stop.code, int) else 1)
        os._exit(1)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


class Project:
    """One copy of the project in a folder."""

    def __init__(self, folder: Path, server: subprocess.Popen) -> None:
        self.folder, self.server = folder, server

    def snakemake(self, *arguments: str) -> subprocess.CompletedProcess:
        """Run Snakemake in the folder with the package that lies there."""
        command = [sys.executable, "-m", "snakemake", "--cores", "2", *arguments]
        return subprocess.run(
            command,
            cwd=self.folder,
            env={**os.environ, "PYTHONPATH": str(self.folder)},
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )

    def plan(self, *arguments: str) -> dict[str, int]:
        """Return how many jobs of each rule a run would start now."""
        log = self.folder.parent / "plan.log"
        request = [str(self.folder), str(log), ["--dry-run", "--cores", "2", *arguments]]
        self.server.stdin.write(json.dumps(request) + "\n")
        self.server.stdin.flush()
        status = self.server.stdout.readline().strip()
        text = log.read_text()
        assert status == "0", text
        assert "Job stats:" in text or "Nothing to be done" in text, text
        table = text.partition("Job stats:")[2].partition("\ntotal")[0]
        jobs = re.findall(r"^(\w+) +(\d+)$", table, re.MULTILINE)
        return {rule: int(count) for rule, count in jobs if rule != "all"}

    def edit(self, file: str, old: str, new: str) -> None:
        """Replace a text that occurs in a file."""
        path = self.folder / file
        text = path.read_text()
        assert old in text, f"{file} does not hold {old!r}"
        path.write_text(text.replace(old, new, 1))

    def copy(self, folder: Path) -> "Project":
        """Return a copy with all modification times kept."""
        shutil.copytree(self.folder, folder, symlinks=True)
        return Project(folder, self.server)


@pytest.fixture(scope="session")
def server() -> Iterator[subprocess.Popen]:
    """The process that dry runs are forked from."""
    command = [sys.executable, "-c", SERVER]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield process
        process.stdin.close()


@pytest.fixture(scope="session")
def pristine(tmp_path_factory, server) -> Project:
    """The project as it is, nothing computed yet, with real steps."""
    folder = tmp_path_factory.mktemp("pristine") / "project"
    folder.mkdir()
    for part in PARTS:
        source = ROOT / part
        if source.is_dir():
            shutil.copytree(source, folder / part, ignore=shutil.ignore_patterns("*.tmp*"))  # compiled code comes along
        else:
            shutil.copy2(source, folder / part)
    return Project(folder, server)


@pytest.fixture(scope="session")
def finished(pristine, tmp_path_factory) -> Project:
    """The smoke study with stand-in steps, everything computed."""
    project = pristine.copy(tmp_path_factory.mktemp("finished") / "project")
    (project.folder / "pdhe" / "cli.py").write_text(STUB)
    config = project.folder / "config" / "config.yaml"
    config.write_text("studies: [config/studies/smoke.yaml]\nfigures: {dpi: 100}\n")
    done = project.snakemake()
    assert done.returncode == 0, done.stdout + done.stderr
    return project
