"""Extreme cases: of each family those that are refused and the most extreme that is right; what counts as failed."""

import itertools
import time

import numpy as np
import pytest

from pdhe.errors import PdheError, SceneError
from pdhe.extremes import outcome, page
from pdhe.extremes.outcome import Extreme, judge, report_of
from pdhe.extremes.registry import EXTREMES, cases_of
from pdhe.verification.page import failures
from pdhe.verification.plates import plate_body, square_plate
from pdhe.verification.report import Row

EVERY = [case for group in EXTREMES for case in cases_of(group)]


def chosen():
    for _, family in itertools.groupby(EVERY, lambda case: case.family):
        cases = list(family)
        yield from (case for case in cases if case.refused)
        yield from [case for case in cases if case.quick and not case.refused][-1:]


@pytest.mark.parametrize("case", list(chosen()), ids=lambda case: f"{case.family}, {case.level}")
def test_quick_cases_end_as_stated(case):
    found = judge(case)
    broken = [(row.what, row.expected, row.measured) for row in found.rows if not row.passed]
    assert found.outcome == ("refused" if case.refused else "right"), (found.message, broken)


@pytest.mark.slow
@pytest.mark.parametrize("group", EXTREMES)
def test_every_case_ends_as_stated(group):
    report = outcome.run_group(group)
    assert report.passed, [row.what for row in report.rows if not row.passed]


def test_names_are_unique_and_families_together():
    names = [(case.family, case.level) for case in EVERY]
    assert len(set(names)) == len(names) > 100
    families = [family for family, _ in itertools.groupby(family for family, _ in names)]
    assert len(set(families)) == len(families) > 20


def _refuse():
    raise SceneError("scene", "mesh.spacing", 1, "is wrong")


def _fail():
    raise ZeroDivisionError


GOOD, BAD = Row("x", 1.0, 1.0), Row("x", 1.0, 2.0)


@pytest.mark.parametrize(
    ("case", "ends"),
    [
        (Extreme("f", "good", lambda: [GOOD]), "right"),
        (Extreme("f", "refused", _refuse, refused="mesh.spacing"), "refused"),
        (Extreme("f", "bound broken", lambda: [GOOD, BAD]), "failed"),
        (Extreme("f", "nothing compared", list), "failed"),
        (Extreme("f", "not a number", lambda: [Row("x", 1.0, np.nan, kind="shown")]), "failed"),
        (Extreme("f", "refused for another reason", _refuse, refused="mesh.cells"), "failed"),
        (Extreme("f", "not refused", lambda: [GOOD], refused="mesh.cells"), "failed"),
        (Extreme("f", "refused without being asked", _refuse), "failed"),
        (Extreme("f", "exception", _fail), "failed"),
        (Extreme("f", "warning", lambda: [Row("x", 0.0, float(np.float64(0.0) / np.float64(0.0)))]), "failed"),
        (Extreme("f", "hang", lambda: time.sleep(5.0)), "failed"),
    ],
    ids=lambda value: value.level if isinstance(value, Extreme) else "",
)
def test_outcomes(case, ends):
    found = judge(case, limit=0.2)
    assert found.outcome == ends
    assert report_of("group", []).passed
    assert all(row.passed for row in outcome._rows(found)) == (ends != "failed")


def test_report_map_table_and_verdict(tmp_path):
    cases = [
        Extreme("f", "good", lambda: [GOOD]),
        Extreme("f", "refused", _refuse, refused="mesh.spacing"),
        Extreme("g", "bad", lambda: [GOOD, BAD]),
    ]
    report_of("group", cases).write(tmp_path / "group")
    reports = page.gather([tmp_path / "group"])
    assert page.summary(reports) == "3 cases in 2 families: 1 right, 1 refused, 1 failed."
    assert len(failures(reports)) == 1
    page.write_map(reports, tmp_path / "map.png")
    page.write_table(reports, tmp_path / "table.csv")
    assert (tmp_path / "table.csv").read_text(encoding="utf-8").count("\n") == 5
    text = page.as_markdown(reports, "map.png")
    assert "| f, refused | refused |" in text
    assert "is wrong" in text
    assert "class='bad'>failed" in page.as_html(reports, tmp_path / "map.png")


def test_unknown_group():
    with pytest.raises(PdheError, match="no group"):
        cases_of("elastic")


def test_least_eigenvalue_agrees_with_the_dense_one():
    from pdhe.extremes.elasticity import stiffness
    from pdhe.stability import least_eigenvalue

    for nu, weights in ((0.499, "moment matched"), (0.47, "volume"), (0.4, "moment matched")):
        plate = square_plate(8, 8)
        body = plate_body(plate, 1.5e-3, nu=nu, weights=weights)
        values = np.linalg.eigvalsh(stiffness(body))
        found = least_eigenvalue(body, np.ones((64, 2), bool))
        # Measured 1e-9 at most: all 120 Lanczos steps of 128 degrees of freedom.
        assert found == pytest.approx(values[0] / values[-1], rel=1e-6, abs=1e-9)
    assert least_eigenvalue(body, np.zeros((64, 2), bool)) == 0.0
