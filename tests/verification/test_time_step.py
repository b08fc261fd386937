"""Order and limits of the time integration."""

from pdhe.verification.time_step import INTEGRATORS, run


def test_order_and_limits():
    report = run(columns=16)
    assert all(any(f"order of {name}" in row.what for row in report.rows) for name in INTEGRATORS)
    failed = [(row.what, row.expected, row.measured) for row in report.rows if not row.passed]
    assert not failed
