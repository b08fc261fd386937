"""Command line: one subcommand a step; each calls one function of the package and does nothing else.

What a subcommand needs is imported when it runs, so that help and errors come at once.
"""

import argparse
import json
import shlex
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pdhe.errors import PdheError

PICTURES = (".png", ".pdf", ".svg")
"""Kinds of files that a picture can be written to."""
ESTIMATE_FROM = 5000
"""Nodes from which a result carries an estimate of its error: shorter runs take less than loading what it needs."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    Parameters
    ----------
    argv
        Arguments without the name of the program; those of the process when None.

    Returns
    -------
    int
        0 after success, 1 after an error that is explained on standard error, 128 and the number of the signal after
        an interruption.
    """
    arguments = _parser().parse_args(argv)
    try:
        arguments.run(arguments)
    except (PdheError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as stop:
        print(str(stop) or "interrupted", file=sys.stderr)
        return getattr(stop, "status", 130)
    return 0


def mesh(arguments: argparse.Namespace) -> None:
    """Mesh a geometry."""
    from pdhe.mesh import make_mesh

    spec = _json(arguments.spec, "--spec")
    geometry, mesh_block = _mesh_blocks(spec)
    make_mesh(geometry, mesh_block, _ready(arguments.out))


def nodes(arguments: argparse.Namespace) -> None:
    """Turn a mesh into nodes with volumes and node sets."""
    from pdhe.discretization import discretize, write_discretization

    spec = _json(arguments.spec, "--spec")
    write_discretization(discretize(arguments.mesh, *_mesh_blocks(spec)), _ready(arguments.out))


def solve(arguments: argparse.Namespace) -> None:
    """Solve a scene on given nodes."""
    from pdhe.discretization import read_discretization
    from pdhe.scene import Scene
    from pdhe.simulation import solve_case

    out = _ready(arguments.out)
    scene = Scene.from_resolved({"title": out.stem, **_json(arguments.spec, "--spec")})
    # The scene itself stands in the result.
    command = shlex.join(["pdhe", "solve", "--spec", "SCENE", "--nodes", str(arguments.nodes), "--out", str(out)])
    solve_case(scene, read_discretization(arguments.nodes), out, _progress, command, _estimated(scene))


def run(arguments: argparse.Namespace) -> None:
    """Mesh and solve one scene file without the workflow."""
    from pdhe.discretization import discretize
    from pdhe.mesh import make_mesh
    from pdhe.scene import load_scene
    from pdhe.simulation import solve_case

    out = _ready(arguments.out)
    changes, remarks = _chosen(arguments.scene)
    scene = load_scene(arguments.scene, changes)
    mesh_file = out.with_suffix(".msh")
    make_mesh(scene.geometry, scene.mesh, mesh_file)
    command = shlex.join(["pdhe", "run", str(arguments.scene), "--out", str(out)])
    solve_case(
        scene, discretize(mesh_file, scene.geometry, scene.mesh), out, _progress, command, remarks or _estimated(scene)
    )


def choose(arguments: argparse.Namespace) -> None:
    """Find the settings with which a scene is as accurate as it asks for, by runs on coarse meshes."""
    from pdhe.tradeoff.choose import choose as choose_settings

    choice = choose_settings(arguments.scene, _progress)
    print(choice.text())


def _chosen(scene: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings of a scene that leaves them to its accuracy, and what its result tells of them; nothing otherwise."""
    from pdhe.fidelity import leaves_spacing_to_accuracy
    from pdhe.scene_reading import read_scene_file

    if not leaves_spacing_to_accuracy(read_scene_file(scene)):
        return {}, {}
    from pdhe.tradeoff.choose import choose as choose_settings

    choice = choose_settings(scene, _progress)
    _progress(choice.text())
    errors = json.dumps(choice.errors, sort_keys=True)
    return choice.changes, {"choice": choice.text(), "predicted_error": choice.predicted, "predicted_errors": errors}


def _estimated(scene: Any) -> dict[str, Any]:
    """What a result tells of its own error: nothing where a run is too short for the pilot runs that it takes."""
    plate = scene.geometry
    if plate.width * plate.height < ESTIMATE_FROM * scene.mesh.spacing**2:
        return {}
    from pdhe.tradeoff.choose import estimate

    errors = estimate(scene)
    return {"predicted_error": max(errors.values()), "predicted_errors": json.dumps(errors)} if errors else {}


def plan(arguments: argparse.Namespace) -> None:
    """Tell what a scene would compute, and at what cost."""
    from pdhe.case import build_case
    from pdhe.discretization import discretize
    from pdhe.forecast import make_forecast
    from pdhe.mesh import make_mesh
    from pdhe.plan import make_plan
    from pdhe.scene import load_scene
    from pdhe.simulation import fly_pilot
    from pdhe.tradeoff.choose import estimate

    scene = load_scene(arguments.scene, _chosen(arguments.scene)[0])
    with tempfile.TemporaryDirectory() as folder:
        mesh_file = Path(folder, "plan.msh")
        make_mesh(scene.geometry, scene.mesh, mesh_file)
        case = build_case(scene, discretize(mesh_file, scene.geometry, scene.mesh))
    pilot = fly_pilot(scene, case.discretization.volume.size)
    expected = make_forecast(case, pilot)
    print(make_plan(case, pilot, expected))
    seconds = expected.seconds
    print("expected time: seconds" if seconds is None else f"expected time: {seconds:.3g} s of one thread")
    errors = estimate(scene)
    told = ", ".join(f"{name} {100.0 * error:.2g} %" for name, error in errors.items())
    print(f"expected error of the mesh: {told or 'not estimated (docs/tradeoff.md)'}")


def validate(arguments: argparse.Namespace) -> None:
    """Check scene and study files; every file is checked, also after an error in one of them."""
    from pdhe.fidelity import leaves_spacing_to_accuracy
    from pdhe.scene import load_scene
    from pdhe.study import load_study
    from pdhe.yamlfile import read_yaml

    failed = 0
    for file in arguments.files:
        try:
            content = read_yaml(file)
            if isinstance(content, dict) and "check" in content:
                from pdhe.verification.studies import load_check

                print(f"{file}: check of {load_check(str(file)).topic}")
            elif isinstance(content, dict) and "tradeoff" in content:
                from pdhe.tradeoff.design import load_design

                runs = sum(len(list(trade.runs())) for trade in load_design(file).values())
                print(f"{file}: design with {runs} runs")
            elif isinstance(content, dict) and "study" in content:
                print(f"{file}: study with {len(load_study(file).cases)} case(s)")
            elif isinstance(content, dict) and leaves_spacing_to_accuracy(content):
                scene = load_scene(file, {"accuracy": None, "fidelity": "fine"})
                print(f"{file}: scene '{scene.title}', settings left to its accuracy")
            else:
                print(f"{file}: scene '{load_scene(file).title}'")
        except PdheError as error:
            print(f"error: {error}", file=sys.stderr)
            failed += 1
    if failed:
        raise PdheError(f"{failed} of {len(arguments.files)} file(s) cannot be used")


def schema(arguments: argparse.Namespace) -> None:
    """Write the JSON schema of scene files, for editors that complete and check them."""
    from pdhe.scene import scene_json_schema

    _write(arguments.out, json.dumps(scene_json_schema(), indent=2) + "\n")


def index(arguments: argparse.Namespace) -> None:
    """Write the table of the cases of a study, with how each ended where the solutions are given."""
    from pdhe.study import load_study

    study = load_study(arguments.study)
    outcomes = {}
    if arguments.solutions:
        from pdhe.post import summary
        from pdhe.results import open_result

        for solve_id in {case.solve_id for case in study.cases}:
            with open_result(arguments.solutions / f"{solve_id}.nc") as result:
                outcomes[solve_id] = {key: value for key, value in summary(result).items() if key != "title"}
    _write(arguments.out, study.table(outcomes))


def diagnose(arguments: argparse.Namespace) -> None:
    """Explain a result: what broke or how far from it, energy, hydrogen, work, origin."""
    from pdhe.diagnosis import diagnose as explain

    for path in arguments.files:
        print(explain(path))


def verify(arguments: argparse.Namespace) -> None:
    """Tell which results no longer match their hashes, their names, or the code and versions that made them."""
    from pdhe.store import check, solutions_and_nodes

    files = solutions_and_nodes(arguments.results)
    problems = 0
    for path in files:
        for problem in check(path):
            print(f"{path}: {problem}")
            problems += 1
    if problems:
        raise PdheError(
            f"{problems} mismatch(es) in {len(files)} file(s); what is deleted, the workflow computes again"
        )
    print(f"{len(files)} file(s) match")


def gc(arguments: argparse.Namespace) -> None:
    """List the results that no study refers to, or remove them."""
    from pdhe.store import configured_studies, size_of, unused

    studies = arguments.studies or configured_studies()
    found = unused(arguments.results, studies)
    total = 0
    for path in found:
        size = size_of(path)
        total += size
        print(f"{size / 1e6:9.1f} MB  {path}")
    did = "removed" if arguments.remove else "could be removed with --remove"
    if arguments.remove:
        from pdhe.store import remove

        remove(found)
    print(f"{total / 1e6:9.1f} MB in {len(found)} place(s) {did}; {len(studies)} study file(s) refer to the rest")


def figures(arguments: argparse.Namespace) -> None:
    """Draw one picture of a result."""
    from pdhe.plotting import draw

    if arguments.out.suffix not in PICTURES:
        raise PdheError(f"{arguments.out}: pictures are written as {', '.join(PICTURES)}")
    draw(arguments.kind, arguments.result, _json(arguments.style, "--style"), _ready(arguments.out))


def animate(arguments: argparse.Namespace) -> None:
    """Draw one picture of a result as an animation over time."""
    from pdhe.plotting import animate as draw_animation

    draw_animation(arguments.kind, arguments.result, _json(arguments.style, "--style"), _ready(arguments.out))


def history(arguments: argparse.Namespace) -> None:
    """Write the curves over time as a table and draw them."""
    if not (arguments.out_csv or arguments.out_png):
        raise PdheError("nothing to write: give --out-csv, --out-png or both")
    if arguments.out_csv:
        from pdhe.post import history_table

        _write(arguments.out_csv, history_table(arguments.result))
    if arguments.out_png:
        from pdhe.plotting import draw_history

        draw_history(arguments.result, _ready(arguments.out_png))


def check(arguments: argparse.Namespace) -> None:
    """Run one topic of the verification and write its table, figure and verdict."""
    from pdhe.verification.topics import run_topic

    report = run_topic(arguments.topic, _json(arguments.settings, "--settings"))
    report.write(arguments.out)
    print(f"{report.title}: {sum(row.passed for row in report.rows)} of {len(report.rows)} rows hold", file=sys.stderr)


def page(arguments: argparse.Namespace) -> None:
    """Gather topics of the verification on one page, as HTML and, for the documentation, as Markdown."""
    from pdhe.verification.page import as_html, as_markdown, read_reports

    reports = read_reports(arguments.folders)
    _write(arguments.out, as_html(reports))
    if arguments.docs:
        figures_folder = arguments.docs / "verification"
        figures_folder.mkdir(parents=True, exist_ok=True)
        _write(arguments.docs / "verification.md", as_markdown(reports, "verification"))
        for report in reports:
            if report["figure"]:
                (figures_folder / f"{report['topic']}.png").write_bytes(report["figure"].read_bytes())


def verdict(arguments: argparse.Namespace) -> None:
    """Fail, naming every comparison that does not hold, unless all topics or groups of extremes pass."""
    from pdhe.verification.page import failures, read_reports

    failed = failures(read_reports(arguments.folders))
    if failed:
        raise PdheError("comparisons that do not hold:\n  " + "\n  ".join(failed))
    _write(arguments.out, "every comparison holds\n")


def benchmark(arguments: argparse.Namespace) -> None:
    """Run one benchmark and write its table, figure, samples and machine."""
    from pdhe.benchmarks.registry import write_benchmark

    report = write_benchmark(arguments.name, _json(arguments.settings, "--settings"), arguments.out)
    judged = [row for row in report.rows if row.kind != "shown"]
    print(f"{report.title}: {sum(row.passed for row in judged)} of {len(judged)} counts hold", file=sys.stderr)


def benchmark_page(arguments: argparse.Namespace) -> None:
    """Gather benchmarks as one JSON file, one page and, where asked, tables in Markdown."""
    from pdhe.benchmarks.page import as_html, as_markdown, gather

    content = gather(arguments.folders)
    _write(arguments.json, json.dumps(content, indent=1) + "\n")
    _write(arguments.out, as_html(content, arguments.folders))
    if arguments.markdown:
        _write(arguments.markdown, as_markdown(content))


def benchmark_compare(arguments: argparse.Namespace) -> None:
    """Print the ratios of two runs of the benchmarks."""
    from pdhe.benchmarks.page import compare

    old, new = (_json(path.read_text(encoding="utf-8"), str(path)) for path in (arguments.old, arguments.new))
    for line in compare(old, new):
        print(line)


def trade(arguments: argparse.Namespace) -> None:
    """Run one scene of a design with all its settings and write errors and costs."""
    from pdhe.tradeoff.design import load_design
    from pdhe.tradeoff.measure import measure

    trades = load_design(arguments.design)
    if arguments.scene not in trades:
        raise PdheError(f"{arguments.design}: no scene '{arguments.scene}'; there are {', '.join(trades)}")
    measure(trades[arguments.scene], _progress).write(arguments.out)


def tradeoff_page(arguments: argparse.Namespace) -> None:
    """Gather the scenes of a design in one picture, one table and one page."""
    from pdhe.tradeoff.page import as_csv, as_html, as_markdown, draw, gather, models_of

    scenes = gather(arguments.folders)
    draw(scenes, _ready(arguments.picture))
    _write(arguments.csv, as_csv(scenes))
    _write(arguments.out, as_html(scenes, arguments.picture))
    if arguments.markdown:
        _write(arguments.markdown, as_markdown(scenes))
    if arguments.models:
        _write(arguments.models, json.dumps(models_of(scenes), indent=1) + "\n")


def extremes(arguments: argparse.Namespace) -> None:
    """Run one group of extreme cases and write its table and verdict."""
    from pdhe.extremes.outcome import run_group

    report = run_group(arguments.group)
    report.write(arguments.out)
    print(f"{report.title}: {report.text}", file=sys.stderr)


def extremes_page(arguments: argparse.Namespace) -> None:
    """Gather groups of extreme cases as a map, a table and a page."""
    from pdhe.extremes.page import as_html, as_markdown, gather, write_map, write_table

    reports = gather(arguments.folders)
    write_map(reports, _ready(arguments.map))
    write_table(reports, _ready(arguments.table))
    _write(arguments.out, as_html(reports, arguments.map))
    if arguments.docs:
        _write(arguments.docs / "extremes.md", as_markdown(reports, "images/extremes.png"))
        _ready(arguments.docs / "images" / "extremes.png").write_bytes(arguments.map.read_bytes())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="pdhe", description="Studies of hydrogen-assisted fracture.")
    parser.add_argument("--version", action=_Version, nargs=0, help="show program's version number and exit")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    def add(function, *options):
        summary = function.__doc__.splitlines()[0]
        command = commands.add_parser(function.__name__.replace("_", "-"), help=summary, description=summary)
        for names, settings in options:
            command.add_argument(*names, **settings)
        command.set_defaults(run=function)

    def option(*names, **settings):
        return names, settings

    def file(*names, help, required=True):
        return option(*names, help=help, required=required, type=Path, metavar="FILE")

    spec = option("--spec", required=True, metavar="JSON", help="resolved blocks of the scene, SI")
    style = option("--style", default="{}", metavar="JSON", help="style of the figures")
    result = file("--result", help="result of a solve")
    kind = option("--kind", required=True, choices=("damage", "displacement", "coverage"), help="field to draw")
    scene = option("scene", type=Path, metavar="SCENE", help="scene file")
    anywhere = file("--out", help="file to write; standard output when not given", required=False)

    add(run, scene, file("--out", help="result to write; the mesh goes beside it"))
    add(plan, scene)
    add(choose, scene)
    add(validate, option("files", nargs="+", type=Path, metavar="FILE", help="scene or study file"))
    add(schema, anywhere)
    add(mesh, spec, file("--out", help="mesh to write"))
    add(nodes, spec, file("--mesh", help="mesh to read"), file("--out", help="nodes to write"))
    add(solve, spec, file("--nodes", help="nodes to read"), file("--out", help="result to write"))
    add(figures, result, kind, style, file("--out", help="picture to write"))
    add(animate, result, kind, style, file("--out", help="animation to write"))
    add(
        history,
        result,
        file("--out-csv", help="table to write", required=False),
        file("--out-png", help="picture to write", required=False),
    )
    add(
        index,
        option("study", type=Path, metavar="STUDY", help="study file"),
        option("--solutions", type=Path, metavar="FOLDER", help="folder of the solutions, results/store/solve"),
        anywhere,
    )
    add(diagnose, option("files", nargs="+", type=Path, metavar="RESULT", help="result of a solve"))
    place = option("results", nargs="?", type=Path, default=Path("results"), metavar="RESULTS", help="results folder")
    add(verify, place)
    add(
        gc,
        place,
        option(
            "--study",
            dest="studies",
            type=Path,
            action="append",
            metavar="FILE",
            help="study that keeps its results, several times for several; all below config when none is given",
        ),
        option("--remove", action="store_true", help="remove what is listed"),
    )
    folders = option("folders", nargs="+", type=Path, metavar="FOLDER", help="folder of a checked topic")
    folder = option("--out", required=True, type=Path, metavar="FOLDER", help="folder to write into")
    settings = option("--settings", default="{}", metavar="JSON", help="settings of the topic")
    add(check, option("topic", metavar="TOPIC", help="topic of the verification"), settings, folder)
    docs = option("--docs", type=Path, metavar="FOLDER", help="write verification.md and its figures here as well")
    add(page, folders, file("--out", help="page to write"), docs)
    add(extremes, option("group", metavar="GROUP", help="group of extreme cases"), folder)
    add(
        extremes_page,
        folders,
        file("--out", help="page to write"),
        file("--map", help="picture to write"),
        file("--table", help="table to write"),
        option("--docs", type=Path, metavar="FOLDER", help="write extremes.md and its picture here as well"),
    )
    add(verdict, folders, file("--out", help="file to write when all is well"))
    add(benchmark, option("name", metavar="NAME", help="benchmark to run"), settings, folder)
    results = option("folders", nargs="+", type=Path, metavar="FOLDER", help="folder of a benchmark that has run")
    tables = file("--markdown", help="tables to write", required=False)
    add(benchmark_page, results, file("--out", help="page to write"), file("--json", help="numbers to write"), tables)
    runs = [option(name, type=Path, metavar=name.upper(), help=f"benchmarks.json, {name}") for name in ("old", "new")]
    add(benchmark_compare, *runs)
    add(
        trade,
        option("design", type=Path, metavar="DESIGN", help="file of the design"),
        option("--scene", required=True, metavar="NAME", help="scene of it"),
        folder,
    )
    measured = option("folders", nargs="+", type=Path, metavar="FOLDER", help="folder of a measured scene")
    picture, numbers = file("--picture", help="picture to write"), file("--csv", help="table of all runs to write")
    models = file("--models", help="orders of convergence to write, for `pdhe choose`", required=False)
    add(tradeoff_page, measured, file("--out", help="page to write"), picture, numbers, tables, models)
    return parser


class _Version(argparse.Action):
    """Print the version, which takes as long to look up as all the rest of the command line to load."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib import metadata

        try:
            version = metadata.version("pdhe")
        except metadata.PackageNotFoundError:
            version = "(not installed)"
        print(f"pdhe {version}")
        parser.exit()


def _json(text: str, name: str) -> dict:
    """Read a JSON object given as an option."""
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise PdheError(f"{name} is not JSON: {error}") from error
    if not isinstance(value, dict):
        raise PdheError(f"{name} needs a JSON object, not {text}")
    return value


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


def _ready(path: Path) -> Path:
    """Make the folder of a file that is about to be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _write(path: Path | None, text: str) -> None:
    """Write a text to a file, or to standard output when there is none."""
    if path is None:
        sys.stdout.write(text)
    else:
        _ready(path).write_text(text, encoding="utf-8")


def _progress(message: str) -> None:
    """Show the progress of a solve."""
    print(message, flush=True)
