"""Settings of the tests of extremes."""

import numba
import pytest


@pytest.fixture(autouse=True)
def one_thread():
    """Bodies of a few hundred nodes gain nothing from threads, and lose much on a busy machine."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)
