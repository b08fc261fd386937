"""Settings of the tests of extremes."""

import pytest


@pytest.fixture(autouse=True)
def in_one_thread(one_thread):
    """All of these tests run in one thread."""
