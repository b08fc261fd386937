"""The cases of the configured studies, and what the rules look up in them."""

import functools
import gc
import json
import os
import re
import shlex
import sys
from pathlib import Path

from pdhe.benchmarks.registry import BENCHMARKS, configured
from pdhe.errors import PdheError
from pdhe.extremes.registry import EXTREMES
from pdhe.needs import Needs, fails_again, needs_of
from pdhe.provenance import canonical, digest, fingerprint
from pdhe.scene_umat import SOURCES as UMAT_SOURCES
from pdhe.study import PICTURES as PICTURE_KINDS
from pdhe.study import load_aside, load_studies
from pdhe.tradeoff.design import load_trades
from pdhe.verification.studies import load_checks
from pdhe.verification.topics import TOPICS
from pdhe.warm import MANY_CASES, folder_for
from snakemake.jobs import Job

# Of the many objects of a large plan nearly all stay: to look for garbage less often saves a tenth of the time.
gc.set_threshold(200_000, 20, 100)

try:
    STUDIES = {study.name: study for study in load_studies(config, workflow.configfiles)}
    ASIDE = {study.name: study for study in load_aside(config, workflow.configfiles)}
    CHECKS = {check.topic: check for check in load_checks(config, workflow.configfiles)}
    MEASUREMENTS = configured(config)
    TRADES = load_trades(config, workflow.configfiles)
except PdheError as error:
    sys.exit(f"error: {error}")

for name in set(STUDIES) & set(ASIDE):
    sys.exit(f"error: {ASIDE[name].file}: the study '{name}' has a target of its own and is listed as well")


def solutions_for(studies):
    return [f"results/store/solve/{case.solve_id}.nc" for study in studies for case in study.cases]


def histories_for(studies):
    return [
        f"results/{study.name}/{case.name}/history.{end}"
        for study in studies
        for case in study.cases
        for end in ("csv", "png")
    ]


def pictures_for(studies):
    return [
        f"results/{study.name}/{case.name}/{kind}.{end}"
        for study in studies
        for case in study.cases
        for kind in case.pictures
        for end in (("png", "gif") if study.animations else ("png",))
    ]


def indexes_for(studies):
    return [f"results/{study.name}/cases.csv" for study in studies]


SOLUTIONS = list(dict.fromkeys(solutions_for(STUDIES.values())))
HISTORIES = histories_for(STUDIES.values())
PICTURES = pictures_for(STUDIES.values())
INDEXES = indexes_for(STUDIES.values())

# What rules look up, whichever target asks for it.
ALL = STUDIES | ASIDE
CASES = {(study.name, case.name): case for study in ALL.values() for case in study.cases}
MESHES = {case.mesh_id: case for case in CASES.values()}
SOLVES = {case.solve_id: case for case in CASES.values()}
USER_MATERIALS = dict(case.user_material for case in CASES.values() if case.user_material)

# Jobs find the programs of this environment, whether or not it is activated. In a large study that runs on this
# machine, they share processes in which everything is imported already.
environment = f"export PATH={shlex.quote(str(Path(sys.executable).parent))}:$PATH; "
if len(SOLUTIONS) >= MANY_CASES and workflow.is_main_process:
    environment += f"export PDHE_WARM={shlex.quote(folder_for(os.getpid()))}; "
shell.prefix(environment)

# A topic that was given on the command line has a page and a verdict of its own; those of the whole set stay.
VERIFIED = f"results/verification/{next(iter(CHECKS))}" if "check" in config else "results/verification"

# What runs when no target is named: for a file given as configuration, what that file asks for.
if "check" in config:
    DEFAULT = [f"{VERIFIED}/index.html", f"{VERIFIED}/passed.txt"]
elif isinstance(config.get("tradeoff"), dict):
    DEFAULT = ["results/tradeoff/index.html"]
else:
    DEFAULT = None

REPORTS = [f"results/verification/{topic}/report.json" for topic in CHECKS]

# A study that was given on the command line has a report of its own.
REPORT = f"results/{next(iter(STUDIES))}/report.html" if "study" in config else "results/report.html"
CAPTIONS = sorted(os.path.relpath(path) for path in Path(workflow.basedir, "workflow/report").glob("*.rst"))

# Options with which another Snakemake sees the same workflow; the report is made by one.
SAME_CONFIGURATION = ["--snakefile", os.path.relpath(workflow.main_snakefile)]
if workflow.config_settings.configfiles:
    SAME_CONFIGURATION += ["--configfile", *map(str, workflow.config_settings.configfiles)]
if workflow.config_settings.config:
    settings = workflow.config_settings.config.items()
    SAME_CONFIGURATION += ["--config", *(f"{key}={json.dumps(value)}" for key, value in settings)]


onstart:
    # Snakemake quotes these for the shell of a cluster as Python would: right unless they hold an apostrophe or a backslash.
    if not workflow.local_exec:
        for text in (workflow.main_snakefile, sys.executable, *(workflow.config_settings.config_args or ())):
            if repr(str(text)) != f"'{text}'":
                sys.exit(
                    f"error: on a cluster a shell would read {text!r} as commands; leave out what needs quoting"
                )


# What a cluster ended (time, memory, a node) is tried again, as often as `retries` says; a job that said what is wrong with
# its scene is not. Snakemake asks a job for its retries when it has failed, and has no setting for this.
def restarts_of(job):
    return 0 if any(map(fails_again, job.log)) else job.rule.restart_times


if workflow.is_main_process and isinstance(getattr(Job, "restart_times", None), property):
    Job.restart_times = property(restarts_of)


wildcard_constraints:
    group="|".join(map(re.escape, EXTREMES)),
    measurement="|".join(map(re.escape, MEASUREMENTS)),
    trade="|".join(map(re.escape, TRADES)),
    topic="|".join(map(re.escape, CHECKS)),
    study="|".join(map(re.escape, ALL)),
    case="[^/]+",
    kind="|".join(PICTURE_KINDS),
    mesh_id="[^/]+",
    solve_id="[^/]+",


def mesh_spec(wildcards):
    return MESHES[wildcards.mesh_id].mesh_spec


def solve_spec(wildcards):
    return SOLVES[wildcards.solve_id].solve_spec


def nodes_of(wildcards):
    return f"results/store/nodes/{SOLVES[wildcards.solve_id].mesh_id}.nc"


def library_of(wildcards):
    """The compiled user material of a case: made from its source, or as the scene gives it."""
    material = SOLVES[wildcards.solve_id].user_material
    if material is None:
        return []
    return f"results/store/umat/{material[0]}.so" if material[1].endswith(UMAT_SOURCES) else material[1]


def result_of(wildcards):
    case = CASES.get((wildcards.study, wildcards.case))
    if case is None:
        raise ValueError(f"the study '{wildcards.study}' has no case '{wildcards.case}'")
    return f"results/store/solve/{case.solve_id}.nc"


def solutions_of(wildcards):
    solve_ids = dict.fromkeys(case.solve_id for case in ALL[wildcards.study].cases)
    return [f"results/store/solve/{solve_id}.nc" for solve_id in solve_ids]


def style_of(wildcards):
    return canonical(ALL[wildcards.study].style)


@functools.cache
def needs_to_solve(solve_id) -> Needs:
    return needs_of(SOLVES[solve_id].resolved)


@functools.cache
def needs_to_mesh(mesh_id) -> Needs:
    return needs_of(MESHES[mesh_id].resolved)


def solve_threads(wildcards):
    """An equal share of the cores for every solve, on a cluster as many as pay; results do not depend on it."""
    cores = workflow.global_resources["_cores"].value
    if workflow.remote_exec or cores is None:
        return needs_to_solve(wildcards.solve_id).threads
    return max(1, cores // max(1, len(SOLUTIONS)))


def solve_memory(wildcards, attempt):
    return needs_to_solve(wildcards.solve_id).mem_mb(attempt)


def solve_minutes(wildcards, attempt):
    return needs_to_solve(wildcards.solve_id).runtime(attempt)


def mesh_memory(wildcards):
    return needs_to_mesh(wildcards.mesh_id).mesh_mem_mb()


# The same for all drawings: a function for each of the many would take a tenth of the time of a large plan.
DRAWING_MEMORY = max((needs_to_solve(solve_id).drawing_mem_mb() for solve_id in SOLVES), default=1000)
