import pytest

from pdhe.scene import load_scene
from pdhe.verification.crack_scenes import HELD_PULL, LAYOUTS, RAMP, run


def test_cracks_take_their_paths(tmp_path):
    report = run(spacing=4e-3, layouts=("inclined", "hole"))
    assert report.passed, [row for row in report.rows if not row.passed]
    report.write(tmp_path)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("file", "layout"), [("inclined_crack", "inclined"), ("offset_cracks", "offset"), ("crack_near_hole", "hole")]
)
def test_the_example_scenes_are_those_of_the_topic(file, layout):
    scene, wanted = load_scene(f"config/scenes/{file}.yaml"), LAYOUTS[layout]
    assert {c.name: (c.start, c.end) for c in scene.geometry.cracks} == wanted.cracks
    assert [hole.model_dump() for hole in scene.geometry.holes] == list(wanted.holes)
    assert scene.time.end == wanted.end
    assert {c.on for c in scene.hydrogen.boundary} == set(wanted.cracks)
    assert scene.loads[0].displacement.y(2.0 * RAMP) == pytest.approx(HELD_PULL)
    assert scene.mesh.cells == "triangle"
