"""Values as formulas of place: text to arrays, by a walk over the syntax tree that knows a few operations only.

Nothing is evaluated as code. A formula is arithmetic with x, y and z, and the functions of :data:`FUNCTIONS`.
"""

from __future__ import annotations

import ast
import math
import re
import warnings

import numpy as np

from pdhe.errors import PdheError

LONGEST, MOST_PARTS = 500, 200
"""Most characters of a formula, and most parts of its tree, which its walk is not deeper than."""
PLACES = ("x", "y", "z")
"""Coordinates of a node, m."""
FUNCTIONS = {
    "abs": (np.abs, 1), "acos": (np.arccos, 1), "asin": (np.arcsin, 1), "atan": (np.arctan, 1),
    "atan2": (np.arctan2, 2), "cos": (np.cos, 1), "cosh": (np.cosh, 1), "exp": (np.exp, 1), "hypot": (np.hypot, 2),
    "log": (np.log, 1), "max": (np.maximum, 2), "min": (np.minimum, 2), "sin": (np.sin, 1), "sinh": (np.sinh, 1),
    "sqrt": (np.sqrt, 1), "tan": (np.tan, 1), "tanh": (np.tanh, 1),
    "where": (lambda condition, yes, no: np.where(condition != 0.0, yes, no), 3),
}  # fmt: skip
"""Functions by name, and how many values they take. ``where(x < 0.1, 1, 2)`` is 1 where the condition holds, else 2."""
_OPERATIONS = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide, ast.Pow: np.power,
    ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater, ast.GtE: np.greater_equal,
}  # fmt: skip
_CHARACTERS = re.compile(r"[0-9A-Za-z_+\-*/()., <>=]+")
_KNOWN = f"known are x, y, z in metres, pi, + - * / **, < <= > >=, and {', '.join(FUNCTIONS)}"


class FormulaError(PdheError, ValueError):
    """Text that is not a formula; ``problem`` and ``hint`` are the two clauses of a message."""

    def __init__(self, problem: str, hint: str = _KNOWN) -> None:
        self.problem, self.hint = problem, hint
        super().__init__(f"{problem}; {hint}")


def value_at(text: str, place: np.ndarray) -> np.ndarray:
    """Value of a formula at some places.

    Parameters
    ----------
    text
        The formula, for example ``"0.3 + 20*x*(0.1 - y)"``.
    place
        Points, m (k, 2) or (k, 3).

    Returns
    -------
    numpy.ndarray
        (k,); infinite or not a number where the formula is.

    Raises
    ------
    FormulaError
        If the text is not a formula of so many coordinates.
    """
    names = dict(zip(PLACES, np.asarray(place, float).T, strict=False))
    with np.errstate(all="ignore"):
        value = _walk(_tree(text), names)
    return np.broadcast_to(np.asarray(value, float), (len(place),)).copy()


def coordinates_of(text: str) -> set[str]:
    """Those of :data:`PLACES` that a formula names; :class:`FormulaError` if it is none."""
    tree = _tree(text)
    with np.errstate(all="ignore"):
        _walk(tree, dict.fromkeys(PLACES, np.float64(0.5)))
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} & set(PLACES)


def _tree(text: str) -> ast.expr:
    text = text.strip()
    if not text or len(text) > LONGEST:
        raise FormulaError(f"is not a formula of 1 to {LONGEST} characters", "write it shorter")
    if "^" in text:
        raise FormulaError("has a ^", "write powers with **, for example `x**2`")
    if not _CHARACTERS.fullmatch(text):
        strange = _CHARACTERS.sub("", text)[:1]
        raise FormulaError(f"has the character {strange!r}, which no formula has")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # of text such as `1if`, which is refused below
            tree = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise FormulaError("is not a formula", "for example `0.3 + 20*x*(0.1 - y)`, with x and y in metres") from None
    if sum(1 for _ in ast.walk(tree)) > MOST_PARTS:
        raise FormulaError(f"has more than {MOST_PARTS} parts", "write it shorter")
    return tree


def _walk(node: ast.expr, names: dict[str, np.ndarray]) -> np.ndarray:
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            try:
                return np.float64(value)
            except OverflowError:
                raise FormulaError("has a number that is too large", "write a smaller one") from None
        case ast.Name(id="pi"):
            return np.float64(math.pi)
        case ast.Name(id=name) if name in names:
            return names[name]
        case ast.Name(id=name) if name in PLACES:
            raise FormulaError(f"asks for {name} in the plane", "there are x and y")
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return np.negative(_walk(operand, names))
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _walk(operand, names)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATIONS:
            return _OPERATIONS[type(op)](_walk(left, names), _walk(right, names))
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _OPERATIONS:
            return np.asarray(_OPERATIONS[type(op)](_walk(left, names), _walk(right, names)), float)
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
            function, count = FUNCTIONS[name]
            if len(args) != count:
                raise FormulaError(f"gives `{name}` {len(args)} values", f"it takes {count}")
            return function(*(_walk(item, names) for item in args))
    text = ast.unparse(node)
    raise FormulaError(f"has `{text if len(text) <= 40 else text[:37] + '...'}`, which no formula has")
