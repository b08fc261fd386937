import itertools

import numpy as np
import pytest
from PIL import Image

from pdhe import post
from pdhe.errors import PdheError
from pdhe.plotting import animate, draw, draw_history
from pdhe.plotting.layout import Layout
from pdhe.plotting.picture import KINDS, Picture
from pdhe.plotting.shape import cell_of_pixel, displaced_corners
from pdhe.plotting.style import Style
from pdhe.results import open_result
from tests.results import DAY, SPACING, plate, write_result

FAST = {"dpi": 60, "frame_width": 240}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_result(tmp_path_factory.mktemp("plotting") / "result.nc", physics="mdhu")


@pytest.fixture(scope="module")
def triangles(tmp_path_factory):
    return write_result(tmp_path_factory.mktemp("plotting") / "triangles.nc", physics="mdhu", triangles=True)


def picture(path, kind, **style):
    with open_result(path) as result:
        return Picture(result.load(), kind, Style.of(style))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mesh", ["path", "triangles"])
def test_figures_have_the_asked_width_and_colours(request, tmp_path, kind, mesh):
    draw(kind, request.getfixturevalue(mesh), FAST, tmp_path / "figure.png")
    with Image.open(tmp_path / "figure.png") as image:
        assert image.width == pytest.approx(180 / 25.4 * 60, abs=1)
        assert len(image.convert("RGB").getcolors(100_000)) > 20


@pytest.mark.parametrize("kind", KINDS)
def test_animations_have_a_frame_an_output_one_palette_and_a_held_end(path, tmp_path, kind):
    out = tmp_path / "film.gif"
    animate(kind, path, FAST | {"hold": 2}, out)
    durations, colours = [], []
    with Image.open(out) as film:
        assert film.n_frames == 7
        assert film.width == 240
        assert film.info["loop"] == 0
        for number in range(film.n_frames):
            film.seek(number)
            durations.append(film.info["duration"])
            colours.append({colour for _, colour in film.convert("RGB").getcolors(100_000)})
    assert durations == [500] * 6 + [2500]
    assert len(set().union(*colours)) <= 256
    assert all(len(one) > 20 for one in colours)
    assert out.stat().st_size < 200_000


def test_animations_are_thinned_to_the_number_of_frames(path, tmp_path):
    animate("coverage", path, FAST | {"frames": 3}, tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == 3


def test_single_output_makes_a_still(tmp_path):
    result = write_result(tmp_path / "one.nc", physics="m", outputs=2)
    animate("displacement", result, FAST | {"frames": 1}, tmp_path / "film.gif")
    draw("displacement", result, FAST | {"times": [0]}, tmp_path / "figure.png")
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == 1


def test_pictures_are_the_same_every_time(path, tmp_path):
    for name in ("one", "two"):
        draw("damage", path, FAST, tmp_path / f"{name}.png")
        animate("damage", path, FAST, tmp_path / f"{name}.gif")
    for end in ("png", "gif"):
        assert (tmp_path / f"one.{end}").read_bytes() == (tmp_path / f"two.{end}").read_bytes()


@pytest.mark.parametrize("physics", ["mdh", "md", "m", "h"])
def test_history_draws_what_there_is(tmp_path, physics):
    result = write_result(tmp_path / "result.nc", physics=physics)
    draw_history(result, tmp_path / "history.png")
    with Image.open(tmp_path / "history.png") as image:
        rows = {"mdh": 3, "md": 3, "m": 2, "h": 1}[physics]
        assert image.height == pytest.approx((42 * rows + 8) / 25.4 * 300, abs=2)


def test_state_variables_are_drawn_by_name_on_one_scale(path, tmp_path):
    first, rest = picture(path, "state"), picture(path, "state", state="rest")
    assert first.limits == (0.0, 1e-2) and first.label == "age" and first.remark(6) == "up to 0.01"
    assert rest.limits == (0.0, 1.0) and not rest.field.any()
    with pytest.raises(PdheError, match="figure style: 'state' is 'old', not one of age, rest"):
        picture(path, "state", state="old")
    with pytest.raises(PdheError, match=r"holds no state, because its scene has no `material\.umat\.states`"):
        draw("state", write_result(tmp_path / "none.nc"), FAST, tmp_path / "none.png")


def test_absent_physics_is_explained(tmp_path):
    dry = write_result(tmp_path / "dry.nc", physics="md")
    with pytest.raises(PdheError, match="holds no coverage, because its scene has no `hydrogen`"):
        draw("coverage", dry, {}, tmp_path / "x.png")
    diffusion = write_result(tmp_path / "diffusion.nc", physics="h")
    with pytest.raises(PdheError, match="no displacement, because its scene has no `loads`"):
        animate("displacement", diffusion, {}, tmp_path / "x.gif")
    with pytest.raises(PdheError, match="did you mean 'damage'"):
        draw("damages", dry, {}, tmp_path / "x.png")
    assert not (tmp_path / "x.png").exists()


def test_colour_limits_do_not_depend_on_the_values(path):
    assert picture(path, "damage").limits == (0.0, 0.5)
    assert picture(path, "coverage").limits == (0.0, 1.0)
    low, high = picture(path, "displacement").limits
    assert -low == high == pytest.approx(20.0)  # um, the largest displacement of all outputs
    assert picture(path, "damage", damage_limit=0.2).beyond
    assert not picture(path, "damage").beyond


def test_displacement_shows_the_larger_component_unless_told_otherwise(path):
    assert "u_y" in picture(path, "displacement").label
    assert "u_x" in picture(path, "displacement", component="x").label
    assert picture(path, "displacement", component="magnitude").limits[0] == 0.0


def test_magnification_is_a_round_number(path):
    assert picture(path, "displacement").magnification == 50.0  # 20 um becomes 1 mm, 2.5 % of 40 mm
    assert picture(path, "displacement", magnification=0).magnification == 0.0
    assert picture(path, "damage").magnification == 0.0


def test_times_select_the_nearest_outputs(path, tmp_path):
    draw("damage", path, FAST | {"times": ["41 days", 41 * DAY, 5.0e6]}, tmp_path / "two.png")
    draw("damage", path, FAST | {"times": [40 * DAY, 60 * DAY]}, tmp_path / "same.png")
    assert (tmp_path / "two.png").read_bytes() == (tmp_path / "same.png").read_bytes()


@pytest.mark.parametrize(
    ("style", "words"),
    [
        ({"dip": 100}, "unknown key 'dip'; did you mean 'dpi'"),
        ({"dpi": "high"}, "'dpi' needs a number from 40 to 1200"),
        ({"dpi": None}, "leave the key out"),
        ({"times": []}, "a list of times"),
        ({"times": ["4 mm"]}, "not a unit of time"),
        ({"frames": 2.5}, "a whole number"),
        ({"coverage_map": "virdis"}, "name of a matplotlib colour map"),
        ({"component": "w"}, "one of auto, x, y, z, magnitude"),
        ({"window": [0, 1]}, "left, right, bottom and top"),
        ({"window": [1, 0, 0, 1]}, "left < right"),
    ],
)
def test_style_errors_say_what_would_work(style, words):
    with pytest.raises(PdheError, match=words):
        Style.of(style)


def test_window_takes_quantities():
    assert Style.of({"window": ["1 cm", 0.02, "0 mm", "5 mm"]}).window == (0.01, 0.02, 0.0, 0.005)


def test_every_pixel_shows_the_cell_at_its_centre():
    for triangles in (False, True):
        d = plate(triangles)
        shown = cell_of_pixel(d.vertices[d.cells], (0.0, 0.04, 0.0, 0.02), (40, 80))
        assert shown.min() == 0
        counts = np.bincount(shown.ravel())
        assert len(counts) == len(d.cells)
        centres = np.round(d.coordinates / (0.0005, -0.0005) + (-0.5, 39.5)).astype(int)
        assert (shown[centres[:, 1], centres[:, 0]] == np.arange(len(d.cells))).all()
    outside = cell_of_pixel(d.vertices[d.cells], (-0.04, 0.04, 0.0, 0.02), (10, 40))
    assert (outside[:, :19] == -1).all() and (outside[:, 21:] >= 0).all()


@pytest.mark.parametrize("mesh", ["path", "triangles"])
def test_displaced_body_opens_along_the_crack_and_nowhere_else(request, mesh):
    shown = picture(request.getfixturevalue(mesh), "displacement", magnification=100)
    corners = shown.corners(6) - shown.vertices[shown.cells]
    tip = 0.03
    points = shown.vertices[shown.cells].reshape(-1, 2)
    moved = corners.reshape(-1, 2)[:, 1]
    for point in np.unique(points.round(9), axis=0):
        here = moved[(np.abs(points - point) < 1e-9).all(axis=1)]
        torn = abs(point[1] - 0.01) < 1e-9 and point[0] < tip - 1e-9
        assert (np.ptp(here) > 3e-3) if torn else (np.ptp(here) < 1e-12)


def test_without_displacement_nothing_moves():
    d = plate()
    facets = post.Facets(np.empty((0, 2), int), np.empty((0, 2), int), np.empty(0), np.empty(0, int), np.empty((0, 2)))
    still = displaced_corners(d.vertices, d.cells, facets, np.empty(0, int), np.zeros_like(d.coordinates))
    np.testing.assert_array_equal(still, d.vertices[d.cells])


def test_crack_lines_follow_the_crack(path):
    flat = picture(path, "damage")
    lines = flat.crack(6, flat.corners(6))
    assert lines[..., 0].max() == pytest.approx(0.03)
    assert np.abs(np.diff(lines[1:], axis=1)).max() == pytest.approx(SPACING)
    open_faces = picture(path, "displacement")
    assert len(open_faces.crack(6, open_faces.corners(6))) == 12  # two faces of six facets


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 9])
@pytest.mark.parametrize("aspect", [0.2, 1.0, 2.0, 10.0])
@pytest.mark.parametrize("width", [85.0, 180.0])
def test_layouts_hold_every_panel_on_the_page(count, aspect, width):
    layout = Layout.of(count, aspect, width, 8.0)
    assert layout.columns * layout.rows >= count
    assert layout.size[0] <= width + 1e-9
    assert layout.panel[0] / layout.panel[1] == pytest.approx(aspect)
    figure = layout.figure(50)
    boxes = [layout.axes(figure, number).get_position() for number in range(count)]
    for box in boxes:
        assert 0 < box.x0 < box.x1 < 1 and 0 < box.y0 < box.y1 < 1
    for one, other in itertools.pairwise(boxes):
        assert one.x1 < other.x0 or one.y0 > other.y1


def test_a_plate_has_no_third_component(path, tmp_path):
    with pytest.raises(PdheError, match="'component' is 'z', which a plate does not have"):
        draw("displacement", path, FAST | {"component": "z"}, tmp_path / "figure.png")
