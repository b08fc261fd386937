from pdhe.verification.graded import run


def test_graded_meshes_are_no_worse_than_uniform_ones(tmp_path):
    report = run(
        side=0.05,
        growths=(0.15,),
        ratios=(3.015,),
        strip_cells=(48, 32, 14),
        strips=1,
        spacing=2e-3,
        end=2.8e6,
        lengths=(2e-3,),
        finer=None,
    )
    assert report.passed, [row for row in report.rows if not row.passed]
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000
