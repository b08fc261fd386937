"""The hydrogen balance of whole runs, on coarse meshes."""

from pdhe.verification.hydrogen_balance import run


def test_content_changes_by_what_came_in():
    report = run(spacing=5e-3, growth_spacing=5e-3)
    assert any("growing crack" in row.what for row in report.rows)
    failed = [(row.what, row.expected, row.measured) for row in report.rows if not row.passed]
    assert not failed
