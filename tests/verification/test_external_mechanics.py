from pdhe.verification.external_mechanics import run


def test_figures_from_outside():
    report = run(columns=32, holes=((1e-3, "squares"),))
    assert report.passed, [row for row in report.rows if not row.passed]
    assert len(report.rows) == 4 + 6 + 3 + 2
