"""Meshes of bodies in space: hexahedra and tetrahedra between the two faces of the plate.

Groups: the volume ``plate``; the faces ``left``, ``right``, ``bottom``, ``top``, ``front`` (z = 0) and ``back``; the
walls of every hole under its own name; every crack as ``crack:<name>``. Two kinds of mesh:

- hexahedra are a structured grid of cubes, which cracks do not cut;
- tetrahedra conform to every face, hole and crack: a crack is a surface inside the body, through the thickness along
  its segment, a disc or a polygon. Their mean volume is the cube of the spacing, within 5 %.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from pdhe.errors import PdheError
from pdhe.scene_solid import FACES, cubic_cells, polygon_normal

if TYPE_CHECKING:
    from pdhe.scene import Crack, Geometry, Mesh

CRACK_PREFIX = "crack:"
#: Edge length over spacing for a mean cell of spacing^3. Regular tetrahedra, which do not fill space, need 2.04.
TETRAHEDRON_EDGE = 2.1
#: Relative error of the mean volume that is left alone, and how often the body is meshed anew to get there.
VOLUME_TOLERANCE, ATTEMPTS = 0.05, 4
#: Distance in spacings at which a face of the model counts as lying on a face of the body.
ON_FACE = 1e-5

Groups = dict[str, list[int]]


def model(gmsh: Any, geometry: Geometry, mesh_spec: Mesh) -> tuple[Groups, list[int]]:
    """Make the model of a body in units of the spacing: its groups of surfaces by name, and its volumes."""
    return (_grid if mesh_spec.cells == "hexahedron" else _conforming)(gmsh, geometry, mesh_spec)


def generate(gmsh: Any, mesh_spec: Mesh) -> None:
    """Mesh the model; tetrahedra with one edge length, corrected until their mean volume is near 1."""
    if mesh_spec.cells == "hexahedron":
        gmsh.model.mesh.generate(3)
        return
    edge = TETRAHEDRON_EDGE
    for _ in range(ATTEMPTS):
        for option in ("Mesh.MeshSizeMin", "Mesh.MeshSizeMax"):
            gmsh.option.setNumber(option, edge)
        gmsh.model.mesh.clear()
        gmsh.model.mesh.generate(3)
        volume = sum(gmsh.model.occ.getMass(3, tag) for _, tag in gmsh.model.getEntities(3))
        mean = volume / sum(len(tags) for tags in gmsh.model.mesh.getElements(3)[1])
        if abs(mean - 1.0) <= VOLUME_TOLERANCE:
            break
        edge /= mean ** (1.0 / 3.0)


def _grid(gmsh: Any, geometry: Geometry, mesh_spec: Mesh) -> tuple[Groups, list[int]]:
    """A block of equal cubes, its front drawn out along z; nothing conforms to cracks, which are surfaces beside it."""
    unit = mesh_spec.spacing
    size = geometry.width, geometry.height, geometry.thickness
    (nx, ny, nz), wrong = cubic_cells(size, unit)
    if wrong:
        raise PdheError(f"mesh.spacing: {unit:g} m {wrong}")
    geo = gmsh.model.geo
    width, height, thickness = (side / unit for side in size)
    corners = (0.0, 0.0), (width, 0.0), (width, height), (0.0, height)
    points = [geo.addPoint(x, y, 0) for x, y in corners]
    edges = [geo.addLine(points[k], points[(k + 1) % 4]) for k in range(4)]
    front = geo.addPlaneSurface([geo.addCurveLoop(edges)])
    for edge, count in zip(edges, (nx, ny, nx, ny), strict=True):
        geo.mesh.setTransfiniteCurve(edge, count + 1)
    geo.mesh.setTransfiniteSurface(front)
    geo.mesh.setRecombine(2, front)
    back, volume, *sides = geo.extrude([(2, front)], 0, 0, thickness, numElements=[nz], recombine=True)
    geo.synchronize()
    names = ("bottom", "right", "top", "left")
    groups = {name: [tag] for name, (_, tag) in zip(names, sides, strict=True)}
    groups |= dict(zip(FACES, ([front], [back[1]]), strict=True))
    return groups, [volume[1]]


def _conforming(gmsh: Any, geometry: Geometry, mesh_spec: Mesh) -> tuple[Groups, list[int]]:
    """A block without its holes, fragmented together with the surfaces of its cracks.

    The map that gmsh returns says which pieces each crack became; faces and walls are told by where they are.
    """
    unit, occ = mesh_spec.spacing, gmsh.model.occ
    width, height, thickness = geometry.width / unit, geometry.height / unit, geometry.thickness / unit
    body = [(3, occ.addBox(0, 0, 0, width, height, thickness))]
    if geometry.holes:
        drills = [
            (3, occ.addCylinder(hole.centre[0] / unit, hole.centre[1] / unit, 0, 0, 0, thickness, hole.radius / unit))
            for hole in geometry.holes
        ]
        body, _ = occ.cut(body, drills)
    surfaces = [(2, _surface(occ, crack, unit, thickness)) for crack in geometry.cracks]
    # Without surfaces there is nothing to fragment, and gmsh would return no map.
    pieces = occ.fragment(body, surfaces)[1] if surfaces else [body]
    occ.synchronize()
    volumes = sorted({tag for parts in pieces[: len(body)] for dim, tag in parts if dim == 3})
    outer = {abs(tag) for _, tag in gmsh.model.getBoundary([(3, v) for v in volumes], True, False)}
    attached = outer | {abs(tag) for _, tag in gmsh.model.getBoundary([(3, v) for v in volumes], False, False)}
    attached |= {tag for v in volumes for dim, tag in gmsh.model.mesh.getEmbedded(3, v) if dim == 2}
    groups: Groups = {name: [] for name in ("bottom", "right", "top", "left", *FACES)}
    groups |= {hole.name: [] for hole in geometry.holes}
    levels = {
        "left": (0, 0.0), "right": (0, width), "bottom": (1, 0.0), "top": (1, height), "front": (2, 0.0),
        "back": (2, thickness),
    }  # fmt: skip
    for tag in sorted(outer):
        box = gmsh.model.getBoundingBox(2, tag)
        # Boxes of curved surfaces are a little too large, those of plane ones by about 1e-7.
        flat = [name for name, (k, at) in levels.items() if max(abs(box[k] - at), abs(box[k + 3] - at)) < ON_FACE]
        groups[flat[0] if flat else _hole_at(geometry, box, unit)].append(tag)
    for crack, parts in zip(geometry.cracks, pieces[len(body) :], strict=True):
        inside = {tag for dim, tag in parts if dim == 2 and tag in attached and tag not in outer}
        groups[CRACK_PREFIX + crack.name] = sorted(inside)
    # Pieces outside the body, of a crack that sticks out of it or starts in a hole.
    gmsh.model.removeEntities([(2, t) for _, t in gmsh.model.getEntities(2) if t not in attached], recursive=True)
    # Delaunay: of gmsh's algorithms the one that copes with surfaces inside a volume.
    gmsh.option.setNumber("Mesh.Algorithm", 6)
    gmsh.option.setNumber("Mesh.Algorithm3D", 1)
    gmsh.option.setNumber("Mesh.Optimize", 1)
    return groups, volumes


def _surface(occ: Any, crack: Crack, unit: float, thickness: float) -> int:
    """The surface of a crack; through the thickness where it is given by a segment."""
    if getattr(crack, "disc", None) is not None:
        disc = crack.disc
        return occ.addDisk(
            *(c / unit for c in disc.centre), disc.radius / unit, disc.radius / unit, zAxis=list(disc.normal)
        )
    if getattr(crack, "polygon", None) is not None:
        corners = flattened(crack.polygon)
        points = [occ.addPoint(*(c / unit for c in corner)) for corner in corners]
    else:
        ends = [tuple(c / unit for c in end) for end in (crack.start, crack.end)]
        points = [occ.addPoint(*ends[k], z) for k, z in ((0, 0.0), (1, 0.0), (1, thickness), (0, thickness))]
    lines = [occ.addLine(points[k], points[(k + 1) % len(points)]) for k in range(len(points))]
    return occ.addPlaneSurface([occ.addCurveLoop(lines)])


def flattened(corners: tuple[tuple[float, float, float], ...]) -> list[tuple[float, ...]]:
    """Corners of a polygon moved onto the plane through the first one, m: written decimals are not quite plane."""
    normal, _ = polygon_normal(corners)
    moved = []
    for corner in corners:
        off = sum(n * (c - o) for n, c, o in zip(normal, corner, corners[0], strict=True))
        moved.append(tuple(c - off * n for c, n in zip(corner, normal, strict=True)))
    return moved


def _hole_at(geometry: Geometry, box: tuple[float, ...], unit: float) -> str:
    """Name of the hole whose wall has the middle of its bounding box (in units of the spacing) nearest to its axis."""
    x, y = 0.5 * (box[0] + box[3]) * unit, 0.5 * (box[1] + box[4]) * unit
    return min(geometry.holes, key=lambda hole: math.dist(hole.centre, (x, y)) / hole.radius).name
