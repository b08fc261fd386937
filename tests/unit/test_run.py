"""The set-up script: what it says where a machine lacks something, and when it does nothing."""

import ast
import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def run():
    """The script as a module, loaded anew."""
    spec = importlib.util.spec_from_file_location("run", ROOT / "run.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def commands(run, monkeypatch, tmp_path):
    """Collect the commands instead of running them; every one succeeds."""
    seen = []

    def call(command, environment=None):
        seen.append(" ".join(str(word) for word in command))
        return 0

    monkeypatch.setattr(run, "call", call)
    monkeypatch.setattr(run, "VENV", tmp_path / "venv")
    monkeypatch.setattr(run, "PYTHON", tmp_path / "python")
    monkeypatch.setattr(run, "STAMP", tmp_path / "stamp")
    monkeypatch.setattr(run, "system_libraries", lambda: None)
    return seen


def test_old_python_can_read_it_and_is_refused(run, monkeypatch):
    ast.parse((ROOT / "run.py").read_text(), feature_version=(3, 6))
    monkeypatch.setattr(run.sys, "version_info", (3, 9, 2))
    with pytest.raises(SystemExit, match=r"Python 3\.11 or newer is needed; .* is 3\.9\.2"):
        run.main([])


def test_uv_is_used_where_it_is(run, commands, monkeypatch):
    monkeypatch.setattr(run, "works", lambda command: command[0] == "uv")
    run.setup()
    assert commands[0].startswith("uv venv")
    assert "--require-hashes" in commands[1]
    assert "--no-deps --no-build-isolation --editable" in commands[2]


def test_pip_is_used_where_uv_is_not(run, commands, monkeypatch):
    monkeypatch.setattr(run, "works", lambda command: "import ensurepip, venv" in command)
    run.setup()
    assert "-m venv" in commands[0]
    assert "-m pip install" in commands[1]
    assert "--require-hashes" in commands[1]


def test_second_set_up_does_nothing_until_the_lock_changes(run, commands, monkeypatch, tmp_path):
    monkeypatch.setattr(run, "works", lambda command: True)
    (tmp_path / "python").touch()
    run.setup()
    done = len(commands)
    assert done
    run.setup()
    assert len(commands) == done
    lock = tmp_path / "lock"
    lock.write_text("other")
    monkeypatch.setattr(run, "LOCK", lock)
    run.setup()
    assert len(commands) > done


def test_failed_set_up_is_not_taken_for_done(run, commands, monkeypatch, tmp_path):
    monkeypatch.setattr(run, "works", lambda command: True)
    monkeypatch.setattr(run, "call", lambda command, environment=None: 3)
    with pytest.raises(SystemExit, match="failed with status 3"):
        run.setup()
    assert not (tmp_path / "stamp").exists()


def lacking(run, monkeypatch, root, sudo, apt=True):
    def missing(name):
        raise OSError(name)

    seen = []
    monkeypatch.setattr(run.sys, "platform", "linux")
    monkeypatch.setattr(run.ctypes, "CDLL", missing)
    monkeypatch.setattr(run.os, "geteuid", lambda: 0 if root else 1000, raising=False)
    monkeypatch.setattr(run.shutil, "which", lambda name: "/usr/bin/apt-get" if apt else None)
    monkeypatch.setattr(run, "works", lambda command: sudo)
    monkeypatch.setattr(run, "call", lambda command, environment=None: seen.append(" ".join(command)) or 0)
    return seen


@pytest.mark.parametrize(("root", "sudo", "prefix"), [(True, False, ""), (False, True, "sudo -n ")])
def test_missing_libraries_are_installed_where_no_password_is_needed(root, sudo, prefix, run, monkeypatch, capsys):
    seen = lacking(run, monkeypatch, root, sudo)
    run.system_libraries()
    assert seen[0] == f"{prefix}apt-get update -qq"
    assert seen[1].startswith(f"{prefix}apt-get install -y --no-install-recommends libglu1-mesa")
    assert "libGLU.so.1" in capsys.readouterr().out


@pytest.mark.parametrize("apt", [True, False])
def test_missing_libraries_are_named_otherwise(apt, run, monkeypatch, capsys):
    seen = lacking(run, monkeypatch, root=False, sudo=False, apt=apt)
    with pytest.raises(SystemExit, match="libglu1-mesa"):
        run.system_libraries()
    assert seen == []
    assert "libGLU.so.1" in capsys.readouterr().out


def test_missing_venv_module_names_its_package(run, monkeypatch):
    lacking(run, monkeypatch, root=False, sudo=False)
    with pytest.raises(SystemExit, match=r"python3\.\d+-venv"):
        run.make_venv()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("setup slrum", "setup knows no 'slrum'; there are `python3 run.py setup` and `... setup slurm`"),
        ("setup slurm now", "setup knows no 'slurm now'"),
        ("setup --help", "setup knows no '--help'"),
        ("tset", "no command or target 'tset'; did you mean `test`? commands: setup, setup slurm, test; targets: all,"),
        ("verifcation", "did you mean `verification`?"),
        ("xyz", "no command or target 'xyz'; commands: "),
    ],
)
def test_an_unknown_word_is_refused_before_anything_is_done(words, told, run, commands):
    with pytest.raises(SystemExit) as stop:
        run.main(words.split())
    assert str(stop.value).startswith(f"error: {told}") or told in str(stop.value)
    assert "\n" not in str(stop.value) and not commands


@pytest.mark.parametrize(
    "words", ["", "-n", "figures", "solve -n", "results/report.html", "--configfile x.yaml", "-- all"]
)
def test_what_snakemake_knows_goes_to_it(words, run, commands, monkeypatch):
    monkeypatch.setattr(run, "setup", lambda: None)
    assert run.main(words.split()) == 0
    assert commands[-1].endswith(f"-m snakemake --cores 2 {words}".rstrip())


@pytest.mark.parametrize("words", ["setup", "setup slurm", "test --slow -k x"])
def test_commands_are_known(words, run, commands, monkeypatch):
    monkeypatch.setattr(run, "setup", lambda: None)
    monkeypatch.setattr(run, "setup_slurm", lambda: commands.append("slurm"))
    assert run.main(words.split()) == 0
    assert commands == {"setup": [], "setup slurm": ["slurm"]}.get(words, commands)
