"""Convergence of coverage, on few nodes."""

from pdhe.verification.convergence_diffusion import run


def test_nodes_and_horizon():
    report = run(columns=(24, 36, 48), ratios=(3, 6), compared=2)
    assert len(report.tables["nodes"]) == 3
    assert len(report.tables["fixed_horizon"]) == 6
    failed = [(row.what, row.expected, row.measured) for row in report.rows if not row.passed]
    assert not failed
