from pdhe.verification.moduli import run


def test_moduli_are_recovered(tmp_path):
    report = run(columns=28, ratios=(3.0,), table_ratios=(3.0,), partials=("full",))
    assert report.passed, [row for row in report.rows if not row.passed]
    assert len(report.rows) == 11
    table = {line["weights"]: line for line in report.tables["corrections"]}
    assert set(table) == {"none", "volume", "energy", "moment matched"}
    # Theory, eq. 3.2: m = 3, whole cells, no correction: the lattice sum gives 1.0595 E and nu = 0.277.
    assert abs(table["none"]["interior_E"] - 1.0595) < 2e-4
    assert abs(table["none"]["interior_nu"] - 0.2773) < 2e-4
    report.write(tmp_path)
    assert (tmp_path / "corrections.csv").is_file()
    assert (tmp_path / "figure.png").stat().st_size > 10_000
