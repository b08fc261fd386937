localrules:
    report,


rule report:
    input:
        HISTORIES,
        PICTURES,
        INDEXES,
        captions=CAPTIONS,
    output:
        REPORT,
    log:
        "logs/report.log",
    benchmark:
        "logs/benchmark/report.tsv"
    conda:
        "../envs/pdhe.yaml"
    params:
        options=SAME_CONFIGURATION,
    shell:
        "python -m snakemake results {params.options:q} --nolock --report {output:q} > {log:q} 2>&1"
        " && python -m pdhe stamp {output:q} --made-by 'snakemake --report' >> {log:q} 2>&1"
