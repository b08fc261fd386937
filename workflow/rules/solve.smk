rule solve:
    input:
        nodes=nodes_of,
        umat=library_of,
    output:
        "results/store/solve/{solve_id}.nc",
    log:
        "logs/solve/{solve_id}.log",
    benchmark:
        "logs/benchmark/solve/{solve_id}.tsv"
    conda:
        "../envs/pdhe.yaml"
    threads: solve_threads
    resources:
        mem_mb=solve_memory,
        runtime=solve_minutes,
    params:
        spec=solve_spec,
        umat=lambda wildcards, input: ["--umat", input.umat] if input.umat else [],
        code=fingerprint("pdhe.simulation"),
    shell:
        "NUMBA_NUM_THREADS={threads} python -m pdhe solve"
        " --spec {params.spec:q} --nodes {input.nodes:q} {params.umat:q} --out {output:q} > {log:q} 2>&1"
