"""Identity of parameters and of code."""

import importlib.metadata
import subprocess
import sys

import pytest

from pdhe import provenance
from pdhe.provenance import canonical, closure, digest, fingerprint, versions


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package of a few modules; returns a function that writes one of them."""
    root = tmp_path / "toy"
    (root / "sub").mkdir(parents=True)

    def write(name, text):
        (root / name).write_text(text)
        provenance._module.cache_clear()

    monkeypatch.setattr(provenance, "PACKAGE", root)
    write("__init__.py", '"""Toy."""\n')
    write("sub/__init__.py", "")
    write("sub/deep.py", "from ..leaf import f\n")
    write("leaf.py", 'def f():\n    """Say one."""\n    return 1  # one\n')
    write("alone.py", "value = 3\n")
    write("top.py", "def g():\n    from .sub import deep\n    return deep.f()\n")
    yield write
    provenance._module.cache_clear()


def test_numbers_of_equal_value_have_one_text():
    assert canonical({"b": (1.0, 2.5), "a": None}) == '{"a":null,"b":[1,2.5]}'
    assert digest({"a": 1.0}) == digest({"a": 1})
    assert digest({"a": 1.0}) != digest({"a": 1.0000000000000002})
    assert canonical(True) == "true" != canonical(1)


@pytest.mark.parametrize(("value", "error"), [(float("nan"), ValueError), (float("inf"), ValueError), ({1}, TypeError)])
def test_values_without_identity_are_refused(value, error):
    with pytest.raises(error):
        canonical({"x": value})


@pytest.mark.parametrize(
    "line",
    [
        "import toy.leaf",
        "import toy.leaf as renamed",
        "from toy import leaf",
        "from toy.leaf import f",
        "from . import leaf",
        "from .leaf import f",
        "def late():\n    import toy.leaf",
    ],
)
def test_every_form_of_import_is_followed(package, line):
    package("user.py", line + "\n")
    assert "toy.leaf" in closure("toy.user")


def test_imports_are_followed_through_packages_and_functions(package):
    assert closure("toy.top") == ("toy", "toy.leaf", "toy.sub", "toy.sub.deep", "toy.top")
    assert "toy.alone" in closure("toy.top", "toy.alone")


def test_type_checking_imports_do_not_count(package):
    package("user.py", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from toy import leaf\n")
    assert "toy.leaf" not in closure("toy.user")


def test_fingerprint_sees_code_and_nothing_else(package):
    before = fingerprint("toy.top")
    package("leaf.py", 'def f():\n    """Say one, reworded."""\n\n    return 1  # still one\n')
    package("alone.py", "value = 4\n")
    assert fingerprint("toy.top") == before
    package("leaf.py", "def f():\n    return 2\n")
    assert fingerprint("toy.top") != before


def test_unknown_module_is_an_error(package):
    with pytest.raises(FileNotFoundError, match=r"toy\.none"):
        fingerprint("toy.none")


def test_versions_name_the_dependencies():
    found = versions()
    assert found["numpy"] == importlib.metadata.version("numpy")
    assert {"pdhe", "numba", "snakemake"} <= set(found)


def test_analyses_are_kept_and_cannot_be_out_of_date(package, tmp_path, monkeypatch):
    file = tmp_path / "kept" / "fingerprints.json"
    monkeypatch.setattr(provenance._Analyses, "_file", staticmethod(lambda: file))
    monkeypatch.setattr(sys, "dont_write_bytecode", False)

    def fresh():
        """Fingerprint in a new process, and how many modules it took apart."""
        taken = []
        monkeypatch.setattr(provenance, "_KNOWN", provenance._Analyses())
        monkeypatch.setattr(provenance, "_analysis", lambda *a: taken.append(a) or analysis(*a))
        provenance._module.cache_clear()
        return fingerprint("toy.top"), len(taken)

    analysis = provenance._analysis
    first, count = fresh()
    assert count == len(closure("toy.top")) == 5
    assert fresh() == (first, 0)
    package("leaf.py", "def f():\n    return 2\n")
    second, count = fresh()
    assert second != first and count == 1
    package("leaf.py", 'def f():\n    """Say one."""\n    return 1  # one\n')
    assert fresh() == (first, 0)
    file.write_text("[1, 2")
    assert fresh() == (first, 5)
    assert fresh() == (first, 0)


def test_solve_loads_neither_xarray_nor_a_reader_of_meshes():
    slow = {"xarray", "pandas", "meshio", "gmsh", "matplotlib", "pint"}
    code = f"import sys, pdhe.simulation; assert not {slow} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
