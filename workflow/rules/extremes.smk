"""The extremes: one job a group of cases, one map, one table, one verdict."""


rule extreme_cases:
    output:
        verdict="results/extremes/{group}/report.json",
        table="results/extremes/{group}/table.csv",
        outcomes="results/extremes/{group}/outcomes.csv",
    log:
        "logs/extremes/{group}.log",
    benchmark:
        "logs/benchmark/extremes/{group}.tsv"
    conda:
        "../envs/pdhe.yaml"
    params:
        folder=subpath(output.verdict, parent=True),
        code=lambda wildcards: fingerprint(EXTREMES[wildcards.group]),
    shell:
        "NUMBA_NUM_THREADS={threads} python -m pdhe extremes {wildcards.group} --out {params.folder:q} > {log:q} 2>&1"


rule extremes_page:
    input:
        expand("results/extremes/{group}/{file}", group=EXTREMES, file=["report.json", "outcomes.csv"]),
    output:
        page="results/extremes/index.html",
        map="results/extremes/map.png",
        table="results/extremes/extremes.csv",
    log:
        "logs/extremes/page.log",
    benchmark:
        "logs/benchmark/extremes/page.tsv"
    conda:
        "../envs/pdhe.yaml"
    params:
        folders=[f"results/extremes/{group}" for group in EXTREMES],
        code=fingerprint("pdhe.extremes.page"),
    shell:
        "python -m pdhe extremes-page {params.folders:q} --out {output.page:q} --map {output.map:q}"
        " --table {output.table:q} > {log:q} 2>&1"


rule extremes_verdict:
    input:
        expand("results/extremes/{group}/report.json", group=EXTREMES),
    output:
        "results/extremes/passed.txt",
    log:
        "logs/extremes/verdict.log",
    benchmark:
        "logs/benchmark/extremes/verdict.tsv"
    conda:
        "../envs/pdhe.yaml"
    params:
        folders=[f"results/extremes/{group}" for group in EXTREMES],
        code=fingerprint("pdhe.verification.page"),
    shell:
        "python -m pdhe verdict {params.folders:q} --out {output:q} > {log:q} 2>&1"
