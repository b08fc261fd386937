localrules:
    index,


rule picture:
    input:
        result_of,
    output:
        report(
            "results/{study}/{case}/{kind}.png",
            caption="../report/picture.rst",
            category="{study}",
            subcategory="{case}",
            labels={"shows": "{kind}", "form": "picture"},
        ),
    log:
        "logs/{study}/{case}/{kind}.png.log",
    benchmark:
        "logs/benchmark/{study}/{case}/{kind}.png.tsv"
    conda:
        "../envs/pdhe.yaml"
    resources:
        mem_mb=DRAWING_MEMORY,
    params:
        style=style_of,
        code=fingerprint("pdhe.plotting"),
    shell:
        "python -m pdhe figures --kind {wildcards.kind} --result {input:q}"
        " --style {params.style:q} --out {output:q} > {log:q} 2>&1"


rule animation:
    input:
        result_of,
    output:
        report(
            "results/{study}/{case}/{kind}.gif",
            caption="../report/animation.rst",
            category="{study}",
            subcategory="{case}",
            labels={"shows": "{kind}", "form": "animation"},
        ),
    log:
        "logs/{study}/{case}/{kind}.gif.log",
    benchmark:
        "logs/benchmark/{study}/{case}/{kind}.gif.tsv"
    conda:
        "../envs/pdhe.yaml"
    resources:
        mem_mb=DRAWING_MEMORY,
    params:
        style=style_of,
        code=fingerprint("pdhe.plotting"),
    shell:
        "python -m pdhe animate --kind {wildcards.kind} --result {input:q}"
        " --style {params.style:q} --out {output:q} > {log:q} 2>&1"


rule history:
    input:
        result_of,
    output:
        table=report(
            "results/{study}/{case}/history.csv",
            caption="../report/history.rst",
            category="{study}",
            subcategory="{case}",
            labels={"shows": "history", "form": "table"},
        ),
        picture=report(
            "results/{study}/{case}/history.png",
            caption="../report/history.rst",
            category="{study}",
            subcategory="{case}",
            labels={"shows": "history", "form": "picture"},
        ),
    log:
        "logs/{study}/{case}/history.log",
    benchmark:
        "logs/benchmark/{study}/{case}/history.tsv"
    conda:
        "../envs/pdhe.yaml"
    resources:
        mem_mb=DRAWING_MEMORY,
    params:
        code=fingerprint("pdhe.plotting", "pdhe.post"),
    shell:
        "python -m pdhe history --result {input:q}"
        " --out-csv {output.table:q} --out-png {output.picture:q} > {log:q} 2>&1"


rule index:
    input:
        solutions_of,
    output:
        report(
            "results/{study}/cases.csv",
            caption="../report/index.rst",
            category="{study}",
            subcategory="all cases",
            labels={"shows": "cases", "form": "table"},
        ),
    log:
        "logs/{study}/cases.log",
    benchmark:
        "logs/benchmark/{study}/cases.tsv"
    conda:
        "../envs/pdhe.yaml"
    params:
        file=lambda wildcards: ALL[wildcards.study].file,
        table=lambda wildcards: digest(ALL[wildcards.study].table()),
        code=fingerprint("pdhe.post"),
    shell:
        "python -m pdhe index {params.file:q} --solutions results/store/solve --out {output:q} > {log:q} 2>&1"
