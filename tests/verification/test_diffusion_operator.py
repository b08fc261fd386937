"""The diffusion operator on single modes, at small settings."""

from pdhe.transport import KERNELS
from pdhe.verification.diffusion_operator import run


def test_modes_decay_as_the_symbol_says():
    report = run(columns=24, triangle_columns=40)
    assert all(sum(kernel in row.what for row in report.rows) >= 6 for kernel in KERNELS)
    failed = [(row.what, row.expected, row.measured) for row in report.rows if not row.passed]
    assert not failed
