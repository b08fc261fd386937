"""Options that add the tests which take minutes or a cluster; one thread for those that gain nothing from more."""

import signal

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


@pytest.fixture(scope="module")
def heeding_interrupts():
    """SIGINT as a terminal's shell leaves it; a shell without one has what it runs in the background ignore it.

    Commands respect that, and so do those that tests start.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
