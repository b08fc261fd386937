"""The thesis' unit cases of section 8.1 with corrected numbers, and the damage beside a straight crack."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pdhe.bonds import build_bonds, partial_volume
from pdhe.corrections import volume_correction
from pdhe.materials import ThesisSpring, make_body
from pdhe.verification.drawing import COLOURS, MARKERS, label, panels
from pdhe.verification.plates import plate_body, square_plate
from pdhe.verification.report import Report, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Share of a family's bonds that a straight crack cuts, for the rows of nodes beside it: counted by hand on a square
#: lattice. Half of the 28 (80) bonds less those of the own row and of the rows between node and crack.
ROWS = {3: (11 / 28, 6 / 28, 1 / 28), 5: (35 / 80, 26 / 80, 17 / 80, 8 / 80, 1 / 80)}
EXACT = "closed form; round-off only"

TEXT = """The lines numbered 8.1 are the unit cases of section 8.1 of the thesis, put to the functions that the
solver uses. Two of them needed a correction. The surface correction 2 V0 / (V_i + V_j) with V_i = 4, V_j = 5 and
horizon 3 gives the printed 37.6991 = 12 pi and 75.3982 = 24 pi if the uncorrected stiffnesses are 1 and 2 and the
thickness is 6; the thesis gives neither, and its formula for V0, h / (pi delta^2), cannot give a value with pi in
the numerator. The partial volume for horizon 3, spacing 4 and length 2.8284 is (3 + 2 - 2.8284) / 4 = 0.542893; the
printed 0.43589 does not follow from its equation.

A straight crack cuts known shares of the bonds of the rows beside it, at most 0.5: a sharp crack is not a band of
damage near 1. Averaged over a plate of W by H, a crack of length a gives 4 delta a / (3 pi W H) in the limit of
many nodes."""


def profile(z: np.ndarray) -> np.ndarray:
    """Damage at distance ``z`` (in horizons) from a long straight crack, in the limit of many nodes."""
    return (np.arccos(z) - z * np.sqrt(1.0 - z**2)) / np.pi


def _pair(first, second, u_first, u_second) -> tuple[np.ndarray, float, np.ndarray]:
    """Bond between two nodes: its vector, its length, and the relative displacement of its ends."""
    x = np.array([first, second], float)
    bonds = build_bonds(x, np.ones(2), np.ones(2), 1.0, 3.0, surface="none")
    body = make_body(bonds, ThesisSpring(1.0, 0.25, 1.0, 3.0), x, np.ones(2))
    stretch, angle, _ = body.bond_parts(np.array([u_first, u_second], float), np.array([0]), np.array([0]))
    n = np.array([bonds.nx[0], bonds.ny[0]])
    length = float(bonds.length[0])
    return n * length, length, length * (stretch[0] * n + angle[0] * np.array([-n[1], n[0]]))


def thesis_cases() -> list[Row]:
    """The seven cases."""
    rows = []

    def vector(name: str, expected: tuple[float, float], measured: np.ndarray, reason: str = EXACT) -> None:
        for axis, want, got in zip("xy", expected, measured, strict=True):
            rows.append(Row(f"{name}, {axis}", want, float(got), 1e-14, "1", "relative", reason))

    bond, length, relative = _pair((1, 2), (3, 4), (1, 2), (3, 4))
    vector("8.1.1 bond vector", (2.0, 2.0), bond)
    rows.append(Row("8.1.2 bond length", np.sqrt(8.0), length, 1e-14, "1", "relative", EXACT))
    vector("8.1.3 relative displacement", (2.0, 2.0), relative)
    family = (np.array([0, 1, 2]), np.array([0, 1]), np.array([1, 0]), np.array([4.0, 5.0]))
    correction = volume_correction(*family, 3.0, 6.0)[0]
    why = "12 pi and 24 pi, from stiffnesses 1 and 2 and thickness 6; the thesis prints 37.6991 and 75.3982"
    vector(
        "8.1.4 corrected normal and tangential stiffness", (12 * np.pi, 24 * np.pi), correction * np.array([1, 2]), why
    )
    share = partial_volume(np.array([2.8284]), 3.0, np.array([4.0]), "ramp")[0]
    why = "(3 + 2 - 2.8284) / 4 = 0.5429; the thesis prints 0.43589, which its equation does not give"
    vector("8.1.5 force scaled by the partial volume", (0.5429, 1.0858), share * np.array([1, 2]), why)
    exact = partial_volume(np.array([np.sqrt(8.0)]), 3.0, np.array([4.0]), "ramp")[0]
    rows.append(
        Row("8.1.5 partial volume of the bond of 8.1.2", 0.542893, float(exact), 1e-6, "1", "relative", "6 digits")
    )
    bond, length, relative = _pair((0, 0), (1, 2), (0, 0), (3, 4))
    rows.append(Row("8.1.6 norm of (1, 2)", np.sqrt(5.0), length, 1e-14, "1", "relative", EXACT))
    vector("8.1.7 deformed bond (1, 2) + (3, 4)", (4.0, 6.0), bond + relative)
    return rows


def crack_damage(m: int, columns: int, rows: int, length: int) -> tuple[np.ndarray, float, float]:
    """Damage of the rows above a crack, in its middle; mean damage of the plate; and what the limit predicts for it."""
    plate = square_plate(columns, rows)
    middle = plate.height / 2
    body = plate_body(plate, m * 1e-3, weights="none", cracks=[((0.0, middle), (length * 1e-3, middle))])
    phi = body.damage()
    beside = phi.reshape(rows, columns)[rows // 2 :, length // 2][:m]
    predicted = 4.0 * m * length / (3.0 * np.pi * columns * rows)
    return beside, float(np.average(phi, weights=plate.volume)), float(predicted)


def run(columns: int = 200, rows: int = 100, length: int = 100, ratios: tuple[int, ...] = (3, 5, 10)) -> Report:
    """Check the operators; the crack runs from the left edge of a plate of ``columns`` by ``rows`` cells."""
    table = thesis_cases()
    profiles = {}
    for m in ratios:
        beside, mean, predicted = crack_damage(m, columns, rows, length)
        profiles[m] = beside
        for k, expected in enumerate(ROWS.get(m, ())):
            table.append(
                Row(f"damage in row {k + 1} beside a crack, m = {m}", expected, float(beside[k]), 1e-12, "1",
                    "relative", "counted on the lattice; round-off only")
            )  # fmt: skip
        why = "measured +1.0 %, +2.6 % and +1.2 % for m = 3, 5, 10: lattice against integral, and the tip"
        table.append(Row(f"mean damage of the plate, m = {m}", predicted, mean, 0.05, "1", "relative", why))
    return Report("operators", "Operators and unit cases", TEXT, table, _drawing(profiles))


def _drawing(profiles: dict[int, np.ndarray]):
    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, 1)
        z = np.linspace(0.0, 1.0, 200)
        ax.plot(z, profile(z), color="0.3", linewidth=1.2, label="limit of many nodes")
        for k, (m, values) in enumerate(profiles.items()):
            ax.plot(
                (np.arange(values.size) + 0.5) / m, values, MARKERS[k], color=COLOURS[k], markersize=6,
                label=f"rows of nodes, m = {m}",
            )  # fmt: skip
        ax.axhline(0.36, color="0.6", linewidth=0.8, linestyle="--")
        ax.text(0.99, 0.365, "damage 0.36: saturated with hydrogen", ha="right", fontsize=8, color="0.4")
        label(ax, "distance from the crack / horizon", "damage")
        ax.legend(fontsize=8, frameon=False)

    return draw
