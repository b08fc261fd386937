"""Small results, made up rather than computed, that several tests share."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from pdhe.discretization import Discretization
from pdhe.results import Recorder

SPACING, COLUMNS, ROWS, THICKNESS = 5e-3, 8, 4, 4e-3
DAY = 86400.0
#: The notch lies on a line of the grid and ends at the corner of four cells.
NOTCH = {"name": "notch", "from": [0.0, 0.01], "to": [0.015, 0.01]}


def plate(triangles: bool = False) -> Discretization:
    """A plate of 40 mm by 20 mm in squares, or in triangles that are their halves."""
    x, y = np.meshgrid(np.arange(COLUMNS + 1) * SPACING, np.arange(ROWS + 1) * SPACING)
    vertices = np.column_stack([x.ravel(), y.ravel()])
    first = (np.arange(ROWS)[:, None] * (COLUMNS + 1) + np.arange(COLUMNS)).ravel()
    cells = np.column_stack([first, first + 1, first + COLUMNS + 2, first + COLUMNS + 1])
    if triangles:
        cells = cells[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    volume = np.full(len(cells), SPACING**2 * THICKNESS / (1 + triangles))
    centres = vertices[cells].mean(axis=1)
    sets = {"top": np.arange(3, dtype=np.int32), "all": np.arange(len(cells), dtype=np.int32)}
    spacing = np.full(len(cells), SPACING)
    return Discretization(centres, volume, spacing, vertices, cells.astype(np.int32), sets, not triangles, THICKNESS)


def opening(centres: np.ndarray, share: float, tip: float) -> np.ndarray:
    """Displacements of a plate pulled along y by 20 um on either side, torn along y = 10 mm up to x = tip."""
    u = np.zeros_like(centres)
    up = np.sign(centres[:, 1] - 0.01)
    u[:, 1] = 2e-5 * share * np.where(centres[:, 0] < tip, up, (centres[:, 1] - 0.01) / 0.01)
    u[:, 0] = -1e-6 * share * centres[:, 0] / 0.04
    return u


def write_result(
    path: Path, physics: str = "mdh", triangles: bool = False, outputs: int = 7, notch: dict = NOTCH
) -> Path:
    """Write a result with mechanics (m), damage (d), hydrogen (h) and state variables (u), as wanted.

    The crack starts in the middle of the time and advances by a cell at each output from then on.
    """
    d, recorder = plate(triangles), Recorder()
    above = np.flatnonzero((d.coordinates[:, 1] > 0.01) & (d.coordinates[:, 1] < 0.015))
    below = np.flatnonzero((d.coordinates[:, 1] < 0.01) & (d.coordinates[:, 1] > 0.005))
    above, below = (side[np.argsort(d.coordinates[side, 0])] for side in (above, below))
    if triangles:  # of two halves, those with a side on the line y = 10 mm
        above, below = (
            side[np.abs(d.vertices[d.cells[side]][:, :, 1] - 0.01).round(9).__eq__(0).sum(axis=1) == 2]
            for side in (above, below)
        )
    tip, work = 0.015, 0.0
    for k, time in enumerate(np.linspace(0.0, 60 * DAY, outputs)):
        share = min(1.0, 2 * k / (outputs - 1))
        row: dict[str, float] = {"history_time": time}
        fields = {}
        if k > outputs // 2 and "d" in physics:
            column = round(tip / SPACING)
            tip += SPACING
            recorder.broke(above[column : column + 1], below[column : column + 1], time - DAY)
        if "m" in physics:
            fields["displacement"] = opening(d.coordinates, share, tip)
            work = max(work, share**2)
            row |= {"reaction_top_y": 5e4 * share, "applied_top_y": 2e-5 * share}
            row |= {"elastic_energy": share**2 - 20.0 * (tip - 0.015), "external_work": work}
        if "d" in physics:
            phi = np.where((np.abs(d.coordinates[:, 1] - 0.01) < 0.005) & (d.coordinates[:, 0] < tip), 0.4, 0.0)
            fields["damage"] = phi
            grown = tip - 0.015
            row |= {"fracture_energy": 15.0 * grown, "crack_length": tip, "crack_extension": grown}
            row |= {"crack_tip_x": tip if grown else np.nan, "crack_tip_y": 0.01 if grown else np.nan}
            row |= {"mean_damage": phi.mean(), "broken_bonds": round(grown / SPACING)}
        if "h" in physics:
            psi = np.exp(-d.coordinates[:, 0] / 0.01) * np.sqrt(k / (outputs - 1))
            fields["coverage"] = psi
            content = float((psi * d.volume).sum())
            row |= {"mean_coverage": psi.mean(), "hydrogen_content": content, "hydrogen_influx": content}
        if "u" in physics:
            fields["state_age"] = 1e-2 * share * np.linspace(0.0, 1.0, len(d.cells)) ** 2
            fields["state_rest"] = np.zeros(len(d.cells))
        recorder.row(**row)
        recorder.snapshot(time, **fields)
    scene = {"geometry": {"cracks": [notch] if "m" in physics else []}}
    recorder.contents(d, {"title": "made up", "status": "complete", "scene": json.dumps(scene)}).write(path)
    return path
