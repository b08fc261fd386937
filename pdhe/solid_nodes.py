"""Cells that fill space turned into nodes: centroids, volumes, the cells on a surface."""

from __future__ import annotations

import numpy as np

from pdhe.surfaces import Surface

#: Facets of a cell by its corners, seen from outside counter-clockwise (numbering of gmsh), by number of corners.
FACETS = {
    4: ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)),
    8: ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
#: A hexahedron as tetrahedra around the diagonal from corner 0 to corner 6.
_SIXTHS = ((0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6))
#: A crack that the mesh does not follow owns the cells whose centroid is at most this many spacings away from it.
CRACK_REACH = 0.75
#: Relative tolerance below which lengths count as equal.
ROUND_OFF = 1e-6


def centroids_and_volumes(vertices: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centroid (n, 3) and signed volume (n,) of each tetrahedron or hexahedron with plane facets."""
    with np.errstate(all="ignore"):  # volumes are checked by the caller
        origin = vertices[cells[:, 0]]
        volume, moment = np.zeros(len(cells)), np.zeros((len(cells), 3))
        for part in ((0, 1, 2, 3),) if cells.shape[1] == 4 else _SIXTHS:
            a, b, c = (vertices[cells[:, k]] - origin for k in part[1:])
            sixth = np.einsum("ij,ij->i", np.cross(a, b), c) / 6.0
            volume += sixth
            moment += sixth[:, None] * (a + b + c) / 4.0
        return origin + moment / volume[:, None], volume


def facet_keys(facets: np.ndarray, vertex_count: int) -> np.ndarray:
    """One integer for each facet (m, 3 or 4) whatever the order of its corners: its three least vertices tell it."""
    low = np.sort(facets, axis=1)[:, :3].astype(np.int64)
    return (low[:, 0] * vertex_count + low[:, 1]) * vertex_count + low[:, 2]


def facets_of_cells(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All facets (m, 3 or 4) of the cells, and the cell of each (m,)."""
    sides = FACETS[cells.shape[1]]
    facets = cells[:, np.array(sides)].reshape(-1, len(sides[0]))
    return facets, np.repeat(np.arange(len(cells), dtype=np.int32), len(sides))


def facet_areas(
    vertices: np.ndarray, cells: np.ndarray, axis: int, level: float, slack: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cells with facets in a plane across an axis, (k,), and the area of these, m^2 (k,).

    ``level`` is where the plane is, m; ``slack`` how far off it a corner of each cell may be, m (n,).
    """
    facets, owner = facets_of_cells(cells)
    on = (np.abs(vertices[facets, axis] - level) <= slack[owner][:, None]).all(axis=1)
    corners, owner = vertices[facets[on]], owner[on]
    # Twice the area of a plane facet is the length of the product of its diagonals, of a triangle of two sides.
    one, two = corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1]
    area = 0.5 * np.linalg.norm(np.cross(one, two), axis=1)
    nodes, place = np.unique(owner, return_inverse=True)
    return nodes, np.bincount(place, weights=area, minlength=nodes.size)


def cells_on_surfaces(
    cells: np.ndarray, surfaces: dict[str, np.ndarray], vertex_count: int
) -> dict[str, tuple[np.ndarray, bool]]:
    """For each surface, the cells with a facet on it, and whether all of its elements are facets of cells."""
    facets, owner = facets_of_cells(cells)
    keys = facet_keys(facets, vertex_count)
    found = {}
    for name, elements in surfaces.items():
        wanted = facet_keys(elements, vertex_count)
        nodes = np.unique(owner[np.isin(keys, wanted)]).astype(np.int32)
        found[name] = nodes, bool(np.isin(wanted, keys).all())
    return found


def near_surface(coordinates: np.ndarray, spacing: np.ndarray, surface: Surface) -> np.ndarray:
    """Nodes whose projection falls strictly inside the surface and that lie within 0.75 spacing of it."""
    slack = ROUND_OFF * spacing
    inside = surface.depth(coordinates) > slack
    near = np.abs(surface.height(coordinates)) <= CRACK_REACH * spacing + slack
    return np.flatnonzero(inside & near).astype(np.int32)


def snapped_to_grid(
    vertices: np.ndarray, cells: np.ndarray, size: np.ndarray, spacing: float
) -> tuple[np.ndarray, bool]:
    """Vertices of a structured mesh of a block of some size (3,), m, rid of round-off, and whether it is one."""
    counts = np.maximum(1, np.rint(size / spacing))
    index = np.rint(vertices * (counts / size))
    snapped = index * size / counts
    used = np.unique(cells)
    if cells.shape[1] != 8 or len(cells) != counts.prod():
        return vertices, False
    if np.abs(vertices - snapped)[used].max() > ROUND_OFF * spacing:
        return vertices, False
    return snapped, True
