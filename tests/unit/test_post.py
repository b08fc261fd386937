import csv
import io
import subprocess
import sys

import numpy as np
import pytest

from pdhe import post
from pdhe.errors import PdheError
from pdhe.results import open_result
from tests.results import COLUMNS, DAY, NOTCH, ROWS, write_result


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_result(tmp_path_factory.mktemp("post") / "result.nc")


@pytest.fixture
def result(path):
    with open_result(path) as dataset:
        yield dataset


def variant(folder, **settings):
    return open_result(write_result(folder / "variant.nc", **settings))


def test_history_table_has_units_in_its_header_and_a_line_a_step(path, result):
    rows = list(csv.DictReader(io.StringIO(post.history_table(path))))
    assert len(rows) == result.sizes["step"] == 7
    assert {"history_time [s]", "reaction_top_y [N]", "crack_extension [m]", "mean_coverage [1]"} <= set(rows[0])
    assert float(rows[-1]["history_time [s]"]) == 60 * DAY
    assert float(rows[-1]["crack_extension [m]"]) == pytest.approx(0.015)


def test_history_table_refuses_what_is_no_result(tmp_path):
    with pytest.raises(PdheError, match="no such result"):
        post.history_table(tmp_path / "none.nc")


@pytest.mark.parametrize("triangles", [False, True])
def test_facets_join_two_cells_or_lie_on_the_boundary(tmp_path, triangles):
    facets = post.facets_of(variant(tmp_path, triangles=triangles))
    inner = COLUMNS * (ROWS - 1) + ROWS * (COLUMNS - 1) + triangles * COLUMNS * ROWS
    assert len(facets.vertices) == inner
    assert len(facets.outer_vertices) == 2 * (COLUMNS + ROWS)
    assert (facets.cells[:, 0] != facets.cells[:, 1]).all()


@pytest.mark.parametrize("triangles", [False, True])
def test_crack_is_the_notch_and_what_broke_ahead_of_it(tmp_path, triangles):
    result = variant(tmp_path, triangles=triangles)
    before, end = post.crack_path(result, 0.0), post.crack_path(result, 60 * DAY)
    assert len(before) == 3 and len(end) == 6
    np.testing.assert_allclose(end[..., 1], 0.01, atol=1e-12)
    assert before[..., 0].max() == pytest.approx(0.015)
    assert end[..., 0].max() == pytest.approx(0.03)


def test_crack_leaves_out_broken_facets_that_do_not_open(result):
    changed = result.load().copy(deep=True)
    facets = post.facets_of(changed)
    grown = np.flatnonzero(np.isfinite(facets.broken) & (facets.broken > 0))
    assert grown.size == 3
    one, other = facets.cells[grown[-1]]
    changed["displacement"][-1, other] = changed["displacement"].values[-1, one]
    kept = post.open_facets(changed, facets)[-1]
    assert set(grown) - set(kept) == {grown[-1]}


def test_closed_crack_stays_a_crack(result):
    changed = result.load().copy(deep=True)
    changed["displacement"][-1] = 0.0
    assert len(post.crack_path(changed, np.inf)) == 6


def test_crack_tip_exists_once_there_is_growth(result, tmp_path):
    assert post.crack_tip(result, 30 * DAY) is None
    assert post.crack_tip(result, 60 * DAY) == (pytest.approx(0.03), pytest.approx(0.01))
    assert post.crack_tip(variant(tmp_path, physics="h"), 60 * DAY) is None


def test_growth_is_between_first_and_last_failure(result, tmp_path):
    assert post.growth(result) == (39 * DAY, 59 * DAY)
    assert post.growth(variant(tmp_path, physics="m")) is None


def test_nearest_snapshot(result):
    assert [post.nearest_snapshot(result, day * DAY) for day in (-1, 4, 6, 5, 99)] == [0, 0, 1, 0, 6]


def test_telling_snapshots_show_the_growth_or_the_advance_of_hydrogen(result, tmp_path):
    assert post.telling_snapshots(result) == [3, 4, 5, 6]
    assert post.telling_snapshots(result, 1) == [6]
    diffusion = variant(tmp_path, physics="h", outputs=33)
    assert post.telling_snapshots(diffusion) == [2, 8, 18, 32]
    assert post.telling_snapshots(variant(tmp_path, physics="m", outputs=2)) == [0, 1]


@pytest.mark.parametrize(
    ("time", "span", "label"),
    [
        (0.0, 0.0, "0 s"),
        (30.0, 60.0, "30.0 s"),
        (3600.0, 48 * 3600.0, "1.0 h"),
        (1.2e6, 6e6, "13.9 days"),
        (1e7, 2e7, "116 days"),
        (3.15576e8, 6e8, "10.0 years"),
    ],
)
def test_times_are_written_for_readers(time, span, label):
    assert post.time_label(time, span) == label


def test_energy_balance_closes(result, tmp_path):
    balance = post.energy_balance(result)
    assert balance["dissipated"][-1] == pytest.approx(0.3)
    assert balance["fracture"][-1] + balance["relaxation"][-1] == pytest.approx(0.3)
    with pytest.raises(PdheError, match="no energies"):
        post.energy_balance(variant(tmp_path, physics="h"))


def test_summary_holds_what_there_is(result, tmp_path):
    numbers = post.summary(result)
    assert numbers["growth_start"] == 39 * DAY
    assert numbers["crack_tip_x"] == pytest.approx(0.03)
    assert numbers["energy_dissipated"] == pytest.approx(0.3)
    assert numbers["hydrogen_imbalance"] == 0.0
    dry = post.summary(variant(tmp_path, physics="m"))
    assert not {"mean_coverage", "growth_start", "mean_damage"} & set(dry)


def test_a_node_on_a_crack_lies_on_its_left():
    a, b = np.array([[0.5, -1.0], [0.5, 0.0], [1.5, -1.0]]), np.array([[0.5, 0.0], [0.5, 1.0], [1.5, 1.0]])
    assert post._cross(a, b, np.zeros(2), np.array([1.0, 0.0])).tolist() == [True, False, False]


def test_numbers_need_no_matplotlib():
    code = "import sys, pdhe.post; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_speed_is_the_slope_of_the_extension_over_a_few_entries(result):
    speed = post.crack_speed(result, 1)
    time, way = result["history_time"].values, result["crack_extension"].values
    assert speed[3] == pytest.approx((way[4] - way[2]) / (time[4] - time[2]))
    assert speed[0] == pytest.approx((way[1] - way[0]) / (time[1] - time[0]))
    assert post.crack_speed(result, 100) == pytest.approx(np.full(time.size, way[-1] / time[-1]))


@pytest.mark.parametrize("triangles", [False, True])
def test_a_crack_that_goes_on_straight_has_the_direction_of_its_notch(tmp_path, triangles):
    result = variant(tmp_path, triangles=triangles)
    assert post.crack_direction(result, 0.0) is None
    assert post.crack_direction(result, 60 * DAY) == pytest.approx(0.0, abs=1e-9)


def test_a_crack_grows_from_the_end_that_is_inside_whichever_comes_first(tmp_path):
    result = variant(tmp_path, notch=NOTCH | {"from": NOTCH["to"], "to": NOTCH["from"]})
    assert post.crack_direction(result, 60 * DAY) == pytest.approx(0.0, abs=1e-9)  # was 180 of the wrong end


def test_cracks_across_a_line_are_counted(result):
    last = result.isel(time=[-1]).load().copy(deep=True)
    last["damage"].values[:] = 0.0
    x, y = last["node_x"].values, last["node_y"].values
    assert post.crossings(last, 0.02, np.inf) == 0
    last["damage"].values[0, np.abs(y - y.min()) < 1e-9] = 0.5
    assert post.crossings(last, 0.02, np.inf) == 1
    last["damage"].values[0, (np.abs(y - y.max()) < 1e-9) & (x > x.mean())] = 0.5
    assert [post.crossings(last, place, np.inf) for place in (x.min(), x.max())] == [1, 2]
