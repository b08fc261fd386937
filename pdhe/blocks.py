"""Values of the material that differ from one part of the plate to another, and of bonds between two parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pdhe.bonds import Bonds
from pdhe.errors import SceneError
from pdhe.scene_places import at

if TYPE_CHECKING:
    from pdhe.scene_blocks import Axes, DiffusivityOn, Interface, StiffnessOn, ToughnessOn


#: Largest ratio of Young's moduli within a body that was found right.
MOST_CONTRAST = 1e6


#: Range of values over those of the material, by formulas as by factors.
LEAST, MOST = 1e-6, 1e6


def node_values(
    coordinates: np.ndarray,
    node_sets: Mapping[str, np.ndarray],
    regions: Sequence[ToughnessOn | DiffusivityOn | StiffnessOn],
    elsewhere: float,
    key: str,
) -> np.ndarray:
    """Value of every node over that of the material, (n,); later regions go before earlier ones.

    Parameters
    ----------
    coordinates, node_sets
        Positions, m (n, dim), and nodes by name.
    regions, elsewhere, key
        Values by node set, that of the material, and the key of the regions in the scene.

    Raises
    ------
    SceneError
        If a formula gives a node no value, or one out of :data:`LEAST` to :data:`MOST` times that of the material.
    """
    node = np.ones(len(coordinates))
    for k, region in enumerate(regions):
        nodes = node_sets[region.on]
        values = np.broadcast_to(region.over(elsewhere, coordinates[nodes]), nodes.shape)
        _require(values, (values >= LEAST) & (values <= MOST), coordinates[nodes], f"{key}.{k}",
                 f"{LEAST:g} to {MOST:g} times that of the material")  # fmt: skip
        node[nodes] = values
    return node


def _require(values: np.ndarray, right: np.ndarray, place: np.ndarray, key: str, wanted: str) -> None:
    """Refuse values of nodes (k,) at the first that is not right, bool (k,)."""
    wrong = np.flatnonzero(~right)
    if wrong.size:
        at = ", ".join(f"{1e3 * length:.6g}" for length in place[wrong[0]])
        raise SceneError(
            "scene", key, float(values[wrong[0]]), f"is what the formula gives at ({at}) mm", f"it must be {wanted}"
        )


def axis_angles(coordinates: np.ndarray, node_sets: Mapping[str, np.ndarray], items: Sequence[Axes]) -> np.ndarray:
    """Direction of the material axis 1 at each node of a plate, rad (n,); later items go before earlier ones."""
    angle = np.zeros(len(coordinates))
    for k, item in enumerate(items):
        nodes = node_sets[item.on]
        angle[nodes] = _angles(coordinates[nodes], item, k)
    return angle


def axis_frames(coordinates: np.ndarray, node_sets: Mapping[str, np.ndarray], items: Sequence[Axes]) -> np.ndarray:
    """Material axes 1, 2 and 3 at each node in space, unit vectors, one a row (n, 3, 3); later items go first."""
    frame = np.broadcast_to(np.eye(3), (len(coordinates), 3, 3)).copy()
    for k, item in enumerate(items):
        nodes = node_sets[item.on]
        if item.axis_1 is not None:
            first, third = np.array(item.axis_1), np.cross(item.axis_1, item.axis_2)
            first, third = first / np.linalg.norm(first), third / np.linalg.norm(third)
            frame[nodes] = first, np.cross(third, first), third
            continue
        c, s = np.cos(angle := _angles(coordinates[nodes], item, k)), np.sin(angle)
        frame[nodes] = np.eye(3)
        frame[nodes, 0, 0] = frame[nodes, 1, 1] = c
        frame[nodes, 0, 1], frame[nodes, 1, 0] = s, -s
    return frame


def _angles(coordinates: np.ndarray, item: Axes, number: int) -> np.ndarray:
    """Angles about z that an item gives to nodes, rad (k,)."""
    angle = np.broadcast_to(at(item.angle, coordinates), len(coordinates))
    _require(angle, np.isfinite(angle), coordinates, f"mechanics.axes.{number}.angle", "a number everywhere")
    if item.around is None:
        return angle
    x, y = (coordinates[:, :2] - item.around).T
    return angle + np.arctan2(y, x)


def stiffness_ratios(
    bonds: Bonds,
    coordinates: np.ndarray,
    node_sets: Mapping[str, np.ndarray],
    regions: Sequence[StiffnessOn],
    youngs_modulus: float,
) -> np.ndarray:
    """Stiffness of every directed bond over that in the material, (b,) (theory, eq. 2.25).

    That of two springs in a row, half a bond each, one in the material of either end. ``youngs_modulus`` is that of
    the material, Pa.

    Raises
    ------
    SceneError
        If Young's moduli differ by more than :data:`MOST_CONTRAST`.
    """
    node = node_values(coordinates, node_sets, regions, youngs_modulus, "mechanics.regions")
    contrast = float(node.max() / node.min())
    if contrast > MOST_CONTRAST * (1.0 + 1e-9):
        raise SceneError(
            "scene", "mechanics.regions", contrast, f"is the ratio of Young's moduli, above {MOST_CONTRAST:g}",
            "a hole, or a prescribed displacement of a stiff part, says the same",
        )  # fmt: skip
    return 2.0 / (1.0 / node[bonds.owners()] + 1.0 / node[bonds.far()])


def toughness_ratios(
    bonds: Bonds,
    coordinates: np.ndarray,
    node_sets: Mapping[str, np.ndarray],
    regions: Sequence[ToughnessOn],
    interfaces: Sequence[Interface],
    toughness: float,
) -> np.ndarray:
    """Fracture energy of every directed bond over that of the material, (b,) (theory, eq. 5.12).

    Each end of a bond gives half of its fracture energy; a bond from one side of an interface to the other has that
    of the interface. Later entries go before earlier ones.

    Parameters
    ----------
    bonds, coordinates, node_sets
        Families, positions of nodes, m (n, dim), and nodes by name.
    regions, interfaces
        Fracture energies by node set, and between two node sets, where `all` is what is outside the other one.
    toughness
        Fracture energy of the material, J/m^2.

    Raises
    ------
    SceneError
        If the two sides of an interface share nodes, or no bond leads from one to the other.
    """
    node = node_values(coordinates, node_sets, regions, toughness, "damage.regions")
    owner, far = bonds.owners(), bonds.far()
    ratio = 0.5 * (node[owner] + node[far])
    for k, interface in enumerate(interfaces):
        one, other = _sides(bonds.node_count, node_sets, interface.between, f"damage.interfaces.{k}.between")
        across = (one[owner] & other[far]) | (other[owner] & one[far])
        if not across.any():
            raise SceneError(
                "scene", f"damage.interfaces.{k}.between", list(interface.between),
                "no bond leads from one to the other", "name two node sets that lie within a horizon of each other",
            )  # fmt: skip
        ratio[across] = interface.over(toughness)
    return ratio


def _sides(
    count: int, node_sets: Mapping[str, np.ndarray], names: tuple[str, str], key: str
) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes lie on the one side and on the other, bool (n,) each."""
    one, other = np.zeros((2, count), bool)
    one[node_sets[names[0]]] = other[node_sets[names[1]]] = True
    if names[0] == "all":
        one &= ~other
    elif names[1] == "all":
        other &= ~one
    shared = int((one & other).sum())
    if shared:
        raise SceneError(
            "scene", key, list(names), f"are two sets that share {shared} nodes of this mesh",
            "an interface has every node on one side: make the sets apart",
        )  # fmt: skip
    return one, other
