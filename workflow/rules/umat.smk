"""User materials: a compiled library for every source in config/umat, and for every source that a scene names."""

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


rule scene_material:
    input:
        lambda wildcards: USER_MATERIALS[wildcards.umat_id],
    output:
        "results/store/umat/{umat_id}.so",
    log:
        "logs/umat/{umat_id}.log",
    benchmark:
        "logs/benchmark/umat/{umat_id}.tsv"
    wildcard_constraints:
        umat_id="|".join(map(re.escape, USER_MATERIALS)) or "(?!)",
    conda:
        "../envs/pdhe.yaml"
    params:
        content=lambda wildcards: wildcards.umat_id.rpartition("-")[2],
        code=fingerprint("pdhe.materials.umat"),
    shell:
        "python -m pdhe umat-build {input:q} --content {params.content:q} --out {output:q} > {log:q} 2>&1"
