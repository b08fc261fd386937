import numpy as np
import pytest

from pdhe.scene import Crack
from pdhe.segments import crossed_by as crossed_in_plane
from pdhe.surfaces import Surface, crossed_by, surface_of

SQUARE = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 2.0, 0.0), (0.0, 2.0, 0.0)]
NOTCHED = [(0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (3.0, 3.0, 0.0), (1.5, 1.0, 0.0), (0.0, 3.0, 0.0)]


def through(points, low=-1.0, high=1.0):
    """Segments along z through points of the plane z = 0."""
    points = np.asarray(points, float)
    return np.column_stack([points, np.full(len(points), low)]), np.column_stack([points, np.full(len(points), high)])


def test_a_disc_is_crossed_inside_its_rim():
    disc = Surface.disc((1.0, 1.0, 0.0), (0.0, 0.0, 5.0), 1.0)
    points = [(1.0, 1.0), (1.9, 1.0), (2.1, 1.0), (1.0 + 0.8, 1.0 + 0.7)]
    assert crossed_by(*through(points), [disc]).tolist() == [True, True, False, False]
    assert disc.area == pytest.approx(np.pi) and disc.size == disc.width == 2.0


def test_a_polygon_with_a_notch_is_crossed_where_it_is():
    surface = Surface.polygon(NOTCHED)
    points = [(1.5, 0.5), (1.5, 2.0), (0.2, 2.5), (2.8, 2.5), (-0.1, 1.0)]
    assert crossed_by(*through(points), [surface]).tolist() == [True, False, True, True, False]
    assert surface.area == pytest.approx(9.0 - 3.0)


def test_a_rim_is_not_cut_unless_another_surface_goes_on_there():
    surface = Surface.polygon(SQUARE)
    start, end = through([(2.0, 1.0), (0.0, 1.0), (2.0, 2.0)])
    assert crossed_by(start, end, [surface]).tolist() == [False, False, False]
    beside = Surface.polygon([(2.0, 0.0, 0.0), (4.0, 0.0, 0.0), (4.0, 2.0, 0.0), (2.0, 2.0, 0.0)])
    assert crossed_by(start, end, [surface, beside]).tolist() == [True, False, True]


def test_a_point_on_a_surface_lies_on_the_side_of_its_normal():
    surface = Surface.polygon(SQUARE)
    inside = [(1.0, 1.0)]
    assert crossed_by(*through(inside, low=-1.0, high=0.0), [surface]).tolist() == [True]
    assert crossed_by(*through(inside, low=0.0, high=1.0), [surface]).tolist() == [False]


def test_distances_are_those_to_the_nearest_point():
    surface = Surface.polygon(SQUARE)
    points = np.array([[1.0, 1.0, 3.0], [3.0, 1.0, 0.0], [5.0, 6.0, 0.0], [3.0, 1.0, 1.0]])
    assert surface.distance(points) == pytest.approx([3.0, 1.0, 5.0, np.sqrt(2.0)])
    disc = Surface.disc((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 2.0)
    assert disc.distance(np.array([[1.0, 0.0, 0.0], [0.0, 5.0, 0.0]])) == pytest.approx([1.0, 3.0])


def test_a_segment_goes_through_the_thickness_with_the_same_left():
    """Cuts in space are those of the plane for every place across the thickness."""
    rng = np.random.default_rng(0)
    start, end = rng.uniform(0.0, 1.0, (2, 200, 2))
    start[:20], end[20:40] = [0.5, 0.5], [0.4, 0.5]  # on the crack
    crack = Crack.model_construct(name="a", start=(0.2, 0.3), end=(0.7, 0.7), disc=None, polygon=None)
    level = Crack.model_construct(name="b", start=(0.3, 0.5), end=(0.6, 0.5), disc=None, polygon=None)
    want = crossed_in_plane(start, end, [(crack.start, crack.end), (level.start, level.end)])
    depth = rng.uniform(0.1, 0.4, (2, 200, 1))
    surfaces = [surface_of(item, 0.5) for item in (crack, level)]
    found = crossed_by(np.hstack([start, depth[0]]), np.hstack([end, depth[1]]), surfaces)
    assert 20 < want.sum() < 180
    assert np.array_equal(found, want)


def test_a_tilted_surface_far_from_the_origin_keeps_its_digits():
    rng = np.random.default_rng(1)
    normal = np.array([1.0, 2.0, -0.5])
    disc = Surface.disc((100.0, 200.0, 300.0), normal, 1e-3)
    assert np.abs(np.concatenate([disc.axes, disc.normal[None]]) @ disc.axes.T - np.eye(3)[:, :2]).max() < 1e-15
    inside = disc.origin + 0.9e-3 * rng.uniform(0, 1, (50, 1)) * disc.axes[0]
    assert (disc.distance(inside) < 1e-12).all()
    assert crossed_by(inside - 1e-3 * disc.normal, inside + 1e-3 * disc.normal, [disc]).all()
