"""Compiled user materials in scenes: their block, the digest that their files are known by, what they go with.

Pure Python, as all that reads a scene; :mod:`pdhe.histories` compiles, loads and tries them.
"""

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, ValidationInfo, model_validator

from pdhe import scene_fields as fields
from pdhe import units
from pdhe.errors import SceneError
from pdhe.scene_fields import Block, Reading, number, problem
from pdhe.yamlfile import find_file, is_file

if TYPE_CHECKING:
    from pdhe.scene import Scene

SOURCES = (".c", ".f", ".for", ".f90")
"""Endings of sources that can be compiled."""
MOST_STATES, MOST_PROPERTIES = 1000, 10_000
DIGITS = 16
"""Hexadecimal digits of the digest of a user material."""
_INCLUDED = re.compile(
    rb"""^\s*(?:#\s*include\s*"([^"\n]+)"|include\s*['"]([^'"\n]+)['"])""", re.MULTILINE | re.IGNORECASE
)


def _read_property(value: Any, info: ValidationInfo) -> float:
    """Read a number, or a quantity of whatever kind, which becomes one of SI."""
    if isinstance(value, str) and not fields.is_si(info):
        try:
            return number(units.measure(value)[0], info)
        except units.QuantityError as error:
            raise problem(error.problem, error.hint) from None
    return number(value, info)


def _read_state_name(value: Any, info: ValidationInfo) -> str:
    if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z0-9_]{1,40}", value) or value == "variables":
        raise problem("is not a usable name", "use up to 40 letters, digits and underscores")
    return value


def _read_states(value: Any) -> Any:
    """Read a count of nameless variables, or a list of names and blocks."""
    if isinstance(value, bool | float | str):
        raise problem("must be a number of state variables or a list of them", "for example `[plastic_strain]`")
    if isinstance(value, int):
        if not 0 <= value <= MOST_STATES:
            raise problem(f"must be between 0 and {MOST_STATES}", "write a whole number in that range")
        value = [str(k + 1) for k in range(value)]
    return [{"name": item} if isinstance(item, str) else item for item in fields.as_list(value)]


Property = Annotated[
    float,
    Reading(_read_property, {"anyOf": [{"type": "number"}, {"type": "string", "pattern": units.QUANTITY_PATTERN}]}),
]
StateName = Annotated[str, Reading(_read_state_name, {"type": "string", "pattern": "^[A-Za-z0-9_]{1,40}$"})]


class StateVariable(Block):
    """A state variable: its name in results, its unit there, and its value at the start, in that unit."""

    name: StateName
    unit: fields.Text = "1"
    initial: Property = 0.0


class Umat(Block):
    """An Abaqus user material: a source to compile or a compiled library, and what it is given.

    ``name`` is what the routine is told (CMNAME), ``symbol`` that of the routine in the library. ``properties`` are
    numbers, or quantities, which become SI. ``content`` is the digest of the file: it is found by the program; where it
    is given, it must be right.
    """

    source: fields.Text | None = None
    library: fields.Text | None = None
    name: fields.Text = "MATERIAL"
    symbol: fields.Text = "umat_"
    properties: Annotated[tuple[Property, ...], BeforeValidator(fields.as_list)] = ()
    states: Annotated[tuple[StateVariable, ...], BeforeValidator(_read_states)] = ()
    content: fields.Text | None = None

    @model_validator(mode="after")
    def _fits(self) -> "Umat":
        if (self.source is None) == (self.library is None):
            raise problem("needs either `source` or `library`", f"a source is a {', '.join(SOURCES)}, a library a .so")
        if self.source is not None and Path(self.source).suffix.lower() not in SOURCES:
            hint = f"a source is a {', '.join(SOURCES)}; give what is compiled already as `library`"
            raise problem("cannot be compiled", hint, "source")
        if not re.fullmatch(r"[A-Za-z][!-~]{0,79}", self.name):
            raise problem("is not the name of a material", "a letter first, then up to 79 ASCII without blanks", "name")
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.$]{0,199}", self.symbol):
            raise problem("is not the name of a routine", "for example `umat_`", "symbol")
        for key, most in (("properties", MOST_PROPERTIES), ("states", MOST_STATES)):
            if len(getattr(self, key)) > most:
                raise problem(f"are {len(getattr(self, key))}, more than {most}", "give fewer", key)
        names = [state.name for state in self.states]
        for k, name in enumerate(names):
            if name in names[:k]:
                raise problem("is listed twice", "give every state variable a name of its own", f"states.{k}.name")
        return self


def content_of(path: str | Path) -> str:
    """Return the digest of a source, of the files beside it that it includes and of its kind; or that of a library.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    total, path = hashlib.sha256(), Path(path)
    if path.suffix.lower() not in SOURCES:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:DIGITS]
    total.update(path.suffix.lower().encode())
    seen, waiting = {path.resolve()}, [path]
    while waiting:
        text = waiting.pop(0).read_bytes()
        total.update(b"%d\0" % len(text) + text)
        for names in _INCLUDED.findall(text):
            # What is not there comes with the compiler, or is `ABA_PARAM.INC`.
            other = path.parent / (names[0] or names[1]).decode("utf-8", "replace")
            if is_file(other) and other.resolve() not in seen:
                seen.add(other.resolve())
                waiting.append(other)
    return total.hexdigest()[:DIGITS]


def find_files(raw: Mapping[str, Any], file: str) -> None:
    """Find the file of the user material of a scene as it is written, if it has one, and note its digest, in place.

    Raises
    ------
    SceneError
        If it is not there, cannot be read, or is not the one that the scene says it is.
    """
    material = raw.get("material")
    umat = material.get("umat") if isinstance(material, dict) else None
    if not isinstance(umat, dict):
        return
    for key in ("source", "library"):
        if not isinstance(umat.get(key), str):
            continue
        where, found = f"material.umat.{key}", find_file(umat[key], [file])
        if not is_file(found):
            hint = "give its path from where you start, from the scene's folder, or from one above it"
            raise SceneError(file, where, umat[key], "is not a file", hint)
        try:
            content = content_of(found)
        except OSError as error:
            raise SceneError(file, where, umat[key], f"cannot be read: {error.strerror}", "") from error
        if umat.get("content") not in (None, content):
            hint = "leave `content` out, or take back the file that was meant"
            raise SceneError(
                file, "material.umat.content", umat["content"], f"is not that of {umat[key]}, {content}", hint
            )
        umat |= {key: found, "content": content}


def identity_of(umat: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a solution depends on: all of the resolved block but the place of the file."""
    return {key: value for key, value in umat.items() if key not in ("source", "library")}


def numbers_of(states: int, plane: str | None) -> tuple[int, int]:
    """Numbers of a node with so many state variables: in a result at every output, and in memory all the time."""
    axes, components = (3, 6) if plane is None else (2, 3 if plane == "stress" else 4)
    # The history, one trial beside it, and the tangent.
    return components + states, 2 * (axes**2 + components + states + 4) + components**2


def check_umat(scene: "Scene") -> None:
    """Refuse what user materials do not go with."""
    if scene.material.umat is None or scene.loads is None:
        return
    here, mechanics = "where the material is a user material", scene.mechanics
    if mechanics.model != "correspondence":
        hint = "use `mechanics: {model: correspondence}`"
        raise problem("has no deformation gradient, which a user material needs", hint, "mechanics.model")
    for found, key, text, hint in (
        (scene.material.orthotropic is not None, "material.orthotropic",
         "has no meaning beside `umat`, which has constants of its own", "leave one of them out"),
        (scene.solver.precision != "double", "solver.precision", f"must be double {here}", "leave it out"),
        (scene.accuracy is not None, "accuracy", f"has not been measured {here}", "give `mesh.spacing` instead"),
        (scene.stepping.mode != "fixed", "stepping.mode",
         "must be `fixed` for a user material, whose history goes forward in increments",
         "for example `stepping: {mode: fixed, load_steps: 20, diffusion_substeps: 1}`"),
        (scene.time.end <= 0.0, "time.end", "leaves no time for increments", "for example `1 s`"),
        (scene.damage is not None, "damage",
         "has no criterion for a user material: the energy of a bond is not what it could release once it has yielded",
         "leave `damage` out"),
    ):  # fmt: skip
        if found:
            raise problem(text, hint, key)
    for k, load in enumerate(scene.loads):
        for axis, given in load.components.items():
            if load.kind == "displacement" and given(0.0) != 0.0:
                hint = "let it begin at zero, for example `{0 s: 0 mm, 1 s: 0.01 mm}`"
                raise problem("is a jump at the start, before the first increment", hint,
                              f"loads.{k}.displacement.{'xyz'[axis]}")  # fmt: skip
