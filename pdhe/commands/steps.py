"""Commands that compute a scene, step by step or whole, and those that say beforehand what it takes."""

import argparse
import json
import shlex
import tempfile
from pathlib import Path
from typing import Any

from pdhe.commands.streams import progress, read_object, ready
from pdhe.errors import PdheError


def mesh(arguments: argparse.Namespace) -> None:
    """Mesh a geometry."""
    from pdhe.mesh import make_mesh

    spec = read_object(arguments.spec, "--spec")
    geometry, mesh_block = _mesh_blocks(spec)
    make_mesh(geometry, mesh_block, ready(arguments.out))


def nodes(arguments: argparse.Namespace) -> None:
    """Turn a mesh into nodes with volumes and node sets."""
    from pdhe.discretization import discretize, write_discretization

    spec = read_object(arguments.spec, "--spec")
    write_discretization(discretize(arguments.mesh, *_mesh_blocks(spec)), ready(arguments.out))


def solve(arguments: argparse.Namespace) -> None:
    """Solve a scene on given nodes."""
    from pdhe.discretization import read_discretization
    from pdhe.scene import Scene
    from pdhe.simulation import solve_case

    out = ready(arguments.out)
    spec = read_object(arguments.spec, "--spec")
    _place_user_material(spec, arguments.umat)
    scene = Scene.from_resolved({"title": out.stem, **spec})
    # The scene itself stands in the result.
    command = shlex.join(["pdhe", "solve", "--spec", "SCENE", "--nodes", str(arguments.nodes), "--out", str(out)])
    solve_case(scene, read_discretization(arguments.nodes), out, progress, command, _estimated(scene, out))


def run(arguments: argparse.Namespace) -> None:
    """Mesh and solve one scene file without the workflow."""
    from pdhe.discretization import discretize
    from pdhe.mesh import make_mesh
    from pdhe.scene import load_scene
    from pdhe.simulation import solve_case

    out = ready(arguments.out)
    changes, told = _chosen(arguments.scene)
    scene = load_scene(arguments.scene, changes)
    try_user_material(scene, str(arguments.scene))
    mesh_file = out.with_suffix(".msh")
    make_mesh(scene.geometry, scene.mesh, mesh_file)
    command = shlex.join(["pdhe", "run", str(arguments.scene), "--out", str(out)])
    remarks = (lambda _: told) if told else _estimated(scene, out)
    solve_case(scene, discretize(mesh_file, scene.geometry, scene.mesh), out, progress, command, remarks)


def choose(arguments: argparse.Namespace) -> None:
    """Find the settings with which a scene is as accurate as it asks for, by runs on coarse meshes."""
    from pdhe.tradeoff.choose import choose as choose_settings

    choice = choose_settings(arguments.scene, progress)
    print(choice.text())


def plan(arguments: argparse.Namespace) -> None:
    """Tell what a scene would compute, and at what cost."""
    from pdhe.case import build_case
    from pdhe.discretization import discretize
    from pdhe.forecast import check_memory, make_forecast
    from pdhe.mesh import make_mesh
    from pdhe.needs import needs_of
    from pdhe.plan import make_plan
    from pdhe.scene import load_scene
    from pdhe.simulation import fly_pilot
    from pdhe.tradeoff.choose import estimate

    changes, chosen = _chosen(arguments.scene)
    scene = load_scene(arguments.scene, changes)
    try_user_material(scene, str(arguments.scene))
    with tempfile.TemporaryDirectory() as folder:
        mesh_file = Path(folder, "plan.msh")
        make_mesh(scene.geometry, scene.mesh, mesh_file)
        nodes = discretize(mesh_file, scene.geometry, scene.mesh)
        tight = check_memory(scene, nodes.volume.size)
        case = build_case(scene, nodes)
    pilot = fly_pilot(scene, case.discretization.volume.size)
    expected = make_forecast(case, pilot)
    print("\n".join([make_plan(case, pilot, expected), *([tight] if tight else [])]))
    seconds = expected.seconds
    print("expected time: seconds" if seconds is None else f"expected time: {seconds:.3g} s of one thread")
    needs = needs_of(scene.resolved())
    asked = f"{needs.threads} thread(s), {needs.mem_mb()} MB, {needs.runtime()} min"
    print(f"on a cluster this asks for: {asked} (docs/clusters.md)")
    # An accuracy has had its pilot runs.
    errors = json.loads(chosen["predicted_errors"]) if chosen else estimate(scene)
    told = ", ".join(f"{name} {100.0 * error:.2g} %" for name, error in errors.items())
    print(f"expected error of the mesh: {told or 'the result will tell it (docs/tradeoff.md)'}")


def try_user_material(scene: Any, file: str) -> None:
    """Compile, load and try the user material of a scene, if it has one, before anything else is done."""
    if scene.material.umat is not None and scene.loads is not None:
        from pdhe.histories import user_material

        user_material(scene, file)


def _place_user_material(spec: dict[str, Any], library: Path | None) -> None:
    """Say in a resolved scene where its compiled user material lies, in place: identities leave that out."""
    material = spec.get("material")
    umat = material.get("umat") if isinstance(material, dict) else None
    if not isinstance(umat, dict):
        return
    if library is not None:
        umat.pop("source", None)
        umat["library"] = str(library)
    elif "source" not in umat and "library" not in umat:
        raise PdheError("--spec has a user material: give its compiled library as `--umat`")


def _chosen(scene: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings of a scene that leaves them to its accuracy, and what its result tells of them; nothing otherwise."""
    from pdhe.fidelity import leaves_spacing_to_accuracy
    from pdhe.scene_reading import read_scene_file

    if not leaves_spacing_to_accuracy(read_scene_file(scene)):
        return {}, {}
    from pdhe.tradeoff.choose import choose as choose_settings

    choice = choose_settings(scene, progress)
    progress(choice.text())
    errors = json.dumps(choice.errors, sort_keys=True)
    basis = "from the runs on coarse meshes that chose the settings; right within a factor of 2"
    told = {"choice": choice.text(), "predicted_error": choice.predicted, "predicted_errors": errors}
    return choice.changes, told | {"error_basis": basis}


def _estimated(scene: Any, out: Path) -> Any:
    """What a result that can be written tells of its own error, given what the run came to."""
    from pdhe.tradeoff.own_error import own_error
    from pdhe.wholefile import check_place

    check_place(out)

    def remarks(contents: Any) -> dict[str, Any]:
        # Now, when the run itself has checkpoints to go on from: the one on a coarser mesh keeps none.
        told = own_error(scene, progress).attributes(contents)
        expected = f"{100.0 * told['predicted_error']:.2g} %, " if "predicted_error" in told else ""
        progress(f"expected error of the mesh: {expected}{told['error_basis']}")
        return told

    return remarks


def _mesh_blocks(spec: dict) -> tuple[Any, Any]:
    """Return the geometry and mesh blocks of a stage description as the objects the scene has."""
    from pdhe.scene import Geometry, Mesh
    from pdhe.scene_reading import reporting

    blocks: list[Any] = []
    for name, block in (("geometry", Geometry), ("mesh", Mesh)):
        if name not in spec:
            raise PdheError(f"--spec has no block '{name}'")
        with reporting("--spec", spec[name]):
            blocks.append(block.model_validate(spec[name], context={"si": True}))
    return blocks[0], blocks[1]
