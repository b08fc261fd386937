from pdhe.verification.decoupled import run


def test_either_physics_runs_alone(tmp_path):
    report = run(spacing=2e-3)
    assert report.passed, [row for row in report.rows if not row.passed]
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000
