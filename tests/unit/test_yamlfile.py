"""The YAML loader: plain words stay words, numbers are numbers, traps are refused with their line."""

import contextlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdhe.errors import SceneError
from pdhe.yamlfile import MAX_BYTES, parse_yaml, read_yaml


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("on", "on"),
        ("off", "off"),
        ("yes", "yes"),
        ("No", "No"),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("1e-5", 1e-5),
        ("1E5", 1e5),
        ("+.5", 0.5),
        ("3.", 3.0),
        ("-7", -7),
        ("010", 10),
        ("0x10", 16),
        ("0o10", 8),
        ("1_000", "1_000"),
        ("1:30:00", "1:30:00"),
        ("2025-05-04", "2025-05-04"),
        ("<<", "<<"),
        ("7 mm", "7 mm"),
        ("'1'", "1"),
        ("[0 mm, 50 mm]", ["0 mm", "50 mm"]),
    ],
)
def test_values(text, value):
    result = parse_yaml(f"key: {text}\n", "f")["key"]
    assert result == value
    assert type(result) is type(value)


def test_special_floats():
    data = parse_yaml("a: .inf\nb: -.inf\nc: .nan\n", "f")
    assert data["a"] == float("inf")
    assert data["b"] == -float("inf")
    assert data["c"] != data["c"]


def test_on_is_a_key():
    assert parse_yaml("{on: top}", "f") == {"on": "top"}


def test_few_aliases_are_fine():
    assert parse_yaml("a: &x {b: 1}\nc: *x\n", "f") == {"a": {"b": 1}, "c": {"b": 1}}


BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 9)
)


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        ("", "is empty"),
        ("# only a comment\n", "is empty"),
        ("- a\n- b\n", "holds a list, not a mapping"),
        ("just words", "holds a str, not a mapping"),
        ("a: 1\nb: 2\na: 3\n", "line 3, column 1: key 'a' is given twice, first on line 1"),
        ("x: {a: 1, a: 2}\n", "line 1, column 11: key 'a' is given twice"),
        ("a: b: c\n", "line 1, column 5"),
        ("a: [1, 2\n", "line 2"),
        ("a:\n\t- 1\n", "indent with spaces"),
        ("a: &a [*a]\n", "contains itself"),
        ("a: *b\n", "undefined alias"),
        ("a: !!python/object/apply:os.getcwd []\n", "has no meaning here"),
        ("a: !!binary aGk=\n", "has no meaning here"),
        ("a: !!int x\n", "not a whole number"),
        ("a: !!float x\n", "not a number"),
        ("a: !!map [1]\n", "mapping is expected"),
        ("a: 1\n---\nb: 2\n", "line 2"),
        ("[1]: 2\n", "a key must be plain text"),
        ("a: \x00\n", "cannot be read"),
        ("a: " + "[" * 5000, "nested too deeply"),
        ("a: " + "9" * 5000, "more than 100 digits"),
        (BOMB, "more than"),
        ("a: &x [" + "1, " * 5000 + "1]\nb: [" + "*x, " * 30 + "1]\n", "values"),
    ],
)
def test_refusals(text, fragment):
    with pytest.raises(SceneError) as caught:
        parse_yaml(text, "scene.yaml")
    assert str(caught.value).startswith("scene.yaml: ")
    assert fragment in str(caught.value)


def test_files(tmp_path):
    good = tmp_path / "good.yaml"
    good.write_bytes(b"\xef\xbb\xbfa: 1\r\n")  # byte order mark and Windows line ends
    assert read_yaml(good) == {"a": 1}
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(b"a: 1\ntitle: \xe9\n")
    large = tmp_path / "large.yaml"
    large.write_bytes(b"#" * (MAX_BYTES + 1))
    for path, fragment in [
        (tmp_path / "none.yaml", "does not exist"),
        (tmp_path, "cannot be opened"),
        (latin, "is not UTF-8 text (line 2)"),
        (large, "is larger than"),
        ("with\0nul", "cannot be opened"),
    ]:
        with pytest.raises(SceneError) as caught:
            read_yaml(path)
        assert fragment in str(caught.value)
        assert str(path).replace("\0", "\\x00") in str(caught.value)


@given(st.binary(max_size=60) | st.text(alphabet="ab:-[]{}&*!|>'\"#%@,?~0.e\n \t<=", max_size=40).map(str.encode))
@settings(max_examples=150, deadline=None)
def test_any_bytes_give_a_mapping_or_the_error(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("yaml") / "x.yaml"
    path.write_bytes(content)
    with contextlib.suppress(SceneError):
        assert isinstance(read_yaml(path), dict)
