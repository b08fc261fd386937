from pdhe.verification.symmetry import run


def test_halves_and_quarters_give_what_the_whole_body_gives(tmp_path):
    report = run(operator_spacing=5e-3, spacing=5e-3)
    assert report.passed, [row for row in report.rows if not row.passed]
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000
