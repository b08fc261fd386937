"""Nodes of the plate: one per mesh cell, at its centroid, with its true volume, and the named sets they belong to.

Centroids with element areas, rather than mesh vertices with shared-out areas, put no node on the boundary and need no
averaged volume; after the moment-matched correction of the bonds they reproduce the elastic moduli on irregular meshes.

Nodes are numbered in horizontal strips one spacing high, from left to right in each: row by row on a structured mesh,
and nearly so on any other. One sort serves both, and a family is a few contiguous runs of memory.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pdhe import solid_nodes
from pdhe.errors import PdheError
from pdhe.mesh import ALL, CRACK_PREFIX, EDGES, PLATE
from pdhe.netcdf import CHANGED, Variable, read_netcdf, write_netcdf
from pdhe.scene_blocks import SOLID_CELLS
from pdhe.scene_mirrors import mirrors_through
from pdhe.scene_solid import FACES
from pdhe.sizing import SizeField
from pdhe.surfaces import surface_of
from pdhe.wholefile import intact

if TYPE_CHECKING:
    from pdhe.scene import Crack, Geometry, Mesh

# A crack that the mesh does not follow owns the cells whose centroid is at most this many spacings away from it.
CRACK_REACH = 0.75
# Largest cell over the spacing asked for; meshes without near misses stay below 1.3.
COARSEST = 2.0
# Relative tolerance below which lengths and areas count as equal.
ROUND_OFF = 1e-6
# A circle of chords of length h misses pi h^2 / 6 of its area, whatever its radius: 1.2 spacing^2 for triangles.
HOLE_TOLERANCE = 3.0
# Edges of tetrahedra over the spacing, generously: chords of holes in space are as long.
SOLID_EDGE = 2.2

_DIMENSIONS = {
    "coordinates": ("node", "component"),
    "volume": ("node",),
    "spacing": ("node",),
    "vertices": ("vertex", "component"),
    "cells": ("node", "corner"),
}
_ATTRIBUTES = {
    "coordinates": {"units": "m", "long_name": "position of the node, the centroid of its cell"},
    "volume": {"units": "m^3", "long_name": "volume of the cell"},
    "spacing": {"units": "m", "long_name": "square root of the area of the cell"},
    "vertices": {"units": "m", "long_name": "position of the vertex"},
    "cells": {"units": "1", "long_name": "vertices of the cell, counter-clockwise; the last one repeated if fewer"},
}


@dataclass(frozen=True, eq=False)
class Discretization:
    """Nodes, their volumes, the cells they stand for and the named node sets; ``n`` nodes, ``nv`` vertices."""

    coordinates: np.ndarray
    """(n, 2) float64, m: cell centroids; in space (n, 3)."""
    volume: np.ndarray
    """(n,) float64, m^3: area of the cell times the thickness; in space the volume of the cell."""
    spacing: np.ndarray
    """(n,) float64, m: square root of the area of the cell; in space the cube root of its volume."""
    vertices: np.ndarray
    """(nv, 2) float64, m: vertices of the mesh; in space (nv, 3)."""
    cells: np.ndarray
    """(n, 3) or (n, 4) int32: vertices of each cell, counter-clockwise; a triangle among quadrilaterals repeats one.

    In space (n, 4), tetrahedra, or (n, 8), hexahedra, in the order of gmsh."""
    node_sets: dict[str, np.ndarray]
    """Name to sorted int32 node numbers: the four edges, every hole and crack, and ``all``."""
    regular: bool
    """True if all cells are equal squares, or cubes, aligned with the axes (within 1e-6)."""
    thickness: float
    """m."""

    @property
    def dimension(self) -> int:
        """2 for a plate, 3 for a body in space."""
        return self.coordinates.shape[1]


def discretize(mesh_path: str | os.PathLike[str], geometry: Geometry, mesh_spec: Mesh) -> Discretization:
    """Read a mesh written by :func:`pdhe.mesh.make_mesh` and turn its cells into nodes.

    An edge set holds the cells with a vertex on the edge: on triangles, where every second cell of the outer row has no
    facet on it, holding the others alone would make a grip 2 to 4 % too soft (topic ``moduli``). A hole set holds the
    cells with a facet on the hole. The set of a crack that the mesh conforms to holds the cells with a facet on it, on
    both sides; that of any other crack holds the cells whose centroid projects inside the crack and lies within 0.75
    spacing of it. On a structured mesh all rules agree, for a crack along a grid line.

    Parameters
    ----------
    mesh_path
        Mesh file.
    geometry
        The geometry that was meshed: ``width``, ``height``, ``thickness`` (m), ``holes`` and ``cracks``.
    mesh_spec
        ``spacing`` (m) that was asked for.

    Raises
    ------
    PdheError
        The file is missing, damaged, lacks a physical group or is the mesh of another geometry; a crack owns no cell.
    """
    path = Path(mesh_path)
    if mesh_spec.cells in SOLID_CELLS:
        return _discretize_solid(path, geometry, mesh_spec)
    vertices, cells, curves = _read_mesh(path, geometry)
    vertices, on_grid = _snapped_to_grid(vertices, cells, geometry, mesh_spec.spacing)
    coordinates, area = _centroids_and_areas(vertices, cells)
    _check_areas(path, area, geometry, mesh_spec.spacing)

    strips = max(1, round(geometry.height / mesh_spec.spacing))
    strip = np.floor(coordinates[:, 1] * (strips / geometry.height)).astype(np.int32)
    order = np.lexsort((coordinates[:, 1], coordinates[:, 0], strip))
    coordinates, area, cells = coordinates[order], area[order], cells[order]
    regular = on_grid and cells.shape[1] == 4 and _squares(vertices[cells[0]])
    if regular:
        area = np.full(len(area), area.mean())
    spacing = np.sqrt(area)
    wanted = SizeField(geometry, mesh_spec)(coordinates) if mesh_spec.refine else np.array([mesh_spec.spacing])
    coarsest = int(np.argmax(spacing / wanted))
    if spacing[coarsest] > COARSEST * (asked := wanted[coarsest % wanted.size]):
        raise PdheError(
            f"{path}: the largest cell is {spacing[coarsest]:.3g} m wide where {asked:g} m were asked for: "
            "cracks, holes or edges that nearly touch use up the cells; move them apart or together, or use a "
            "smaller mesh.spacing"
        )

    node_sets: dict[str, np.ndarray] = {}
    on_curve = _cells_on_curves(cells, curves, len(vertices))
    for name in (*EDGES, *(hole.name for hole in geometry.holes)):
        node_sets[name], conforming = on_curve[name]
        if not conforming:
            raise _damaged(path, f"the curve {name!r} does not follow the cells")
        if name in EDGES:
            touching = np.isin(cells, curves[name]).any(axis=1)
            node_sets[name] = np.flatnonzero(touching).astype(np.int32)
    for crack in geometry.cracks:
        nodes, conforming = on_curve[CRACK_PREFIX + crack.name]
        node_sets[crack.name] = nodes if conforming else _near_crack(coordinates, spacing, crack)
        if not node_sets[crack.name].size:
            raise _no_cell(crack.name, mesh_spec.spacing)
    node_sets[ALL] = np.arange(len(area), dtype=np.int32)

    vertices, cells = _used(vertices, cells)
    return Discretization(
        coordinates=coordinates,
        volume=area * geometry.thickness,
        spacing=spacing,
        vertices=vertices,
        cells=cells,
        node_sets=node_sets,
        regular=regular,
        thickness=float(geometry.thickness),
    )


def _used(vertices: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drop vertices that belong to no cell."""
    used = np.zeros(len(vertices), dtype=bool)
    used[cells.ravel()] = True
    renumbered = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return vertices[used], renumbered[cells]


def _discretize_solid(path: Path, geometry: Geometry, mesh_spec: Mesh) -> Discretization:
    """The same for cells that fill space: layers one spacing thick along z, in each of them strips as in the plane."""
    vertices, cells, surfaces = _read_mesh(path, geometry, solid=True)
    size = np.array([geometry.width, geometry.height, geometry.thickness])
    vertices, on_grid = solid_nodes.snapped_to_grid(vertices, cells, size, mesh_spec.spacing)
    coordinates, volume = solid_nodes.centroids_and_volumes(vertices, cells)
    # A circle of chords of length h misses pi h^2 / 6 of its area, here along the whole thickness.
    chords = HOLE_TOLERANCE * SOLID_EDGE**2 * mesh_spec.spacing**2 * geometry.thickness * len(geometry.holes)
    _check_sum(path, volume, geometry, float(size[2]), chords, "m^3")
    strips = np.maximum(1, np.rint(size / mesh_spec.spacing))
    strip = np.floor(coordinates * (strips / size)).astype(np.int32)
    order = np.lexsort((coordinates[:, 2], coordinates[:, 1], coordinates[:, 0], strip[:, 1], strip[:, 2]))
    coordinates, volume, cells = coordinates[order], volume[order], cells[order]
    sides = size / strips
    regular = on_grid and bool(np.ptp(sides) <= ROUND_OFF * sides[0])
    if regular:
        volume = np.full(len(volume), volume.mean())
    spacing = np.cbrt(volume)
    if spacing.max() > COARSEST * mesh_spec.spacing:
        raise PdheError(
            f"{path}: the largest cell is {spacing.max():.3g} m wide where {mesh_spec.spacing:g} m were asked for: "
            "cracks, holes or faces that nearly touch use up the cells; move them apart or together, or use a "
            "smaller mesh.spacing"
        )
    node_sets: dict[str, np.ndarray] = {}
    on_surface = solid_nodes.cells_on_surfaces(cells, surfaces, len(vertices))
    for name in (*EDGES, *FACES, *(hole.name for hole in geometry.holes)):
        node_sets[name], conforming = on_surface[name]
        if not conforming:
            raise _damaged(path, f"the surface {name!r} does not follow the cells")
        if name in (*EDGES, *FACES):
            node_sets[name] = np.flatnonzero(np.isin(cells, surfaces[name]).any(axis=1)).astype(np.int32)
    for crack in geometry.cracks:
        nodes, conforming = on_surface.get(CRACK_PREFIX + crack.name, (np.empty(0, np.int32), False))
        near = solid_nodes.near_surface(coordinates, spacing, surface_of(crack, geometry.thickness))
        node_sets[crack.name] = nodes if conforming and nodes.size else near
        if not node_sets[crack.name].size:
            raise _no_cell(crack.name, mesh_spec.spacing)
    node_sets[ALL] = np.arange(len(volume), dtype=np.int32)
    vertices, cells = _used(vertices, cells)
    return Discretization(
        coordinates, volume, spacing, vertices, cells, node_sets, regular, float(geometry.thickness)
    )  # fmt: skip


def _no_cell(name: str, spacing: float) -> PdheError:
    """The error for a crack that no cell lies at."""
    return PdheError(
        f"geometry.cracks: crack {name!r} owns no cell of the mesh; use a smaller mesh.spacing than "
        f"{spacing:g} m or a longer crack"
    )


def write_discretization(discretization: Discretization, path: str | os.PathLike[str]) -> None:
    """Write a NetCDF-4 file; it appears complete or not at all. The set ``all`` is implied."""
    named = {name: nodes for name, nodes in discretization.node_sets.items() if name != ALL}
    members = np.concatenate([*named.values(), np.empty(0, dtype=np.int32)]).astype(np.int32)
    variables = {
        name: Variable(dimensions, getattr(discretization, name), _ATTRIBUTES[name])
        for name, dimensions in _DIMENSIONS.items()
    } | {
        "node_set_name": Variable(
            ("node_set",), np.array(list(named), dtype=object), {"long_name": "name of the node set"}
        ),
        "node_set_size": Variable(
            ("node_set",),
            np.array([len(nodes) for nodes in named.values()], dtype=np.int32),
            {"units": "1", "long_name": "number of nodes in the node set"},
        ),
        "node_set_member": Variable(
            ("member",), members, {"units": "1", "long_name": "nodes of the sets, one set after another"}
        ),
    }
    attributes = {
        "title": "discretization of a plate",
        "thickness": discretization.thickness,
        "thickness_units": "m",
        "regular": int(discretization.regular),
    }
    write_netcdf(path, variables, attributes)


def read_discretization(path: str | os.PathLike[str]) -> Discretization:
    """Read a file written by :func:`write_discretization`.

    Raises
    ------
    PdheError
        The file is missing or is not such a file.
    """
    path = Path(path)
    try:
        data, attributes = read_netcdf(path)
        arrays = {name: data[name] for name in _DIMENSIONS}
        ends = np.cumsum(data["node_set_size"])
        parts = np.split(data["node_set_member"], ends[:-1]) if ends.size else []
        node_sets = dict(zip((str(name) for name in data["node_set_name"]), parts, strict=True))
        node_sets[ALL] = np.arange(len(arrays["volume"]), dtype=np.int32)
        regular, thickness = bool(attributes["regular"]), float(attributes["thickness"])
    except FileNotFoundError as error:
        raise PdheError(f"{path}: no such file of nodes; run the nodes step first") from error
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        raise _damaged(path, str(error)) from error
    return Discretization(**arrays, node_sets=node_sets, regular=regular, thickness=thickness)


def _damaged(path: Path, problem: str) -> PdheError:
    """The error for a file that cannot be used."""
    return PdheError(f"{path}: not a usable file ({problem}); delete it and run again")


def _read_mesh(
    path: Path, geometry: Geometry, solid: bool = False
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Vertices (nv, 2), cells (n, 3 or 4) and, for each curve group, its segments (m, 2) of vertex numbers.

    In space vertices (nv, 3), cells (n, 4 or 8) and, for each surface group, its elements (m, 3 or 4). A mesh that
    does not follow a crack has no group for it then.
    """
    if not path.is_file():
        raise PdheError(f"{path}: no such mesh; run the mesh step first")
    import meshio.gmsh  # here, because it loads readers of many formats and a solve has no mesh to read

    whole = intact(path)
    if not whole:
        raise _damaged(path, "its end is missing, or it was not written by pdhe" if whole is None else CHANGED)
    try:
        # meshio.read would print and leave the program; its reader for gmsh raises, and only warns on the console.
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            mesh = meshio.gmsh.read(path)
        vertices = np.ascontiguousarray(mesh.points[:, : 2 + solid], dtype=np.float64)
    except Exception as error:  # a damaged file fails in many ways: struct, Unicode, index, value, memory errors
        raise _damaged(path, f"{type(error).__name__}: {error}") from error

    curves = [
        *EDGES,
        *(FACES if solid else ()),
        *(hole.name for hole in geometry.holes),
        *(CRACK_PREFIX + crack.name for crack in geometry.cracks),
    ]
    if solid:
        curves = [name for name in curves if not name.startswith(CRACK_PREFIX) or name in mesh.cell_sets]
    for name in (PLATE, *curves):
        if not sum(len(part) for part in mesh.cell_sets.get(name, ())):
            raise PdheError(f"{path}: physical group {name!r} is missing or empty; delete the file and run again")

    def blocks(name: str) -> dict[str, np.ndarray]:
        """Elements of one group, stacked by type."""
        found: dict[str, list[np.ndarray]] = {}
        for block, part in zip(mesh.cells, mesh.cell_sets[name], strict=True):
            if len(part):
                found.setdefault(block.type, []).append(block.data[part])
        return {kind: np.concatenate(parts).astype(np.int32) for kind, parts in found.items()}

    by_type = blocks(PLATE)
    segments = {name: blocks(name) for name in curves}
    if solid:
        kind = "hexahedron" if "hexahedron" in by_type else "tetra"
        facet = "quad" if kind == "hexahedron" else "triangle"
        if set(by_type) != {kind} or any(set(kinds) != {facet} for kinds in segments.values()):
            raise _damaged(path, f"it does not hold tetrahedra alone or hexahedra alone: {sorted(by_type)}")
        cells, facets = by_type[kind], {name: kinds[facet] for name, kinds in segments.items()}
        if not np.isfinite(vertices).all() or min(part.min() for part in (cells, *facets.values())) < 0:
            raise _damaged(path, "its vertices are incomplete")
        return vertices, cells, facets
    if not set(by_type) <= {"triangle", "quad"} or any(set(kinds) != {"line"} for kinds in segments.values()):
        raise _damaged(path, f"it holds elements other than lines, triangles and quadrilaterals: {sorted(by_type)}")
    lines = {name: kinds["line"] for name, kinds in segments.items()}
    if len(by_type) == 2:
        by_type["triangle"] = by_type["triangle"][:, [0, 1, 2, 2]]
    cells = np.concatenate(list(by_type.values()))
    if not np.isfinite(vertices).all() or min(part.min() for part in (cells, *lines.values())) < 0:
        raise _damaged(path, "its vertices are incomplete")
    return vertices, cells, lines


def _centroids_and_areas(vertices: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centroid (n, 2) and signed area (n,) of each polygon, by the shoelace formula about its first corner."""
    with np.errstate(all="ignore"):  # areas are checked next
        origin = vertices[cells[:, 0]]
        area = np.zeros(len(cells))
        moment = np.zeros((len(cells), 2))
        previous = vertices[cells[:, 1]] - origin
        for corner in range(2, cells.shape[1]):
            current = vertices[cells[:, corner]] - origin
            triangle = 0.5 * (previous[:, 0] * current[:, 1] - current[:, 0] * previous[:, 1])
            area += triangle
            moment += triangle[:, None] * (previous + current) / 3.0
            previous = current
        return origin + moment / area[:, None], area


def _check_areas(path: Path, area: np.ndarray, geometry: Geometry, spacing: float) -> None:
    """Every area is positive and their sum is that of the plate without its holes, or without what it has of them.

    The sum may differ by 1e-6 of the plate plus 3 spacing^2 per hole, whose circle became a polygon.
    """
    _check_sum(path, area, geometry, 1.0, HOLE_TOLERANCE * spacing**2 * len(geometry.holes), "m^2")


def _check_sum(path: Path, size: np.ndarray, geometry: Geometry, depth: float, chords: float, unit: str) -> None:
    """Areas, or volumes of a ``depth``, are positive and sum up to those of the geometry; ``chords`` may lack."""
    if not (size > 0).all():
        kind = "area" if unit == "m^2" else "volume"
        raise _damaged(path, f"{np.count_nonzero(~(size > 0))} cells have no positive {kind}")
    plate, total = geometry.width * geometry.height * depth, float(size.sum())
    holes = (math.pi * hole.radius**2 / 2 ** len(mirrors_through(geometry, hole)) for hole in geometry.holes)
    expected = plate - depth * sum(holes)
    if abs(total - expected) > ROUND_OFF * plate + chords:
        raise _damaged(path, f"its cells cover {total:.6g} {unit} where the geometry has {expected:.6g} {unit}")


def _cells_on_curves(
    cells: np.ndarray, curves: dict[str, np.ndarray], vertex_count: int
) -> dict[str, tuple[np.ndarray, bool]]:
    """For each curve, the cells with a facet on it, and whether all of its segments are facets of cells."""
    on_any = np.zeros(vertex_count, dtype=bool)
    for segments in curves.values():
        on_any[segments.ravel()] = True

    def keys(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """One integer for a pair of vertices in either order."""
        return np.minimum(first, second).astype(np.int64) * vertex_count + np.maximum(first, second)

    following = np.roll(cells, -1, axis=1)
    owner, corner = np.nonzero(on_any[cells] & on_any[following])
    facets = keys(cells[owner, corner], following[owner, corner])
    found = {}
    for name, segments in curves.items():
        wanted = keys(segments[:, 0], segments[:, 1])
        nodes = np.unique(owner[np.isin(facets, wanted)]).astype(np.int32)
        found[name] = nodes, bool(np.isin(wanted, facets).all())
    return found


def _near_crack(coordinates: np.ndarray, spacing: np.ndarray, crack: Crack) -> np.ndarray:
    """Nodes whose projection falls strictly inside the crack and that lie within 0.75 spacing of it."""
    start, end = np.asarray(crack.start, dtype=np.float64), np.asarray(crack.end, dtype=np.float64)
    length = math.dist(crack.start, crack.end)
    along = (end - start) / length
    relative = coordinates - start
    position = relative @ along
    distance = np.abs(relative[:, 1] * along[0] - relative[:, 0] * along[1])
    slack = ROUND_OFF * spacing
    inside = (position > slack) & (position < length - slack)
    return np.flatnonzero(inside & (distance <= CRACK_REACH * spacing + slack)).astype(np.int32)


def _snapped_to_grid(
    vertices: np.ndarray, cells: np.ndarray, geometry: Geometry, spacing: float
) -> tuple[np.ndarray, bool]:
    """Vertices of a structured mesh, rid of gmsh's round-off, and whether it is one.

    gmsh places them to about 1e-12 of the spacing, which would make equal cells and symmetric families slightly
    unequal.
    """
    size = np.array([geometry.width, geometry.height])
    counts = np.maximum(1, np.rint(size / spacing))
    index = np.rint(vertices * (counts / size))
    snapped = index * size / counts
    used = np.unique(cells)
    if len(cells) != counts.prod() or np.abs(vertices - snapped)[used].max() > ROUND_OFF * spacing:
        return vertices, False
    return snapped, True


def _squares(corners: np.ndarray) -> bool:
    """Whether a cell (4, 2) that is a rectangle along the axes is a square."""
    width, height = corners.max(axis=0) - corners.min(axis=0)
    return bool(abs(width - height) <= ROUND_OFF * width)
