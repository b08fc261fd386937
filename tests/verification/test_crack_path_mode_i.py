import pytest

from pdhe.verification.crack_path_mode_i import needed_coverage, run


def test_the_crack_runs_straight_and_as_far_as_it_should(tmp_path):
    # Measured at 2.5 mm: tip 132.5 mm, 62.5 mm half-way, mean coverage 0.804.
    report = run(
        spacing=2.5e-3,
        end=1.2e7,
        tip=(0.125, 0.140),
        half_way=(0.057, 0.068),
        coverage=(0.78, 0.83),
        coarse_spacing=None,
        criteria=("stretch",),
    )
    assert report.passed, [row for row in report.rows if not row.passed]
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_coverage_that_the_load_needs():
    psi = needed_coverage()
    assert 1.0 - 1.0467 * psi + 0.1687 * psi**2 == pytest.approx(0.317, abs=1e-3)
