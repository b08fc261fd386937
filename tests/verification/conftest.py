"""Settings of the tests of the verification."""

import pytest


@pytest.fixture(autouse=True)
def in_one_thread(one_thread):
    """All of these tests run in one thread."""
