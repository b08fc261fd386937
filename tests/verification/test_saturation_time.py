"""The time to saturation that the thesis gives, and the one that its results need."""

from pdhe.verification.saturation_time import run


def test_saturation_takes_months():
    report = run(columns=25)
    assert any(row.expected > 1e7 for row in report.rows)
    failed = [(row.what, row.expected, row.measured) for row in report.rows if not row.passed]
    assert not failed
