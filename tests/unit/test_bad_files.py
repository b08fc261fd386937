"""Files that are wrong in any way: one message, an exit status, no traceback, and no file appears.

Hypothesis takes good files apart and puts hostile values into them. The draws are the same in every run. A draw takes
about 15 ms: thousands of each kind (``--slow``) are a matter of minutes.
"""

import copy
import json
import math
import shutil
import tempfile
import traceback
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from pdhe import cli
from pdhe.benchmarks.registry import configured
from pdhe.errors import PdheError
from pdhe.plotting.style import Style
from pdhe.scene import load_scene, scene_json_schema
from pdhe.study import CONFIG_KEYS, STUDY_KEYS, STYLE_KEYS, load_aside, load_studies
from pdhe.tradeoff.design import load_trades
from pdhe.verification.studies import load_checks
from pdhe.yamlfile import parse_yaml, read_yaml
from tests.every_key import SCENES as EVERY_KEY

ROOT = Path(__file__).parents[2]
FUZZ = {
    "deadline": None, "derandomize": True, "database": None, "suppress_health_check": list(HealthCheck),
    # Failures are gathered, not raised: there is nothing to replay, to shrink or to explain.
    "phases": [Phase.generate],
}  # fmt: skip

NEWER = [parse_yaml(text, "newer") for text in EVERY_KEY]
SCENES = [read_yaml(path) for path in sorted((ROOT / "config/scenes").glob("*.yaml"))] + NEWER
MATERIALS = [read_yaml(path) for path in sorted((ROOT / "config/materials").glob("*.yaml"))]
STUDY = {
    "study": {
        "name": "good",
        "scene": "scene.yaml",
        "set": {"time.end": "1e6 s"},
        "sweep": {"mesh.spacing": ["5 mm", "10 mm"], "solver.tolerance": [1e-5, 1e-6]},
        "cases": {"wet": {}, "dry": {"hydrogen": None}},
        "figures": {"animations": False, "pictures": ["damage"], "dpi": 100, "times": ["1 h"]},
    }
}
CHECK = {"check": {"topic": "moduli", "settings": {"spacing": 0.01}}}
DESIGN = read_yaml(ROOT / "config/studies/tradeoff.yaml")
CONFIG = {
    "studies": ["study.yaml"], "figures": {"dpi": 100}, "verification": ["check.yaml"], "verification_docs": "docs",
    "tradeoff": "design.yaml", "dynamics": "aside.yaml", "benchmarks": {"startup": {}, "scaling": {"nodes": [5000]}},
}  # fmt: skip
STYLE = {
    "times": ["1 h"], "panels": 3, "dpi": 100, "width": 85, "font_size": 7, "damage_map": "viridis",
    "coverage_map": "magma", "displacement_map": "RdBu", "state": "age", "state_map": "magma",
    "damage_limit": 0.4, "component": "x", "magnification": 10,
    "window": [0, 1, 0, "40 mm"], "frames": 10, "frame_width": 400, "duration": 3, "hold": 1,
}  # fmt: skip

#: Words of the schema: some of them fit where they are put, and not with what stands elsewhere.
WORDS = sorted({word for block in scene_json_schema()["$defs"].values() for item in block["properties"].values()
                for word in item.get("enum", ())})  # fmt: skip

deep = [[]]
for _ in range(60):
    deep = [deep]
# All but surrogates, without the table of them all that takes seconds to make.
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
HOSTILE = st.one_of(
    st.sampled_from(
        [
            None, True, False, 0, -1, 10**30, -(10**400), 1e308, 5e-324, math.nan, math.inf, -math.inf, "", " ", "1e-5",
            "on", "off", "yes", "~", "nan", "inf mm", "-7 mm", "0 mm", "1e999 m", "7", "7 mmm", "7 s", "7 mm mm", "mm",
            "1e5 mm", "1e-30 mm", "7 mm; rm -rf .", "$(touch x)", "`touch x`", "../../etc/passwd", "a\tb",
            "a\nb", "Ä ö ü ß", "𝔘", "\u202e", "x" * 5000, "%s %n", "{0}", "__import__('os')", "!!python/object:x", "*a",
            "&a", "<<", "7 mm^99999999", "7 m**m**m", "7 (m", "7 meter/0", "9" * 400 + " mm", "1e99999999 m",
            [], [[]], deep, {}, {"": 1}, {"a": {"b": {}}}, {"x": "1 mm"}, [1, 2], ["1 mm", "2 mm"], [None], [{}],
            {"0 h": "0 mm", "1 h": "1 mm"}, {"0 h": 0, "1 h": 1}, {"1 h": "1 mm", "0 h": "0 mm"}, {"times": [0]},
        ]
    ),
    st.sampled_from(WORDS),
    TEXT,
    st.integers(-(10**6), 10**6),
    st.floats(),
).map(copy.deepcopy)  # fmt: skip
KEYS = st.one_of(
    st.sampled_from(["", " ", "on", "scene", "geometry", "time", "x", "a.b", "0", "loads.0.on", "__class__", "a\nb"]),
    st.sampled_from(sorted({name for block in scene_json_schema()["$defs"].values() for name in block["properties"]})),
    TEXT,
)  # fmt: skip


def places(value, path=()):
    """Every place of a nested value."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from places(item, (*path, key))


@st.composite
def spoilt(draw, good):
    """A good mapping with one to three things wrong."""
    value = copy.deepcopy(draw(st.sampled_from(good)))
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(sorted(places(value), key=str)))
        if not path:
            value[draw(KEYS)] = draw(HOSTILE)
            continue
        parent = value
        for key in path[:-1]:
            parent = parent[key]
        last, what = path[-1], draw(st.sampled_from(["set", "set", "set", "remove", "rename", "wrap", "double", "add"]))
        if what == "set":
            parent[last] = draw(HOSTILE)
        elif what == "remove":
            del parent[last]
        elif what == "wrap":
            parent[last] = [parent[last]]
        elif isinstance(parent, list):
            parent.append(copy.deepcopy(parent[last]) if what == "double" else draw(HOSTILE))
        else:
            item = parent[last] if what == "double" else parent.pop(last) if what == "rename" else draw(HOSTILE)
            parent[draw(KEYS)] = copy.deepcopy(item)
        if not value:
            break
    return value


@st.composite
def garbled(draw, texts):
    """The bytes of a good file with something wrong in them."""
    content = draw(st.sampled_from(texts)).encode()
    place = draw(st.integers(0, len(content) - 1))
    what = draw(st.sampled_from(["flip", "cut", "insert", "repeat", "encode", "bomb", "tag", "alias"]))
    if what == "flip":
        return content[:place] + bytes([content[place] ^ 1 << draw(st.integers(0, 7))]) + content[place + 1 :]
    if what == "cut":
        return content[:place]
    if what == "insert":
        odd = [
            b"\0", b"\t", b"\xff", b"\xef\xbb\xbf", b"\x85", b"\xe2\x80\xa8", b": ", b"- ", b"{", b"]", b'"', b"'",
            b"|", b"#", b"%", b"\x1b[31m", b"\n---\n", b"\n...\n", b'"\\ud800"', b'"\\0"', b"? ", b"\r",
        ]  # fmt: skip
        return content[:place] + draw(st.sampled_from(odd)) + content[place:]
    lines = content.splitlines(keepends=True)
    if what == "repeat":
        line = draw(st.integers(0, len(lines) - 1))
        return b"".join([*lines[:line], lines[line], *lines[line:]])
    if what == "encode":
        return content.decode().encode(draw(st.sampled_from(["utf-16", "utf-32", "utf-8-sig", "utf-16-le"])))
    if what == "bomb":
        levels = "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
        return b"a0: &a0 [x]\n" + levels.encode() + content
    if what == "tag":
        return content.replace(b": ", b": !!python/object/apply:os.system ", draw(st.integers(1, 3)))
    return content.replace(b": ", b": &a ", 1).replace(b"\n", b"\nz: *a\n", 1)


def outcome(*words):
    """Status, standard output and standard error of a command."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = cli.main([str(word) for word in words])
    return status, out.getvalue(), err.getvalue()


def refused(words, folder):
    """Run a command on a file: whether it was refused, which is one message and no file."""
    before = sorted(folder.rglob("*"))
    status, out, err = outcome(*words)
    assert sorted(folder.rglob("*")) == before
    if status == 0:
        assert not err
        return False
    assert status == 1 and not out, (status, out)
    assert err.startswith("error: ") and err.count("\n") == 1 and len(err) < 3000, err
    assert "Traceback" not in err and "\x1b" not in err
    return True


def dumped(value):
    """YAML of a value, or None where YAML has no way to write it."""
    try:
        return yaml.safe_dump(value, allow_unicode=True, sort_keys=False)
    except (yaml.YAMLError, ValueError):
        return None


@pytest.fixture(scope="module")
def folder():
    with tempfile.TemporaryDirectory(prefix="bad files ä ") as name:
        place = Path(name, "scenes")
        place.mkdir()
        (place.parent / "materials").mkdir()
        for path in (ROOT / "config/materials").glob("*.yaml"):
            (place.parent / "materials" / path.name).write_bytes(path.read_bytes())
        yield place


def draws(count):
    """A few draws with every run of the tests, many with ``--slow``."""
    return pytest.mark.parametrize("count", [count, pytest.param(20 * count, marks=pytest.mark.slow)])


def check(strategy, count, look):
    """Look at so many draws; how many were refused. One failure of every kind is shown, none hides another."""
    seen, failures = [], {}

    @given(strategy)
    @settings(max_examples=count, **FUZZ)
    def every(value):
        try:
            seen.append(look(value))
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            kind = f"{type(error).__name__} at {place.filename}:{place.lineno}"
            failures.setdefault(kind, f"{kind}: {str(error)[:600]}; of {value!r:.2000}")

    every()
    assert not failures, "\n".join(failures.values())
    return sum(filter(None, seen)), len(seen)


def write(path, value):
    """Write a draw; whether it could be written."""
    content = value if isinstance(value, bytes) else dumped(value)
    if content is None:
        return False
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))
    return True


def test_scenes_that_are_spoilt_are_good(folder):
    """That they have every key there is: tests/quality/test_keys.py."""
    for scene in NEWER:
        assert write(folder / "scene.yaml", scene) and not refused(["validate", folder / "scene.yaml"], folder)


@draws(150)
def test_spoilt_scenes(count, folder):
    def look(value):
        file = folder / "scene.yaml"
        if not write(file, value):
            return None
        bad = refused(["validate", file], folder)
        if bad:
            # What validate refuses, nothing runs: and at no other cost.
            for words in (["run", file, "--out", folder / "x" / "result.nc"], ["plan", file]):
                (folder / "x").mkdir(exist_ok=True)
                assert refused(words, folder), words
        return bad

    texts = [path.read_text() for path in sorted((ROOT / "config/scenes").glob("*.yaml"))] + EVERY_KEY
    bad, seen = check(st.one_of(spoilt(SCENES), garbled(texts)), count, look)
    assert bad > 0.4 * seen


@draws(60)
def test_spoilt_materials(count, folder):
    scene = {**SCENES[0], "material": "own"}
    (folder / "scene.yaml").write_text(dumped(scene))

    def look(value):
        own = folder.parent / "materials/own.yaml"
        return write(own, value) and refused(["validate", folder / "scene.yaml"], folder)

    texts = [path.read_text() for path in sorted((ROOT / "config/materials").glob("*.yaml"))]
    bad, seen = check(st.one_of(spoilt(MATERIALS), garbled(texts)), count, look)
    (folder.parent / "materials/own.yaml").unlink()
    assert bad > 0.3 * seen


@draws(60)
def test_spoilt_studies_checks_and_designs(count, folder):
    (folder / "scene.yaml").write_text((ROOT / "config/scenes/smoke.yaml").read_text())

    def look(value):
        return write(folder / "study.yaml", value) and refused(["validate", folder / "study.yaml"], folder)

    texts = [dumped(value) for value in (STUDY, STUDY, CHECK, DESIGN)]
    bad, seen = check(st.one_of(spoilt([STUDY, STUDY, CHECK, DESIGN]), garbled(texts)), count, look)
    assert bad > 0.3 * seen


@draws(60)
def test_spoilt_descriptions_of_stages(count, folder):
    resolved = [load_scene(ROOT / f"config/scenes/{name}.yaml").resolved() for name in ("smoke", "inclined_crack")]
    for scene in NEWER:
        write(folder / "scene.yaml", {**scene, "accuracy": None})
        resolved.append(load_scene(folder / "scene.yaml").resolved())

    def look(value):
        try:
            spec = json.dumps(value)
        except (ValueError, TypeError):
            return None
        words = ["--spec", spec, "--nodes", folder / "none.nc", "--out", folder / "x" / "r.nc"]
        (folder / "x").mkdir(exist_ok=True)
        assert refused(["solve", *words], folder)
        return True

    check(spoilt(resolved), count, look)


@draws(60)
def test_spoilt_configurations_and_styles(count, tmp_path, monkeypatch):
    readers = (load_studies, load_aside, load_checks, load_trades, configured)
    monkeypatch.chdir(tmp_path)
    for part in ("scenes", "materials"):
        shutil.copytree(ROOT / "config" / part, tmp_path / "config" / part)
    (tmp_path / "scene.yaml").write_text((ROOT / "config/scenes/smoke.yaml").read_text())
    aside = {"study": {**STUDY["study"], "name": "aside"}}
    for name, value in (("study", STUDY), ("aside", aside), ("check", CHECK), ("design", DESIGN)):
        (tmp_path / f"{name}.yaml").write_text(dumped(value))
    assert {*CONFIG, "study", "check"} == {*CONFIG_KEYS} and {*STYLE} == {*STYLE_KEYS}
    assert {*STUDY["study"]} == {*STUDY_KEYS}
    for function in readers:
        function(CONFIG)

    def look(value):
        read = readers if "studies" in value or "dpi" not in value else (Style.of,)
        told = 0
        for function in read:
            try:
                function(value)
            except PdheError as error:
                assert function == Style.of or "\n" not in str(error)
                told += 1
        return told > 0

    check(spoilt([CONFIG, STYLE]), count, look)
