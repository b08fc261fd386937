"""Permeation through a slab, on few nodes."""

from pdhe.transport import KERNELS
from pdhe.verification.permeation import run


def test_flux_and_lag():
    report = run(columns=20, points=60)
    assert all(any(kernel in row.what for row in report.rows) for kernel in KERNELS)
    failed = [(row.what, row.expected, row.measured) for row in report.rows if not row.passed]
    assert not failed
