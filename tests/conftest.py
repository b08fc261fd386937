"""Options that add the tests which take minutes or a cluster; one thread for those that gain nothing from more."""

import pytest


def pytest_addoption(parser):
    parser.addoption("--slow", action="store_true", help="run the tests that take minutes as well")
    parser.addoption("--cluster", action="store_true", help="run those that set up a Slurm, and install it, as well")


def pytest_collection_modifyitems(config, items):
    for name, reason in (("slow", "takes minutes"), ("cluster", "sets up a Slurm")):
        if not config.getoption(f"--{name}"):
            skip = pytest.mark.skip(reason=f"{reason}; add --{name}")
            for item in items:
                if name in item.keywords:
                    item.add_marker(skip)


@pytest.fixture
def one_thread():
    """Bodies of a few hundred nodes gain nothing from threads, and lose much on a busy machine."""
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)
