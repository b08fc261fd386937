"""The whole body of which a part was computed: its mesh, and a result on all of it (theory, section 3)."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from pdhe.mirrors import Symmetry

if TYPE_CHECKING:
    import xarray as xr


def whole_mesh(vertices: np.ndarray, cells: np.ndarray, symmetry: Symmetry) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, m (v, 2), and cells of the whole body, counter-clockwise as those of the part are.

    Image ``q`` of cell ``i`` of ``n`` has the number ``q n + i``. Vertices on a mirror line are there once.
    """
    vertices = symmetry.framed(vertices)
    slack = 1e-9 * float(np.abs(vertices).max(initial=0.0))
    for axis in symmetry.axes:
        beyond = np.flatnonzero(np.abs(vertices[:, axis]) > slack)
        image = np.arange(len(vertices), dtype=cells.dtype)
        image[beyond] = len(vertices) + np.arange(beyond.size)
        flip = np.ones(2)
        flip[axis] = -1.0
        vertices = np.concatenate([vertices, flip * vertices[beyond]])
        cells = np.concatenate([cells, image[cells][:, [2, 1, 0, 3][: cells.shape[1]]]])
    return vertices + symmetry.origin, cells


def whole_result(result: xr.Dataset) -> xr.Dataset:
    """Return a result on the whole body; that of a whole body as it is.

    Positions are those of the scene: the images have theirs beyond its plate. Histories are of the whole body anyway.
    The scene that comes with it has the cracks of the whole body and no mirror lines.
    """
    scene = json.loads(result.attrs["scene"])
    geometry = scene.get("geometry", {})
    if not geometry.get("symmetry"):
        return result
    import xarray as xr

    symmetry = Symmetry.along(geometry["symmetry"], geometry["plate"]["width"], geometry["plate"]["height"])
    signs, n = [symmetry.sign(q) for q in range(symmetry.copies)], result.sizes["node"]
    new: dict[str, tuple] = {}
    vertices, cells = whole_mesh(result["vertices"].values, result["cells"].values, symmetry)
    framed = symmetry.framed(np.column_stack([result["node_x"].values, result["node_y"].values]))
    nodes = np.concatenate([sign * framed for sign in signs]) + symmetry.origin
    arrays = {"vertices": vertices, "cells": cells, "node_x": nodes[:, 0], "node_y": nodes[:, 1]}
    if "broken_time" in result.variables:
        i, j = (result[name].values.astype(np.int64) for name in ("broken_i", "broken_j"))
        kept, ends = [], []
        for q in range(symmetry.copies):
            ends.append((q * n + i, (j // n ^ q) * n + j % n))
            # A bond of a node with its own image comes back as itself.
            kept.append((i != j % n) | (q < (j // n ^ q)))
        keep = np.concatenate(kept)
        for name, values in zip(("broken_i", "broken_j"), zip(*ends, strict=True), strict=True):
            arrays[name] = np.concatenate(values)[keep].astype(np.int32)
        arrays["broken_time"] = np.tile(result["broken_time"].values, symmetry.copies)[keep]
    for name, variable in result.variables.items():
        values = arrays.get(str(name))
        if values is None:
            values = variable.values
            if "node" in variable.dims:
                axis = variable.dims.index("node")
                last = variable.dims[-1]
                copies = [values * sign if last == "component" else values for sign in signs]
                if last == "entry":  # a shear stress changes its sign in a mirror
                    shear = result["entry"].values == "12"
                    copies = [np.where(shear, sign.prod(), 1.0) * values for sign in signs]
                values = np.concatenate(copies, axis=axis)
        new[str(name)] = (variable.dims, values, variable.attrs)
    cracks = [
        {"name": crack["name"], "from": list(np.add(start, symmetry.origin)), "to": list(np.add(end, symmetry.origin))}
        for crack in geometry.get("cracks", [])
        for start, end in symmetry.cracks([(crack["from"], crack["to"])])
    ]
    kept_geometry = {key: value for key, value in geometry.items() if key != "symmetry"}
    scene["geometry"] = kept_geometry | {"cracks": cracks}
    sets = {
        name: [q * n + node for q in range(symmetry.copies) for node in nodes_of]
        for name, nodes_of in json.loads(result.attrs.get("node_sets", "{}")).items()
    }
    attributes = {**result.attrs, "scene": json.dumps(scene, sort_keys=True), "node_sets": json.dumps(sets)}
    coordinates = {str(name): new.pop(str(name)) for name in result.coords}
    return xr.Dataset(new, coordinates, attributes)
