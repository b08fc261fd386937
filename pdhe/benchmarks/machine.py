"""What a benchmark ran on: processor, caches, memory, compiler and versions; nothing that names the computer."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pdhe.provenance import versions

VERSIONS = ("pdhe", "numpy", "numba", "scipy", "pyamg", "snakemake")


def describe() -> dict[str, Any]:
    """Describe processor, memory, system and versions, with the date and how busy the machine is."""
    installed = versions()
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "processor": processor(),
        "cores": cores(),
        "caches": caches(),
        "memory_bytes": memory(),
        "system": f"{platform.system()} {platform.machine()}",
        "compiler": compiler_version(),
        "python": platform.python_version(),
        "versions": {name: installed[name] for name in VERSIONS if name in installed},
        "load_before": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
    }


def one_line(machine: dict[str, Any]) -> str:
    """The description in a line."""
    memory_text = f", {machine['memory_bytes'] / 2**30:.0f} GiB" if machine["memory_bytes"] else ""
    cache = ", ".join(f"{name} {size}" for name, size in machine["caches"].items())
    load = f"; load before {machine['load_before']}" if machine["load_before"] is not None else ""
    return (
        f"{machine['processor']}, {machine['cores']} cores{memory_text} ({cache or 'caches unknown'}), "
        f"{machine['system']}, Python {machine['python']}, {machine['compiler'] or 'no compiler'}, "
        f"{machine['date']}{load}"
    )


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def processor() -> str:
    """Model of the processor."""
    for line in _read("/proc/cpuinfo").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    if platform.system() == "Darwin":
        done = subprocess.run(["sysctl", "-n", "machdep.cpu.brand_string"], capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return done.stdout.strip()
    return platform.processor() or platform.machine()


def caches() -> dict[str, str]:
    """Size of each cache that the first core sees, by level."""
    found = {}
    for folder in sorted(Path("/sys/devices/system/cpu/cpu0/cache").glob("index*")):
        level, kind, size = (_read(folder / name).strip() for name in ("level", "type", "size"))
        if kind != "Instruction" and size:
            found[f"L{level}"] = size
    return found


def memory() -> int | None:
    """Memory of the machine, bytes; None where the system does not tell."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError, AttributeError):
        return None


def compiler_version() -> str | None:
    """First line of what the system's C compiler says about itself."""
    program = shutil.which("gcc") or shutil.which("clang") or shutil.which("cc")
    if program is None:
        return None
    done = subprocess.run([program, "--version"], capture_output=True, text=True, check=False)
    return done.stdout.partition("\n")[0] if done.returncode == 0 else None


def peak_memory() -> int:
    """Largest resident memory of this process so far, bytes.

    Linux carries the peak of the parent over into a child's ``ru_maxrss``; ``VmHWM`` is the process's own.
    """
    for line in _read("/proc/self/status").splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if platform.system() == "Darwin" else peak * 1024


def _read(path: str | Path) -> str:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
