"""Checks of a scene in space: cells, cracks as discs and polygons, and which node sets may share nodes.

Pure Python, as all that reads a scene; :mod:`pdhe.scene_checks` calls these where cells fill space.
"""

import math
from typing import TYPE_CHECKING

from pdhe.scene_fields import problem

if TYPE_CHECKING:
    from pdhe.scene import Scene
    from pdhe.scene_blocks import Crack

FACES = ("front", "back")
"""Node set names that every body in space has beside those of a plate: at z = 0 and at the thickness."""
SOLID_MODELS = ("condensed rotation", "thesis spring", "one-parameter", "state-based", "correspondence")
"""Elastic models that there are in space."""
SQUARENESS = 0.02
"""Largest relative difference of the sides of a cell on a structured mesh."""
FLATNESS = 1e-6
"""Distance of a polygon's corner from the plane of the others over the polygon's size that counts as none."""

Place = tuple[float, float, float]
Box = tuple[tuple[float, float], ...]


def cubic_cells(size: Place, spacing: float) -> tuple[tuple[int, int, int], str]:
    """Cells along the sides (m) of a block for a wanted spacing (m), and what is wrong if they are not cubes."""
    counts = tuple(max(1, round(side / spacing)) for side in size)
    sides = [side / count for side, count in zip(size, counts, strict=True)]
    if max(sides) - min(sides) <= SQUARENESS * max(sides):
        return counts, ""
    fitting = [
        size[0] / n
        for n in range(1, 4 * counts[0] + 4)
        if all(side >= 0.9 * size[0] / n and abs(_off(side * n / size[0])) <= 1e-6 for side in size)
    ]
    nearest = min(fitting, key=lambda length: abs(length - spacing), default=None)
    hint = f", for example {_mm(float(f'{nearest:.6g}'))}" if nearest else ""
    return counts, f"gives cells of {_mm(*sides)}, which are not cubes; choose one that divides all sides{hint}"


def _off(count: float) -> float:
    return count / max(1, round(count)) - 1.0


def _mm(*lengths: float) -> str:
    return " x ".join(f"{1e3 * length:g}" for length in lengths) + " mm"


def size_of(scene: "Scene") -> Place:
    """Width, height and thickness of the body, m."""
    g = scene.geometry
    return g.width, g.height, g.thickness


def check_cells(scene: "Scene", most: float) -> None:
    """Check spacing and horizon against the body; ``most`` nodes are allowed."""
    size, spacing = size_of(scene), scene.mesh.spacing
    if scene.geometry.symmetry:
        raise problem("is there for plates alone", "describe the whole body", "geometry.symmetry")
    if spacing > min(size):
        hint = f"use a fraction of the smallest side, {_mm(min(size))}"
        raise problem(f"is larger than the body, {_mm(*size)}", hint, "mesh.spacing")
    if scene.mesh.cells == "hexahedron":
        if scene.geometry.holes:
            raise problem("cannot follow holes", "use `cells: tetrahedron`", "mesh.cells")
        wrong = cubic_cells(size, spacing)[1]
        if wrong:
            raise problem(wrong, "or use `cells: tetrahedron`", "mesh.spacing")
    nodes = math.prod(side / spacing for side in size)
    if nodes > most:
        least = (math.prod(size) / most) ** (1.0 / 3.0)
        text = f"gives about {nodes:.3g} nodes, more than {most:.0e}"
        raise problem(text, f"use at least {_mm(float(f'{1.01 * least:.3g}'))}", "mesh.spacing")
    if scene.horizon_length >= min(size):
        key = "horizon.ratio" if scene.horizon.ratio is not None else "horizon.length"
        text = f"is a horizon of {_mm(scene.horizon_length)}, not smaller than the body, {_mm(*size)}"
        raise problem(text, "use a smaller horizon or a finer spacing, or a plane mesh for a thin plate", key)


def check_shape(scene: "Scene", crack: "Crack", key: str) -> None:
    """Check a crack that is a disc or a polygon."""
    size, spacing = size_of(scene), scene.mesh.spacing
    if crack.disc is not None:
        key, centre, radius = f"{key}.disc", crack.disc.centre, crack.disc.radius
        if not _inside(centre, size):
            raise problem("is outside the body", f"the body is {_mm(*size)} from (0, 0, 0)", f"{key}.centre")
        if radius < spacing * (1.0 - 1e-9):
            text = f"is smaller than the spacing, {_mm(spacing)}"
            raise problem(text, "refine the mesh or enlarge the disc", f"{key}.radius")
        return
    corners, key = crack.polygon, f"{key}.polygon"
    if len(corners) < 3:
        raise problem(f"has {len(corners)} corners", "give three or more, in order around it", key)
    for k, corner in enumerate(corners):
        if not _inside(corner, size):
            raise problem("is outside the body", f"the body is {_mm(*size)} from (0, 0, 0)", f"{key}.{k}")
    normal, area = polygon_normal(corners)
    across = max(math.dist(a, b) for a in corners for b in corners)
    if area < 0.5 * spacing**2 or area < 1e-9 * across**2:
        text = f"has an area of {1e6 * area:.3g} mm^2, less than half a cell's"
        raise problem(text, "give corners in order around it, or refine the mesh", key)
    off = [sum(n * (c - o) for n, c, o in zip(normal, corner, corners[0], strict=True)) for corner in corners]
    if max(off) - min(off) > FLATNESS * across:
        text = f"is not plane: its corners are up to {1e3 * (max(off) - min(off)):.3g} mm apart across it"
        raise problem(text, "divide it into triangles", key)


def polygon_normal(corners: tuple[Place, ...]) -> tuple[Place, float]:
    """Unit normal and area (m^2) of a polygon (Newell); zero normal if it has no area."""
    total = [0.0, 0.0, 0.0]
    for a, b in zip(corners, (*corners[1:], corners[0]), strict=True):
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            # From the first corner, so that a small polygon far from the origin keeps its digits.
            total[k] += (a[i] - corners[0][i]) * (b[j] - corners[0][j])
            total[k] -= (a[j] - corners[0][j]) * (b[i] - corners[0][i])
    twice = math.sqrt(sum(t * t for t in total))
    return tuple(t / twice if twice else 0.0 for t in total), 0.5 * twice


def _inside(place: Place, size: Place) -> bool:
    slack = 1e-9 * max(size)
    return all(-slack <= x <= side + slack for x, side in zip(place, size, strict=True))


def box_of(scene: "Scene", name: str) -> Box:
    """Return the least and the greatest coordinate along each axis of what a node set follows, m."""
    w, h, t = size_of(scene)
    whole = ((0.0, w), (0.0, h), (0.0, t))
    flat = {"left": (0, 0.0), "right": (0, w), "bottom": (1, 0.0), "top": (1, h), "front": (2, 0.0), "back": (2, t)}
    if name in flat:
        axis, level = flat[name]
        return tuple((level, level) if k == axis else whole[k] for k in range(3))
    for hole in scene.geometry.holes:
        if hole.name == name:
            (x, y), r = hole.centre, hole.radius
            return (x - r, x + r), (y - r, y + r), whole[2]
    for region in scene.regions or ():
        if region.name == name:
            x0, y0, x1, y1 = region.box
            return (x0, x1), (y0, y1), whole[2]
    crack = next(crack for crack in scene.geometry.cracks if crack.name == name)
    if crack.disc is not None:
        length = math.sqrt(sum(n * n for n in crack.disc.normal))
        reach = [crack.disc.radius * math.sqrt(max(0.0, 1.0 - (n / length) ** 2)) for n in crack.disc.normal]
        return tuple((c - r, c + r) for c, r in zip(crack.disc.centre, reach, strict=True))
    if crack.polygon is not None:
        return tuple((min(values), max(values)) for values in zip(*crack.polygon, strict=True))
    (x0, y0), (x1, y1) = crack.start, crack.end
    return (min(x0, x1), max(x0, x1)), (min(y0, y1), max(y0, y1)), whole[2]


def boxes_apart(one: Box, two: Box) -> float:
    """Distance between two boxes, m: at most that of what they hold."""
    gaps = [max(0.0, a - d, c - b) for (a, b), (c, d) in zip(one, two, strict=True)]
    return math.sqrt(sum(gap * gap for gap in gaps))


def check_mechanics(scene: "Scene") -> None:
    """Refuse what is made for plates alone."""
    if scene.mechanics.model not in SOLID_MODELS:
        listed = " or ".join(f"`{name}`" for name in SOLID_MODELS)
        raise problem("is made for plates", f"use {listed}, or a plane mesh", "mechanics.model")
    if scene.mechanics.plane != "stress":
        raise problem("is a state of plates", "leave it out: the body is computed in space", "mechanics.plane")
    if scene.mechanics.weights == "energy":
        raise problem("is made for plates", "use `moment matched`, `volume` or `none`", "mechanics.weights")
