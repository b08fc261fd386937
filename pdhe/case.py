"""A case: scene and discretisation made ready to run, holding only what the scene's physics needs."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from pdhe.blocks import axis_angles, axis_frames, node_values, stiffness_ratios, toughness_ratios
from pdhe.bonds import Bonds, Families, Grading, build_bonds
from pdhe.boundary import OPPOSITE, UPPER, DisplacementConditions, Prescribed
from pdhe.damage import (
    CRITERIA,
    FailureRule,
    critical_stretch,
    crossing_sum,
    stretch_factors,
    stretch_squares,
    together_at,
)
from pdhe.discretization import Discretization
from pdhe.dynamics import Traction, Verlet
from pdhe.embrittlement import LAWS, resistance
from pdhe.errors import SceneError
from pdhe.histories import make_increments, make_user_body
from pdhe.increments import Increments
from pdhe.materials import MODELS, Body, BondLoad, FiniteStrain, Model, make_body
from pdhe.materials.constants import Orthotropic
from pdhe.materials.user import SolidUserBody, UserBody
from pdhe.mirrors import EDGE_AXIS, Symmetry
from pdhe.newton import NewtonEquilibrium
from pdhe.scene import Scene
from pdhe.scene_mirrors import edge_segments, mirrors_through, region_diagonal
from pdhe.segments import distance_to_segment
from pdhe.sizing import SizeField
from pdhe.solid_bonds import build_solid_bonds
from pdhe.solid_nodes import ROUND_OFF, facet_areas
from pdhe.solvers import Equilibrium
from pdhe.stability import NEGATIVE, least_eigenvalue
from pdhe.surfaces import surface_of
from pdhe.transport import Diffusion, Edge, build_diffusion

#: Storage of bond weights and rates by the name that scenes use.
PRECISIONS = {"double": np.float64, "single": np.float32}
#: Poisson's ratio up to which the stiffness of two-parameter bonds is positive at a horizon of 3 spacings and more.
SAFE_POISSON = {"stress": 0.45, "strain": 0.32, None: 0.3}
#: Least tolerance of equilibria over the ratio of moduli: at 1e6, bars of 20 to 80 cells reach 1e-5; plies whose axes
#: differ 1000 times have reached 1.4e-10.
FINEST_TOLERANCE = 1e-11
EDGES = ("left", "right", "bottom", "top")


@dataclass(frozen=True)
class Case:
    """Everything a run needs. Parts of absent physics are None and hold no memory.

    Attributes
    ----------
    bonds
        Without loads only what an exchange of hydrogen needs to know of them.
    equilibrium, conditions
        Mechanics and its prescribed displacements; None without ``loads``. With a user material it goes by increments.
    rule
        When bonds break; None without ``damage``.
    diffusion
        Hydrogen exchange rates; None without ``hydrogen``.
    dynamics
        Motion with inertia, in place of ``equilibrium``; None unless ``stepping`` asks for it.
    """

    scene: Scene
    discretization: Discretization
    bonds: Bonds | Families
    equilibrium: Equilibrium | Increments | NewtonEquilibrium | None
    conditions: DisplacementConditions | None
    rule: FailureRule | None
    diffusion: Diffusion | None
    dynamics: Verlet | None = None

    @property
    def copies(self) -> int:
        """How many times the nodes make up the whole body; 1 without mirror lines."""
        return 2 ** len(self.scene.geometry.symmetry or ())

    def from_cracks(self, points: np.ndarray) -> np.ndarray:
        """Distance of points (k, dim) from the nearest pre-crack, m (k,)."""
        cracks, thickness = self.scene.geometry.cracks, self.discretization.thickness
        if self.discretization.dimension == 3:
            return np.min([surface_of(crack, thickness).distance(points) for crack in cracks], axis=0)
        return np.min([distance_to_segment(points, crack.start, crack.end) for crack in cracks], axis=0)

    @property
    def linear(self) -> bool:
        """Whether displacements are proportional to what is prescribed, as long as nothing breaks."""
        return not isinstance(self.equilibrium, NewtonEquilibrium | Increments)

    @property
    def body(self) -> Body | None:
        """Bonds with their present breakage."""
        mechanics = self.equilibrium or self.dynamics
        return None if mechanics is None else mechanics.body

    @property
    def history(self) -> UserBody | SolidUserBody | None:
        """The body, where its forces depend on how it came to its displacements; None for all others."""
        return self.body if isinstance(self.body, UserBody | SolidUserBody) else None


def partial_volume_rule(scene: Scene, discretization: Discretization) -> str:
    """Resolve ``auto``: whole cells on a regular lattice, where the moment match absorbs the rest; a ramp otherwise."""
    chosen = scene.mechanics.partial_volume
    return chosen if chosen != "auto" else ("full" if discretization.regular else "ramp")


def build_case(scene: Scene, discretization: Discretization) -> Case:
    """Assemble the parts that the scene asks for.

    Raises
    ------
    SceneError
        If a node set that the scene names has no nodes, no bond is left to carry anything, no bond may break although
        there is a block ``damage``, or the stiffness is indefinite.
    """
    d = _with_regions(scene, discretization)
    _require_node_sets(scene, d)
    partial = partial_volume_rule(scene, d)
    model = _model(scene, d)
    symmetry = Symmetry.of(scene.geometry)
    if symmetry is not None and scene.loads is not None and not model.body.sees_images:
        raise SceneError(
            "scene", "geometry.symmetry", list(scene.geometry.symmetry), f"is not there for `{scene.mechanics.model}`",
            "describe the whole body, or use `mechanics: {model: condensed rotation}`",
        )  # fmt: skip
    bonds = _solid_bonds(scene, d, partial) if d.dimension == 3 else build_bonds(
        d.coordinates, d.volume, d.spacing, d.thickness, scene.horizon_length, partial=partial,
        surface=scene.mechanics.weights if scene.loads is not None else "none",
        tangential_ratio=model.tangential_ratio,
        cracks=[(crack.start, crack.end) for crack in scene.geometry.cracks],
        grading=_grading(scene, d),
        # Diffusion takes the images of insulated edges into its rates, which mirror lines are to it.
        symmetry=symmetry if scene.loads is not None else None,
    )  # fmt: skip
    if bonds.length.size == 0:
        raise SceneError("scene", "horizon", scene.horizon_length, "no two nodes lie within the horizon", "raise it")
    equilibrium = conditions = rule = diffusion = dynamics = None
    if scene.loads is not None:
        conditions = DisplacementConditions(
            [
                Prescribed(load.on, component, value, corners, load.at)
                for load in scene.loads
                for component, (value, corners) in load.motion.items()
            ],
            d.node_sets,
            d.coordinates,
            (scene.geometry.width, scene.geometry.height, scene.geometry.thickness),
            scene.geometry.symmetry or (),
            _reaction_factors(scene, symmetry),
        )
        relative = None
        if scene.mechanics.regions:
            relative = stiffness_ratios(
                bonds, d.coordinates, d.node_sets, scene.mechanics.regions, scene.material.youngs_modulus
            )
            _require_reachable(scene, float(relative.max() / relative.min()))
        if scene.material.orthotropic is not None:
            ply = scene.material.orthotropic
            moduli = (scene.material.youngs_modulus, ply.youngs_modulus_2, ply.shear_modulus_12)
            _require_reachable(scene, max(moduli) / min(moduli))
        if scene.material.umat is not None:
            body = make_user_body(scene, bonds, model, d.coordinates, d.volume)
        else:
            body = make_body(bonds, model, d.coordinates, d.volume, PRECISIONS[scene.solver.precision], relative)
        _require_support(scene, body)
        if body.can_be_indefinite:
            _require_positive_stiffness(scene, body, ~conditions.fixed)
        if scene.stepping.mode == "dynamic":
            dynamics = _dynamics(scene, d, body, conditions)
        elif isinstance(body, UserBody | SolidUserBody):
            equilibrium = make_increments(scene, d, body, conditions.fixed)
        elif isinstance(body, FiniteStrain):
            settings = scene.solver
            equilibrium = NewtonEquilibrium(
                body, conditions.fixed, d.spacing, settings.tolerance, settings.max_iterations
            )
        else:
            equilibrium = Equilibrium(
                body, conditions.fixed, d.coordinates, d.spacing, scene.solver.tolerance, scene.solver.max_iterations
            )
        if scene.damage is not None:
            rule = _failure_rule(scene, d, bonds, model, relative)
    if scene.hydrogen is not None:
        exchange = bonds.within() if scene.loads is not None else bonds.alone()
        diffusion = _diffusion(scene, d, exchange, partial)
        bonds = exchange if scene.loads is None else bonds
    return Case(scene, d, bonds, equilibrium, conditions, rule, diffusion, dynamics)


def _reaction_factors(scene: Scene, symmetry: Symmetry | None) -> dict[tuple[str, int], float]:
    """By what to multiply the force on a set of a part: the whole set goes on beyond the mirror lines that it meets.

    Across a mirror line the forces on either side cancel, along it they add.
    """
    factors: dict[tuple[str, int], float] = {}
    if symmetry is None:
        return factors
    lines = edge_segments(scene.geometry.width, scene.geometry.height)
    lines |= {crack.name: (crack.start, crack.end) for crack in scene.geometry.cracks}
    lines |= {region.name: region_diagonal(scene.geometry, region) for region in scene.regions or ()}
    holes = {hole.name: mirrors_through(scene.geometry, hole) for hole in scene.geometry.holes}
    for name in {load.on for load in scene.loads or ()}:
        if name == "all":
            met = list(symmetry.axes)
        elif name in lines:
            met = symmetry.touched(lines[name])
        else:
            met = [EDGE_AXIS[edge][0] for edge in holes[name]]
        for component in (0, 1):
            factors[name, component] = float(np.prod([0.0 if axis == component else 2.0 for axis in met]))
    return factors


def _model(scene: Scene, d: Discretization) -> Model:
    """The elastic model, with those settings of the block ``mechanics`` that it knows."""
    kind, material, mechanics = MODELS[scene.mechanics.model], scene.material, scene.mechanics
    options = {field.name: getattr(mechanics, field.name) for field in fields(kind) if hasattr(mechanics, field.name)}
    options["plane"] = scene.plane
    if scene.loads is not None and material.orthotropic is not None:
        more = material.orthotropic.model_dump()
        options["orthotropic"] = Orthotropic(material.youngs_modulus, poissons_ratio_12=material.poissons_ratio, **more)
        axes = d.coordinates, d.node_sets, mechanics.axes or ()
        options |= {"angle": axis_angles(*axes)} if scene.plane else {"frame": axis_frames(*axes)}
    return kind(material.youngs_modulus, material.poissons_ratio, d.thickness, scene.horizon_length, **options)


def _require_support(scene: Scene, body: Body) -> None:
    nodes = body.unsupported()
    if nodes.size:
        place = ", ".join(f"{x:g}" for x in body.coordinates[nodes[0]])
        wanted, lie = ("more than one direction", "a row") if scene.plane else ("all three directions", "a plane")
        raise SceneError(
            "scene", "mechanics.model", scene.mechanics.model,
            f"needs bonds in {wanted}, but those of {nodes.size} nodes lie in {lie}, the first at ({place}) m",
            "use a finer mesh or another model",
        )  # fmt: skip


def _solid_bonds(scene: Scene, d: Discretization, partial: str) -> Bonds:
    return build_solid_bonds(
        d.coordinates, d.volume, d.spacing, scene.horizon_length, partial=partial,
        surface=scene.mechanics.weights if scene.loads is not None else "none",
        cracks=[surface_of(crack, d.thickness) for crack in scene.geometry.cracks],
    )  # fmt: skip


def _require_reachable(scene: Scene, contrast: float) -> None:
    """Refuse a tolerance that round-off of the stiff part's forces keeps the residual of the soft one from."""
    least = FINEST_TOLERANCE * contrast
    if scene.stepping.mode != "dynamic" and scene.solver.tolerance < least * (1.0 - 1e-9):
        raise SceneError(
            "scene", "solver.tolerance", scene.solver.tolerance,
            f"is less than round-off allows where moduli differ {contrast:.4g} times",
            f"give at least {least:.2g}",
        )  # fmt: skip


def _require_positive_stiffness(scene: Scene, body: Body, free: np.ndarray) -> None:
    """Refuse a body that would give energy away as it deforms: with negative tangential springs the mesh decides."""
    lowest = least_eigenvalue(body, free)
    if lowest < NEGATIVE:
        raise SceneError(
            "scene", "material.poissons_ratio", scene.material.poissons_ratio,
            f"makes the stiffness of this body indefinite: its least eigenvalue is {lowest:.2g} of the largest",
            f"{SAFE_POISSON[scene.plane]:g} is safe at a horizon of 3 spacings and more in "
            f"{f'plane {scene.plane}' if scene.plane else 'space'}; other `mechanics.weights` may help above it",
        )  # fmt: skip


def _with_regions(scene: Scene, d: Discretization) -> Discretization:
    """Name the nodes inside the regions of a scene."""
    if not scene.regions:
        return d
    slack = 1e-9 * max(scene.geometry.width, scene.geometry.height)
    sets = dict(d.node_sets)
    for region in scene.regions:
        low, high = np.array(region.box).reshape(2, 2)
        place = d.coordinates[:, :2]  # in space a region goes through the thickness
        inside = ((place >= low - slack) & (place <= high + slack)).all(axis=1)
        if region.centre is not None:
            inside &= np.linalg.norm(place - region.centre, axis=1) <= region.radius + slack
        sets[region.name] = np.flatnonzero(inside).astype(np.int32)
    return replace(d, node_sets=sets)


def _dynamics(scene: Scene, d: Discretization, body: Body, conditions: DisplacementConditions) -> Verlet:
    loads, stepping = scene.loads or (), scene.stepping
    initial, tractions = np.zeros(d.coordinates.shape), []
    for load in loads:
        for component, given in load.components.items():
            if load.kind == "initial_velocity":
                initial[d.node_sets[load.on], component] = given
            elif load.kind == "traction":
                size = (scene.geometry.width, scene.geometry.height, scene.geometry.thickness)
                nodes, area = edge_areas(d, load.on, size)
                tractions.append(Traction(load.on, component, given, given.corners, nodes, area))
    mass, breaks = scene.material.density * d.volume, scene.damage is not None
    motion = Verlet(body, mass, conditions, tractions, initial, stepping.damping, breaks)
    if stepping.step is not None and stepping.step > motion.limit:
        raise SceneError(
            "scene", "stepping.step", stepping.step, f"is beyond the stable step of {motion.limit:.4g} s",
            "leave it out: `safety: 0.8` takes 0.8 of that",
        )  # fmt: skip
    return motion


def edge_areas(d: Discretization, edge: str, size: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Nodes whose cells have a side on an edge of the plate or a face of the body, (k,), and its area, m^2 (k,).

    ``size`` is that of the body, m (3,).
    """
    axis = OPPOSITE[edge][1]
    level = size[axis] if edge in UPPER else 0.0
    if d.dimension == 3:
        return facet_areas(d.vertices, d.cells, axis, level, ROUND_OFF * d.spacing)
    corners = d.vertices[d.cells]
    along, on = corners[:, :, 1 - axis], np.abs(corners[:, :, axis] - level) <= ROUND_OFF * d.spacing[:, None]
    both = on & np.roll(on, -1, axis=1)
    length = np.sum(np.abs(along - np.roll(along, -1, axis=1)) * both, axis=1)
    nodes = np.flatnonzero(length > 0.0)
    return nodes, length[nodes] * d.thickness


def _grading(scene: Scene, d: Discretization) -> Grading | None:
    """The horizon of every node where the mesh is graded: a multiple of the spacing wanted there."""
    if not scene.mesh.refine:
        return None
    size = SizeField(scene.geometry, scene.mesh)
    return Grading(scene.horizon.ratio * size(d.coordinates), size.depth(d.coordinates))


def _require_node_sets(scene: Scene, d: Discretization) -> None:
    wanted = [("loads", load.on) for load in scene.loads or ()]
    if scene.hydrogen is not None:
        wanted += [("hydrogen.boundary", condition.on) for condition in scene.hydrogen.boundary]
        wanted += [("hydrogen.regions", item.on) for item in scene.hydrogen.regions or ()]
    wanted += [("mechanics.axes", item.on) for item in scene.mechanics.axes or ()]
    wanted += [("mechanics.regions", item.on) for item in scene.mechanics.regions or ()]
    if scene.damage is not None:
        wanted += [("damage.no_fail", name) for name in scene.damage.no_fail]
        wanted += [("damage.regions", item.on) for item in scene.damage.regions or ()]
        wanted += [("damage.interfaces", name) for item in scene.damage.interfaces or () for name in item.between]
    for key, name in wanted:
        if d.node_sets.get(name, np.empty(0)).size == 0:
            known = ", ".join(n for n, nodes in d.node_sets.items() if nodes.size)
            raise SceneError("scene", key, name, "node set is empty on this mesh", f"sets with nodes: {known}")


def _failure_rule(
    scene: Scene, d: Discretization, bonds: Bonds, model: Model, relative: np.ndarray | None
) -> FailureRule:
    settings, hydrogen = scene.damage, scene.hydrogen
    owner, far = bonds.owners(), bonds.far()
    may_fail = bonds.once()
    for name in settings.no_fail:
        protected = np.zeros(d.volume.size, bool)
        protected[d.node_sets[name]] = True
        may_fail &= ~(protected[owner] | protected[far])
    if not (may_fail & ~bonds.cut).any():
        raise SceneError(
            "scene", "damage.no_fail", list(settings.no_fail), "protects every bond of this mesh", "leave `damage` out"
        )
    weakened = None
    if hydrogen is not None:
        law, degradation = LAWS[hydrogen.law], hydrogen.degradation

        def weakened(psi: np.ndarray) -> np.ndarray:
            return resistance(law, degradation, psi)

    crossing, toughness = crossing_sum(bonds, d.volume), scene.material.toughness(scene.plane)
    criterion = CRITERIA[settings.criterion]
    spent = crossing_sum(bonds, d.volume, stretch_squares(bonds, criterion)) if criterion.equal_energy else crossing
    critical = critical_stretch(model, spent, toughness, settings.calibration, criterion)
    ratios = None
    if settings.regions or settings.interfaces:
        regions, interfaces = settings.regions or (), settings.interfaces or ()
        ratios = toughness_ratios(bonds, d.coordinates, d.node_sets, regions, interfaces, toughness)
    if relative is not None:
        # A bond takes the same energy whatever its stiffness, and so breaks at another stretch.
        ratios = 1.0 / relative if ratios is None else ratios / relative
    factors = stretch_factors(bonds, ratios, criterion)
    # With inertia nothing is solved for, and a bond breaks when it has reached its resistance.
    together = 0.0 if scene.stepping.mode == "dynamic" else together_at(scene.solver.tolerance)
    split = None if settings.split is None else settings.split.weights(toughness)
    load = BondLoad(criterion.by_energy, settings.tension_only, split)
    return FailureRule(critical, crossing, load, weakened, may_fail, together=together, **factors)


def _diffusion(scene: Scene, d: Discretization, bonds: Families, partial: str) -> Diffusion:
    size = {"left": (0, 0.0), "right": (0, scene.geometry.width), "bottom": (1, 0.0), "top": (1, scene.geometry.height)}
    if d.dimension == 3:
        size |= {"front": (2, 0.0), "back": (2, d.thickness)}
    edges = {name: Edge(axis, position) for name, (axis, position) in size.items()}
    prescribed = {condition.on for condition in scene.hydrogen.boundary} & set(edges)
    relative = None
    if scene.hydrogen.regions:
        given = scene.hydrogen.regions, scene.material.diffusivity
        relative = node_values(d.coordinates, d.node_sets, *given, "hydrogen.regions")
    diffusion = build_diffusion(
        bonds, d.coordinates, d.volume, d.spacing, d.thickness, scene.material.diffusivity, scene.hydrogen.kernel,
        partial, edges, prescribed, relative,
    )  # fmt: skip
    return replace(diffusion, rate=diffusion.rate.astype(PRECISIONS[scene.solver.precision], copy=False))
