"""What comes from outside is never run: no pickles, no evaluation, no shell without quotes; dependencies are pinned."""

import ast
import re
import shutil
import subprocess
import sys
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
SOURCES = sorted([*(ROOT / "pdhe").rglob("*.py"), ROOT / "run.py"])
RULES = sorted([ROOT / "Snakefile", *(ROOT / "workflow").rglob("*.smk")])
LOCKS = [ROOT / "requirements.lock", ROOT / "requirements-slurm.lock"]

PICKLING = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
NETWORK = {"socket", "urllib", "http", "ftplib", "smtplib", "requests", "httpx", "urllib3", "aiohttp"}
EVALUATING = {"eval", "exec", "compile", "__import__"}
SHELLS = {"os.system", "os.popen", "subprocess.getoutput", "subprocess.getstatusoutput"}
# Held to a pattern, or names out of our own registries.
SAFE_WITHOUT_QUOTES = {"threads", "wildcards.topic", "wildcards.group", "wildcards.measurement", "wildcards.kind"}
SAFE_WITHOUT_QUOTES |= {"wildcards.trade"}


def nodes(path: Path):
    return ast.walk(ast.parse(path.read_bytes(), filename=str(path)))


def imported(path: Path) -> set[str]:
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found.add(node.module.partition(".")[0])
    return found


def calls(path: Path) -> list[tuple[str, ast.Call]]:
    return [(ast.unparse(node.func), node) for node in nodes(path) if isinstance(node, ast.Call)]


def keywords(call: ast.Call) -> dict[str, str]:
    return {word.arg: ast.unparse(word.value) for word in call.keywords}


@pytest.mark.parametrize("path", SOURCES, ids=[str(path.relative_to(ROOT)) for path in SOURCES])
def test_nothing_that_was_read_is_run(path):
    assert not imported(path) & PICKLING
    for name, call in calls(path):
        assert name not in EVALUATING, f"line {call.lineno}: {name}"
        assert name not in SHELLS, f"line {call.lineno}: {name}"
        assert keywords(call).get("shell", "False") == "False", f"line {call.lineno}: a shell"
        if name in ("np.load", "numpy.load"):
            assert keywords(call).get("allow_pickle") == "False", f"line {call.lineno}: {name}"
        if name.startswith("yaml.") and name.rpartition(".")[2].startswith("load"):
            assert keywords(call).get("Loader") == "_Loader", f"line {call.lineno}: {name}"


def test_the_loader_of_yaml_makes_no_objects():
    import yaml

    from pdhe.yamlfile import _Loader

    assert issubclass(_Loader, yaml.SafeLoader | getattr(yaml, "CSafeLoader", yaml.SafeLoader))


@pytest.mark.parametrize("path", SOURCES, ids=[str(path.relative_to(ROOT)) for path in SOURCES])
def test_nothing_talks_to_the_network(path):
    used = imported(path) & NETWORK
    if path.name == "warm.py":  # processes of this machine, by a file
        assert used == {"socket"}
        assert set(re.findall(r"socket\.(AF_\w+)", path.read_text())) == {"AF_UNIX"}
    else:
        assert not used


def shell_texts(path: Path) -> list[str]:
    """The command templates of the rules in a file, each joined from its pieces."""
    blocks = re.findall(r"^    shell:\n((?:        .*\n)+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    return [ast.literal_eval(f"({block})") for block in blocks]


def test_every_value_in_a_command_is_quoted():
    texts = {path.name: shell_texts(path) for path in RULES}
    assert sum(map(len, texts.values())) >= 15
    for name, templates in texts.items():
        for text in templates:
            for placeholder in re.findall(r"\{([^{}]*)\}", text):
                quoted = placeholder.endswith(":q") or placeholder in SAFE_WITHOUT_QUOTES
                assert quoted, f"{name}: {{{placeholder}}} reaches a shell without quotes"


def pins(lock: Path) -> list[tuple[Requirement, list[str]]]:
    """Each requirement of a lock file with its hashes."""
    text = re.sub(r"^\s*#.*\n", "", lock.read_text(), flags=re.MULTILINE).replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.strip()]
    return [(Requirement(re.split(r"\s--hash", line)[0]), re.findall(r"--hash=(\S+)", line)) for line in lines]


@pytest.mark.parametrize("lock", LOCKS, ids=[lock.name for lock in LOCKS])
def test_every_dependency_is_pinned_with_hashes(lock):
    found = pins(lock)
    assert found
    for requirement, hashes in found:
        assert re.fullmatch(r"==[^*]+", str(requirement.specifier)), requirement
        assert requirement.url is None, requirement
        assert hashes and all(re.fullmatch(r"sha256:[0-9a-f]{64}", each) for each in hashes), requirement


def test_every_declared_dependency_is_locked():
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    locked = {requirement.name.lower().replace("_", "-") for lock in LOCKS for requirement, _ in pins(lock)}
    groups = project["dependency-groups"]
    for line in (*project["project"]["dependencies"], *groups["build"], *groups["test"], *groups["slurm"]):
        assert Requirement(line).name.lower() in locked, line


def test_what_is_installed_is_what_is_locked():
    """The audit that works offline: nothing in the environment that the hashes did not pass."""
    if Path(sys.prefix).resolve() != ROOT / ".venv":
        pytest.skip("these tests do not run in the environment that run.py makes")
    if find_spec("pre_commit"):
        pytest.skip("the tools of developers are installed as well, which no lock holds")
    locked: dict[str, set[str]] = {}
    for lock in LOCKS:
        for requirement, _ in pins(lock):
            if requirement.marker is None or requirement.marker.evaluate():
                name = re.sub(r"[-_.]+", "-", requirement.name.lower())
                locked.setdefault(name, set()).add(str(requirement.specifier)[2:])
    for found in metadata.distributions():
        name = re.sub(r"[-_.]+", "-", found.metadata["Name"].lower())
        if name in locked:
            assert found.version in locked[name], name
        else:
            assert name in ("pdhe", "pip", "setuptools", "wheel"), f"{name} is in no lock"


@pytest.mark.slow
@pytest.mark.parametrize("lock", LOCKS, ids=[lock.name for lock in LOCKS])
def test_no_dependency_has_a_known_vulnerability(lock):
    program = ["uvx", "pip-audit"] if shutil.which("uvx") else ["pip-audit"]
    if not shutil.which(program[0]):
        pytest.skip("neither uvx nor pip-audit is installed")
    command = [*program, "--disable-pip", "--require-hashes", "--progress-spinner=off", "--requirement", str(lock)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip("pip-audit had no answer within five minutes")
    text = done.stdout + done.stderr
    if "could not be audited" in text or not re.search(r"[Nn]o known vulnerabilities|[Ff]ound \d+ known", text):
        pytest.skip(f"the service that knows vulnerabilities cannot be reached: {text.strip().splitlines()[-1:]}")
    assert done.returncode == 0, text
