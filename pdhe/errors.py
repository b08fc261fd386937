"""Errors that a user can act on: each names the place, the value and what would have worked."""

LONGEST = 300
"""Characters of a value that a message shows."""


class PdheError(Exception):
    """Base of every error that pdhe raises on purpose; the command line prints it without a traceback."""


class SceneError(PdheError):
    """A scene, study or material file asks for something that cannot be done.

    Parameters
    ----------
    file
        Path of the file as the user gave it.
    key
        Dotted key inside the file, for example ``material.youngs_modulus``; empty for the file as a whole.
    value
        The offending value; ``None`` when there is none to show.
    problem
        What is wrong, in one clause.
    hint
        What would have worked.
    """

    def __init__(self, file: str, key: str, value: object, problem: str, hint: str = "") -> None:
        self.file, self.key, self.value, self.problem, self.hint = str(file), key, value, problem, hint
        where = f"{self.file}: " + (f"key '{key}': " if key else "")
        got = f" (got {_shown(value)})" if value is not None else ""
        text = f"{where}{problem}{got}" + (f"; {hint}" if hint else "")
        # One line, whatever a file holds, and nothing that a terminal acts on.
        super().__init__("".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text))


def _shown(value: object) -> str:
    """Write a value so that a message stays readable."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # numbers of thousands of digits, for one
        return "a value too large to show"
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


class Interrupted(KeyboardInterrupt):
    """A run was told to end: not an error of the run, so that nothing that handles errors takes it for one.

    Parameters
    ----------
    text
        What is kept, and how to go on.
    status
        Exit status for the process: 128 and the number of the signal.
    """

    def __init__(self, text: str, status: int) -> None:
        self.status = status
        super().__init__(text)


class SimulationError(PdheError):
    """A run cannot go on; the message names time, step, node and bond.

    Parameters
    ----------
    text
        What went wrong.
    node
        Where, if known.
    """

    def __init__(self, text: str, node: int | None = None) -> None:
        self.node = node
        super().__init__(text)
