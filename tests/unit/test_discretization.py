from types import SimpleNamespace

import meshio
import numpy as np
import pytest

from pdhe.discretization import discretize, read_discretization, write_discretization
from pdhe.errors import PdheError
from pdhe.mesh import make_mesh
from pdhe.scene import Geometry, Mesh

EDGES = {"left", "right", "bottom", "top"}


def geometry(width=0.04, height=0.02, holes=(), cracks=()):
    return SimpleNamespace(
        width=width,
        height=height,
        thickness=0.004,
        holes=tuple(SimpleNamespace(name=n, centre=c, radius=r) for n, c, r in holes),
        cracks=tuple(SimpleNamespace(name=n, start=a, end=b) for n, a, b in cracks),
        symmetry=None,
    )


def spec(cells="quadrilateral", spacing=1e-3):
    return SimpleNamespace(spacing=spacing, cells=cells, refine=None)


@pytest.fixture
def nodes_of(tmp_path):
    """Mesh a plate and discretize it."""

    def build(mesh, **shapes):
        plate = geometry(**shapes)
        make_mesh(plate, mesh, tmp_path / "plate.msh")
        return discretize(tmp_path / "plate.msh", plate, mesh)

    return build


def signed_distance(points, start, end):
    """Distance to the line through start and end, positive on its left."""
    along = np.subtract(end, start) / np.linalg.norm(np.subtract(end, start))
    relative = points - np.asarray(start)
    return relative[:, 1] * along[0] - relative[:, 0] * along[1]


def polygon_areas(d):
    x, y = np.moveaxis(d.vertices[d.cells], -1, 0)
    return 0.5 * (x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1)


def facet_count(d, name, on_curve):
    """Facets of the cells in a set whose two ends satisfy ``on_curve``."""
    polygon = d.vertices[d.cells[d.node_sets[name]]]
    on = on_curve(polygon)
    distinct = np.linalg.norm(polygon - np.roll(polygon, -1, axis=1), axis=-1) > 0
    return (on & np.roll(on, -1, axis=1) & distinct).sum(axis=1)


def test_structured_plate(nodes_of):
    d = nodes_of(spec())
    assert d.regular
    assert d.coordinates.shape == (800, 2) and d.cells.shape == (800, 4) and d.vertices.shape == (41 * 21, 2)
    assert d.cells.dtype == np.int32 and d.thickness == 0.004
    np.testing.assert_allclose(d.spacing, 1e-3, rtol=1e-14)
    np.testing.assert_allclose(d.volume, 4e-9, rtol=1e-14)
    assert np.unique(d.volume).size == 1
    x, y = np.meshgrid((np.arange(40) + 0.5) * 1e-3, (np.arange(20) + 0.5) * 1e-3)
    np.testing.assert_allclose(d.coordinates, np.column_stack([x.ravel(), y.ravel()]), rtol=1e-14)


def test_structured_edges_are_the_outer_rows_and_columns(nodes_of):
    d = nodes_of(spec())
    number = np.arange(800).reshape(20, 40)
    for name, expected in {
        "bottom": number[0], "top": number[-1], "left": number[:, 0], "right": number[:, -1], "all": number.ravel()
    }.items():  # fmt: skip
        np.testing.assert_array_equal(d.node_sets[name], expected)
        assert d.node_sets[name].dtype == np.int32


def test_rounded_spacing_is_the_one_reported(nodes_of):
    d = nodes_of(spec(spacing=1.001e-3), height=0.0203)
    assert len(d.volume) == 40 * 20
    assert not d.regular, "1 mm by 1.015 mm"
    np.testing.assert_allclose(d.spacing, np.sqrt(1e-3 * 1.015e-3), rtol=1e-12)
    np.testing.assert_allclose(d.coordinates[[0, 1, 40]], [[5e-4, 5.075e-4], [1.5e-3, 5.075e-4], [5e-4, 1.5225e-3]])


def test_crack_along_a_grid_line_owns_the_cells_on_both_sides(nodes_of):
    d = nodes_of(spec(), cracks=[("notch", (0.0, 0.01), (0.02, 0.01))])
    assert d.regular and len(d.vertices) == 41 * 21
    number = np.arange(800).reshape(20, 40)
    np.testing.assert_array_equal(d.node_sets["notch"], number[9:11, :20].ravel())


def test_crack_through_a_row_of_centroids_owns_that_row(nodes_of):
    d = nodes_of(spec(), cracks=[("notch", (0.0, 0.0095), (0.0205, 0.0095))])
    np.testing.assert_array_equal(d.node_sets["notch"], np.arange(800).reshape(20, 40)[9, :20])


def test_inclined_crack_on_a_grid_owns_the_cells_near_it(nodes_of):
    start, end = (0.005, 0.004), (0.025, 0.014)
    d = nodes_of(spec(), cracks=[("scratch", start, end)])
    nodes = d.node_sets["scratch"]
    distance = signed_distance(d.coordinates, start, end)
    position = signed_distance(d.coordinates, start, (start[0] + end[1] - start[1], start[1] - (end[0] - start[0])))
    expected = (abs(distance) <= 0.75e-3) & (position > 0) & (position < np.hypot(0.02, 0.01))
    np.testing.assert_array_equal(nodes, np.flatnonzero(expected))
    assert (distance[nodes] > 0).any() and (distance[nodes] < 0).any()


@pytest.mark.parametrize("cells", ["triangle", "quadrilateral"])
def test_mesh_conforms_to_hole_and_inclined_crack(cells, nodes_of):
    start, end = (0.004, 0.004), (0.017, 0.013)
    d = nodes_of(spec(cells, 8e-4), holes=[("bore", (0.03, 0.01), 0.005)], cracks=[("scratch", start, end)])
    assert set(d.node_sets) == EDGES | {"bore", "scratch", "all"}
    assert not d.regular

    def on_crack(points):
        return abs(signed_distance(points.reshape(-1, 2), start, end)).reshape(points.shape[:-1]) < 1e-9

    def on_bore(points):
        return abs(np.linalg.norm(points - [0.03, 0.01], axis=-1) - 0.005) < 1e-9

    distance = signed_distance(d.coordinates, start, end)[d.node_sets["scratch"]]
    assert (distance > 0).sum() == (distance < 0).sum() >= 10
    assert (facet_count(d, "scratch", on_crack) == 1).all()
    assert (facet_count(d, "bore", on_bore) == 1).all()
    assert d.node_sets["bore"].size >= 20
    for name, axis, value in (("left", 0, 0.0), ("right", 0, 0.04), ("bottom", 1, 0.0), ("top", 1, 0.02)):
        touches = (abs(d.vertices[d.cells][..., axis] - value) < 1e-12).any(axis=1)
        assert np.array_equal(d.node_sets[name], np.flatnonzero(touches))
        count = facet_count(d, name, lambda points, axis=axis, value=value: abs(points[..., axis] - value) < 1e-12)
        assert count.sum() >= 0.02 / (1.6 * 8e-4)
        if cells == "triangle":
            assert count.size > 1.5 * count.sum(), "those that touch the edge with a corner belong to it as well"


@pytest.mark.parametrize("cells", ["triangle", "quadrilateral"])
def test_areas_and_centroids_are_those_of_the_polygons(cells, nodes_of):
    spacing, radius = 8e-4, 0.005
    d = nodes_of(spec(cells, spacing), holes=[("bore", (0.03, 0.01), radius)])
    area = polygon_areas(d)
    assert (area > 0).all(), "corners run counter-clockwise"
    np.testing.assert_allclose(d.volume, area * 0.004, rtol=1e-9)
    np.testing.assert_allclose(d.spacing, np.sqrt(area), rtol=1e-9)
    expected = 0.04 * 0.02 - np.pi * radius**2
    missing = area.sum() - expected
    assert 0 < missing < 1.5 * spacing**2, "the polygon within the circle misses pi h^2 / 6, h = 1.5 spacing at most"
    first_moment = np.array(
        [0.04 * 0.02 * 0.02 - np.pi * radius**2 * 0.03, 0.04 * 0.02 * 0.01 - np.pi * radius**2 * 0.01]
    )
    np.testing.assert_allclose(area @ d.coordinates, first_moment + missing * np.array([0.03, 0.01]), rtol=1e-6)


def test_triangles_among_quadrilaterals_repeat_a_corner(nodes_of):
    # This plate leaves 2 triangles with gmsh 4.15; other versions may leave another number, so only consistency counts.
    d = nodes_of(
        spec(spacing=1e-3),
        width=0.2,
        height=0.1,
        holes=[("bore", (0.1, 0.05), 0.02)],
        cracks=[("a", (0.1, 0.05), (0.15, 0.07)), ("b", (0.02, 0.02), (0.05, 0.04))],
    )
    assert d.cells.shape[1] == 4
    np.testing.assert_allclose(d.volume, polygon_areas(d) * 0.004, rtol=1e-9)
    repeated = d.cells[:, 2] == d.cells[:, 3]
    corners = d.vertices[d.cells[repeated, :3]]
    np.testing.assert_allclose(d.coordinates[repeated], corners.mean(axis=1), atol=1e-12)


def test_cracks_that_cross_and_touch_the_edge(nodes_of):
    cracks = [
        ("a", (0.01, 0.005), (0.02, 0.015)),
        ("b", (0.01, 0.015), (0.02, 0.005)),
        ("c", (0.0, 0.01), (0.006, 0.01)),
        ("d", (0.03, 0.0), (0.03, 0.02)),
    ]
    d = nodes_of(spec("triangle"), cracks=cracks)
    assert d.volume.sum() == pytest.approx(0.04 * 0.02 * 0.004, rel=1e-12)
    for name, start, end in cracks:
        distance = signed_distance(d.coordinates, start, end)[d.node_sets[name]]
        length = np.hypot(*np.subtract(end, start))
        assert (distance > 0).sum() == (distance < 0).sum() >= 0.9 * length / 1.52e-3
        assert abs(distance).max() < 1.52e-3


def test_crack_along_an_edge_has_one_side(nodes_of):
    d = nodes_of(spec("triangle"), cracks=[("lip", (0.0, 0.0), (0.02, 0.0))])
    assert 0 < d.node_sets["lip"].size < d.node_sets["bottom"].size
    assert np.isin(d.node_sets["lip"], d.node_sets["bottom"]).all()


def test_takes_the_blocks_of_a_scene(tmp_path):
    plate = Geometry.model_validate(
        {
            "plate": {"width": "40 mm", "height": "20 mm", "thickness": "4 mm"},
            "holes": [{"name": "bore", "centre": ["30 mm", "10 mm"], "radius": "4 mm"}],
            "cracks": [{"name": "notch", "from": ["0 mm", "10 mm"], "to": ["10 mm", "10 mm"]}],
        }
    )
    mesh = Mesh.model_validate({"spacing": "1 mm", "cells": "triangle"})
    make_mesh(plate, mesh, tmp_path / "plate.msh")
    d = discretize(tmp_path / "plate.msh", plate, mesh)
    assert set(d.node_sets) == EDGES | {"bore", "notch", "all"}
    assert d.volume.sum() == pytest.approx((0.04 * 0.02 - np.pi * 0.004**2) * 0.004, rel=3e-3)


@pytest.mark.parametrize("cells", ["triangle", "quadrilateral"])
def test_nodes_are_numbered_in_strips_of_one_spacing(cells, nodes_of):
    d = nodes_of(spec(cells))
    strip = np.floor(d.coordinates[:, 1] / 1e-3).astype(int)
    assert (np.diff(strip) >= 0).all()
    same = np.diff(strip) == 0
    assert (np.diff(d.coordinates[:, 0])[same] > -1e-12).all()


def test_every_vertex_belongs_to_a_cell(nodes_of):
    d = nodes_of(spec(), cracks=[("scratch", (0.005, 0.004), (0.025, 0.014))])
    np.testing.assert_array_equal(np.unique(d.cells), np.arange(len(d.vertices)))


def test_crack_shorter_than_a_cell_is_refused(nodes_of):
    with pytest.raises(PdheError, match=r"'speck' owns no cell.*smaller mesh\.spacing"):
        nodes_of(spec(), cracks=[("speck", (0.01, 0.01), (0.0103, 0.01))])


def test_round_trip(nodes_of, tmp_path):
    for d in (nodes_of(spec(), cracks=[("notch", (0.0, 0.01), (0.02, 0.01))]), nodes_of(spec("triangle"))):
        write_discretization(d, tmp_path / "deep" / "nodes.nc")
        again = read_discretization(tmp_path / "deep" / "nodes.nc")
        for name in ("coordinates", "volume", "spacing", "vertices", "cells"):
            np.testing.assert_array_equal(getattr(again, name), getattr(d, name))
            assert getattr(again, name).dtype == getattr(d, name).dtype
            assert getattr(again, name).flags.c_contiguous
        assert list(again.node_sets) == list(d.node_sets)
        for name in d.node_sets:
            np.testing.assert_array_equal(again.node_sets[name], d.node_sets[name])
            assert again.node_sets[name].dtype == np.int32
        assert (again.regular, again.thickness) == (d.regular, d.thickness)
    assert [file.name for file in (tmp_path / "deep").iterdir()] == ["nodes.nc"]


def test_file_of_nodes_is_the_same_to_the_byte(nodes_of, tmp_path):
    d = nodes_of(spec(), cracks=[("notch", (0.0, 0.01), (0.02, 0.01))])
    write_discretization(d, tmp_path / "first.nc")
    write_discretization(d, tmp_path / "second.nc")
    assert (tmp_path / "first.nc").read_bytes() == (tmp_path / "second.nc").read_bytes()


@pytest.fixture
def plate_mesh(tmp_path):
    make_mesh(geometry(), spec(), tmp_path / "plate.msh")
    return tmp_path / "plate.msh"


@pytest.mark.parametrize("kept", [0.0, 0.02, 0.3, 0.7, 0.99])
def test_truncated_mesh(kept, plate_mesh):
    data = plate_mesh.read_bytes()
    plate_mesh.write_bytes(data[: int(kept * len(data))])
    with pytest.raises(PdheError, match=r"plate\.msh: not a usable file .*delete it and run again"):
        discretize(plate_mesh, geometry(), spec())


def test_garbled_mesh(plate_mesh, capfd):
    data = plate_mesh.read_bytes()
    random = np.random.default_rng(3)
    for start, stop in (
        (0, 60),
        (100, 400),
        (len(data) // 3, len(data) // 3 + 400),
        (len(data) - 9000, len(data) - 8000),
    ):
        plate_mesh.write_bytes(data[:start] + random.bytes(stop - start) + data[stop:])
        with pytest.raises(PdheError, match=r"plate\.msh: .*delete .* and run again"):
            discretize(plate_mesh, geometry(), spec())
    plate_mesh.write_text("not a mesh\n$End\n")
    with pytest.raises(PdheError, match=r"plate\.msh: not a usable file"):
        discretize(plate_mesh, geometry(), spec())
    assert capfd.readouterr() == ("", "")


def test_missing_group_is_named(plate_mesh):
    with pytest.raises(PdheError, match=r"plate\.msh: physical group 'crack:notch' is missing"):
        discretize(plate_mesh, geometry(cracks=[("notch", (0.0, 0.01), (0.02, 0.01))]), spec())


def test_mesh_of_another_plate_is_refused(plate_mesh):
    with pytest.raises(PdheError, match=r"its cells cover 0\.0008 m\^2 where the geometry has 0\.0012 m\^2"):
        discretize(plate_mesh, geometry(width=0.06), spec())


def test_missing_files_are_named(tmp_path):
    with pytest.raises(PdheError, match=r"none\.msh: no such mesh"):
        discretize(tmp_path / "none.msh", geometry(), spec())
    with pytest.raises(PdheError, match=r"none\.nc: no such file of nodes"):
        read_discretization(tmp_path / "none.nc")


def test_damaged_file_of_nodes(nodes_of, tmp_path):
    path = tmp_path / "nodes.nc"
    write_discretization(nodes_of(spec()), path)
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(PdheError, match=r"nodes\.nc: not a usable file .*delete it and run again"):
        read_discretization(path)


def test_mesh_file_is_read_by_other_programs(plate_mesh):
    mesh = meshio.gmsh.read(plate_mesh)
    assert set(mesh.field_data) == EDGES | {"plate"}
