"""Meshes of the plate, written by gmsh with one named physical group for every set of nodes that a scene can speak of.

Groups: the surface ``plate``; the edges ``left``, ``right``, ``bottom``, ``top``; every hole under its own name; every
crack as ``crack:<name>``. Three kinds of mesh:

- a plain plate in quadrilaterals is a structured grid. The number of cells along each side is rounded, so the actual
  spacing may differ from the one asked for. Cracks are written as curves that do not cut the grid;
- triangles, with or without holes, conform to every edge, hole and crack;
- a plate with holes in quadrilaterals is an unstructured mesh that conforms too; a few triangles may remain in it.

Hexahedra and tetrahedra fill the body between its two faces, ``front`` and ``back``: see :mod:`pdhe.solid_mesh`.

Cells are sized so that their mean area is the square of the spacing: exactly so on a structured grid whose spacing
divides the plate, within 5 % otherwise, unless features smaller than the spacing dominate the mesh. On graded meshes
parts of one spacing are within 3 %, if thirty cells or more, and all between them within 5 %. gmsh runs on
one thread, without random seeds, so the same request gives the same bytes.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe import solid_mesh
from pdhe.apart import apart
from pdhe.errors import PdheError
from pdhe.scene_blocks import SOLID_CELLS
from pdhe.scene_checks import square_cells
from pdhe.scene_solid import FACES
from pdhe.sizing import SizeField
from pdhe.wholefile import moved_when_whole, why_not_written

if TYPE_CHECKING:
    from pdhe.scene import Geometry, Mesh

PLATE = "plate"
ALL = "all"
EDGES = ("bottom", "right", "top", "left")
CRACK_PREFIX = "crack:"

# Edge length over spacing for a mean cell area of spacing^2. An equilateral triangle needs 2 / 3^(1/4) = 1.5197.
EDGE_OVER_SPACING = {"triangle": 1.52, "quadrilateral": 1.0}
# Relative error of the mean cell area that is left alone, and how often the plate is meshed anew to get there.
AREA_TOLERANCE, ATTEMPTS = 0.05, 4
# The same for each part of one spacing of a graded mesh; those of fewer cells count as what lies between the parts, for
# which a spacing of 0 stands.
PART_TOLERANCE, PART_ATTEMPTS, FEW = 0.03, 8, 30
BETWEEN = 0.0
SYSTEM_LIBRARIES = "libglu1-mesa libgl1 libxft2 libxcursor1 libxinerama1 libgomp1"

END = b"$EndElements\n"
# gmsh keeps one global model: two threads of one process take turns.
_GMSH_LOCK = threading.Lock()


def make_mesh(geometry: Geometry, mesh_spec: Mesh, path: str | os.PathLike[str]) -> None:
    """Mesh the plate and write it in gmsh's binary format 4.1, in metres.

    The file appears complete or not at all. On Linux gmsh works in a process of its own, which a signal ends at once.

    Parameters
    ----------
    geometry
        ``width``, ``height`` (m), ``holes`` (``name``, ``centre``, ``radius``) and ``cracks`` (``name``, ``start``,
        ``end``). The lower-left corner of the plate is at (0, 0).
    mesh_spec
        ``spacing`` (m) and ``cells`` (``"quadrilateral"``, ``"triangle"``, ``"hexahedron"`` or ``"tetrahedron"``).
    path
        File to write; its folder is created.

    Raises
    ------
    PdheError
        gmsh or one of its system libraries is missing, the cells of a structured plate would not be square within 2 %,
        a group would be empty, two of them would share a name, or gmsh fails.
    OSError
        The file cannot be written.
    """
    path = Path(path)
    _check_names(geometry, mesh_spec.cells in SOLID_CELLS)
    path.parent.mkdir(parents=True, exist_ok=True)
    _import_gmsh()
    with moved_when_whole(path, sealed=True, ending=".msh") as temporary:
        temporary.touch()
        # One call of gmsh may take minutes, in which it hears of no signal.
        with _GMSH_LOCK:
            apart(lambda: _mesh_to(geometry, mesh_spec, temporary))
        # gmsh takes no notice of what the system says of its writing.
        with temporary.open("rb") as file:
            file.seek(-min(len(END), temporary.stat().st_size), os.SEEK_END)
            if file.read() != END:
                raise why_not_written(temporary, "the mesh could not be written to its end")


def _mesh_to(geometry: Geometry, mesh_spec: Mesh, path: Path) -> None:
    """Mesh the plate and let gmsh write the mesh."""
    with _gmsh_session() as gmsh:
        # Lengths are in units of the spacing while gmsh works, whose tolerances are absolute; metres on writing.
        gmsh.option.setNumber("Mesh.ScalingFactor", mesh_spec.spacing)
        if mesh_spec.cells in SOLID_CELLS:
            groups, volumes = solid_mesh.model(gmsh, geometry, mesh_spec)
            _add_groups(gmsh, groups, volumes, 3)
            solid_mesh.generate(gmsh, mesh_spec)
        elif mesh_spec.cells == "quadrilateral" and not geometry.holes:
            _structured(gmsh, geometry, mesh_spec)
            gmsh.model.mesh.generate(2)
        else:
            _unstructured(gmsh, geometry, mesh_spec)
            if mesh_spec.refine:
                _generate_to_field(gmsh, SizeField(geometry, mesh_spec), mesh_spec.spacing)
            else:
                _generate_to_size(gmsh, EDGE_OVER_SPACING[mesh_spec.cells])
        gmsh.write(str(path))


def structured_counts(width: float, height: float, spacing: float) -> tuple[int, int]:
    """Cells along the width and the height (m) of a structured plate of square cells of about ``spacing`` (m).

    Raises
    ------
    PdheError
        The two actual spacings differ by more than 2 %.
    """
    nx, ny, hint = square_cells(width, height, spacing)
    if hint:
        raise PdheError(f"mesh.spacing: {spacing:g} m {hint}")
    return nx, ny


def _check_names(geometry: Geometry, solid: bool) -> None:
    """Refuse two node sets under one name."""
    taken = {PLATE, ALL, *EDGES}
    taken |= {*FACES} if solid else set()
    for name in [hole.name for hole in geometry.holes] + [crack.name for crack in geometry.cracks]:
        if name in taken:
            raise PdheError(f"geometry: the name {name!r} is already taken; give the hole or crack its own name")
        taken.add(name)


def _import_gmsh() -> Any:
    """gmsh, or an error that says what to install."""
    try:
        import gmsh
    except OSError as error:
        raise PdheError(
            f"gmsh needs a system library that is not installed: {error}; on Debian or Ubuntu install it with "
            f"`apt-get install -y --no-install-recommends {SYSTEM_LIBRARIES}`"
        ) from error
    except ImportError as error:
        raise PdheError(f"the Python package gmsh cannot be imported: {error}; install it with pip") from error
    return gmsh


@contextmanager
def _gmsh_session() -> Iterator[Any]:
    """A quiet gmsh with one thread and a fresh model, closed on the way out; its failures become ``PdheError``."""
    gmsh = _import_gmsh()
    # No configuration files: a mesh depends on the scene alone. No signal handler: works outside the main thread.
    gmsh.initialize(argv=[], readConfigFiles=False, run=False, interruptible=False)
    try:
        for option, value in {
            "General.Terminal": 0,
            "General.NumThreads": 1,
            "Mesh.Binary": 1,
            "Mesh.MshFileVersion": 4.1,
        }.items():
            gmsh.option.setNumber(option, value)
        gmsh.model.add(PLATE)
        yield gmsh
    except PdheError:
        raise
    except Exception as error:  # gmsh raises bare Exception
        reason = str(error) or "it gives no reason, as where memory runs out"
        raise PdheError(f"gmsh could not mesh the plate: {reason}; check holes and cracks, or the spacing") from error
    finally:
        gmsh.finalize()


def _corners(width: float, height: float) -> tuple[tuple[float, float], ...]:
    """Corners of the plate, counter-clockwise from the origin; edge k of EDGES joins corner k to the next."""
    return (0.0, 0.0), (width, 0.0), (width, height), (0.0, height)


def _structured(gmsh: Any, geometry: Geometry, mesh_spec: Mesh) -> None:
    """A grid of equal cells; cracks are separate curves divided at about the spacing."""
    unit = mesh_spec.spacing
    nx, ny = structured_counts(geometry.width, geometry.height, unit)
    geo = gmsh.model.geo
    points = [geo.addPoint(x / unit, y / unit, 0) for x, y in _corners(geometry.width, geometry.height)]
    edges = [geo.addLine(points[k], points[(k + 1) % 4]) for k in range(4)]
    surface = geo.addPlaneSurface([geo.addCurveLoop(edges)])
    for edge, count in zip(edges, (nx, ny, nx, ny), strict=True):
        geo.mesh.setTransfiniteCurve(edge, count + 1)
    geo.mesh.setTransfiniteSurface(surface)
    geo.mesh.setRecombine(2, surface)
    groups = {name: [edge] for name, edge in zip(EDGES, edges, strict=True)}
    for crack in geometry.cracks:
        (x0, y0), (x1, y1) = crack.start, crack.end
        line = geo.addLine(geo.addPoint(x0 / unit, y0 / unit, 0), geo.addPoint(x1 / unit, y1 / unit, 0))
        length = ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5
        geo.mesh.setTransfiniteCurve(line, max(1, round(length / unit)) + 1)
        groups[CRACK_PREFIX + crack.name] = [line]
    geo.synchronize()
    _add_groups(gmsh, groups, [surface])


def _unstructured(gmsh: Any, geometry: Geometry, mesh_spec: Mesh) -> None:
    """Triangles or recombined quadrilaterals that conform to edges, holes and cracks.

    Edges, circles and cracks are fragmented together with the plate; the map that gmsh returns says which pieces each
    of them became, so cracks may cross each other and touch an edge or a hole.
    """
    unit = mesh_spec.spacing
    occ = gmsh.model.occ
    plate = [(2, occ.addRectangle(0, 0, 0, geometry.width / unit, geometry.height / unit))]
    corners = _corners(geometry.width, geometry.height)
    segments = {name: (corners[k], corners[(k + 1) % 4]) for k, name in enumerate(EDGES)}
    segments |= {CRACK_PREFIX + crack.name: (crack.start, crack.end) for crack in geometry.cracks}
    curves = {
        name: occ.addLine(occ.addPoint(x0 / unit, y0 / unit, 0), occ.addPoint(x1 / unit, y1 / unit, 0))
        for name, ((x0, y0), (x1, y1)) in segments.items()
    }
    disks = []
    for hole in geometry.holes:
        x, y, radius = hole.centre[0] / unit, hole.centre[1] / unit, hole.radius / unit
        disks.append((2, occ.addDisk(x, y, 0, radius, radius)))
        curves[hole.name] = occ.addCircle(x, y, 0, radius)
    if disks:
        plate, _ = occ.cut(plate, disks)
    _, pieces = occ.fragment(plate, [(1, tag) for tag in curves.values()])
    occ.synchronize()

    surfaces = sorted({tag for parts in pieces[: len(plate)] for dim, tag in parts if dim == 2})
    attached = {tag for dim, tag in gmsh.model.getBoundary([(2, s) for s in surfaces], False, False) if dim == 1}
    attached |= {tag for s in surfaces for dim, tag in gmsh.model.mesh.getEmbedded(2, s) if dim == 1}
    groups = {
        name: sorted({tag for dim, tag in parts if dim == 1 and tag in attached})
        for name, parts in zip(curves, pieces[len(plate) :], strict=True)
    }
    # Pieces outside the plate, of a crack that starts in a hole.
    gmsh.model.removeEntities([(1, t) for _, t in gmsh.model.getEntities(1) if t not in attached], recursive=True)

    if mesh_spec.cells == "triangle":
        gmsh.option.setNumber("Mesh.Algorithm", 6)  # frontal Delaunay
    else:
        gmsh.option.setNumber("Mesh.Algorithm", 8)  # frontal Delaunay for quadrilaterals
        gmsh.option.setNumber("Mesh.RecombineAll", 1)
    _add_groups(gmsh, groups, surfaces)


def _generate_to_size(gmsh: Any, edge: float) -> None:
    """Mesh with one edge length everywhere, corrected until the mean cell area is near 1 (the spacing squared).

    Edges divide into whole numbers of segments and cracks force smaller cells, so the mean of the first mesh of a small
    plate may be 15 % off. The last attempt stands.
    """
    for _ in range(ATTEMPTS):
        for option in ("Mesh.MeshSizeMin", "Mesh.MeshSizeMax"):
            gmsh.option.setNumber(option, edge)
        gmsh.model.mesh.clear()
        gmsh.model.mesh.generate(2)
        area = sum(gmsh.model.occ.getMass(2, tag) for _, tag in gmsh.model.getEntities(2))
        mean = area / sum(len(tags) for tags in gmsh.model.mesh.getElements(2)[1])
        if abs(mean - 1.0) <= AREA_TOLERANCE:
            break
        edge /= mean**0.5


def _generate_to_field(gmsh: Any, size: SizeField, unit: float) -> None:
    """Mesh with triangles whose mean area over every part is the square of the spacing wanted at their centroid.

    Parts are those of one spacing, each with a length of edges of its own, and all that lies between. With one length
    for all of them triangles are 15 % smaller where sizes grow, and those of the fine parts 10 % too large if the mean
    over the mesh is right. Sizes come from the field alone: gmsh neither carries those of the boundary into the inside
    nor adds to them. Where no attempt is good enough the best one stands.
    """
    for option in ("Mesh.MeshSizeExtendFromBoundary", "Mesh.MeshSizeFromPoints", "Mesh.MeshSizeFromCurvature"):
        gmsh.option.setNumber(option, 0)
    edges, tried = {BETWEEN: EDGE_OVER_SPACING["triangle"]}, []
    for _ in range(PART_ATTEMPTS):
        areas = _areas_by_part(gmsh, size, unit, edges)
        worst = max(
            abs(area - 1.0) / (AREA_TOLERANCE if part == BETWEEN else PART_TOLERANCE) for part, area in areas.items()
        )
        if worst <= 1.0:
            return
        tried.append((worst, edges))
        edges = edges | {part: edges.get(part, edges[BETWEEN]) / area**0.5 for part, area in areas.items()}
    _areas_by_part(gmsh, size, unit, min(tried, key=lambda attempt: attempt[0])[1])


def _areas_by_part(gmsh: Any, size: SizeField, unit: float, edges: dict[float, float]) -> dict[float, float]:
    """Mesh with edges of so many spacings in each part, and return the mean area of its cells over the one wanted.

    Parts go by their spacing, m, and what lies between them by :data:`BETWEEN`.
    """
    between = edges[BETWEEN]

    def edge(dim: int, tag: int, x: float, y: float, z: float, lc: float) -> float:
        wanted = size.at(x * unit, y * unit)
        return edges.get(wanted, between) * wanted / unit

    gmsh.model.mesh.clear()
    gmsh.model.mesh.setSizeCallback(edge)
    gmsh.model.mesh.generate(2)
    tags, places, _ = gmsh.model.mesh.getNodes()
    vertex = np.zeros((int(tags.max()) + 1, 2))
    vertex[tags] = places.reshape(-1, 3)[:, :2]
    triangles = vertex[np.concatenate([corners.reshape(-1, 3) for corners in gmsh.model.mesh.getElements(2)[2]])]
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    wanted = size(triangles.mean(axis=1) * unit)
    area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / (wanted / unit) ** 2
    part = np.full(len(area), BETWEEN)
    for spacing in size.plateaus:
        cells = wanted == spacing
        if np.count_nonzero(cells) >= FEW:
            part[cells] = spacing
    return {float(spacing): float(area[part == spacing].mean()) for spacing in np.unique(part)}


def _add_groups(gmsh: Any, curves: dict[str, list[int]], surfaces: list[int], dim: int = 2) -> None:
    """Register the physical groups; gmsh writes only the elements that belong to one."""
    for name, tags in curves.items():
        if not tags:
            raise PdheError(f"geometry: no part of {name!r} lies in or on the plate; move it or remove it")
        gmsh.model.addPhysicalGroup(dim - 1, tags, name=name)
    gmsh.model.addPhysicalGroup(dim, surfaces, name=PLATE)
