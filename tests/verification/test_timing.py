import time

import pytest

from pdhe import advance, simulation
from pdhe.verification.timing import Stopwatch, run


def test_counts_hold_and_nothing_stays_patched(tmp_path):
    before = advance.advance, advance.substep, advance.fail_until_stable, simulation.Candidates, simulation.record
    report = run(rows_of_nodes=20, load_steps=60, end=4e6)
    after = advance.advance, advance.substep, advance.fail_until_stable, simulation.Candidates, simulation.record
    assert before == after
    assert report.passed, [row for row in report.rows if not row.passed]
    shares = [row.measured for row in report.rows if row.what.startswith("events: share of")]
    assert sum(shares) == pytest.approx(1.0)
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_stopwatch_counts_each_moment_once():
    watch = Stopwatch()
    inner = watch.of("inner", lambda: time.sleep(0.02))

    def work():
        time.sleep(0.01)
        inner()

    begun = time.perf_counter()
    watch.of("outer", work)()
    total = time.perf_counter() - begun
    assert watch.calls == {"outer": 1, "inner": 1}
    assert watch.seconds["inner"] >= 0.02
    assert watch.seconds["outer"] >= 0.01
    assert sum(watch.seconds.values()) <= total
