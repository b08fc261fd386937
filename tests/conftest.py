"""Options that add the tests which take minutes or a cluster; one thread for those that gain nothing from more."""

import ctypes
import os
import signal
import sys

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


class _Head(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint32), ("process", ctypes.c_int))


class _Sets(ctypes.Structure):
    _fields_ = (("effective", ctypes.c_uint32), ("permitted", ctypes.c_uint32), ("inheritable", ctypes.c_uint32))


@pytest.fixture
def held_to_permissions():
    """Root may write anywhere: meanwhile it may write where anybody else might (capabilities(7), of this thread)."""
    if os.geteuid() != 0:
        yield
        return
    if not sys.platform.startswith("linux"):
        pytest.skip("root may write anywhere")
    libc, head, sets = ctypes.CDLL(None, use_errno=True), _Head(0x20080522, 0), (_Sets * 2)()
    assert libc.capget(ctypes.byref(head), sets) == 0
    before = sets[0].effective
    sets[0].effective &= ~(1 << 1)  # CAP_DAC_OVERRIDE
    assert libc.capset(ctypes.byref(head), sets) == 0
    yield
    sets[0].effective = before
    assert libc.capset(ctypes.byref(head), sets) == 0
