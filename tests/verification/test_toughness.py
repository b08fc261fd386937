from pdhe.scene_blocks import Damage
from pdhe.verification.toughness import run


def test_a_running_crack_takes_the_fracture_energy_put_in(tmp_path):
    report = run(ratios=(3.015,), nodes=("0", "45"), columns=42, rows=28, cells=11, heights=(), equal=("0",))
    assert report.passed, [row for row in report.rows if not row.passed]
    assert len(report.tables["paths"]) == 7
    # Something happened: every path has more breaks than a crack through ten cells can do with.
    assert all(line["runs"] > 1.0 for line in report.tables["paths"])
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_the_calibration_that_measures_best_is_the_default():
    assert Damage.model_fields["calibration"].default == "discrete"
    assert Damage.model_fields["criterion"].default == "energy"
