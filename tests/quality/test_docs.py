"""The documentation agrees with the code: equation numbers, links, code, keys."""

import ast
import importlib
import itertools
import re
import textwrap
from pathlib import Path

import pytest
import yaml

from pdhe import scene_blocks
from pdhe.cli import _parser
from pdhe.damage import CRITERIA
from pdhe.embrittlement import LAWS
from pdhe.fields import FIELDS
from pdhe.materials import MODELS
from pdhe.scene import Scene, load_scene, scene_json_schema
from pdhe.scene_fields import Block
from pdhe.study import STYLE_KEYS
from pdhe.transport import KERNELS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", *DOCS.glob("*.md")])
SOURCES = sorted([*(ROOT / "pdhe").rglob("*.py"), *(ROOT / "tests").rglob("*.py")])
NUMBER = r"\d+\.\d+"
CITATION = re.compile(rf"[Tt]heory,\s+eqs?\.\s+({NUMBER}(?:(?:,| and| to|, and)\s+{NUMBER})*)")


def text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def equations() -> list[str]:
    return re.findall(rf"\\tag\{{({NUMBER})\}}", text(DOCS / "theory.md"))


def key(number: str) -> tuple[int, ...]:
    return tuple(map(int, number.split(".")))


def cited(path: Path) -> set[str]:
    """Equations that a file refers to; ``2.5 to 2.7`` stands for all in between."""
    found = set()
    for match in CITATION.finditer(re.sub(r"\n\s*#?:?\s*", " ", text(path))):
        found.update(re.findall(NUMBER, match[1]))
        for first, last in re.findall(rf"({NUMBER}) to ({NUMBER})", match[1]):
            (chapter, low), (other, high) = key(first), key(last)
            assert chapter == other and low < high, f"{path}: {first} to {last}"
            found.update(f"{chapter}.{k}" for k in range(low, high + 1))
    return found


def blocks(path: Path, language: str) -> list[str]:
    """Fenced code blocks of a page in a language."""
    found = re.findall(rf"^ *```{language}\n(.*?)^ *```$", text(path), re.MULTILINE | re.DOTALL)
    return [textwrap.dedent(block) for block in found]


def prose(path: Path) -> str:
    """A page without its code blocks."""
    return re.sub(r"^ *```.*?^ *```$", "", text(path), flags=re.MULTILINE | re.DOTALL)


def anchors(path: Path) -> set[str]:
    """Names of the headings of a page, as they stand in links."""
    headings = re.findall(r"^#+ (.*)$", prose(path), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_equations_are_numbered_once_and_in_order():
    numbers = equations()
    assert len(numbers) > 35
    assert numbers == sorted(set(numbers), key=key)


def test_equations_that_the_code_cites_exist():
    known, seen = set(equations()), set()
    for path in SOURCES:
        wanted = cited(path)
        assert wanted <= known, f"{path}: {sorted(wanted - known)}"
        seen |= wanted
    assert {"2.2", "2.3", "2.6", "2.7", "3.4", "4.6", "5.4"} <= seen


def test_equations_that_the_documentation_cites_exist():
    known = set(equations())
    for path in PAGES:
        for group in re.findall(rf"\beqs?\.\s+({NUMBER}(?:(?:,| and| to)\s+{NUMBER})*)", prose(path)):
            assert set(re.findall(NUMBER, group)) <= known, f"{path}: {group}"


def test_sections_that_the_code_cites_exist():
    sections = set(re.findall(r"^## (\d+)\. ", text(DOCS / "theory.md"), re.MULTILINE))
    for path in SOURCES:
        flat = re.sub(r"\s+", " ", text(path))
        assert set(re.findall(r"[Tt]heory, section (\d+(?:\.\d+)*)", flat)) <= sections, path
        assert not re.findall(r"[Tt]heory, \d", flat), f"{path}: write `eq.` or `section` before the number"


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_relative_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.exists(), target
        assert not anchor or anchor in anchors(file), target


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_python_examples_compile_and_import_what_exists(page):
    for block in blocks(page, "python"):
        for node in ast.walk(ast.parse(block, filename=page.name)):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("pdhe"):
                module = importlib.import_module(node.module)
                for alias in node.names:
                    assert hasattr(module, alias.name), f"{node.module} has no {alias.name}"


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_scenes_in_the_documentation_load(page, tmp_path):
    for number, block in enumerate(blocks(page, "yaml")):
        content = yaml.safe_load(block)
        if isinstance(content, dict) and {"geometry", "mesh", "time"} <= set(content):
            file = tmp_path / f"{number}.yaml"
            file.write_text(block, encoding="utf-8")
            load_scene(file, materials_dir=ROOT / "config" / "materials")


def test_the_guide_shows_a_scene_with_every_block():
    shown = [yaml.safe_load(block) for block in blocks(DOCS / "guide.md", "yaml")]
    # A fidelity and an accuracy exclude each other.
    assert any(set(Scene.model_fields) - {"accuracy"} <= set(scene) for scene in shown)


def scene_keys() -> set[str]:
    classes = [item for item in vars(scene_blocks).values() if isinstance(item, type) and issubclass(item, Block)]
    fields = itertools.chain(Scene.model_fields.items(), *(c.model_fields.items() for c in classes if c is not Block))
    return {field.alias or name for name, field in fields}


@pytest.mark.parametrize(
    "names", [scene_keys() - {"times", "values"}, FIELDS, STYLE_KEYS], ids=["scene", "result", "figures"]
)
def test_the_guide_names_everything(names):
    words = set(re.findall(r"\w+", " ".join(re.findall(r"`[^`]+`", prose(DOCS / "guide.md")))))
    assert set(names) - words == set()


def test_commands_in_the_documentation_exist():
    known = next(action.choices for action in _parser()._actions if action.choices)
    for page in PAGES:
        for command in re.findall(r"^ *\.venv/bin/pdhe (\w+)", text(page), re.MULTILINE):
            assert command in known, f"{page.name}: pdhe {command}"


def test_the_layout_names_every_module():
    words = set(re.findall(r"[\w/]+", " ".join(re.findall(r"`[^`]+`", prose(DOCS / "layout.md")))))
    for path in (ROOT / "pdhe").iterdir():
        if path.suffix == ".py" and not path.stem.startswith("__"):
            assert path.stem in words, path.stem
        elif (path / "__init__.py").is_file():
            assert f"{path.name}/" in words, path.name


def test_scenes_offer_what_the_registries_hold():
    """Names of choices are written down twice, because reading a scene must not load numba."""
    blocks_of_scene = scene_json_schema()["$defs"]
    for block, name, registry in (
        ("Mechanics", "model", MODELS),
        ("Hydrogen", "kernel", KERNELS),
        ("Hydrogen", "law", LAWS),
        ("Damage", "criterion", CRITERIA),
    ):
        assert set(blocks_of_scene[block]["properties"][name]["enum"]) == set(registry)
