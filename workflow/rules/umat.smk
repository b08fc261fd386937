"""User materials: a compiled library for every source in config/umat."""

UMATS = {
    os.path.splitext(name)[0] + os.path.splitext(name)[1].replace(".", "_"): f"{folder}/{name}"
    for folder in ("config/umat", f"{workflow.basedir}/config/umat")
    if os.path.isdir(folder)
    for name in sorted(os.listdir(folder))
    if name.lower().endswith((".c", ".f", ".for", ".f90"))
}


rule user_material:
    input:
        lambda wildcards: UMATS[wildcards.material],
    output:
        "results/umat/{material}.so",
    log:
        "logs/umat/{material}.log",
    benchmark:
        "logs/benchmark/umat/{material}.tsv"
    wildcard_constraints:
        material="|".join(map(re.escape, UMATS)) or "(?!)",
    conda:
        "../envs/pdhe.yaml"
    params:
        code=fingerprint("pdhe.materials.umat"),
    shell:
        "python -m pdhe umat-build {input:q} --out {output:q} > {log:q} 2>&1"
