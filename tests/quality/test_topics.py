"""Every topic of the verification is listed in the configuration, has a check file and a test."""

from pathlib import Path

from pdhe.verification.studies import load_checks
from pdhe.verification.topics import TOPICS
from pdhe.yamlfile import read_yaml

ROOT = Path(__file__).parents[2]


def test_every_topic_runs_with_the_verification(monkeypatch):
    monkeypatch.chdir(ROOT)
    assert {check.topic for check in load_checks(read_yaml("config/config.yaml"))} == set(TOPICS)


def test_every_topic_has_a_test():
    tests = {path.stem.removeprefix("test_") for path in (ROOT / "tests/verification").glob("test_*.py")}
    assert set(TOPICS) <= tests
