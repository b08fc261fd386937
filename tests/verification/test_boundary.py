from pdhe.verification.boundary import run


def test_conditions_hold_and_contradictions_are_refused(tmp_path):
    report = run(spacing=1e-3)
    assert report.passed, [row for row in report.rows if not row.passed] + report.tables["refusals"]
    assert len(report.rows) == 2 * 6 + 3
    assert all(line["message"] for line in report.tables["refusals"])
    assert len(report.tables["nodes"]) == sum(r.measured for r in report.rows if r.what.startswith("node values"))
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000
