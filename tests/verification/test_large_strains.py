import pytest

from pdhe.verification.large_strains import elastica_at, run


def test_large_strains_have_their_closed_forms(tmp_path):
    report = run(across=(5,), ring=False, tears=(1.6,), steps=10)
    assert report.passed, [row for row in report.rows if not row.passed]
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_the_elastica_is_that_of_the_tables():
    """Bisshopp and Drucker (1945), as printed in textbooks: deflection and reach at some loads."""
    for load, deflection, reach in ((1.0, 0.30172, 0.94357), (2.0, 0.49346, 0.83936), (10.0, 0.81061, 0.44500)):
        found = elastica_at(deflection)
        assert found[1] == pytest.approx(load, rel=1e-4) and found[2] == pytest.approx(reach, abs=2e-5)
