rule nodes:
    input:
        "results/store/mesh/{mesh_id}.msh",
    output:
        "results/store/nodes/{mesh_id}.nc",
    log:
        "logs/nodes/{mesh_id}.log",
    benchmark:
        "logs/benchmark/nodes/{mesh_id}.tsv"
    conda:
        "../envs/pdhe.yaml"
    resources:
        mem_mb=mesh_memory,
    params:
        spec=mesh_spec,
        code=fingerprint("pdhe.discretization"),
    shell:
        "python -m pdhe nodes --spec {params.spec:q} --mesh {input:q} --out {output:q} > {log:q} 2>&1"
