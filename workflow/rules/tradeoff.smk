"""Speed against accuracy: one job a scene, its runs in sequence; pictures, one table, one file of numbers."""


rule trade:
    output:
        table=report(
            "results/tradeoff/{trade}/runs.csv",
            caption="../report/trade.rst",
            category="tradeoff",
            subcategory="{trade}",
            labels={"shows": "runs", "form": "table"},
        ),
        numbers="results/tradeoff/{trade}/report.json",
    log:
        "logs/tradeoff/{trade}.log",
    benchmark:
        "logs/benchmark/tradeoff/{trade}.tsv"
    conda:
        "../envs/pdhe.yaml"
    threads: 1
    params:
        file=lambda wildcards: TRADES[wildcards.trade].file,
        folder=subpath(output.numbers, parent=True),
        design=lambda wildcards: TRADES[wildcards.trade].identity(),
        code=fingerprint("pdhe.tradeoff.measure"),
    shell:
        "NUMBA_NUM_THREADS={threads} python -m pdhe trade {params.file:q} --scene {wildcards.trade}"
        " --out {params.folder:q} > {log:q} 2>&1"


rule tradeoff_page:
    input:
        expand(
            "results/tradeoff/{trade}/{file}",
            trade=TRADES,
            file=("report.json", "runs.csv"),
        ),
    output:
        picture=report(
            "results/tradeoff/fronts.png",
            caption="../report/tradeoff.rst",
            category="tradeoff",
            subcategory="all scenes",
            labels={"shows": "all fronts", "form": "picture"},
        ),
        costs=report(
            "results/tradeoff/costs.png",
            caption="../report/tradeoff.rst",
            category="tradeoff",
            subcategory="all scenes",
            labels={"shows": "time and memory", "form": "picture"},
        ),
        table=report(
            "results/tradeoff/runs.csv",
            caption="../report/tradeoff.rst",
            category="tradeoff",
            subcategory="all scenes",
            labels={"shows": "all runs", "form": "table"},
        ),
        page=report(
            "results/tradeoff/index.html",
            caption="../report/tradeoff.rst",
            category="tradeoff",
            subcategory="all scenes",
            labels={"shows": "all scenes", "form": "page"},
        ),
        tables="results/tradeoff/tables.md",
        models="results/tradeoff/models.json",
    log:
        "logs/tradeoff/page.log",
    benchmark:
        "logs/benchmark/tradeoff/page.tsv"
    conda:
        "../envs/pdhe.yaml"
    params:
        folders=[f"results/tradeoff/{name}" for name in TRADES],
        code=fingerprint("pdhe.tradeoff.page"),
    shell:
        "python -m pdhe tradeoff-page {params.folders:q} --picture {output.picture:q} --costs {output.costs:q}"
        " --csv {output.table:q}"
        " --markdown {output.tables:q} --models {output.models:q} --out {output.page:q} > {log:q} 2>&1"
