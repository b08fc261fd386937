rule mesh:
    output:
        "results/store/mesh/{mesh_id}.msh",
    log:
        "logs/mesh/{mesh_id}.log",
    benchmark:
        "logs/benchmark/mesh/{mesh_id}.tsv"
    conda:
        "../envs/pdhe.yaml"
    resources:
        mem_mb=mesh_memory,
    params:
        spec=mesh_spec,
        code=fingerprint("pdhe.mesh"),
    shell:
        "python -m pdhe mesh --spec {params.spec:q} --out {output:q} > {log:q} 2>&1"
