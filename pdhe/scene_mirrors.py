"""Checks of a scene that is a half or a quarter of a symmetric body: nothing may contradict its mirror lines."""

import math
from typing import TYPE_CHECKING

from pdhe.scene_fields import problem

if TYPE_CHECKING:
    from pdhe.scene import Scene
    from pdhe.scene_blocks import Crack, Geometry, Hole, Region

Segment = tuple[tuple[float, float], tuple[float, float]]


def edge_segments(width: float, height: float) -> dict[str, Segment]:
    """Return the four edges of a plate (m) by name."""
    return {
        "left": ((0.0, 0.0), (0.0, height)),
        "right": ((width, 0.0), (width, height)),
        "bottom": ((0.0, 0.0), (width, 0.0)),
        "top": ((0.0, height), (width, height)),
    }


def mirror_levels(geometry: "Geometry") -> dict[str, tuple[int, float]]:
    """Return for each mirror line the axis across it, 0 or 1, and its place along that axis (m)."""
    width, height = geometry.width, geometry.height
    places = {"left": (0, 0.0), "right": (0, width), "bottom": (1, 0.0), "top": (1, height)}
    return {edge: places[edge] for edge in geometry.symmetry or ()}


def mirrors_through(geometry: "Geometry", hole: "Hole") -> list[str]:
    """Return the mirror lines that a hole is centred on: the plate has a half or a quarter of it."""
    lines = mirror_levels(geometry).items()
    return [edge for edge, (axis, level) in lines if abs(hole.centre[axis] - level) <= 1e-9 * hole.radius]


def whole_size(geometry: "Geometry") -> tuple[float, float]:
    """Return width and height (m) of the body of which the plate may be a part."""
    axes = [axis for axis, _ in mirror_levels(geometry).values()]
    return geometry.width * (2.0 if 0 in axes else 1.0), geometry.height * (2.0 if 1 in axes else 1.0)


def whole_length(geometry: "Geometry", crack: "Crack") -> float:
    """Return the length (m) of a crack with the image that it goes on as beyond a mirror line."""
    length = crack.length
    for axis, level in mirror_levels(geometry).values():
        if sum(abs(point[axis] - level) <= 1e-9 * length for point in (crack.start, crack.end)) == 1:
            length *= 2.0
    return length


def check_symmetry(scene: "Scene") -> None:
    """Raise the first contradiction between a scene and the mirror lines it declares."""
    mirrors = mirror_levels(scene.geometry)
    if not mirrors:
        return
    conditions = scene.hydrogen.boundary if scene.hydrogen else ()
    loads = enumerate(scene.loads or ())
    named = [(f"loads.{k}.on", load.on, "its points stay on it and are free along it") for k, load in loads]
    named += [(f"hydrogen.boundary.{k}.on", item.on, "no hydrogen crosses it") for k, item in enumerate(conditions)]
    named += [
        (f"damage.no_fail.{k}", name, "bonds across it break like others")
        for k, name in enumerate(scene.damage.no_fail if scene.damage else ())
    ]
    damage = scene.damage
    text = "its nodes are those beside the line"
    layers = scene.hydrogen.regions if scene.hydrogen else None
    named += [(f"hydrogen.regions.{k}.on", layer.on, text) for k, layer in enumerate(layers or ())]
    if damage is not None:
        named += [(f"damage.regions.{k}.on", region.on, text) for k, region in enumerate(damage.regions or ())]
        pairs = [item.between for item in damage.interfaces or ()]
        named += [(f"damage.interfaces.{k}.between", name, text) for k, pair in enumerate(pairs) for name in pair]
    for key, name, text in named:
        if name in mirrors:
            hint = f"{text}; name another set, or take it out of `geometry.symmetry`"
            raise problem("is a mirror line, inside the body", hint, key)
    _check_cracks(scene, mirrors)
    _check_loads(scene, mirrors)


def _check_cracks(scene: "Scene", mirrors: dict[str, tuple[int, float]]) -> None:
    """Refuse cracks that would have a kink where they meet their images."""
    for k, crack in enumerate(scene.geometry.cracks):
        slack = 1e-9 * math.dist(crack.start, crack.end)
        for edge, (axis, level) in mirrors.items():
            ends = [abs(point[axis] - level) <= slack for point in (crack.start, crack.end)]
            if any(ends) and not all(ends) and abs(crack.start[1 - axis] - crack.end[1 - axis]) > slack:
                text = f"ends at the mirror line `{edge}` at an angle: with its image it would have a kink there"
                hint = "let it end there at a right angle, lie on the line, or stay away from it"
                raise problem(text, hint, f"geometry.cracks.{k}.{'to' if ends[1] else 'from'}")


def _check_loads(scene: "Scene", mirrors: dict[str, tuple[int, float]]) -> None:
    """Refuse loads that would tear a set apart where it meets its image."""
    lines = edge_segments(scene.geometry.width, scene.geometry.height)
    lines |= {crack.name: (crack.start, crack.end) for crack in scene.geometry.cracks}
    lines |= {region.name: region_diagonal(scene.geometry, region) for region in scene.regions or ()}
    holes = {hole.name: mirrors_through(scene.geometry, hole) for hole in scene.geometry.holes}
    for k, load in enumerate(scene.loads or ()):
        for edge, (axis, level) in mirrors.items():
            given, line = load.components.get(axis, 0.0), lines.get(load.on)
            moving = any(given.values) if load.kind != "initial_velocity" and given else given != 0.0
            meets = (
                load.on == "all"
                or edge in holes.get(load.on, ())
                or (line is not None and min(abs(point[axis] - level) for point in line) <= 1e-9 * math.dist(*line))
            )
            if moving and meets:
                text = f"moves `{load.on}` across the mirror line `{edge}`, where its image moves the other way"
                hint = "only 0 is possible there; move a set that does not meet the line, or drop the symmetry"
                raise problem(text, hint, f"loads.{k}.{load.kind}.{'xy'[axis]}")


def region_diagonal(geometry: "Geometry", region: "Region") -> Segment:
    """Return two opposite corners of what a region has of the plate (m)."""
    x0, y0, x1, y1 = region.box
    return (max(x0, 0.0), max(y0, 0.0)), (min(x1, geometry.width), min(y1, geometry.height))
