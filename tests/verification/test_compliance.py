from pdhe.verification.compliance import run


def test_energy_release_rate_and_stress_intensity(tmp_path):
    report = run(spacing=2.5e-3, lengths_mm=(50, 100), coarse_spacing=5e-3, coarse_lengths_mm=(100,))
    assert report.passed, [row for row in report.rows if not row.passed]
    assert len(report.rows) == 5
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000
