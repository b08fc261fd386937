from pdhe.verification.growth_velocity import run


def test_speed_rises_between_the_threshold_and_the_dry_load(tmp_path):
    report = run(pulls_um=(9, 40, 60), other_spacings=(), wide_ratio=None, ramp_spacing=5e-3)
    assert report.passed, [row for row in report.rows if not row.passed]
    measured = {row.what: row.measured for row in report.rows}
    assert measured["speed at 56 MPa m^0.5 over that at 37"] > 3.0
    assert measured["shortest growth between threshold and dry load"] > 0.03
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000
