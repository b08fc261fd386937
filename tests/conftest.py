"""The option that adds the tests which take minutes."""

import pytest


def pytest_addoption(parser):
    parser.addoption("--slow", action="store_true", help="run the tests that take minutes as well")


def pytest_collection_modifyitems(config, items):
    if not config.getoption("--slow"):
        skip = pytest.mark.skip(reason="takes minutes; add --slow")
        for item in items:
            if "slow" in item.keywords:
                item.add_marker(skip)
