import sys
import threading
from types import SimpleNamespace

import meshio
import numpy as np
import pytest

from pdhe.errors import PdheError
from pdhe.mesh import make_mesh, structured_counts


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


def group_sizes(path):
    mesh = meshio.gmsh.read(path)
    return {name: sum(map(len, parts)) for name, parts in mesh.cell_sets.items() if not name.startswith("gmsh:")}


def test_structured_plate_has_the_cells_and_groups_asked_for(tmp_path):
    make_mesh(geometry(), spec(), tmp_path / "deep" / "plate.msh")
    sizes = group_sizes(tmp_path / "deep" / "plate.msh")
    assert sizes == {"plate": 800, "bottom": 40, "top": 40, "left": 20, "right": 20}
    assert [file.name for file in (tmp_path / "deep").iterdir()] == ["plate.msh"]


def test_coordinates_are_metres(tmp_path):
    make_mesh(geometry(), spec(), tmp_path / "plate.msh")
    points = meshio.gmsh.read(tmp_path / "plate.msh").points
    assert points.max(axis=0) == pytest.approx([0.04, 0.02, 0.0], rel=1e-14)


def test_counts_are_rounded():
    assert structured_counts(0.2, 0.1, 0.001) == (200, 100)
    assert structured_counts(0.2, 0.1, 0.00102) == (196, 98)
    assert structured_counts(0.2, 0.101, 0.001) == (200, 101)


def test_cells_far_from_square_are_refused_with_a_spacing_that_works():
    with pytest.raises(PdheError, match=r"mesh\.spacing.*not square.*for example 20 mm") as refusal:
        structured_counts(0.1, 0.06, 0.025)
    assert "0.025" in str(refusal.value)
    assert structured_counts(0.1, 0.06, 0.02) == (5, 3)


PLATES = {
    "structured with a crack": (spec(), {"cracks": [("notch", (0.0, 0.01), (0.02, 0.01))]}),
    "triangles": (spec("triangle"), {}),
    "triangles, hole and inclined crack": (
        spec("triangle"),
        {"holes": [("bore", (0.03, 0.01), 0.004)], "cracks": [("notch", (0.005, 0.004), (0.018, 0.013))]},
    ),
    "crossing cracks": (
        spec("triangle"),
        {"cracks": [("notch", (0.01, 0.005), (0.02, 0.015)), ("other", (0.01, 0.015), (0.02, 0.005))]},
    ),
    "quadrilaterals around a hole, crack from the hole": (
        spec(),
        {"holes": [("bore", (0.02, 0.01), 0.004)], "cracks": [("notch", (0.02, 0.01), (0.03, 0.014))]},
    ),
}


@pytest.mark.parametrize("name", PLATES)
def test_same_request_gives_same_bytes(name, tmp_path):
    mesh, shapes = PLATES[name]
    make_mesh(geometry(**shapes), mesh, tmp_path / "first.msh")
    make_mesh(geometry(width=0.01, height=0.01), spec("triangle"), tmp_path / "another.msh")
    make_mesh(geometry(**shapes), mesh, tmp_path / "second.msh")
    assert (tmp_path / "first.msh").read_bytes() == (tmp_path / "second.msh").read_bytes()


@pytest.mark.parametrize("name", PLATES)
def test_mean_cell_area_is_the_square_of_the_spacing(name, tmp_path):
    mesh, shapes = PLATES[name]
    plate = geometry(**shapes)
    make_mesh(plate, mesh, tmp_path / "plate.msh")
    area = plate.width * plate.height - sum(np.pi * hole.radius**2 for hole in plate.holes)
    assert area / group_sizes(tmp_path / "plate.msh")["plate"] == pytest.approx(mesh.spacing**2, rel=0.05)


def test_curves_are_divided_into_segments_of_their_true_length(tmp_path):
    plate = geometry(
        holes=[("bore", (0.03, 0.01), 0.004)],
        cracks=[
            ("a", (0.0, 0.01), (0.015, 0.01)),
            ("b", (0.005, 0.005), (0.01, 0.015)),
            ("c", (0.03, 0.01), (0.03, 0.0)),
        ],
    )
    make_mesh(plate, spec("triangle"), tmp_path / "plate.msh")
    mesh = meshio.gmsh.read(tmp_path / "plate.msh")

    def length(name):
        ends = [mesh.points[block.data[part]] for block, part in zip(mesh.cells, mesh.cell_sets[name], strict=True)]
        return sum(np.linalg.norm(pair[:, 1] - pair[:, 0], axis=1).sum() for pair in ends if len(pair))

    assert length("crack:a") == pytest.approx(0.015, rel=1e-9)
    assert length("crack:b") == pytest.approx(np.hypot(0.005, 0.01), rel=1e-9)
    assert length("crack:c") == pytest.approx(0.006, rel=1e-9), "the part inside the hole is left out"
    assert length("left") == pytest.approx(0.02, rel=1e-9)
    assert length("bore") == pytest.approx(2 * np.pi * 0.004, rel=0.02)


def test_small_and_large_plates_mesh_alike(tmp_path):
    shapes = PLATES["triangles, hole and inclined crack"][1]
    sizes = []
    for scale in (1e-4, 1.0, 1e4):
        plate = geometry(
            width=0.04 * scale,
            height=0.02 * scale,
            holes=[(n, (x * scale, y * scale), r * scale) for n, (x, y), r in shapes["holes"]],
            cracks=[(n, (a * scale, b * scale), (c * scale, d * scale)) for n, (a, b), (c, d) in shapes["cracks"]],
        )
        make_mesh(plate, spec("triangle", 1e-3 * scale), tmp_path / "plate.msh")
        sizes.append(group_sizes(tmp_path / "plate.msh"))
    # The last digit of a coordinate may decide how a triangle is cut, so the number of cells is not quite the same.
    counts = [size.pop("plate") for size in sizes]
    assert counts == pytest.approx([750] * 3, rel=0.05)
    assert sizes[0] == sizes[1] == sizes[2]


def test_works_in_threads(tmp_path):
    make_mesh(geometry(), spec("triangle"), tmp_path / "plain.msh")
    threads = [
        threading.Thread(target=make_mesh, args=(geometry(), spec("triangle"), tmp_path / f"{k}.msh")) for k in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k in range(3):
        assert (tmp_path / f"{k}.msh").read_bytes() == (tmp_path / "plain.msh").read_bytes()


def test_says_nothing(tmp_path, capfd):
    make_mesh(geometry(), spec("triangle"), tmp_path / "plate.msh")
    assert capfd.readouterr() == ("", "")


def test_crack_outside_the_plate_is_refused_and_leaves_no_file(tmp_path):
    with pytest.raises(PdheError, match="'crack:notch'"):
        make_mesh(geometry(cracks=[("notch", (1.0, 1.0), (2.0, 1.0))]), spec("triangle"), tmp_path / "plate.msh")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["left", "plate", "all", "bore"])
def test_names_must_differ(name, tmp_path):
    with pytest.raises(PdheError, match=f"'{name}' is already taken"):
        make_mesh(
            geometry(holes=[("bore", (0.02, 0.01), 0.002)], cracks=[(name, (0.0, 0.01), (0.01, 0.01))]),
            spec("triangle"),
            tmp_path / "plate.msh",
        )


def test_missing_system_library_is_named_with_its_remedy(tmp_path, monkeypatch):
    class Refuse:
        def find_spec(self, name, path=None, target=None):
            if name == "gmsh":
                raise OSError("libGLU.so.1: cannot open shared object file")

    monkeypatch.delitem(sys.modules, "gmsh", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Refuse(), *sys.meta_path])
    with pytest.raises(PdheError, match=r"libGLU\.so\.1.*apt-get install .*libglu1-mesa"):
        make_mesh(geometry(), spec(), tmp_path / "plate.msh")
