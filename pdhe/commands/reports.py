"""Commands behind the pages on the code itself: verification, extremes, benchmarks, speed against accuracy."""

import argparse
import json
import sys
from pathlib import Path

from pdhe.commands.streams import progress, read_object, ready, write
from pdhe.errors import PdheError


def _stamp_tables(folder: Path, module: str, command: str) -> None:
    """Write into the tables of a folder what made them."""
    from pdhe.stamps import made_by, stamp

    for path in sorted(folder.glob("*.csv")):
        stamp(path, made_by(module, command))


def _made_by(module: str, command: str) -> dict[str, str]:
    from pdhe.stamps import made_by

    return made_by(module, command)


def check(arguments: argparse.Namespace) -> None:
    """Run one topic of the verification and write its table, figure and verdict."""
    from pdhe.verification.topics import TOPICS, run_topic

    report = run_topic(arguments.topic, read_object(arguments.settings, "--settings"))
    report.write(arguments.out)
    _stamp_tables(arguments.out, TOPICS[arguments.topic], arguments.command)
    print(f"{report.title}: {sum(row.passed for row in report.rows)} of {len(report.rows)} rows hold", file=sys.stderr)


def page(arguments: argparse.Namespace) -> None:
    """Gather topics of the verification on one page, as HTML and, for the documentation, as Markdown."""
    from pdhe.verification.page import as_html, as_markdown, read_reports
    from pdhe.wholefile import copy

    reports = read_reports(arguments.folders)
    write(arguments.out, as_html(reports), _made_by("pdhe.verification.page", arguments.command))
    if arguments.docs:
        figures_folder = arguments.docs / "verification"
        figures_folder.mkdir(parents=True, exist_ok=True)
        write(arguments.docs / "verification.md", as_markdown(reports, "verification"))
        for report in reports:
            if report["figure"]:
                copy(report["figure"], figures_folder / f"{report['topic']}.png")


def verdict(arguments: argparse.Namespace) -> None:
    """Fail, naming every comparison that does not hold, unless all topics or groups of extremes pass."""
    from pdhe.verification.page import failures, read_reports

    failed = failures(read_reports(arguments.folders))
    if failed:
        raise PdheError("comparisons that do not hold:\n  " + "\n  ".join(failed))
    write(arguments.out, "every comparison holds\n")


def benchmark(arguments: argparse.Namespace) -> None:
    """Run one benchmark and write its table, figure, samples and machine."""
    from pdhe.benchmarks.registry import BENCHMARKS, write_benchmark

    report = write_benchmark(arguments.name, read_object(arguments.settings, "--settings"), arguments.out)
    _stamp_tables(arguments.out, BENCHMARKS[arguments.name], arguments.command)
    judged = [row for row in report.rows if row.kind != "shown"]
    print(f"{report.title}: {sum(row.passed for row in judged)} of {len(judged)} counts hold", file=sys.stderr)


def benchmark_page(arguments: argparse.Namespace) -> None:
    """Gather benchmarks as one JSON file, one page and, where asked, tables in Markdown."""
    from pdhe.benchmarks.page import as_html, as_markdown, gather

    content = gather(arguments.folders)
    write(arguments.json, json.dumps(content, indent=1) + "\n")
    write(arguments.out, as_html(content, arguments.folders), _made_by("pdhe.benchmarks.page", arguments.command))
    if arguments.markdown:
        write(arguments.markdown, as_markdown(content))


def benchmark_compare(arguments: argparse.Namespace) -> None:
    """Print the ratios of two runs of the benchmarks."""
    from pdhe.benchmarks.page import compare

    old, new = (read_object(path.read_text(encoding="utf-8"), str(path)) for path in (arguments.old, arguments.new))
    for line in compare(old, new):
        print(line)


def trade(arguments: argparse.Namespace) -> None:
    """Run one scene of a design with all its settings and write errors and costs."""
    from pdhe.tradeoff.design import load_design
    from pdhe.tradeoff.measure import measure

    trades = load_design(arguments.design)
    if arguments.scene not in trades:
        raise PdheError(f"{arguments.design}: no scene '{arguments.scene}'; there are {', '.join(trades)}")
    measure(trades[arguments.scene], progress).write(arguments.out)
    _stamp_tables(arguments.out, "pdhe.tradeoff.measure", arguments.command)


def tradeoff_page(arguments: argparse.Namespace) -> None:
    """Gather the scenes of a design: pictures of work and of other costs, one table and one page."""
    from pdhe.tradeoff.page import as_csv, as_html, as_markdown, draw, draw_costs, gather, models_of

    scenes = gather(arguments.folders)
    draw(scenes, ready(arguments.picture))
    draw_costs(scenes, ready(arguments.costs))
    made = _made_by("pdhe.tradeoff.page", arguments.command)
    write(arguments.csv, as_csv(scenes), made)
    write(arguments.out, as_html(scenes, (arguments.picture, arguments.costs)), made)
    if arguments.markdown:
        write(arguments.markdown, as_markdown(scenes))
    if arguments.models:
        write(arguments.models, json.dumps(models_of(scenes), indent=1) + "\n")


def extremes(arguments: argparse.Namespace) -> None:
    """Run one group of extreme cases and write its table and verdict."""
    from pdhe.extremes.outcome import run_group
    from pdhe.extremes.registry import EXTREMES

    report = run_group(arguments.group)
    report.write(arguments.out)
    _stamp_tables(arguments.out, EXTREMES[arguments.group], arguments.command)
    print(f"{report.title}: {report.text}", file=sys.stderr)


def extremes_page(arguments: argparse.Namespace) -> None:
    """Gather groups of extreme cases as a map, a table and a page."""
    from pdhe.extremes.page import as_html, as_markdown, gather, write_map, write_table
    from pdhe.stamps import stamp
    from pdhe.wholefile import copy

    reports = gather(arguments.folders)
    write_map(reports, ready(arguments.map))
    write_table(reports, ready(arguments.table))
    made = _made_by("pdhe.extremes.page", arguments.command)
    stamp(arguments.table, made)
    write(arguments.out, as_html(reports, arguments.map), made)
    if arguments.docs:
        write(arguments.docs / "extremes.md", as_markdown(reports, "images/extremes.png"))
        copy(arguments.map, ready(arguments.docs / "images" / "extremes.png"))
