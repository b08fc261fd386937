"""Commands that turn results into pictures and tables."""

import argparse

from pdhe.commands.streams import read_object, ready, write
from pdhe.errors import PdheError

PICTURES = (".png", ".pdf", ".svg")
"""Kinds of files that a picture can be written to."""


def figures(arguments: argparse.Namespace) -> None:
    """Draw one picture of a result."""
    from pdhe.plotting import draw

    if arguments.out.suffix not in PICTURES:
        raise PdheError(f"{arguments.out}: pictures are written as {', '.join(PICTURES)}")
    draw(arguments.kind, arguments.result, read_object(arguments.style, "--style"), ready(arguments.out))


def animate(arguments: argparse.Namespace) -> None:
    """Draw one picture of a result as an animation over time."""
    from pdhe.plotting import animate as draw_animation

    draw_animation(arguments.kind, arguments.result, read_object(arguments.style, "--style"), ready(arguments.out))


def history(arguments: argparse.Namespace) -> None:
    """Write the curves over time as a table and draw them."""
    if not (arguments.out_csv or arguments.out_png):
        raise PdheError("nothing to write: give --out-csv, --out-png or both")
    if arguments.out_csv:
        from pdhe.post import history_table, source_of
        from pdhe.stamps import made_by

        made = made_by("pdhe.post", arguments.command, **source_of(arguments.result))
        write(arguments.out_csv, history_table(arguments.result), made)
    if arguments.out_png:
        from pdhe.plotting import draw_history

        draw_history(arguments.result, ready(arguments.out_png))
