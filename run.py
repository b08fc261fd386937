#!/usr/bin/env python3
"""Set up and run: the standard library and Python 3.11 or newer are all it needs.

    python3 run.py                     set up if needed, run the configured studies, write results/report.html
    python3 run.py ARGUMENTS           the same, with further arguments for Snakemake (a target, -n, --configfile ...)
    python3 run.py test [ARGUMENTS]    set up if needed, run the tests; the arguments go to pytest
    python3 run.py setup               set up only
    python3 run.py setup slurm         set up with the plugin that hands jobs to Slurm (docs/clusters.md)

The environment is the folder .venv beside this file, with the versions that requirements.lock fixes (of the plugin:
requirements-slurm.lock).
"""

import ctypes
import difflib
import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")
PYTHON = BIN / ("python.exe" if os.name == "nt" else "python")
LOCK, SLURM_LOCK = ROOT / "requirements.lock", ROOT / "requirements-slurm.lock"
STAMP, SLURM_STAMP = VENV / "pdhe-setup.txt", VENV / "pdhe-setup-slurm.txt"
CORES = "2"
OLDEST = (3, 11)

# Shared libraries that the gmsh package loads, and the Debian and Ubuntu packages that hold them and what they need.
GMSH_LIBRARIES = (
    "libGLU.so.1",
    "libGL.so.1",
    "libXrender.so.1",
    "libXcursor.so.1",
    "libXfixes.so.3",
    "libXext.so.6",
    "libXft.so.2",
    "libfontconfig.so.1",
    "libXinerama.so.1",
    "libX11.so.6",
    "libgomp.so.1",
)
GMSH_PACKAGES = ("libglu1-mesa", "libgl1", "libxft2", "libxcursor1", "libxinerama1", "libgomp1")


def main(arguments):
    """Set up, then do what the arguments ask for; return the exit status."""
    if arguments[:1] in (["-h"], ["--help"]):
        print(__doc__.strip())
        return 0
    if sys.version_info < OLDEST:
        have = ".".join(map(str, sys.version_info[:3]))
        need = ".".join(map(str, OLDEST))
        raise SystemExit(f"error: Python {need} or newer is needed; {sys.executable} is {have}")
    refuse_unknown(arguments)
    setup()
    if arguments == ["setup", "slurm"]:
        setup_slurm()
    if arguments[:1] == ["setup"]:
        return 0
    if arguments[:1] == ["test"]:
        return call([PYTHON, "-m", "pytest", *arguments[1:]])
    status = call([PYTHON, "-m", "snakemake", "--cores", CORES, *arguments])
    if status and any((ROOT / ".snakemake" / "locks").glob("*")):
        say("the folder is locked by another run, or by one that was killed: then `python3 run.py --unlock`, and again")
    return status


def refuse_unknown(arguments):
    """Stop before anything is done if the first word is no command, no option, no file and no target of Snakemake."""
    first = arguments[0] if arguments else "-"
    if first == "setup":
        if arguments[1:] not in ([], ["slurm"]):
            wrong = " ".join(arguments[1:])
            raise SystemExit(f"error: setup knows no '{wrong}'; there are `python3 run.py setup` and `... setup slurm`")
    elif first != "test" and not first.startswith("-") and not re.search(r"[./\\]", first):
        rules, targets = [], targets_in(ROOT / "Snakefile")
        for path in (ROOT / "workflow" / "rules").glob("*.smk"):
            rules += targets_in(path)
        if first not in rules + targets:
            near = difflib.get_close_matches(first, ["setup", "test", *targets, *rules], 1)
            hint = f"did you mean `{near[0]}`? " if near else ""
            raise SystemExit(
                f"error: no command or target '{first}'; {hint}commands: setup, setup slurm, test; "
                f"targets: {', '.join(sorted(targets))}, or a file below results/; all of it: python3 run.py --help"
            )


def targets_in(path):
    """Names of the rules in a file of the workflow."""
    return re.findall(r"^(?:rule|checkpoint) +(\w+) *:", path.read_text(encoding="utf-8"), re.MULTILINE)


def setup():
    """Make the environment, unless the one there was made from the same lock file by the same Python."""
    wanted = hashlib.sha256(LOCK.read_bytes() + (ROOT / "pyproject.toml").read_bytes())
    wanted.update(f"{ROOT}\n{sys.version}".encode())
    wanted = wanted.hexdigest()
    if STAMP.is_file() and STAMP.read_text() == wanted and PYTHON.exists():
        return
    system_libraries()
    STAMP.unlink(missing_ok=True)
    say("setting up .venv from requirements.lock")
    project = ["--no-deps", "--no-build-isolation", "--editable", ROOT]
    if works(["uv", "--version"]):
        if not PYTHON.exists():
            shutil.rmtree(VENV, ignore_errors=True)
            check(["uv", "venv", "--quiet", "--python", sys.executable, VENV])
    elif not works([PYTHON, "-m", "pip", "--version"]):
        make_venv()
    check([*installer(), "--require-hashes", "--requirement", LOCK])
    check([*installer(), *project])
    call([PYTHON, "-m", "compileall", "-qq", ROOT / "pdhe"])  # only saves time, so it need not succeed
    STAMP.write_text(wanted)


def setup_slurm():
    """Add the plugin for Slurm to the environment; what it depends on is in requirements.lock already."""
    wanted = hashlib.sha256(SLURM_LOCK.read_bytes() + STAMP.read_bytes()).hexdigest()
    if SLURM_STAMP.is_file() and SLURM_STAMP.read_text() == wanted:
        return
    say("adding the plugin for Slurm from requirements-slurm.lock")
    check([*installer(), "--no-deps", "--require-hashes", "--requirement", SLURM_LOCK])
    SLURM_STAMP.write_text(wanted)


def installer():
    """Command that installs packages into the environment: uv where there is one, otherwise pip."""
    if works(["uv", "--version"]):
        return ["uv", "pip", "install", "--quiet", "--compile-bytecode", "--python", PYTHON]
    return [PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]


def make_venv():
    """Make .venv with the standard library, after the system package that Debian keeps for it where it is missing."""
    if not works([sys.executable, "-c", "import ensurepip, venv"]):
        package = "python{}.{}-venv".format(*sys.version_info)
        system_packages([package], f"this Python cannot make environments ({package} is missing, and there is no uv)")
    shutil.rmtree(VENV, ignore_errors=True)
    check([sys.executable, "-m", "venv", VENV])


def system_libraries():
    """See to it that the shared libraries are there that gmsh loads."""
    if not sys.platform.startswith("linux"):
        return
    missing = []
    for name in GMSH_LIBRARIES:
        try:
            ctypes.CDLL(name)
        except OSError:
            missing.append(name)
    if missing:
        system_packages(GMSH_PACKAGES, "gmsh needs system libraries that are missing: " + " ".join(missing))


def system_packages(packages, reason):
    """Install system packages with apt where that needs no password, otherwise say what to run and stop."""
    say(reason)
    become_root = [] if getattr(os, "geteuid", lambda: 1)() == 0 else ["sudo", "-n"]
    install = ["apt-get", "install", "-y", "--no-install-recommends", *packages]
    if not shutil.which("apt-get"):
        raise SystemExit(
            "error: install them with the package manager of this system; on Debian and Ubuntu they are in "
            + " ".join(packages)
        )
    if become_root and not works([*become_root, "true"]):
        raise SystemExit("error: run this line, then the same command again:\n  sudo " + " ".join(install))
    say("installing " + " ".join(packages))
    environment = {"DEBIAN_FRONTEND": "noninteractive"}
    call([*become_root, "apt-get", "update", "-qq"], environment)
    check([*become_root, *install, "-qq"], environment)


def call(command, environment=None):
    """Run a command in the folder of this file and return its exit status."""
    command = [str(word) for word in command]
    path = os.pathsep.join([str(BIN), os.environ.get("PATH", "")])
    variables = {**os.environ, "PATH": path, "VIRTUAL_ENV": str(VENV), **(environment or {})}
    with subprocess.Popen(command, cwd=ROOT, env=variables) as process:
        while True:
            try:
                return process.wait()
            except KeyboardInterrupt:
                continue  # the command was interrupted too and is cleaning up


def check(command, environment=None):
    """Run a command and stop if it fails."""
    status = call(command, environment)
    if status:
        raise SystemExit("error: this failed with status {}:\n  {}".format(status, " ".join(map(str, command))))


def works(command):
    """Tell whether a command can be run and succeeds; it shows nothing."""
    try:
        done = subprocess.run([str(word) for word in command], capture_output=True, cwd=ROOT, check=False)
    except OSError:
        return False
    return done.returncode == 0


def say(text):
    """Tell what is being done."""
    print(f"run.py: {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
