import pytest

from pdhe.verification.kink_angle import run, tangential_stress


def test_inclined_cracks_kink_across_the_load(tmp_path):
    report = run(cells=60, ratio=3.015, betas=(60.0, 30.0), lattices=(0.0,))
    assert report.passed, [row for row in report.rows if not row.passed]
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


@pytest.mark.parametrize(("beta", "kink"), [(60.0, 43.2), (45.0, 53.1), (30.0, 60.0), (1e-6, 70.5)])
def test_maximum_tangential_stress(beta, kink):
    # Erdogan and Sih (1963); the last is pure shear.
    assert tangential_stress(beta, 0.0) == pytest.approx(kink, abs=0.05)
