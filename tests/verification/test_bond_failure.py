from pdhe.verification.bond_failure import run


def test_only_crack_and_hydrogen_together_break_bonds(tmp_path):
    # The time ends before bonds at the corners of the coarse intact plate fail, as the text of the topic says.
    report = run(spacing=2.5e-3, end=8e6)
    assert report.passed, [row for row in report.rows if not row.passed]
    measured = {row.what: row.measured for row in report.rows}
    assert measured["bonds broken: hydrogen, cracked"] > 0
    assert 0.02 < measured["crack growth"] < 0.14
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000
