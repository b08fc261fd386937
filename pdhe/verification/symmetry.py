"""Halves and quarters of symmetric bodies against the whole ones: operators, elasticity, fracture, hydrogen, work."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.case import Case, build_case
from pdhe.discretization import Discretization
from pdhe.materials import BY_ENERGY
from pdhe.mirrors import Symmetry
from pdhe.plan import bond_bytes
from pdhe.scene import Scene
from pdhe.simulation import simulate
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.notched import plate_with_cracks
from pdhe.verification.report import Report, Row
from pdhe.verification.slabs import nodes_of
from pdhe.whole import whole_mesh

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

#: Residual to which equilibria are found, so that what is left of a difference is round-off and what it leads to.
TOLERANCE = 1e-9
#: Name of an edge as a mirror across either axis shows it.
IMAGE = ({"left": "right", "right": "left"}, {"bottom": "top", "top": "bottom"})
#: Share of bonds that are broken before operators are compared.
BONDS_BROKEN = 0.05
#: Fields of a result that are compared.
FIELDS = ("displacement", "coverage", "damage")

TEXT = """A half of a symmetric body, mirrored at one of its edges, or a quarter, mirrored at two, must give what the
whole body gives. Each part is meshed, and its mesh mirrored to make that of the whole body; both are then computed.

*Operators.* Random displacements and coverages, continued to the whole body by symmetry, with one bond in twenty
broken: forces, energies, damage and rates of diffusion of the part are those of the whole body to round-off, on
lattices, triangles and graded triangles, for positive and negative tangential stiffness, with a crack along the
mirror line or across it, and with a quarter of a hole.

*Runs.* An elastic plate, a dry one that is torn apart, slowly and with inertia, and plates that hydrogen cracks: the
notched plate of the thesis as a half whose mirror line the crack runs along, and a plate with a crack in its middle
as a quarter.
Equilibria are found to 1e-9. The same bonds break in the same rounds; times, displacements, coverages, energies and
forces differ by about that much, unless a difference in the tenth digit lets diffusion choose another length of a
step. Energies, contents and counts of the history are those of the whole body.

*Work.* A half has half of the bonds, but for those across the mirror line, and takes as many sweeps and iterations."""


@dataclass(frozen=True)
class Pair:
    """A part and the whole body that it stands for, on a mesh and on its mirrored copy.

    Attributes
    ----------
    number
        Number of each node of the whole body: image ``q`` of node ``i`` of ``n`` at ``q n + i``.
    """

    part: Case
    whole: Case
    number: np.ndarray

    @cached_property
    def symmetry(self) -> Symmetry:
        """The mirror lines."""
        return Symmetry.of(self.part.scene.geometry)

    def continued(self, values: np.ndarray, vectors: bool = False) -> np.ndarray:
        """Node values of the part as the whole body has them, (..., n) or vectors (..., n, 2)."""
        signs = [self.symmetry.sign(q) if vectors else 1.0 for q in range(self.symmetry.copies)]
        images = np.concatenate([values * sign for sign in signs], axis=-2 if vectors else -1)
        result = np.empty_like(images)
        result[(..., self.number, slice(None)) if vectors else (..., self.number)] = images
        return result


def part_scene(
    size: tuple[float, float],
    mirrors: tuple[str, ...],
    crack: tuple[tuple[float, float], tuple[float, float]],
    spacing: float,
    end: float,
    **options: Any,
) -> Scene:
    """A part of a plate of the thesis' steel, pulled by grips at its upper and, unless a mirror, its lower edge.

    Parameters
    ----------
    size, mirrors, crack
        Of the part: m, edges, and ends of its crack, m.
    options
        As for :func:`pdhe.verification.notched.plate_with_cracks`.
    """
    mesh = options.pop("mesh", None)
    whole = plate_with_cracks(spacing, end, size=size, cracks={}, **options | {"wet": None}).resolved()
    whole["geometry"] |= {"symmetry": list(mirrors), "cracks": [{"name": "notch", "from": crack[0], "to": crack[1]}]}
    # Grips that do not slide: nothing can drift sideways, which neither body would resist.
    still = {"x": {"times": [0.0], "values": [0.0]}}
    whole["loads"] = [
        load | {"displacement": still | load["displacement"]} for load in whole["loads"] if load["on"] not in mirrors
    ]
    whole["solver"] = {"tolerance": TOLERANCE}
    if options.get("wet", ("notch",)) is not None:
        boundary = [{"on": "notch", "coverage": {"times": [0.0], "values": [1.0]}}]
        whole["hydrogen"] = {"boundary": boundary, "degradation": "stretch"}
    return Scene.from_resolved(whole | ({"mesh": mesh} if mesh else {}))


def whole_scene(scene: Scene) -> Scene:
    """The scene of the whole body, its lower-left corner at the origin.

    For scenes whose loads stand on edges and whose holes meet their images. Images of cracks have names of their own,
    but the set of nodes is one, see :func:`mirrored`.
    """
    symmetry, resolved = Symmetry.of(scene.geometry), scene.resolved()
    shift = np.zeros(2)
    for axis in symmetry.axes:
        side = ("width", "height")[axis]
        shift[axis] = resolved["geometry"]["plate"][side]
        resolved["geometry"]["plate"][side] *= 2.0
    del resolved["geometry"]["symmetry"]
    for hole in resolved["geometry"].get("holes", []):
        hole["centre"] = (symmetry.framed(hole["centre"]) + shift).tolist()
    resolved["geometry"]["cracks"] = [
        {"name": crack["name"] + "i" * k, "from": (start + shift).tolist(), "to": (end + shift).tolist()}
        for crack in resolved["geometry"]["cracks"]
        for k, (start, end) in enumerate(symmetry.cracks([(crack["from"], crack["to"])]))
    ]
    for item in resolved["mesh"].get("refine", []):
        item |= {key: (symmetry.framed(item[key]) + shift).tolist() for key in ("from", "to") if key in item}
    for axis in symmetry.axes:
        images = []
        for load in resolved["loads"]:
            if load["on"] in IMAGE[axis]:
                history = load["displacement"]["y"]
                values = [-v if axis == 1 else v for v in history["values"]]
                moved = load["displacement"] | {"y": history | {"values": values}}
                images.append({**load, "on": IMAGE[axis][load["on"]], "displacement": moved})
        resolved["loads"] = resolved["loads"] + images
    return Scene.from_resolved(resolved)


def mirrored(scene: Scene, part: Discretization) -> tuple[Discretization, np.ndarray]:
    """Nodes of the whole body from those of a part, as a mesh of their own has them, and the number of each."""
    symmetry = Symmetry.of(scene.geometry)
    vertices, cells = whole_mesh(part.vertices, part.cells, symmetry)
    framed, signs = symmetry.framed(part.coordinates), [symmetry.sign(q) for q in range(symmetry.copies)]
    low, n = vertices.min(axis=0), part.volume.size
    nodes = np.concatenate([sign * framed for sign in signs]) + symmetry.origin - low
    strip = np.floor(nodes[:, 1] / scene.mesh.spacing + 1e-6).astype(int)
    order = np.lexsort((nodes[:, 1], nodes[:, 0].round(12), strip))
    number = np.empty(order.size, np.int32)
    number[order] = np.arange(order.size)
    sets: dict[str, list[np.ndarray]] = {}
    for name, members in part.node_sets.items():
        if name in (scene.geometry.symmetry or ()):
            continue
        for q, sign in enumerate(signs):
            image = name
            for axis in np.flatnonzero(sign < 0.0):
                image = IMAGE[axis].get(image, image)
            sets.setdefault(image, []).append(number[q * n + members])
    copies = len(signs)
    return Discretization(
        coordinates=nodes[order],
        volume=np.tile(part.volume, copies)[order],
        spacing=np.tile(part.spacing, copies)[order],
        vertices=vertices - low,
        cells=cells[order],
        node_sets={name: np.unique(np.concatenate(found)) for name, found in sets.items()},
        regular=part.regular,
        thickness=part.thickness,
    ), number


def pair_of(scene: Scene, nodes: Discretization | None = None) -> Pair:
    """Build the cases of a part and of the whole body on one mesh."""
    nodes = nodes_of(scene) if nodes is None else nodes
    whole, number = mirrored(scene, nodes)
    return Pair(build_case(scene, nodes), build_case(whole_scene(scene), whole), number)


def break_alike(pair: Pair, share: float) -> None:
    """Break a share of the bonds of the part, and the same ones of the whole body."""
    part, whole, n = pair.part.body, pair.whole.body, pair.part.bonds.node_count
    once = np.flatnonzero(part.bonds.once())
    bond = np.random.default_rng(0).choice(once, int(share * once.size), replace=False)
    i, j = part.bonds.far(part.bonds.reverse[bond]), part.bonds.numbered(bond).astype(np.int64)
    key = whole.bonds.owners().astype(np.int64) * whole.bonds.node_count + whole.bonds.neighbours
    for q in range(pair.symmetry.copies):
        one, other = pair.number[q * n + i], pair.number[(j // n ^ q) * n + j % n]
        wanted = one.astype(np.int64) * whole.bonds.node_count + other
        place = np.searchsorted(key, wanted)
        if (key[place] != wanted).any():
            raise AssertionError("a bond of the part has no like in the whole body")
        whole.break_bonds(place)
    part.break_bonds(bond)


def operator_errors(pair: Pair) -> dict[str, float]:
    """Relative differences of what the operators of the part and of the whole body make of symmetric random fields."""
    break_alike(pair, BONDS_BROKEN)
    part, whole, random = pair.part, pair.whole, np.random.default_rng(1)
    u = random.standard_normal(part.discretization.coordinates.shape)
    psi = random.random(len(u))
    field, coverage = pair.continued(u, vectors=True), pair.continued(psi)

    def rate(case: Case, at: np.ndarray) -> np.ndarray:
        new, none = np.empty_like(at), np.zeros_like(at)
        held = none.astype(bool)
        case.diffusion.step(at, part.diffusion.stable_step(np.zeros(psi.size, bool)), held, none, new, none.copy())
        return new - at

    def difference(found: np.ndarray, exact: np.ndarray) -> float:
        return float(np.abs(found - exact).max() / np.abs(exact).max())

    loads = [
        np.sort(case.body.bond_loads(at, BY_ENERGY)[case.bonds.once()]) for case, at in ((part, u), (whole, field))
    ]
    return {
        "force": difference(pair.continued(part.body.force(u), vectors=True), whole.body.force(field)),
        "energy": difference(pair.continued(part.body.energy(u)), whole.body.energy(field)),
        "largest load": abs(loads[0][-1] / loads[1][-1] - 1.0),
        "damage": difference(pair.continued(part.body.damage()), whole.body.damage()),
        "broken weight": abs(part.copies * part.body.broken_weight / whole.body.broken_weight - 1.0),
        "critical stretch": abs(part.rule.critical / whole.rule.critical - 1.0),
        "diffusion": difference(pair.continued(rate(part, psi)), rate(whole, coverage)),
    }


@dataclass(frozen=True)
class Compared:
    """Results of a part and of the whole body."""

    pair: Pair
    part: xr.Dataset
    whole: xr.Dataset

    def differences(self) -> dict[str, float]:
        """Largest differences of histories, and of fields at all outputs, over their largest value."""
        found = {}
        same = self.part.sizes["step"] == self.whole.sizes["step"]
        for name in ("history_time", "crack_length", "elastic_energy", "kinetic_energy", "external_work",
                     "fracture_energy", "hydrogen_content", "reaction_top_y", "mean_damage"):  # fmt: skip
            if name in self.part.variables:
                one, other = (result[name].values for result in (self.part, self.whole))
                found[name] = float(np.abs(one - other).max() / np.abs(other).max()) if same else np.inf
        for name in FIELDS:
            if name in self.part:
                one = self.pair.continued(self.part[name].values.astype(float), name == "displacement")
                other = self.whole[name].values
                found[name] = float(np.abs(one - other).max() / np.abs(other).max())
        return found

    def work(self, result: xr.Dataset, case: Case) -> float:
        """Bonds times sweeps of a run."""
        sweeps = sum(float(result[name][-1]) for name in ("force_sweeps", "diffusion_sweeps") if name in result)
        return case.bonds.length.size * sweeps


def compared(scene: Scene) -> Compared:
    """Run a part and the whole body."""
    pair = pair_of(scene)
    return Compared(pair, simulate(pair.part), simulate(pair.whole))


def operator_cases(spacing: float) -> dict[str, Scene]:
    """Parts whose operators are compared."""
    half = ((0.1, 0.05), ("bottom",), ((0.0, 0.0), (0.03, 0.0)), spacing, 1e4)
    across = ((0.05, 0.06), ("right",), ((0.02, 0.03), (0.05, 0.03)), spacing, 1e4)
    quarter = ((0.06, 0.05), ("left", "bottom"), ((0.0, 0.0), (0.02, 0.0)), spacing, 1e4)
    bore = {"name": "bore", "centre": [0.0, 0.0], "radius": 0.015}
    fine = {"around": "notch", "spacing": 0.5 * spacing, "within": spacing}
    graded = {"spacing": spacing, "cells": "triangle", "refine": [fine]}
    scenes = {
        "half, lattice": part_scene(*half),
        "half across the crack, lattice": part_scene(*across),
        "quarter, lattice": part_scene(*quarter),
        "half, triangles": part_scene(*half, cells="triangle"),
        "quarter, triangles": part_scene(*quarter, cells="triangle"),
        "quarter, graded triangles": part_scene(*quarter, mesh=graded),
    }
    # One with a quarter of a hole, from which a crack goes out.
    triangles = scenes["quarter, triangles"].resolved()
    triangles["geometry"] |= {"holes": [bore], "cracks": [{"name": "notch", "from": [0.015, 0.0], "to": [0.03, 0.0]}]}
    # A tangential stiffness that is negative, and fades out with damage.
    negative, solid = scenes["quarter, lattice"].resolved(), scenes["quarter, lattice"].resolved()
    negative["material"]["poissons_ratio"] = 0.36
    solid["mechanics"] = {"model": "state-based"}
    gradients = scenes["quarter, lattice"].resolved() | {"mechanics": {"model": "correspondence"}}
    return scenes | {
        "quarter with a hole, triangles": Scene.from_resolved(triangles),
        "quarter, lattice, Poisson's ratio 0.36": Scene.from_resolved(negative),
        "quarter, lattice, state-based": Scene.from_resolved(solid),
        "quarter, lattice, correspondence": Scene.from_resolved(gradients),
    }


def run_cases(spacing: float) -> dict[str, Scene]:
    """Parts whose runs are compared."""
    half = ((0.2, 0.05), ("bottom",), ((0.0, 0.0), (0.05, 0.0)), spacing)
    quarter = ((0.1, 0.05), ("left", "bottom"), ((0.0, 0.0), (0.03, 0.0)), spacing)
    outputs = {"outputs": {"count": 6}}
    torn = {"pull": 0.2e-3, "ramp": 3600.0, "criterion": "energy", "wet": None}
    elastic = part_scene(*half, 3600.0, wet=None, ramp=3600.0, **outputs)
    # Pulled so fast that waves run, and the crack after them.
    fast = {"pull": 0.1e-3, "ramp": 1e-4, "criterion": "energy", "wet": None, "outputs": {"count": 20}}
    hit = part_scene(*half, 1.6e-4, **fast).resolved()
    hit["material"]["density"], hit["stepping"] = 7850.0, {"mode": "dynamic"}
    return {
        "elastic half": elastic.model_copy(update={"damage": None}),
        "dry half": part_scene(*half, 3600.0, **torn, **outputs),
        "dynamic half": Scene.from_resolved(hit),
        "half in hydrogen": part_scene(*half, 6e6, **outputs),
        "quarter in hydrogen": part_scene(*quarter, 6e6, pull=0.03e-3, **outputs),
        "quarter in hydrogen, triangles": part_scene(*quarter, 3e6, pull=0.03e-3, cells="triangle", **outputs),
    }


def run(operator_spacing: float = 2.5e-3, spacing: float = 2.5e-3) -> Report:
    """Compare parts with whole bodies.

    Parameters
    ----------
    operator_spacing, spacing
        Of the bodies whose operators are compared, and of those that are run, m.
    """
    rows: list[Row] = []
    table = []
    for name, scene in operator_cases(operator_spacing).items():
        errors = operator_errors(pair_of(scene))
        rows += operator_rows(name, errors)
        table += [{"case": name, "quantity": what, "difference": error} for what, error in errors.items()]
    runs = {name: compared(scene) for name, scene in run_cases(spacing).items()}
    for name, item in runs.items():
        rows += run_rows(name, item)
        table += [{"case": name, "quantity": what, "difference": error} for what, error in item.differences().items()]
    return Report("symmetry", "Halves and quarters", TEXT, rows, _drawing(runs), {"differences": table})


def operator_rows(name: str, errors: dict[str, float]) -> list[Row]:
    """Judge the largest difference of the operators of a body; on graded meshes, apart from what corrections enter."""
    iterated = {what: error for what, error in errors.items() if what not in ("damage", "diffusion")}
    rows = []
    if "graded" in name:
        why = "corrections of graded meshes are iterated until a thousandth is left; measured up to 5e-4"
        rows.append(Row(f"operators of a {name}", 2e-3, max(iterated.values()), kind="at most", reason=why))
        name, errors = f"{name}, without corrections", {key: errors[key] for key in ("damage", "diffusion")}
    why = "sums in another order: round-off, measured up to 1e-14"
    return [*rows, Row(f"operators of a {name}", 1e-12, max(errors.values()), kind="at most", reason=why)]


def run_rows(name: str, item: Compared) -> list[Row]:
    """Judge a run: what broke, the largest differences, work and memory."""
    broken = [float(result["broken_bonds"][-1]) if "broken_bonds" in result else 0.0 for result in
              (item.part, item.whole)]  # fmt: skip
    rows = [Row(f"{name}: broken bonds", broken[1], broken[0], kind="absolute", reason="the same ones")]
    errors, wet = item.differences(), "coverage" in item.part
    why = f"equilibria are found to {TOLERANCE:g}; measured up to 2e-9"
    if wet:
        why = "1e-4 a step is allowed to diffusion; measured 1e-9 on lattices, up to 1.3e-5 where steps differ"
    fields = {what: error for what, error in errors.items() if what in FIELDS}
    for what, error in (
        ("times", errors["history_time"]),
        ("histories", max(error for what, error in errors.items() if what not in FIELDS)),
        ("fields", max(fields.values())),
    ):
        rows.append(Row(f"{name}: {what}", 5e-5 if wet else 1e-7, error, kind="at most", reason=why))
    copies = item.pair.symmetry.copies
    why = f"1/{copies}, and what the bonds across the mirror lines add on so coarse a mesh"
    for what, ratio in (
        ("work", item.work(item.part, item.pair.part) / item.work(item.whole, item.pair.whole)),
        ("memory of bonds", bond_bytes(item.pair.part) / bond_bytes(item.pair.whole)),
    ):
        rows.append(Row(f"{name}: {what}, over the whole", 1.25 / copies, ratio, kind="at most", reason=why))
    return rows


def _drawing(runs: dict[str, Compared]):
    def draw(figure: Figure) -> None:
        figure.set_size_inches(7.4, 3.0)
        first, second = panels(figure, 2)
        grown = [(k, *run) for k, run in enumerate(runs.items()) if "crack_extension" in run[1].part]
        for k, name, item in grown:
            for result, style in ((item.whole, {"linewidth": 3.0, "alpha": 0.35}), (item.part, {"linewidth": 0.9})):
                time = result["history_time"].values / item.pair.part.scene.time.end
                growth = 1e3 * result["crack_extension"].values
                first.step(
                    time, growth, where="post", color=COLOURS[k], **style, label=name if "alpha" in style else None
                )
        first.legend(fontsize=6, frameon=False, loc="center right", bbox_to_anchor=(1.0, 0.7))
        label(first, "time over that of the end", "growth (mm); pale: whole body")
        names = list(runs)
        for k, name in enumerate(names):
            found = [max(error, 1e-17) for error in runs[name].differences().values()]
            second.plot(np.full(len(found), k), found, "o", markersize=3, color=COLOURS[k % len(COLOURS)])
        second.axhline(TOLERANCE, color="0.4", linestyle="--", linewidth=0.8)
        second.set_yscale("log")
        second.set_xticks(range(len(names)), [name.replace(" ", "\n") for name in names], fontsize=6)
        label(second, "", "differences; dashed: solver")

    return draw
