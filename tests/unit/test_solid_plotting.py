"""Pictures of bodies in space."""

import json

import numpy as np
import pytest
from PIL import Image

from pdhe import post
from pdhe.plotting import animate, draw
from pdhe.plotting.picture import KINDS
from pdhe.plotting.solid import Camera, SolidPicture
from pdhe.plotting.style import Style
from pdhe.results import Recorder, open_result
from pdhe.scene import Crack
from pdhe.surfaces import surface_of
from tests.unit.test_solid_scenes import nodes

FAST = {"dpi": 60, "frame_width": 240}
SIZE = (6e-3, 4e-3, 4e-3)
NOTCH = {"name": "notch", "from": [0.0, 2e-3], "to": [2e-3, 2e-3]}
PENNY = {"name": "penny", "disc": {"centre": [4.5e-3, 2e-3, 2e-3], "normal": [0.0, 1.0, 0.0], "radius": 1.2e-3}}


def write_solid_result(folder, cells: str):
    """A block torn along y = 2 mm up to x = 2, 3 and 4 mm at its three outputs."""
    cracks = tuple(Crack.model_validate(item, context={"si": True}) for item in (NOTCH, PENNY))
    d, recorder = nodes(folder, cells, cracks=cracks, size=SIZE), Recorder()
    x, y, _ = d.coordinates.T
    for k, time in enumerate((0.0, 3600.0, 7200.0)):
        tip = 2e-3 + 1e-3 * k
        if k:
            torn = (x > tip - 1e-3) & (x < tip)
            low, high = (np.flatnonzero((np.abs(y - at) < 0.51e-3) & torn) for at in (1.5e-3, 2.5e-3))
            if cells == "hexahedron":
                recorder.broke(low, high, time - 60.0)
        opening = 1e-5 * np.where(x < tip, np.sign(y - 2e-3), (y - 2e-3) / 2e-3)
        recorder.snapshot(
            time, displacement=np.column_stack([0 * x, opening, -0.1 * opening]), coverage=x / 6e-3 * (k + 1) / 3,
            damage=np.where((np.abs(y - 2e-3) < 1e-3) & (x < tip), 0.4, 0.0), state_age=1e-2 * x / 6e-3,
        )  # fmt: skip
        recorder.row(history_time=time, crack_extension=tip - 2e-3)
    plate = dict(zip(("width", "height", "thickness"), SIZE, strict=True))
    scene = {"geometry": {"plate": plate, "cracks": [NOTCH, PENNY]}}
    path = folder / "solid.nc"
    recorder.contents(d, {"title": "made up", "status": "complete", "scene": json.dumps(scene)}).write(path)
    return path


@pytest.fixture(scope="module", params=["hexahedron", "tetrahedron"])
def path(request, tmp_path_factory):
    return write_solid_result(tmp_path_factory.mktemp("solid"), request.param)


def picture(path, kind, **style) -> SolidPicture:
    with open_result(path) as result:
        return SolidPicture(result.load(), kind, Style.of(style))


@pytest.mark.parametrize("kind", KINDS)
def test_figures_show_the_body_in_the_colours_of_the_field(path, tmp_path, kind):
    draw(kind, path, FAST, tmp_path / "figure.png")
    with Image.open(tmp_path / "figure.png") as image:
        assert image.width == pytest.approx(180 / 25.4 * 60, abs=1)
        assert len(image.convert("RGB").getcolors(100_000)) > 20


def test_animations_have_one_palette_of_three_lights(path, tmp_path):
    animate("coverage", path, FAST, tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == 3
        assert len(film.convert("RGB").getcolors(100_000)) > 20
    shades = picture(path, "coverage").shades(128)
    assert 150 < len(shades) <= 256 - 32 and shades.max() <= 1.0


def test_facets_enclose_the_cells(path):
    """Outer facets make up the surface of the block; each inner one stands between two cells."""
    with open_result(path) as result:
        facets, vertices = post.facets_of(result), result["vertices"].values
        surfaces = post.crack_surfaces(result)
    outer = vertices[facets.outer_vertices]
    area = 0.5 * np.linalg.norm(np.cross(outer[:, 1] - outer[:, 0], outer[:, 2] - outer[:, 0]), axis=1)
    area *= 2 if outer.shape[1] == 4 else 1
    assert area.sum() == pytest.approx(2 * (24 + 24 + 16) * 1e-6, rel=1e-9)
    want = [surface_of(Crack.model_validate(item, context={"si": True}), 4e-3).area for item in (NOTCH, PENNY)]
    assert [surface.area for surface in surfaces] == pytest.approx(want)
    cut = vertices[facets.vertices[facets.broken == post.PRE_CRACKED]]
    assert len(cut) > 8 and np.abs(cut[..., 1] - 2e-3).max() < 1e-9


def test_a_quarter_is_cut_away_along_the_crack(path):
    """On cubes the rest has the surface of an L-shaped bar: two ends of 12 mm^2, a girth of 16 mm, a length of 6 mm."""
    shown = picture(path, "coverage")
    cells, place, broken = shown.visible(0)
    corners = shown.corners(0)[cells[:, None], place]
    if corners.shape[1] == 4:
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        # Cracks count on both sides inside the rest, on one where the other is cut away: 4 facets of notch, 3 of disc
        inside = np.array([(c[:, 1] == c[0, 1]).all() and abs(c[0, 1] - 2e-3) < 1e-9 for c in corners])
        behind = broken & inside & (corners[:, :, 2].mean(axis=1) < 2e-3)
        assert area[~behind].sum() == pytest.approx(120e-6, rel=1e-9)
        assert behind.sum() == 2 * (4 + 3)
    assert shown.kept.mean() == pytest.approx(0.75, abs=0.06)
    front = shown.kept & (shown._centres[:, 2] > 2e-3)
    assert shown._centres[front, 1].max() < 2.01e-3


def test_a_pixel_shows_the_cell_in_front(path):
    shown = picture(path, "coverage")
    extent, shape = shown.extent, (300, 400)
    image = shown.draw(2, extent, shape)
    # The middle of the top behind the cut: facing up, in full light.
    x, y = shown.camera.flat(np.array([3e-3, 4e-3, 1e-3]))
    row = int((extent[3] - y) / (extent[3] - extent[2]) * shape[0])
    column = int((x - extent[0]) / (extent[1] - extent[0]) * shape[1])
    near = np.abs(shown._centres - [3e-3, 3.5e-3, 1e-3]).max(axis=1) < 1.3e-3
    values = shown.field[2][near]
    colours = shown.colours(shown.norm()(np.linspace(values.min(), values.max(), 200)))[:, :3]
    assert image[row, column, 3] == 1.0
    assert np.abs(colours - image[row, column, :3]).max(axis=1).min() < 0.02
    assert image[0, 0, 3] == 0.0


def test_the_crack_opens_in_the_displaced_shape(path):
    shown = picture(path, "displacement", magnification=10.0)
    corners = shown.corners(2)
    y, x = shown._centres[:, 1], shown._centres[:, 0]
    rim = (np.abs(shown.vertices[shown.cells][..., 1] - 2e-3) < 1e-9) & (shown.vertices[shown.cells][..., 0] < 1e-3)
    above, below = rim & (y > 2e-3)[:, None], rim & (y < 2e-3)[:, None]
    assert corners[above][:, 1].min() - corners[below][:, 1].max() == pytest.approx(2e-4, rel=1e-6)
    assert shown.label.startswith("displacement $u_y$") and x.size == len(corners)


def test_the_camera_is_upright_and_looks_at_the_corner():
    camera = Camera.at_corner()
    frame = np.array([camera.right, camera.up, camera.towards])
    assert np.abs(frame @ frame.T - np.eye(3)).max() < 1e-15 and np.linalg.det(frame) == pytest.approx(1.0)
    flat = camera.flat(np.eye(3))
    assert flat[0, 0] > 0.5 and flat[1, 0] == 0.0 and flat[1, 1] > 0.5 and flat[2, 0] < 0.0 and flat[2, 1] < 0.0
