"""Rules about the source code that no other tool holds."""

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODULES = sorted((ROOT / "pdhe").rglob("*.py"))


def test_modules_import_only_from_layers_below():
    program = shutil.which("lint-imports", path=str(Path(sys.executable).parent))
    if program is None:
        pytest.skip("import-linter is not installed")
    done = subprocess.run([program, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("path", MODULES, ids=[str(path.relative_to(ROOT)) for path in MODULES])
def test_only_the_command_line_prints(path):
    calls = [node.func for node in ast.walk(ast.parse(path.read_bytes())) if isinstance(node, ast.Call)]
    prints = [call for call in calls if isinstance(call, ast.Name) and call.id == "print"]
    assert path.name == "cli.py" or path.parent.name == "commands" or not prints


@pytest.mark.parametrize("path", MODULES, ids=[str(path.relative_to(ROOT)) for path in MODULES])
def test_external_packages_stay_in_their_modules(path):
    """YAML is read in one module, meshes are made in one, and so on."""
    homes = {
        "yaml": ("yamlfile",),
        "gmsh": ("mesh",),
        "pint": ("units",),
        "matplotlib": ("plotting", "verification", "benchmarks", "tradeoff", "extremes"),
        "snakemake": (),
    }
    here = path.relative_to(ROOT / "pdhe").with_suffix("").parts[0]
    for node in ast.walk(ast.parse(path.read_bytes())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module]
        for name in names:
            package = name.partition(".")[0]
            assert package not in homes or here.startswith(homes[package]), f"{here} imports {package}"
