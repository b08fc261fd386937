import pytest

from pdhe.verification.pair import failure, pair, run, shape


def test_pairs_break_at_the_critical_stretch_and_not_below(tmp_path):
    report = run(coverages=(0.0, 1.0), angles=(0.0, 60.0))
    assert report.passed, [row for row in report.rows if not row.passed]
    measured = {row.what: row.measured for row in report.rows}
    assert measured["pairs broken at the critical stretch"] == 8
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_shear_of_a_fixed_spring_counts_only_with_the_energy_criterion():
    case = pair(60.0, None, "energy", "stretch", model="thesis spring")
    # cos 60 = 1/2, sin^2 60 = 3/4, k_t / k_n = 0.13 / 1.29.
    expected = (0.25 + 0.75 * 0.13 / 1.29) ** -0.5
    assert shape(60.0, "thesis spring", "energy") == pytest.approx(expected)
    assert failure(case) / case.rule.critical == pytest.approx(expected, rel=1e-9)
