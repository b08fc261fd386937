"""Uptake by a slab and a square against the series, at small settings."""

from pdhe.transport import KERNELS
from pdhe.verification.diffusion_slab import run


def test_coverage_converges_to_the_series():
    report = run(columns=(25, 50, 100), square=(24, 48), triangles=(25, 50, 100))
    assert report.tables["errors"]
    assert all(any(kernel in row.what for row in report.rows) for kernel in KERNELS)
    failed = [(row.what, row.expected, row.measured) for row in report.rows if not row.passed]
    assert not failed
