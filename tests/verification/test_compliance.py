import pytest

from pdhe.verification.compliance import handbook, run


def test_energy_release_rate_and_stress_intensity(tmp_path):
    report = run(spacing=2.5e-3, lengths_mm=(50, 100), coarse_spacing=5e-3, coarse_lengths_mm=(100,))
    assert report.passed, [row for row in report.rows if not row.passed]
    assert len(report.rows) == 7
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_the_handbook_has_its_known_values():
    # Limit of a shallow crack, 1.1215 and the polynomial of Brown and Srawley, good to 0.5 %.
    assert handbook(1e-6) == pytest.approx(1.1215, rel=1e-3)
    for a in (0.25, 0.5):
        polynomial = 1.12 - 0.231 * a + 10.55 * a**2 - 21.72 * a**3 + 30.39 * a**4
        assert handbook(a) == pytest.approx(polynomial, rel=6e-3)
