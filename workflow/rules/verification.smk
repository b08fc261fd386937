"""The verification: one job a topic, one page, one verdict."""


rule check:
    output:
        table=report(
            "results/verification/{topic}/table.csv",
            caption="../report/check.rst",
            category="verification",
            subcategory="{topic}",
            labels={"shows": "{topic}", "form": "table"},
        ),
        figure=report(
            "results/verification/{topic}/figure.png",
            caption="../report/check.rst",
            category="verification",
            subcategory="{topic}",
            labels={"shows": "{topic}", "form": "picture"},
        ),
        verdict="results/verification/{topic}/report.json",
    log:
        "logs/verification/{topic}.log",
    benchmark:
        "logs/benchmark/verification/{topic}.tsv"
    conda:
        "../envs/pdhe.yaml"
    params:
        folder=subpath(output.verdict, parent=True),
        settings=lambda wildcards: canonical(CHECKS[wildcards.topic].settings),
        code=lambda wildcards: fingerprint(TOPICS[wildcards.topic]),
    shell:
        "NUMBA_NUM_THREADS={threads} python -m pdhe check {wildcards.topic}"
        " --settings {params.settings:q} --out {params.folder:q} > {log:q} 2>&1"


rule verification_page:
    input:
        REPORTS,
    output:
        report(
            f"{VERIFIED}/index.html",
            caption="../report/verification.rst",
            category="verification",
            subcategory="all topics",
            labels={"shows": "all topics", "form": "page"},
        ),
    log:
        "logs/verification/page.log",
    benchmark:
        "logs/benchmark/verification/page.tsv"
    conda:
        "../envs/pdhe.yaml"
    params:
        folders=[f"results/verification/{topic}" for topic in CHECKS],
        docs=(
            ["--docs", config["verification_docs"]]
            if config.get("verification_docs") and "check" not in config
            else []
        ),
        code=fingerprint("pdhe.verification.page"),
    shell:
        "python -m pdhe page {params.folders:q} --out {output:q} {params.docs:q} > {log:q} 2>&1"


rule verdict:
    input:
        REPORTS,
    output:
        f"{VERIFIED}/passed.txt",
    log:
        "logs/verification/verdict.log",
    benchmark:
        "logs/benchmark/verification/verdict.tsv"
    conda:
        "../envs/pdhe.yaml"
    params:
        folders=[f"results/verification/{topic}" for topic in CHECKS],
        code=fingerprint("pdhe.verification.page"),
    shell:
        "python -m pdhe verdict {params.folders:q} --out {output:q} > {log:q} 2>&1"
