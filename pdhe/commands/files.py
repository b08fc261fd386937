"""Commands that check, list and explain scenes, studies and results."""

import argparse
import json
import sys

from pdhe.commands.streams import write
from pdhe.errors import PdheError


def validate(arguments: argparse.Namespace) -> None:
    """Check scene and study files; every file is checked, also after an error in one of them."""
    from pdhe.commands.steps import try_user_material
    from pdhe.fidelity import leaves_spacing_to_accuracy
    from pdhe.provenance import canonical
    from pdhe.scene import Scene, load_scene
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
                study = load_study(file)
                for case in {canonical(case.resolved["material"]): case for case in study.cases}.values():
                    if case.user_material is not None:
                        try_user_material(Scene.from_resolved(case.resolved), case.scene)
                print(f"{file}: study with {len(study.cases)} case(s)")
            elif isinstance(content, dict) and leaves_spacing_to_accuracy(content):
                from pdhe.tradeoff.choose import check

                print(f"{file}: scene '{check(file)[1].title}', settings left to its accuracy")
            else:
                scene = load_scene(file)
                try_user_material(scene, str(file))
                print(f"{file}: scene '{scene.title}'")
        except PdheError as error:
            if len(arguments.files) == 1:
                raise
            print(f"error: {error}", file=sys.stderr)
            failed += 1
    if failed:
        raise PdheError(f"{failed} of {len(arguments.files)} file(s) cannot be used")


def schema(arguments: argparse.Namespace) -> None:
    """Write the JSON schema of scene files, for editors that complete and check them."""
    from pdhe.scene import scene_json_schema

    write(arguments.out, json.dumps(scene_json_schema(), indent=2) + "\n")


def index(arguments: argparse.Namespace) -> None:
    """Write the table of the cases of a study, with how each ended where the solutions are given."""
    from pdhe.provenance import digest
    from pdhe.study import load_study

    study = load_study(arguments.study)
    outcomes = {}
    if arguments.solutions:
        from pdhe.post import summary
        from pdhe.results import open_result

        for solve_id in {case.solve_id for case in study.cases}:
            with open_result(arguments.solutions / f"{solve_id}.nc") as result:
                outcomes[solve_id] = {key: value for key, value in summary(result).items() if key != "title"}
    from pdhe.stamps import made_by

    source = {"study": str(arguments.study), "study_hash": digest(study.table())}
    write(arguments.out, study.table(outcomes), made_by("pdhe.post", arguments.command, **source))


def stamp(arguments: argparse.Namespace) -> None:
    """Write into tables and pages of another program what made them."""
    from pdhe.stamps import made_by
    from pdhe.stamps import stamp as write_into

    for path in arguments.files:
        write_into(path, made_by("pdhe.study", arguments.made_by or arguments.command))


def diagnose(arguments: argparse.Namespace) -> None:
    """Explain a result: what broke or how far from it, energy, hydrogen, work, origin."""
    from pdhe.diagnosis import diagnose as explain

    for path in arguments.files:
        print(explain(path))


def verify(arguments: argparse.Namespace) -> None:
    """Tell which results no longer match their hashes, their names, or the code and versions that made them."""
    from pdhe.store import check, reported, solutions_of, stored

    files = stored(arguments.results)
    problems, looked_at = 0, set()
    for path, found in (*((path, check(path)) for path in files), *reported(arguments.results, solutions_of(files))):
        looked_at.add(path)
        for problem in found:
            print(f"{path}: {problem}")
            problems += 1
    if problems:
        raise PdheError(
            f"{problems} mismatch(es) in {len(looked_at)} file(s); what is deleted, the workflow computes again"
        )
    print(f"{len(looked_at)} file(s) match")


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
