"""A Slurm of one node, from nothing: daemons, key, ports and records of its own, in a folder, gone afterwards.

    python3 tests/cluster/one_node.py COMMAND ...      run a command with such a cluster around it

It needs the programs of the Debian and Ubuntu packages `slurm-wlm` and `munge`, but neither root nor systemd nor
control groups, and leaves a Slurm that is set up on this machine alone.
"""

import contextlib
import getpass
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

PACKAGES = ("slurm-wlm", "munge")
PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "srun", "squeue", "scancel")

# Nothing that needs root: processes are followed by their parents, memory and cores are counted, not enforced.
CONFIGURATION = """\
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller}
SlurmdPort={daemon}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
ReturnToService=2
SlurmdParameters=config_overrides
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
KillWait=5
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
JobCompType=jobcomp/filetxt
JobCompLoc={folder}/finished.txt
NodeName={host} NodeAddr=127.0.0.1 CPUs={cores} RealMemory={memory} State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE DefaultTime=60 State=UP
"""


class Missing(Exception):
    """A program or a permission that the cluster needs is not there."""


def path_with_daemons() -> str:
    """The search path with the folders that hold daemons, which that of a user may leave out."""
    return os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin"])


def missing() -> list[str]:
    """Programs that are not installed."""
    return [name for name in PROGRAMS if shutil.which(name, path=path_with_daemons()) is None]


def install(seconds: float) -> None:
    """Install the packages, where that needs no password and takes no longer than this; raise Missing otherwise."""
    become_root = [] if os.geteuid() == 0 else ["sudo", "-n"]
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    end = time.monotonic() + seconds
    for words in (("update", "-qq"), ("install", "-y", "-qq", "--no-install-recommends", *PACKAGES)):
        command = [*become_root, "apt-get", *words]
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=end - time.monotonic(), check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise Missing(f"{' '.join(command)}: {error}") from None
        if done.returncode and words[0] == "install":
            raise Missing(f"{' '.join(command)}: {done.stderr.strip().splitlines()[-1:]}")


def start(command: list[str], log: Path, **settings) -> subprocess.Popen:
    """Start a daemon in the foreground, so that it can be ended by its process number."""
    with log.open("ab") as stream:
        return subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=stream, stderr=stream, start_new_session=True, **settings
        )


@contextlib.contextmanager
def one_node(folder: Path, cores: int | None = None) -> Iterator[dict[str, str]]:
    """Run the daemons in a folder; give the environment in which their commands find them.

    Parameters
    ----------
    folder
        For keys, logs and records; its path has to be short (sockets) and without spaces. ``finished.txt`` lists the
        jobs that ended, with how and when.
    cores
        That the node says it has, no matter how many there are; those of the machine if left out.

    Raises
    ------
    Missing
        If a program is not installed or the node does not come up.
    """
    if missing():
        raise Missing(f"not installed: {', '.join(missing())} (packages {' '.join(PACKAGES)})")
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(0o755)  # munge refuses a socket in a folder that others may not reach
    for name in ("state", "spool"):
        (folder / name).mkdir()
    key = folder / "munge.key"
    key.touch(0o600)
    key.write_bytes(secrets.token_bytes(128))
    with socket.socket() as first, socket.socket() as second:
        for each in (first, second):
            each.bind(("127.0.0.1", 0))
        controller, daemon = first.getsockname()[1], second.getsockname()[1]
    host = socket.gethostname().partition(".")[0]
    # What the machine has, less what runs beside the jobs.
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20 * 9 // 10
    (folder / "slurm.conf").write_text(
        CONFIGURATION.format(
            folder=folder, host=host, controller=controller, daemon=daemon, user=getpass.getuser(),
            cores=cores or len(os.sched_getaffinity(0)), memory=memory,
        )
    )  # fmt: skip
    environment = {**os.environ, "PATH": path_with_daemons(), "SLURM_CONF": str(folder / "slurm.conf")}
    # Snakemake's job steps drop all variables of Slurm, the place of the configuration with them.
    step = folder / "bin" / "srun"
    step.parent.mkdir()
    real = shutil.which("srun", path=environment["PATH"])
    step.write_text(f'#!/bin/sh\nSLURM_CONF={folder}/slurm.conf exec {real} "$@"\n')
    step.chmod(0o755)
    environment["PATH"] = f"{step.parent}{os.pathsep}{environment['PATH']}"
    munged = ["munged", "--foreground", "--force", f"--key-file={key}", f"--socket={folder}/munge.socket"]
    munged += [f"--{name}-file={folder}/munged.{name}" for name in ("pid", "seed")]
    daemons = []
    try:
        for command in (munged, ["slurmctld", "-D"], ["slurmd", "-D", "-N", host]):
            daemons.append(start(command, folder / f"{command[0]}.out", env=environment))
            wait_for(folder, daemons, lambda: (folder / "munge.socket").exists())
        wait_for(folder, daemons, lambda: "idle" in told(["sinfo", "--noheader", "--format=%T"], environment))
        yield environment
    finally:
        told(["scancel", f"--user={getpass.getuser()}"], environment)
        for process in reversed(daemons):
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def wait_for(folder: Path, daemons: list[subprocess.Popen], ready, seconds: float = 30.0) -> None:
    """Wait until something is so; raise Missing with what the daemons say if one ends or it takes too long."""
    end = time.monotonic() + seconds
    while not ready():
        if time.monotonic() > end or any(process.poll() is not None for process in daemons):
            logs = [path.read_text(errors="replace")[-1000:] for path in sorted(folder.glob("*.out"))]
            raise Missing("the cluster does not come up:\n" + "\n".join(filter(None, logs)))
        time.sleep(0.1)


def told(command: list[str], environment: dict[str, str]) -> str:
    """What a command prints; nothing if it fails."""
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=30, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # the daemons end as well
    with tempfile.TemporaryDirectory(prefix="slurm-") as place, one_node(Path(place, "node")) as around:
        sys.exit(subprocess.run(sys.argv[1:] or ["sinfo"], env=around, check=False).returncode)
