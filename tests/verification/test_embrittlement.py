"""The embrittlement laws and how the failure rule applies it."""

from pdhe.embrittlement import LAWS
from pdhe.verification.embrittlement import LEFT, run


def test_law_and_failure_rule():
    report = run(points=21)
    assert len(report.rows) >= 15
    assert set(LAWS) == set(LEFT)
    failed = [(row.what, row.expected, row.measured) for row in report.rows if not row.passed]
    assert not failed
