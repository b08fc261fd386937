"""Checks of a scene that look at more than one block: geometry, node sets, contradictions, missing physics.

Each check raises the first problem it finds, with the dotted key of the entry to change.
"""

import difflib
import math
from itertools import combinations
from typing import TYPE_CHECKING, Any

from pdhe import scene_solid as solid
from pdhe.scene_fields import problem
from pdhe.scene_mirrors import Segment, check_symmetry, edge_segments, mirror_levels, mirrors_through
from pdhe.scene_places import Formula
from pdhe.scene_tables import MOST_POINTS, Table
from pdhe.scene_umat import check_umat

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pdhe.scene import Scene
    from pdhe.scene_blocks import Crack, Damage, DiffusivityOn, Hole, Region, StiffnessOn, ToughnessOn
    from pdhe.scene_history import PiecewiseLinear
    from pdhe.sizing import SizeField

MAX_NODES = 5_000_000
"""Most nodes of one scene."""
SQUARENESS = 0.02
"""Largest relative difference of the two sides of a cell on a structured mesh."""
MIN_HORIZON_RATIO = 1.2
"""Smallest horizon in units of the spacing at which every node keeps its four nearest neighbours on a rough mesh."""
LEAST_POISSON = -0.9
"""Least Poisson's ratio: towards -1 shear takes all the stiffness, and equilibria take ever more iterations."""
ONE_PARAMETER_TOLERANCE = 0.005
"""How far Poisson's ratio may be from the only one that bonds with one constant have: 0.33 is 1/3."""
SHARING_DISTANCE = 1.5
"""Distance in spacings from which two lines cannot share a node: either set reaches at most 0.75 spacings."""
MAX_HORIZON_GROWTH = 1.0
"""Largest growth of the horizon per length: from 1 on, a bond could be longer than what either end sees (theory)."""
BOND_MODELS = ("condensed rotation", "thesis spring", "one-parameter")
"""Elastic models whose bonds act one by one."""
GRADED_WEIGHTS = ("moment matched", "none")
"""Surface corrections that know horizons that vary."""
RESERVED = ("left", "right", "bottom", "top", "all")
"""Node set names that every plate has."""


def reserved_names(scene: "Scene") -> tuple[str, ...]:
    """Names of the node sets that every body has: those of a plate, in space two faces more."""
    return (*RESERVED, *solid.FACES) if scene.mesh.solid else RESERVED


def check_scene(scene: "Scene") -> None:
    """Raise the first problem of a scene whose blocks are valid one by one."""
    _check_shapes(scene)
    _check_mesh(scene)
    _check_names(scene)
    _check_holes(scene)
    _check_cracks(scene)
    _check_physics(scene)
    _check_split(scene)
    _check_formulas(scene)
    _check_material(scene)
    _check_regions(scene)
    _check_node_sets(scene)
    check_symmetry(scene)
    _check_loads(scene)
    _check_dynamics(scene)
    check_umat(scene)
    _check_strain(scene)
    _check_coverage(scene)


def square_cells(width: float, height: float, spacing: float) -> tuple[int, int, str]:
    """Cells along both sides (m) of a plate for a wanted spacing (m), and what is wrong if they are not square."""
    nx, ny = max(1, round(width / spacing)), max(1, round(height / spacing))
    dx, dy = width / nx, height / ny
    if abs(dx - dy) <= SQUARENESS * dx:
        return nx, ny, ""
    fitting = [
        width / n
        for n in range(1, 4 * nx + 4)
        if (rows := round(height * n / width)) > 0 and abs(height * n / (width * rows) - 1) <= 1e-6
    ]
    nearest = min(fitting, key=lambda length: abs(length - spacing), default=None)
    hint = f", for example {_mm(float(f'{nearest:.6g}'))}" if nearest else ""
    return nx, ny, f"gives cells of {_mm(dx, dy)}, which are not square; choose one that divides both sides{hint}"


def _mm(*lengths: float) -> str:
    return " x ".join(f"{1e3 * length:g}" for length in lengths) + " mm"


def _check_shapes(scene: "Scene") -> None:
    """Refuse cracks in a plate that only bodies in space have, before anything asks where they begin."""
    for k, crack in enumerate(scene.geometry.cracks):
        if crack.start is None and not scene.mesh.solid:
            shape = "disc" if crack.disc is not None else "polygon"
            hint = "use `mesh: {cells: hexahedron}` or `tetrahedron`"
            raise problem("is a crack in space", hint, f"geometry.cracks.{k}.{shape}")


def _check_mesh(scene: "Scene") -> None:
    width, height, spacing = scene.geometry.width, scene.geometry.height, scene.mesh.spacing
    if scene.mesh.solid:
        solid.check_cells(scene, MAX_NODES)
        _check_reach(scene, scene.mesh.cells == "hexahedron")
        return
    if spacing > min(width, height):
        hint = f"use a fraction of the smaller side, {_mm(min(width, height))}"
        raise problem(f"is larger than the plate, {_mm(width, height)}", hint, "mesh.spacing")
    if scene.mesh.cells == "quadrilateral" and not scene.geometry.holes:
        wrong = square_cells(width, height, spacing)[2]
        if wrong:
            raise problem(wrong, "or use `cells: triangle`", "mesh.spacing")
    size = _check_refinement(scene)
    nodes = (width / spacing) * (height / spacing) if size is None else size.cells()
    if nodes > MAX_NODES:
        least = math.sqrt(width * height / MAX_NODES)
        text = f"gives about {nodes:.3g} nodes, more than {MAX_NODES:.0e}"
        hint = f"use at least {_mm(float(f'{1.01 * least:.3g}'))}"
        if size is not None:
            raise problem(text, "use a coarser spacing or a smaller `within`", "mesh.refine")
        raise problem(text, hint, "mesh.spacing")
    _check_reach(scene, scene.mesh.cells == "quadrilateral" and not scene.geometry.holes)
    if scene.horizon_length >= min(width, height):
        key = "horizon.ratio" if scene.horizon.ratio is not None else "horizon.length"
        text = f"is a horizon of {_mm(scene.horizon_length)}, not smaller than the plate, {_mm(width, height)}"
        raise problem(text, "use a smaller horizon or a finer spacing", key)


def _check_reach(scene: "Scene", structured: bool) -> None:
    """Check that the horizon leaves every node neighbours enough."""
    width, height, spacing = scene.geometry.width, scene.geometry.height, scene.mesh.spacing
    key = "horizon.ratio" if scene.horizon.ratio is not None else "horizon.length"
    if structured and scene.loads is not None:
        nx, ny = max(1, round(width / spacing)), max(1, round(height / spacing))
        diagonal = math.hypot(width / nx, height / ny)
        if MIN_HORIZON_RATIO * spacing <= scene.horizon_length < diagonal * (1.0 - 1e-12):
            text = f"is a horizon of {scene.horizon_length / spacing:.4g} spacings, which leaves out the diagonals"
            hint = "along the axes alone, bonds have no lateral contraction: use at least 1.42 spacings with `loads`"
            raise problem(text, hint, key)
    if scene.horizon_length < MIN_HORIZON_RATIO * spacing * (1.0 - 1e-12):
        text = f"is a horizon of {scene.horizon_length / spacing:.4g} spacings, which leaves nodes without neighbours"
        raise problem(text, f"use at least {MIN_HORIZON_RATIO} spacings; 3.015 is customary", key)


def _check_refinement(scene: "Scene") -> "SizeField | None":
    """Check what a graded mesh asks for; return its spacing as a function of place, None for a uniform one."""
    mesh, (width, height) = scene.mesh, (scene.geometry.width, scene.geometry.height)
    if not mesh.refine:
        return None
    from pdhe.sizing import SizeField  # here: reading a scene without refinement does without numpy

    known = [item.name for _, item in _named(scene)]
    slack = 1e-9 * max(width, height)
    for k, item in enumerate(mesh.refine):
        key = f"mesh.refine.{k}"
        if item.around is not None and item.around not in known:
            listed = ", ".join(f"`{name}`" for name in known) or "none in this scene"
            raise problem("is not a hole or a crack", f"names: {listed}; or give `from` and `to`", f"{key}.around")
        for end, point in (("from", item.start), ("to", item.end)):
            x, y = point or (0.0, 0.0)
            if not (-slack <= x <= width + slack and -slack <= y <= height + slack):
                raise problem("is outside the plate", f"the plate is {_mm(width, height)} from (0, 0)", f"{key}.{end}")
    if scene.horizon.ratio is None:
        text = "is one horizon for all nodes, but `mesh.refine` makes their spacings differ"
        raise problem(text, "give `ratio`: the horizon then goes with the spacing", "horizon.length")
    if scene.horizon.ratio * mesh.growth_rate >= MAX_HORIZON_GROWTH:
        text = f"lets the horizon grow by {scene.horizon.ratio * mesh.growth_rate:.3g} of a length along that length"
        most = float(f"{0.999 * MAX_HORIZON_GROWTH / scene.horizon.ratio:.2g}")
        raise problem(text, f"use at most {most:g} with this horizon ratio", "mesh.growth")
    if scene.mechanics.weights not in GRADED_WEIGHTS:
        listed = " or ".join(f"`{name}`" for name in GRADED_WEIGHTS)
        raise problem("is made for one horizon, but `mesh.refine` makes it vary", f"use {listed}", "mechanics.weights")
    return SizeField(scene.geometry, mesh)


def _local_spacing(scene: "Scene", *points: tuple[float, float]) -> float:
    """The smallest spacing at some places, m."""
    if not scene.mesh.refine:
        return scene.mesh.spacing
    from pdhe.sizing import SizeField

    return min(SizeField(scene.geometry, scene.mesh).at(*point) for point in points)


def _named(scene: "Scene") -> "list[tuple[str, Hole | Crack]]":
    holes = [(f"geometry.holes.{k}", hole) for k, hole in enumerate(scene.geometry.holes)]
    return [*holes, *((f"geometry.cracks.{k}", crack) for k, crack in enumerate(scene.geometry.cracks))]


def _check_regions(scene: "Scene") -> None:
    width, height = scene.geometry.width, scene.geometry.height
    if scene.regions is not None and not scene.regions:
        raise problem("is an empty list", "add a region, or leave `regions` out", "regions")
    for k, region in enumerate(scene.regions or ()):
        x0, y0, x1, y1 = region.box
        if not (x0 < x1 and y0 < y1):
            text = "makes a box without an area"
            raise problem(text, "`from` and `to` are two opposite corners of the box", f"regions.{k}.to")
        if x1 < 0.0 or y1 < 0.0 or x0 > width or y0 > height:
            raise problem("is outside the plate", f"the plate is {_mm(width, height)} from (0, 0)", f"regions.{k}.from")


def _check_names(scene: "Scene") -> None:
    taken: dict[str, str] = {}
    regions: list[tuple[str, Any]] = [(f"regions.{k}", region) for k, region in enumerate(scene.regions or ())]
    for key, item in [*_named(scene), *regions]:
        name = item.name.lower()
        if name in reserved_names(scene):
            hint = f"{', '.join(f'`{word}`' for word in reserved_names(scene))} name parts of every plate"
            raise problem("is a reserved name", hint, f"{key}.name")
        if name in taken:
            hint = "names of holes, cracks and regions must differ in more than capitals"
            raise problem(f"is already the name of {taken[name]}", hint, f"{key}.name")
        taken[name] = key


def _check_holes(scene: "Scene") -> None:
    width, height = scene.geometry.width, scene.geometry.height
    for k, hole in enumerate(scene.geometry.holes):
        key, (x, y) = f"geometry.holes.{k}", hole.centre
        if not (0.0 <= x <= width and 0.0 <= y <= height):
            raise problem("is outside the plate", f"the plate is {_mm(width, height)} from (0, 0)", f"{key}.centre")
        spacing = _local_spacing(scene, (x + hole.radius, y), (x - hole.radius, y), (x, y + hole.radius))
        if hole.radius < spacing:
            hint = f"use a radius of at least one spacing, {_mm(spacing)}"
            raise problem("is smaller than the spacing and cannot be meshed", hint, f"{key}.radius")
        away = {"left": x, "bottom": y, "right": width - x, "top": height - y}
        room = min(length for edge, length in away.items() if edge not in mirrors_through(scene.geometry, hole))
        if hole.radius >= room * (1.0 - 1e-9):
            hint = f"use a radius below {_mm(room)}"
            if scene.geometry.symmetry:
                hint += ", or put the centre on the mirror line"
            raise problem("reaches the edge of the plate", hint, f"{key}.radius")
        if room - hole.radius < scene.mesh.spacing * (1.0 - 1e-9):
            text = f"leaves {_mm(room - hole.radius)} to the edge, less than the spacing"
            raise problem(text, "move the hole, or use a finer mesh.spacing", f"{key}.radius")
        for other in scene.geometry.holes[:k]:
            if math.dist(hole.centre, other.centre) <= (hole.radius + other.radius) * (1.0 + 1e-9):
                raise problem(f"overlaps the hole `{other.name}`", "keep material between holes", f"{key}.centre")
            gap = math.dist(hole.centre, other.centre) - hole.radius - other.radius
            if gap < scene.mesh.spacing * (1.0 - 1e-9):
                text = f"leaves {_mm(gap)} to the hole `{other.name}`, less than the spacing"
                raise problem(text, "move the hole, or use a finer mesh.spacing", f"{key}.centre")


def _check_cracks(scene: "Scene") -> None:
    width, height = scene.geometry.width, scene.geometry.height
    slack = 1e-9 * max(width, height)
    for k, crack in enumerate(scene.geometry.cracks):
        key = f"geometry.cracks.{k}"
        if crack.start is None:
            solid.check_shape(scene, crack, key)
            continue
        spacing = _local_spacing(scene, crack.start, crack.end)
        for end, (x, y) in (("from", crack.start), ("to", crack.end)):
            if not (-slack <= x <= width + slack and -slack <= y <= height + slack):
                hint = f"the plate is {_mm(width, height)} from (0, 0); a crack may end on its edge"
                raise problem("is outside the plate", hint, f"{key}.{end}")
        length = math.dist(crack.start, crack.end)
        if length <= slack:
            raise problem("is the point where the crack starts: it has no length", "move one end", f"{key}.to")
        if length < spacing * (1.0 - 1e-9):
            text = f"makes the crack {_mm(length)} long, shorter than the spacing, {_mm(spacing)}"
            raise problem(text, "refine the mesh or lengthen the crack", f"{key}.to")
        for axis, side in ((0, width), (1, height)):
            for level in (0.0, side):
                if (axis, level) in mirror_levels(scene.geometry).values():
                    continue
                if max(abs(crack.start[axis] - level), abs(crack.end[axis] - level)) <= slack:
                    raise problem("puts the crack along the edge, where it cuts nothing", "move it inside", f"{key}.to")
        for hole in scene.geometry.holes:
            if max(math.dist(hole.centre, crack.start), math.dist(hole.centre, crack.end)) <= hole.radius:
                raise problem(f"leaves the crack inside the hole `{hole.name}`", "move the crack", f"{key}.to")
        for other in (other for other in scene.geometry.cracks[:k] if other.start is not None):
            same = min(
                math.dist(crack.start, other.start) + math.dist(crack.end, other.end),
                math.dist(crack.start, other.end) + math.dist(crack.end, other.start),
            )
            if same <= slack:
                raise problem(f"repeats the crack `{other.name}`", "keep one of them", f"{key}.to")


def _check_physics(scene: "Scene") -> None:
    if scene.damage is not None and scene.loads is None:
        hint = "damage follows from stretched bonds: add `loads`, or leave `damage` out"
        raise problem("needs loads", hint, "damage")
    if scene.damage is not None and "all" in scene.damage.no_fail:
        hint = "leave `damage` out, or name the node sets around which no bond may break"
        raise problem("names `all`: no bond is left that may break", hint, "damage.no_fail")
    if scene.hydrogen is not None and not _has_source(scene):
        hint = "prescribe a coverage under `boundary`, give an `initial` one, or leave `hydrogen` out"
        raise problem("has no source: the coverage is zero and stays so", hint, "hydrogen")
    if scene.loads is None and scene.hydrogen is None:
        raise problem("neither loads nor hydrogen is given: there is nothing to compute", "add `loads` or `hydrogen`")
    if scene.loads is not None and not scene.loads:
        raise problem("is an empty list", "add a load, or leave `loads` out for diffusion alone", "loads")
    if scene.hydrogen is not None and scene.material.diffusivity is None:
        hint = "add for example `diffusivity: 0.84e-9 m^2/s` to the material, or leave `hydrogen` out"
        raise problem("is missing, and hydrogen diffusion needs it", hint, "material.diffusivity")
    if scene.damage is not None and scene.material.toughness(scene.plane) is None:
        hint = "add `fracture_toughness` or `critical_energy_release_rate` to the material, or leave `damage` out"
        raise problem("is missing, and damage needs it", hint, "material.fracture_toughness")


def _check_formulas(scene: "Scene") -> None:
    """Refuse formulas and tables of z in the plane, and tables that are too large together."""
    count = 0
    regions = {"mechanics.axes": scene.mechanics.axes, "mechanics.regions": scene.mechanics.regions}
    regions["damage.regions"] = scene.damage.regions if scene.damage else None
    regions["hydrogen.regions"] = scene.hydrogen.regions if scene.hydrogen else None
    for where, items in regions.items():
        for k, item in enumerate(items or ()):
            for key in type(item).model_fields:
                value = getattr(item, key)
                if isinstance(value, Formula | Table) and "z" in value.coordinates and not scene.mesh.solid:
                    text, part = "asks for z in the plane", ".expression" if isinstance(value, Formula) else ""
                    raise problem(text, "a plate has x and y", f"{where}.{k}.{key}{part}")
                count += len(value.points) if isinstance(value, Table) else 0
                if count > MOST_POINTS:
                    text = f"makes more than {MOST_POINTS} points of all tables together"
                    raise problem(text, "give fewer", f"{where}.{k}.{key}")


def _check_split(scene: "Scene") -> None:
    if scene.damage is None or scene.damage.split is None:
        return
    if scene.mechanics.model not in ("state-based", "correspondence"):
        text = f"is not there for `{scene.mechanics.model}`, whose bonds know no dilatation"
        raise problem(text, "use `mechanics: {model: state-based}`, or leave `split` out", "damage.split")
    if scene.material.orthotropic is not None:
        text = "is for isotropic materials: a dilatation of others has shear stresses"
        raise problem(text, "leave `split` or `material.orthotropic` out", "damage.split")
    if scene.mechanics.strain != "small":
        raise problem("is known for small strains alone", "leave `split` out, or use `strain: small`", "damage.split")
    if scene.damage.criterion == "stretch":
        text = "splits energies, and bonds break by their stretch"
        raise problem(text, "use `criterion: energy`, or leave `split` out", "damage.split")


def _has_source(scene: "Scene") -> bool:
    """Tell whether coverage is or can become other than zero, or is prescribed at all."""
    hydrogen = scene.hydrogen
    if hydrogen is None or hydrogen.initial > 0.0 or hydrogen.boundary:
        return True
    faces = scene.damage is not None or bool(scene.geometry.cracks)
    return hydrogen.saturation is not None and scene.loads is not None and faces


def _check_orthotropic(scene: "Scene") -> None:
    """Engineering constants that belong together, and a model that knows them."""
    material, mechanics, given = scene.material, scene.mechanics, scene.material.orthotropic
    if mechanics.axes is not None and given is None:
        raise problem(
            "are axes of an isotropic material", "leave them out, or add `material.orthotropic`", "mechanics.axes"
        )
    if given is None:
        return
    if scene.loads is not None and mechanics.model != "correspondence":
        text = f"is not known to model `{mechanics.model}`"
        raise problem(text, "use `mechanics: {model: correspondence}`", "material.orthotropic")
    if scene.geometry.symmetry:
        text = "mirrors the axes of the material too, which makes another one of it beyond the mirror line"
        raise problem(text, "describe the whole body", "geometry.symmetry")
    if scene.damage is not None and material.critical_energy_release_rate is None:
        text = "is missing: `fracture_toughness` gives it for isotropic materials only"
        raise problem(text, "for example `2 kJ/m^2`", "material.critical_energy_release_rate")
    e1, e2, nu12 = material.youngs_modulus, given.youngs_modulus_2, material.poissons_ratio
    left = 1.0 - nu12**2 * e2 / e1
    key = "material.poissons_ratio"
    for k, item in enumerate(mechanics.axes or ()):
        if item.axis_1 is not None and not scene.mesh.solid:
            hint = "use `angle`, or `mesh: {cells: hexahedron}` or `tetrahedron`"
            raise problem("is a direction in space", hint, f"mechanics.axes.{k}.axis_1")
    if (mechanics.plane == "strain" or scene.mesh.solid) and scene.loads is not None:
        wanted = ("youngs_modulus_3", "poissons_ratio_13", "poissons_ratio_23")
        wanted += ("shear_modulus_13", "shear_modulus_23") if scene.mesh.solid else ()
        state = "a body in space" if scene.mesh.solid else "plane strain"
        for name in wanted:
            if getattr(given, name) is None:
                raise problem(f"is missing, and {state} needs it", "give it", f"material.orthotropic.{name}")
        e3, nu13, nu23 = given.youngs_modulus_3, given.poissons_ratio_13, given.poissons_ratio_23
        key = "material.orthotropic.poissons_ratio_23"
        left = min(left, 1.0 - nu13**2 * e3 / e1, 1.0 - nu23**2 * e3 / e2, _compliance(e1, e2, e3, nu12, nu13, nu23))
    if left <= 0.0:
        raise problem("makes the stiffness indefinite", "|nu_ij| must stay below sqrt(E_i/E_j)", key)


def _compliance(e1: float, e2: float, e3: float, nu12: float, nu13: float, nu23: float) -> float:
    """Determinant of the compliance of the three axes, times the three moduli."""
    return 1.0 - nu12**2 * e2 / e1 - nu23**2 * e3 / e2 - nu13**2 * e3 / e1 - 2.0 * nu12 * nu23 * nu13 * e3 / e1


def _check_material(scene: "Scene") -> None:
    material = scene.material
    _check_orthotropic(scene)
    if material.youngs_modulus < 1.0:
        raise problem("is less than 1 Pa", "`MPa` is megapascal, `mPa` is millipascal", "material.youngs_modulus")
    if material.fracture_toughness is not None and material.critical_energy_release_rate is not None:
        plane = scene.plane
        implied = material.implied_toughness(plane)
        if not math.isclose(implied, material.critical_energy_release_rate, rel_tol=0.01):
            formula, where = "K^2/E" if plane == "stress" else "(1-nu^2) K^2/E", f"plane {plane or 'strain'}"
            text = f"contradicts `fracture_toughness`, which means {implied:.6g} J/m^2 ({formula}, {where})"
            raise problem(text, "give one of the two", "material.critical_energy_release_rate")
    if scene.loads is None:
        return
    if scene.mesh.solid:
        solid.check_mechanics(scene)
    nu, key = material.poissons_ratio, "material.poissons_ratio"
    if nu < LEAST_POISSON:
        raise problem("is outside the range of the bond model", f"it must be at least {LEAST_POISSON:g}", key)
    model, plane = scene.mechanics.model, scene.plane
    natural, name = (1.0 / 3.0, "1/3") if plane == "stress" else (1.0 / 4.0, "1/4")
    if model == "thesis spring" and nu > natural + 1e-9:
        text = f"is above {name}, where the tangential springs are negative and a rotation releases energy (indefinite)"
        raise problem(text, "use `mechanics: {model: condensed rotation}`", key)
    if scene.mechanics.regions:
        use, where = "use `mechanics: {model: condensed rotation}` in the plane", "mechanics.regions"
        if model != "condensed rotation" or scene.mesh.solid:
            raise problem(
                f"are not known to {'bodies in space' if scene.mesh.solid else f'model `{model}`'}", use, where
            )
        if nu > natural + 1e-9:
            text = f"are not known where tangential springs are negative, at a Poisson's ratio above {name}"
            raise problem(text, f"use at most {natural:.4g} in plane {plane}", where)
    for setting in ("zero_energy", "zero_energy_strength"):
        given = getattr(scene.mechanics, setting)
        if model != "correspondence" and given != type(scene.mechanics).model_fields[setting].default:
            text = f"belongs to model `correspondence`, not to `{model}`"
            raise problem(text, "leave it out, or change `mechanics.model`", f"mechanics.{setting}")
    if model not in BOND_MODELS and scene.mechanics.weights == "energy":
        text = f"makes up for what two-parameter bonds lack, not model `{model}`"
        raise problem(text, "use `moment matched`", "mechanics.weights")
    if model == "one-parameter" and abs(nu - natural) > ONE_PARAMETER_TOLERANCE:
        text = f"is not the Poisson's ratio of one-parameter bonds, which is {name} in "
        text += f"plane {plane}" if plane else "space"
        raise problem(text, f"give {natural:.4g}, or use `mechanics: {{model: condensed rotation}}`", key)


def _check_node_sets(scene: "Scene") -> None:
    places = [(f"loads.{k}.on", load.on) for k, load in enumerate(scene.loads or ())]
    if scene.hydrogen is not None:
        places += [(f"hydrogen.boundary.{k}.on", item.on) for k, item in enumerate(scene.hydrogen.boundary)]
        places += _region_places(scene.hydrogen.regions, "hydrogen.regions")
    places += [(f"mechanics.axes.{k}.on", item.on) for k, item in enumerate(scene.mechanics.axes or ())]
    places += _region_places(scene.mechanics.regions, "mechanics.regions")
    if scene.damage is not None:
        places += [(f"damage.no_fail.{k}", name) for k, name in enumerate(scene.damage.no_fail)]
        for k, name in enumerate(scene.damage.no_fail):
            if name in scene.damage.no_fail[:k]:
                raise problem("is listed twice", "keep one of them", f"damage.no_fail.{k}")
        places += _toughness_places(scene.damage)
    for key, name in places:
        if name not in scene.node_sets:
            near = difflib.get_close_matches(name, scene.node_sets, 1, 0.5)
            listed = ", ".join(f"`{item}`" for item in scene.node_sets)
            hint = (f"did you mean `{near[0]}`? " if near else "") + f"node sets of this scene: {listed}"
            raise problem("is not a node set", hint, key)


def _region_places(
    regions: "Sequence[ToughnessOn | DiffusivityOn | StiffnessOn] | None", key: str
) -> list[tuple[str, str]]:
    """Node sets with a value of their own, and where they are named; none of them twice."""
    if regions is not None and not regions:
        raise problem("is an empty list", "add an entry, or leave `regions` out", key)
    names = [region.on for region in regions or ()]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise problem("is listed twice", "keep one of them", f"{key}.{k}.on")
    return [(f"{key}.{k}.on", name) for k, name in enumerate(names)]


def _toughness_places(damage: "Damage") -> list[tuple[str, str]]:
    """Node sets with a fracture energy of their own, and where they are named; none of them twice."""
    places = _region_places(damage.regions, "damage.regions")
    if damage.interfaces is not None and not damage.interfaces:
        raise problem("is an empty list", "add an entry, or leave `interfaces` out", "damage.interfaces")
    interfaces = damage.interfaces or ()
    for k, interface in enumerate(interfaces):
        if set(interface.between) in [set(other.between) for other in interfaces[:k]]:
            raise problem("is listed twice", "keep one of them", f"damage.interfaces.{k}.between")
    return places + [
        (f"damage.interfaces.{k}.between", name) for k, interface in enumerate(interfaces) for name in interface.between
    ]


def _check_loads(scene: "Scene") -> None:
    largest = max(scene.geometry.width, scene.geometry.height)
    prescribed: list[tuple[str, str, str, PiecewiseLinear]] = []
    for k, load in enumerate(scene.loads or ()):
        if 2 in load.components and not scene.mesh.solid:
            hint = "leave it out, or use `mesh: {cells: hexahedron}` or `tetrahedron`"
            raise problem("moves a plate out of its plane", hint, f"loads.{k}.{load.kind}.z")
        if not load.components:
            example = {"displacement": "0.02 mm", "traction": "12 MPa"}.get(load.kind, "16.5 m/s")
            hint = f"give `x`, `y` or both, for example `{{y: {example}}}`; a free node set needs no load"
            raise problem("prescribes nothing", hint, f"loads.{k}.{load.kind}")
        for axis, given in load.components.items():
            key = f"loads.{k}.{load.kind}.{'xyz'[axis]}"
            if load.kind == "displacement" and max(abs(value) for value in given.values) > largest:
                raise problem(f"is larger than the plate, {_mm(largest)}", "check the unit", key)
            if axis in load.motion:
                prescribed.append((key, load.on, "xyz"[axis], given))
    for one, two in combinations(prescribed, 2):
        if one[2] == two[2]:
            same_kind = one[0].split(".")[2] == two[0].split(".")[2]
            still = not any((*one[3].values, *two[3].values))
            _check_pair(scene, one[0], one[1], one[3], two[0], two[1], two[3], same_kind or still)


def _check_dynamics(scene: "Scene") -> None:
    """Check what inertia needs, and what needs inertia."""
    loads, dynamic = scene.loads or (), scene.stepping.mode == "dynamic"
    for k, load in enumerate(loads):
        if load.kind != "displacement" and not dynamic:
            hint = "write `stepping: {mode: dynamic}`; equilibria take prescribed displacements only"
            raise problem("needs inertia", hint, f"loads.{k}.{load.kind}")
        outside = (*RESERVED[:4], *solid.FACES) if scene.mesh.solid else RESERVED[:4]
        if load.kind == "traction" and load.on not in outside:
            raise problem("has no surface that a traction could act on", f"use {', '.join(outside)}", f"loads.{k}.on")
    if not dynamic:
        return
    if scene.loads is None:
        hint = "add `loads`: a velocity, an initial velocity, a traction or a displacement"
        raise problem("needs something that moves", hint, "stepping.mode")
    if scene.material.density is None:
        hint = "add for example `density: 7850 kg/m^3` to the material"
        raise problem("is missing, and inertia needs it", hint, "material.density")
    if scene.time.end <= 0.0:
        raise problem("leaves no time for motion", "waves take `height / 5 km/s`", "time.end")
    for k, load in enumerate(loads):
        for axis, given in load.components.items():
            if load.kind == "displacement" and given(0.0) != 0.0:
                text = "is a jump at the start, where the body is at rest and not deformed"
                hint = "let it begin at zero, for example `{0 us: 0 mm, 1 us: 0.01 mm}`, or prescribe a velocity"
                raise problem(text, hint, f"loads.{k}.displacement.{'xyz'[axis]}")
    for key, kind in (("traction", "traction"), ("initial_velocity", "initial velocity")):
        given_at: dict[tuple[str, int], int] = {}
        for k, load in enumerate(loads):
            for axis in load.components if load.kind == key else ():
                if (load.on, axis) in given_at:
                    text = f"gives `{load.on}` a second {kind} along {'xyz'[axis]}"
                    raise problem(text, "keep one of them", f"loads.{k}.{key}.{'xyz'[axis]}")
                given_at[load.on, axis] = k
                if any(other.on == load.on and axis in other.motion for other in loads):
                    text = f"acts on `{load.on}`, whose motion along {'xyz'[axis]} is prescribed"
                    raise problem(text, "keep one of them", f"loads.{k}.{key}.{'xyz'[axis]}")


def _check_strain(scene: "Scene") -> None:
    """Check what large strains need, and what is not known for them."""
    if scene.loads is None or scene.mechanics.strain == "small":
        return
    if scene.mechanics.model != "correspondence":
        text = f"is not known to model `{scene.mechanics.model}`"
        raise problem(text, "use `mechanics: {model: correspondence}`, or leave it out", "mechanics.strain")
    for found, key, text, hint in (
        (scene.material.umat is not None, "material.umat", "is called with small strains alone", "leave one of them"),
        (scene.damage is not None and scene.stepping.mode == "events", "stepping.mode",
         "knows how bonds are loaded between two load steps for small strains alone", "use mode `fixed` with `damage`"),
        (scene.damage is not None and scene.damage.split is not None, "damage.split",
         "is known for small strains alone", "leave one of them"),
        (scene.stepping.mode == "dynamic", "stepping.mode", "has proved steps for small strains alone",
         "use mode `events` or `fixed`"),
    ):  # fmt: skip
        if found:
            raise problem(f"{text}, not for `mechanics.strain: finite`", f"{hint}, or use `strain: small`", key)


def _check_coverage(scene: "Scene") -> None:
    conditions = enumerate(scene.hydrogen.boundary if scene.hydrogen else ())
    prescribed = [(f"hydrogen.boundary.{k}.coverage", item.on, item.coverage) for k, item in conditions]
    for one, two in combinations(prescribed, 2):
        _check_pair(scene, *one, *two)


def _check_pair(
    scene: "Scene", key1: str, on1: str, value1: "PiecewiseLinear", key2: str, on2: str, value2: "PiecewiseLinear",
    comparable: bool = True,
) -> None:  # fmt: skip
    """Refuse two prescriptions of one quantity that share nodes, unless they agree at every time."""
    if on1 == on2:
        raise problem(f"prescribes what `{key1}` already prescribes on `{on1}`", "keep one of them", key2)
    if (comparable and value1.equals(value2)) or not _touch(scene, on1, on2):
        return
    text = f"contradicts `{key1}`: `{on1}` and `{on2}` share nodes"
    raise problem(text, "give both the same value at every time, or leave one out", key2)


def _touch(scene: "Scene", on1: str, on2: str) -> bool:
    """Tell whether two node sets share nodes, judged by the distance of the lines they follow."""
    if "all" in (on1, on2):
        return True
    if scene.mesh.solid:
        apart = solid.boxes_apart(solid.box_of(scene, on1), solid.box_of(scene, on2))
        return apart < SHARING_DISTANCE * scene.mesh.spacing * (1.0 + 1e-9)
    regions = {region.name: region for region in scene.regions or ()}
    if on1 in regions and on2 in regions:
        (a0, b0, a1, b1), (c0, d0, c1, d1) = regions[on1].box, regions[on2].box
        return a0 <= c1 and c0 <= a1 and b0 <= d1 and d0 <= b1
    if on1 in regions or on2 in regions:
        region, other = (regions[on1], on2) if on1 in regions else (regions[on2], on1)
        return _reaches(scene, region, other)
    (line1, radius1), (line2, radius2) = _line(scene, on1), _line(scene, on2)
    if on1 in RESERVED and on2 in RESERVED:
        return {on1, on2} not in ({"left", "right"}, {"bottom", "top"})
    distance = _segment_distance(line1, line2)
    return distance - radius1 - radius2 < SHARING_DISTANCE * scene.mesh.spacing * (1.0 + 1e-9)


def _reaches(scene: "Scene", region: "Region", name: str) -> bool:
    """Tell whether a box comes so near to what a node set follows that they may share nodes."""
    x0, y0, x1, y1 = region.box
    line, radius = _line(scene, name)
    if any(x0 <= x <= x1 and y0 <= y <= y1 for x, y in line):
        return True
    corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    distance = min(_segment_distance(line, side) for side in zip(corners, (*corners[1:], corners[0]), strict=True))
    # A set follows its line within 0.75 spacings.
    return distance - radius < 0.5 * SHARING_DISTANCE * scene.mesh.spacing * (1.0 + 1e-9)


def _line(scene: "Scene", name: str) -> tuple[Segment, float]:
    """Return the segment that a node set follows, and the radius around it (zero except for holes)."""
    edges = edge_segments(scene.geometry.width, scene.geometry.height)
    if name in edges:
        return edges[name], 0.0
    for hole in scene.geometry.holes:
        if hole.name == name:
            return (hole.centre, hole.centre), hole.radius
    crack = next(crack for crack in scene.geometry.cracks if crack.name == name)
    return (crack.start, crack.end), 0.0


def _segment_distance(one: Segment, two: Segment) -> float:
    """Return the smallest distance between two segments (m)."""

    def turn(a: Any, b: Any, c: Any) -> float:
        return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))

    def to_segment(point: Any, segment: Segment) -> float:
        (ax, ay), (bx, by) = segment
        square = (bx - ax) ** 2 + (by - ay) ** 2
        along = 0.0 if square == 0.0 else ((point[0] - ax) * (bx - ax) + (point[1] - ay) * (by - ay)) / square
        along = min(max(along, 0.0), 1.0)
        return math.dist(point, (ax + along * (bx - ax), ay + along * (by - ay)))

    if turn(*one, two[0]) * turn(*one, two[1]) < 0.0 and turn(*two, one[0]) * turn(*two, one[1]) < 0.0:
        return 0.0
    return min(*(to_segment(end, two) for end in one), *(to_segment(end, one) for end in two))
