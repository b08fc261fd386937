"""Bodies in space against closed forms, on few nodes."""

import pytest

from pdhe.verification.three_dimensions import run


@pytest.mark.usefixtures("one_thread")
def test_bars_a_crack_and_a_slab_in_space():
    report = run(kinds=("hexahedron",), penny=20, layers=(6, 12))
    failed = [(row.what, row.expected, row.measured) for row in report.rows if not row.passed]
    assert len(report.rows) == 11 and not failed
