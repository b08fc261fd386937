from pdhe.verification.operators import run


def test_unit_cases_and_damage_beside_a_crack():
    report = run(columns=60, rows=40, length=40, ratios=(3, 5))
    assert report.passed, [row for row in report.rows if not row.passed]
    assert len(report.rows) == 13 + 3 + 5 + 2
