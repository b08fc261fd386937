"""Tables and pages that say what made them, and still are tables and pages."""

import csv
import io

import pytest

from pdhe import cli
from pdhe.stamps import made_by, problems, read, stamp, stamped, table_of

TABLE = "time [s],damage [1]\r\n0,0\r\n7,0.5\r\n"
PAGE = "<!doctype html><meta charset='utf-8'><title>Page</title><h1># not: a comment</h1>"
MADE = made_by("pdhe.post", "pdhe history --result 'a \"b\" <ä>\n.nc'", scene='{"title": "x"}')


@pytest.mark.parametrize(("text", "ending"), [(TABLE, ".csv"), (PAGE, ".html"), ("", ".csv"), ("<p>", ".html")])
def test_what_is_written_is_read_and_the_rest_is_as_it_was(text, ending):
    whole = stamped(text, ending, MADE)
    made, rest = read(whole, ending)
    assert rest == text and {key: made[key] for key in MADE} == MADE and len(made["content_sha256"]) == 64
    assert stamped(whole, ending, MADE) == whole
    assert read(text, ending) == ({}, text)


def test_a_table_with_a_stamp_is_a_table(tmp_path):
    (tmp_path / "a.csv").write_text(stamped(TABLE, ".csv", MADE), newline="")
    rows = [{"time [s]": "0", "damage [1]": "0"}, {"time [s]": "7", "damage [1]": "0.5"}]
    assert table_of(tmp_path / "a.csv") == rows
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert list(csv.DictReader(io.StringIO("\n".join(line for line in lines if not line.startswith("#"))))) == rows


@pytest.mark.parametrize(("name", "text"), [("a.csv", TABLE), ("a.html", PAGE)])
def test_what_no_longer_matches_is_said(name, text, tmp_path):
    path = tmp_path / name
    path.write_text(text, newline="")
    assert problems(path, {}) is None
    stamp(path, MADE)
    assert problems(path, {}) == []
    path.write_text(path.read_text().replace("7", "8") + "8")
    assert "is not as it was written" in problems(path, {})
    stamp(path, {**MADE, "code_fingerprint": "older", "versions": "{}", "solution_sha256": "gone"})
    found = problems(path, {"there": path})
    assert found[0].startswith("made by other code (older, now ") and found[1] == "made with other versions"
    assert found[2] == "its solution is not in the store, or another one by now"
    stamp(path, {**MADE, "module": "pdhe.no_longer"})
    assert problems(path, {})[0].endswith("now none)")


def test_verify_knows_tables_and_pages(tmp_path, capsys):
    (tmp_path / "store").mkdir()
    (tmp_path / "own.csv").write_text("a,b\n")
    (tmp_path / "page.html").write_text(PAGE)
    assert cli.main(["stamp", str(tmp_path / "page.html"), "--made-by", "another program"]) == 0
    assert read((tmp_path / "page.html").read_text(), ".html")[0]["command"] == "another program"
    assert cli.main(["verify", str(tmp_path)]) == 0
    assert capsys.readouterr().out == "1 file(s) match\n"
    (tmp_path / "page.html").write_text((tmp_path / "page.html").read_text() + "more")
    assert cli.main(["verify", str(tmp_path)]) == 1
    told = capsys.readouterr()
    assert told.out == f"{tmp_path / 'page.html'}: is not as it was written\n" and "1 mismatch(es)" in told.err
