"""The shape of the body in a picture: which cell a pixel shows, and how a displaced body opens along its crack."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from PIL import Image, ImageDraw
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from pdhe.post import Facets

Extent = tuple[float, float, float, float]


def cell_of_pixel(corners: np.ndarray, extent: Extent, shape: tuple[int, int]) -> np.ndarray:
    """Tell for each pixel which cell covers its centre.

    Parameters
    ----------
    corners
        Corners of the cells, m (n, k, 2).
    extent
        Left, right, bottom and top of the picture, m.
    shape
        Rows and columns of pixels; the first row is the top one.

    Returns
    -------
    int32 (rows, columns); -1 outside of all cells.
    """
    rows, columns = shape
    left, right, bottom, top = extent
    scaled = (corners - (left, top)) * (columns / (right - left), -rows / (top - bottom)) - 0.5
    picture = Image.new("I", (columns, rows), -1)
    polygon = ImageDraw.Draw(picture).polygon
    for cell, outline in enumerate(scaled.reshape(len(corners), -1).tolist()):
        polygon(outline, fill=cell)
    return np.asarray(picture)


def displaced_corners(
    vertices: np.ndarray, cells: np.ndarray, facets: Facets, crack: np.ndarray, displacement: np.ndarray
) -> np.ndarray:
    """Return the corners of the cells moved by their displacement, m (n, k, dim).

    The cells around a vertex move it by their mean displacement. Where the facets of the crack separate them, each part
    moves a copy of its own, and the crack opens.
    """
    n, corners = cells.shape
    label = cells.astype(np.int64).ravel()
    broken = np.zeros(len(facets.vertices), bool)
    broken[crack] = True
    torn = np.zeros(len(vertices), bool)
    torn[facets.vertices[broken].ravel()] = True
    if broken.any():
        label = label.copy()
        split = np.flatnonzero(torn[label])
        label[split] = len(vertices) + _parts(cells, facets, ~broken, torn, split)
    count = label.max() + 1
    moved = displacement[np.repeat(np.arange(n), corners)]
    share = np.maximum(np.bincount(label, minlength=count), 1)
    mean = np.column_stack([np.bincount(label, component, count) / share for component in moved.T])
    return vertices[cells] + mean[label].reshape(n, corners, -1)


def _parts(cells: np.ndarray, facets: Facets, bonded: np.ndarray, torn: np.ndarray, split: np.ndarray) -> np.ndarray:
    """Number the corners at torn vertices so that corners joined through bonded facets share a number."""
    index = np.full(cells.size, -1)
    index[split] = np.arange(split.size)
    ends = []
    for vertex in facets.vertices.T:
        rows = np.flatnonzero(bonded & torn[vertex])
        one, other = (
            index[cell * cells.shape[1] + (cells[cell] == vertex[rows, None]).argmax(axis=1)]
            for cell in facets.cells[rows].T
        )
        ends.append((one, other))
    one, other = (np.concatenate(side) for side in zip(*ends, strict=True))
    graph = coo_matrix((np.ones(one.size), (one, other)), shape=(split.size, split.size))
    return connected_components(graph, directed=False)[1]


def facet_lines(corners: np.ndarray, cells: np.ndarray, owner: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Return facets as segments where one of their cells puts them, m (k, 2 ends, 2)."""
    place = (cells[owner][:, None, :] == vertices[:, :, None]).argmax(axis=2)
    return corners[owner[:, None], place]


def in_loops(facets: Facets) -> Facets:
    """Order the facets on the boundary so that, wherever possible, each begins where the last one ends."""
    following = dict(zip(facets.outer_vertices[:, 0].tolist(), range(len(facets.outer_vertices)), strict=True))
    order: list[int] = []
    while following:
        row = following.pop(next(iter(following)))
        while row is not None:
            order.append(row)
            row = following.pop(int(facets.outer_vertices[row, 1]), None)
    order += sorted(set(range(len(facets.outer_vertices))) - set(order))  # where two loops meet in a vertex
    return replace(facets, outer_cells=facets.outer_cells[order], outer_vertices=facets.outer_vertices[order])
