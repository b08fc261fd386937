"""The benchmarks: one job each, one after the other, each with the whole machine; one page and one file of numbers."""


rule measure:
    output:
        table=report(
            "results/benchmarks/{measurement}/table.csv",
            caption="../report/benchmark.rst",
            category="benchmarks",
            subcategory="{measurement}",
            labels={"shows": "{measurement}", "form": "table"},
        ),
        figure=report(
            "results/benchmarks/{measurement}/figure.png",
            caption="../report/benchmark.rst",
            category="benchmarks",
            subcategory="{measurement}",
            labels={"shows": "{measurement}", "form": "picture"},
        ),
        numbers="results/benchmarks/{measurement}/report.json",
        machine="results/benchmarks/{measurement}/machine.json",
    log:
        "logs/benchmarks/{measurement}.log",
    benchmark:
        "logs/benchmark/benchmarks/{measurement}.tsv"
    conda:
        "../envs/pdhe.yaml"
    threads: lambda wildcards: workflow.cores or 1
    params:
        folder=subpath(output.numbers, parent=True),
        settings=lambda wildcards: canonical(MEASUREMENTS[wildcards.measurement]),
        code=lambda wildcards: fingerprint(BENCHMARKS[wildcards.measurement]),
    shell:
        "NUMBA_NUM_THREADS={threads} python -m pdhe benchmark {wildcards.measurement}"
        " --settings {params.settings:q} --out {params.folder:q} > {log:q} 2>&1"


rule benchmark_page:
    input:
        expand(
            "results/benchmarks/{measurement}/{file}",
            measurement=MEASUREMENTS,
            file=("report.json", "machine.json", "figure.png"),
        ),
    output:
        page=report(
            "results/benchmarks/index.html",
            caption="../report/benchmarks.rst",
            category="benchmarks",
            subcategory="all",
            labels={"shows": "all benchmarks", "form": "page"},
        ),
        numbers="results/benchmarks/benchmarks.json",
        tables="results/benchmarks/tables.md",
    log:
        "logs/benchmarks/page.log",
    benchmark:
        "logs/benchmark/benchmarks/page.tsv"
    conda:
        "../envs/pdhe.yaml"
    params:
        folders=[f"results/benchmarks/{name}" for name in MEASUREMENTS],
        code=fingerprint("pdhe.benchmarks.page"),
    shell:
        "python -m pdhe benchmark-page {params.folders:q} --out {output.page:q}"
        " --json {output.numbers:q} --markdown {output.tables:q} > {log:q} 2>&1"
