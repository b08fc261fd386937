"""Studies of hydrogen-assisted fracture: mesh, nodes, solve, figures, report.

    snakemake --cores 2                                             everything that config/config.yaml lists
    snakemake --cores 2 --configfile config/studies/smoke.yaml      one study
    snakemake --cores 2 solutions                                   solutions and the tables of cases, nothing drawn
    snakemake --cores 2 figures                                     pictures and animations only
    snakemake --profile profiles/slurm                              the same on a cluster (docs/clusters.md)
    snakemake --cores 2 verification                                every check of the verification, and its page
    snakemake --cores 2 extremes                                    extreme scenes, each right or refused, and their map
    snakemake --cores 2 benchmarks                                  how fast everything is, and its page
    snakemake --cores 2 tradeoff                                    speed against accuracy, and its page
    snakemake --cores 2 dynamics                                    running cracks, with inertia
    snakemake -n                                                    what would run, and why

Meshes and solutions are kept under results/store by a digest of the parameters they depend on, so that studies share
them and a study that changes computes what is new and nothing else.
"""

from os.path import exists

from snakemake.utils import min_version

min_version("9.20")


# With `--directory FOLDER`, results and logs lie there; files that are not there are those of this checkout.
configfile: "config/config.yaml" if exists("config/config.yaml") else f"{workflow.basedir}/config/config.yaml"


report: "workflow/report/workflow.rst"


include: "workflow/rules/common.smk"
include: "workflow/rules/mesh.smk"
include: "workflow/rules/nodes.smk"
include: "workflow/rules/solve.smk"
include: "workflow/rules/figures.smk"
include: "workflow/rules/report.smk"
include: "workflow/rules/verification.smk"
include: "workflow/rules/benchmarks.smk"
include: "workflow/rules/tradeoff.smk"
include: "workflow/rules/extremes.smk"
include: "workflow/rules/umat.smk"


localrules:
    all,
    benchmarks,
    dynamics,
    extremes,
    figures,
    results,
    solutions,
    tradeoff,
    verification,


rule verification:
    input:
        f"{VERIFIED}/index.html",
        f"{VERIFIED}/passed.txt",


rule extremes:
    input:
        "results/extremes/index.html",
        "results/extremes/passed.txt",


rule benchmarks:
    input:
        "results/benchmarks/index.html",
        "results/benchmarks/benchmarks.json",


rule tradeoff:
    input:
        "results/tradeoff/index.html",


rule dynamics:
    input:
        histories_for(ASIDE.values()),
        pictures_for(ASIDE.values()),
        indexes_for(ASIDE.values()),


rule results:
    input:
        SOLUTIONS,
        HISTORIES,
        PICTURES,
        INDEXES,


rule all:
    default_target: True
    input:
        DEFAULT or rules.results.input + [REPORT],


rule solutions:
    input:
        SOLUTIONS,
        INDEXES,


rule figures:
    input:
        PICTURES,
