"""The list of benchmarks, in the order of their page, and what a configuration asks of them; light to import."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pdhe.errors import PdheError, SceneError
from pdhe.wholefile import write_text

if TYPE_CHECKING:
    from pdhe.verification.report import Report

#: Benchmark -> module that holds ``run(**settings) -> Report``. A new benchmark is one line here.
BENCHMARKS: dict[str, str] = {
    "thesis_loop": "pdhe.benchmarks.thesis_loop",
    "same_answer": "pdhe.benchmarks.same_answer",
    "throughput": "pdhe.benchmarks.throughput",
    "choices": "pdhe.benchmarks.choices",
    "scaling": "pdhe.benchmarks.scaling",
    "memory": "pdhe.benchmarks.memory",
    "foretold": "pdhe.benchmarks.foretold",
    "startup": "pdhe.benchmarks.startup",
    "peers": "pdhe.benchmarks.peers",
}


def configured(config: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Benchmarks of a workflow configuration with their settings, in the order of the list.

    Raises
    ------
    SceneError
        If ``benchmarks`` is not a mapping of known names to settings.
    """
    block = config.get("benchmarks") or {}
    if not isinstance(block, Mapping):
        raise SceneError("configuration", "benchmarks", block, "needs benchmarks with their settings", "throughput: {}")
    for name, settings in block.items():
        if name not in BENCHMARKS:
            known = ", ".join(BENCHMARKS)
            raise SceneError("configuration", "benchmarks", name, "no such benchmark", f"known: {known}")
        if not isinstance(settings, Mapping | None):
            raise SceneError("configuration", f"benchmarks.{name}", settings, "needs settings by name")
    return {name: dict(block[name] or {}) for name in BENCHMARKS if name in block}


def run_benchmark(name: str, settings: dict[str, Any] | None = None) -> Report:
    """Run one benchmark; settings override its defaults.

    Raises
    ------
    PdheError
        If there is no such benchmark, or it does not know one of the settings.
    """
    if name not in BENCHMARKS:
        raise PdheError(f"no benchmark '{name}'; there are {', '.join(BENCHMARKS)}")
    known = signature(import_module(BENCHMARKS[name]).run).parameters
    for key in settings or {}:
        if key not in known:
            raise PdheError(f"benchmark '{name}' has no setting '{key}'; it has {', '.join(known)}")
    return import_module(BENCHMARKS[name]).run(**(settings or {}))


def write_benchmark(name: str, settings: dict[str, Any], folder: str | Path) -> Report:
    """Run one benchmark and write its report, with the machine and the settings, into a folder."""
    from pdhe.benchmarks.machine import describe

    machine = describe()
    report = run_benchmark(name, settings)
    report.write(folder)
    content = {"machine": machine, "settings": settings}
    write_text(Path(folder, "machine.json"), json.dumps(content, indent=1))
    return report
