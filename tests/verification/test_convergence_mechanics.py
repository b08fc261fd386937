from pdhe.verification.convergence_mechanics import run, stiffness_ratios


def test_displacements_converge(tmp_path):
    report = run(counts=(28, 56), columns=(20, 40), ratios=(2, 4))
    assert report.passed, [row for row in report.rows if not row.passed]
    assert len(report.rows) == 2 * 6 + 2 * 2 + 1
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_long_waves_are_those_of_elasticity():
    # Measured 1 - 1e-6 and 1 - 2e-7 at k delta = 0.005: quadratic in it.
    assert all(abs(1.0 - ratio) < 1e-5 for ratio in stiffness_ratios(0.005))
