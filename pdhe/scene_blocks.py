"""The blocks of a scene, each valid by itself; :mod:`pdhe.scene_checks` looks at them together."""

import difflib
import math
from collections.abc import Callable
from itertools import combinations, pairwise
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from pdhe import scene_fields as fields
from pdhe import scene_places as places
from pdhe.scene_fields import Block, choice, problem
from pdhe.scene_history import (
    CoverageHistory,
    DisplacementHistory,
    TractionHistory,
    VelocityHistory,
)
from pdhe.scene_umat import Umat
from pdhe.units import round15

MAX_OUTPUTS = 10_000
"""Most output times of one run."""
EMBRITTLEMENT_LAWS = ("serebrinsky", "linear iron", "linear nickel", "linear aluminium")
"""Names of the laws by which hydrogen lowers the fracture resistance."""
MODELS = ("condensed rotation", "thesis spring", "one-parameter", "state-based", "correspondence")
"""Names of the elastic models."""
SOLID_CELLS = ("hexahedron", "tetrahedron")
#: Cells in a regular grid, as long as there are no holes.
LATTICES = ("quadrilateral", "hexahedron")
"""Cells that fill space."""
FIDELITIES = ("draft", "standard", "fine", "reference")
"""Names of the sets of settings that a scene may leave to the program, from cheap to accurate."""


EDGES = ("left", "right", "bottom", "top")
"""Names of the edges of the plate."""
Mirror = Annotated[str, choice(*EDGES)]
"""An edge that is a mirror line."""


class Plate(Block):
    """The rectangular plate; its lower-left corner is the origin."""

    width: fields.PositiveLength
    height: fields.PositiveLength
    thickness: fields.PositiveLength


class Hole(Block):
    """A circular hole, and the name of the node set around it."""

    name: fields.Name
    centre: fields.Point
    radius: fields.PositiveLength


class Disc(Block):
    """A penny-shaped crack in space."""

    centre: fields.Place
    normal: fields.Direction
    radius: fields.PositiveLength


class Crack(Block):
    """A straight crack from start to end, and the name of the node set along its lips.

    In space it goes through the thickness, or it is a disc or a plane polygon.
    """

    name: fields.Name
    start: fields.Point | None = Field(default=None, alias="from")
    end: fields.Point | None = Field(default=None, alias="to")
    disc: Disc | None = None
    polygon: Annotated[tuple[fields.Place, ...], BeforeValidator(fields.as_list)] | None = None

    @model_validator(mode="after")
    def _one_shape(self) -> "Crack":
        given = [key for key in ("disc", "polygon") if getattr(self, key) is not None]
        if len(given) == 2 or (given and (self.start is not None or self.end is not None)):
            raise problem("is given in two ways", "give `from` and `to`, or `disc`, or `polygon`", given[-1])
        for key, value in (("from", self.start), ("to", self.end)):
            if not given and value is None:
                raise problem("is missing", f"give `{key}`; keys here: `name`, `from`, `to`, `disc`, `polygon`", key)
        return self

    @property
    def length(self) -> float:
        """From end to end, diameter of a disc, largest distance of two corners of a polygon (m)."""
        if self.disc is not None:
            return 2.0 * self.disc.radius
        return max(math.dist(a, b) for a, b in combinations(self.polygon or (self.start, self.end), 2))


class Geometry(Block):
    """The plate with its holes and cracks.

    ``symmetry`` names edges that are mirror lines: the plate is then a half or a quarter of the body.
    """

    plate: Plate
    symmetry: Annotated[tuple[Mirror, ...], BeforeValidator(fields.as_list)] | None = None
    holes: Annotated[tuple[Hole, ...], BeforeValidator(fields.as_list)] = ()
    cracks: Annotated[tuple[Crack, ...], BeforeValidator(fields.as_list)] = ()

    @field_validator("symmetry", mode="after")
    @classmethod
    def _mirrors_in_order(cls, symmetry: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if symmetry is not None and not symmetry:
            raise problem("is an empty list", "name an edge that is a mirror line, or leave `symmetry` out")
        for k, edge in enumerate(symmetry or ()):
            if edge in symmetry[:k]:
                raise problem(f"names `{edge}` twice", "keep one of them")
        for pair in (("left", "right"), ("bottom", "top")):
            if set(pair) <= set(symmetry or ()):
                text = f"names `{pair[0]}` and `{pair[1]}`: between two mirrors the body would repeat itself for ever"
                raise problem(text, "keep one of them")
        return symmetry and tuple(edge for edge in EDGES if edge in symmetry)

    @property
    def width(self) -> float:
        """Plate width, along x (m)."""
        return self.plate.width

    @property
    def height(self) -> float:
        """Plate height, along y (m)."""
        return self.plate.height

    @property
    def thickness(self) -> float:
        """Plate thickness (m)."""
        return self.plate.thickness


class Region(Block):
    """A box with sides along the axes between two corners, or a disc, and the name of the node set inside it."""

    name: fields.Name
    start: fields.Point | None = Field(default=None, alias="from")
    end: fields.Point | None = Field(default=None, alias="to")
    centre: fields.Point | None = None
    radius: fields.PositiveLength | None = None

    @model_validator(mode="after")
    def _one_shape(self) -> "Region":
        given = tuple(value is not None for value in (self.start, self.end, self.centre, self.radius))
        if given not in ((True, True, False, False), (False, False, True, True)):
            raise problem("needs either `from` and `to` or `centre` and `radius`", "a box has corners, a disc a radius")
        return self

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Least x, least y, largest x, largest y (m), of a disc those of the box around it."""
        if self.centre is not None:
            (x, y), radius = self.centre, self.radius
            return x - radius, y - radius, x + radius, y + radius
        (x0, y0), (x1, y1) = self.start, self.end
        return min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)


class Refinement(Block):
    """Where the mesh is finer: spacing (m) within a distance (m) of a hole, a crack or a line."""

    around: fields.Name | None = None
    start: fields.Point | None = Field(default=None, alias="from")
    end: fields.Point | None = Field(default=None, alias="to")
    spacing: fields.PositiveLength
    within: fields.PositiveLength

    @model_validator(mode="after")
    def _one_place(self) -> "Refinement":
        if (self.around is None) != (self.start is not None and self.end is not None) or (
            (self.start is None) != (self.end is None)
        ):
            raise problem(
                "needs either `around` or both `from` and `to`", "for example `{around: notch, spacing: 1 mm, ...}`"
            )
        return self


class Mesh(Block):
    """Spacing (m) and shape of the cells whose centroids are the nodes, and where they are finer.

    Hexahedra and tetrahedra resolve the thickness too: the scene is then one in space.
    ``growth`` is by how much the spacing may grow per length away from what is refined.
    """

    spacing: fields.PositiveLength
    cells: Annotated[str, choice("quadrilateral", "triangle", *SOLID_CELLS)] = "quadrilateral"
    refine: Annotated[tuple[Refinement, ...], BeforeValidator(fields.as_list)] | None = None
    growth: fields.Growth | None = None

    @model_validator(mode="after")
    def _graded(self) -> "Mesh":
        if self.growth is not None and not self.refine:
            raise problem("has nothing to grow away from", "add `refine`, or leave `growth` out", "growth")
        if self.refine is not None and not self.refine:
            raise problem("is an empty list", "add a refinement, or leave `refine` out", "refine")
        if self.refine and self.cells != "triangle":
            raise problem("needs triangles", "add `cells: triangle`: a lattice has one spacing", "refine")
        for k, item in enumerate(self.refine or ()):
            if item.spacing > self.spacing:
                text = f"is coarser than the rest of the plate, {1e3 * self.spacing:g} mm"
                raise problem(text, "`mesh.spacing` is the coarsest spacing", f"refine.{k}.spacing")
        return self

    @property
    def solid(self) -> bool:
        """Whether the cells fill space, not just the plane of the plate."""
        return self.cells in SOLID_CELLS

    @property
    def growth_rate(self) -> float:
        """Growth of the spacing per length, as given or 0.15."""
        return 0.15 if self.growth is None else self.growth

    @property
    def finest(self) -> float:
        """The smallest spacing anywhere (m)."""
        return min([self.spacing, *(item.spacing for item in self.refine or ())])


class Horizon(Block):
    """The horizon, as a multiple of the spacing or as a length (m)."""

    ratio: fields.HorizonRatio | None = None
    length: fields.PositiveLength | None = None

    @model_validator(mode="after")
    def _one_of_two(self) -> "Horizon":
        if (self.ratio is None) == (self.length is None):
            raise problem("needs either `ratio` or `length`, not both and not neither", "for example `{ratio: 3.015}`")
        return self


class Orthotropic(Block):
    """What an orthotropic material has beyond Young's modulus along its axis 1 and Poisson's ratio 12.

    Poisson's ratio 12 is the contraction along 2 under tension along 1. What belongs to axis 3, across a plate, is for
    plane strain and for bodies in space, which need its shear moduli too.
    """

    youngs_modulus_2: fields.Stiffness
    shear_modulus_12: fields.Stiffness
    youngs_modulus_3: fields.Stiffness | None = None
    poissons_ratio_13: fields.CrossRatio | None = None
    poissons_ratio_23: fields.CrossRatio | None = None
    shear_modulus_13: fields.Stiffness | None = None
    shear_modulus_23: fields.Stiffness | None = None


class Material(Block):
    """Material data; `source` says where each value comes from.

    With ``orthotropic``, Young's modulus and Poisson's ratio are those of the axes 1 and 12. With ``umat``, stresses
    are those of a compiled routine, and both only resist what no deformation gradient sees.
    """

    name: fields.Text = "unnamed"
    youngs_modulus: fields.Stiffness
    poissons_ratio: fields.PoissonsRatio
    critical_energy_release_rate: fields.EnergyReleaseRate | None = None
    fracture_toughness: fields.Toughness | None = None
    density: fields.Density | None = None
    diffusivity: fields.Diffusivity | None = None
    saturation_concentration: fields.SaturationConcentration | None = None
    orthotropic: Orthotropic | None = None
    umat: Umat | None = None
    source: dict[str, fields.Text] = Field(default_factory=dict)

    @field_validator("source", mode="after")
    @classmethod
    def _known_sources(cls, source: dict[str, str]) -> dict[str, str]:
        for key in source:
            if key not in cls.model_fields:
                near = difflib.get_close_matches(key, cls.model_fields, 1, 0.5)
                raise problem("is not a key of a material", f"did you mean `{near[0]}`?" if near else "", key[:60])
        return source

    def toughness(self, plane: str | None) -> float | None:
        """Critical energy release rate G_c (J/m^2): as given, or that of K_IC; None if neither is given."""
        if self.critical_energy_release_rate is not None:
            return self.critical_energy_release_rate
        return None if self.fracture_toughness is None else round15(self.implied_toughness(plane))

    def implied_toughness(self, plane: str | None) -> float:
        """Energy release rate at K_IC (J/m^2): K^2/E in plane stress, (1-nu^2) K^2/E in plane strain (Irwin).

        In space (None) it is that of plane strain, which is the state along a crack's front inside a body.
        """
        rate = self.fracture_toughness**2 / self.youngs_modulus
        return rate if plane == "stress" else rate * (1.0 - self.poissons_ratio**2)


class Axes(Block):
    """Direction of the material axis 1 on a node set: an angle (rad) from x, or from the direction away from a point.

    In space these turn about z; or ``axis_1`` is the direction itself, and ``axis_2`` one towards axis 2, which is made
    perpendicular. Angles may be formulas of the place. Later entries of a list go before earlier ones.
    """

    on: fields.NodeSet = "all"
    angle: places.Angle | None = None
    around: fields.Point | None = None
    axis_1: fields.Direction | None = None
    axis_2: fields.Direction | None = None

    @model_validator(mode="after")
    def _one_way(self) -> "Axes":
        given = tuple(value is not None for value in (self.angle, self.axis_1, self.axis_2))
        if given not in ((True, False, False), (False, True, True)) or (self.around is not None and not given[0]):
            hint = "for example `angle: 30 deg`, or in space `{axis_1: [1, 0, 1], axis_2: [0, 1, 0]}`"
            raise problem("needs either `angle` or both `axis_1` and `axis_2`", hint)
        if self.axis_1 is not None:
            (a, b, c), (p, q, r) = self.axis_1, self.axis_2
            across = math.hypot(b * r - c * q, c * p - a * r, a * q - b * p)
            if across < 1e-6 * math.hypot(a, b, c) * math.hypot(p, q, r):
                raise problem("has the direction of `axis_1`", "give another one, for example across it", "axis_2")
        return self


class StiffnessOn(Block):
    """A Young's modulus on a node set, other than that of the material: as such (Pa), or as a factor to it."""

    on: fields.NodeSet
    youngs_modulus: places.Stiffness | None = None
    factor: places.Factor | None = None

    @model_validator(mode="after")
    def _one_value(self) -> "StiffnessOn":
        if (self.youngs_modulus is None) == (self.factor is None):
            raise problem("needs either `youngs_modulus` or `factor`", "for example `factor: 0.1`")
        return self

    def over(self, elsewhere: float, place: Any) -> Any:
        """Young's modulus over that of the material, given the latter (Pa), at points (k, 2), m: one or (k,)."""
        given = self.youngs_modulus
        return places.at(self.factor, place) if given is None else places.at(given, place) / elsewhere


class Mechanics(Block):
    """The elastic model, its weights and the treatment of cells that the horizon cuts.

    ``plane`` says what vanishes across the plate: stress or strain. With ``strain: finite``, for the model
    ``correspondence``, strains and rotations may be large. ``zero_energy`` and its strength are for the model
    ``correspondence``: what resists displacements that its gradient does not see. ``axes`` are those of an orthotropic
    material. ``regions`` have Young's moduli of their own; later entries go before earlier ones.
    """

    model: Annotated[str, choice(*MODELS)] = "condensed rotation"
    plane: Annotated[str, choice("stress", "strain")] = "stress"
    strain: Annotated[str, choice("small", "finite")] = "small"
    zero_energy: Annotated[str, choice("wan", "silling")] = "wan"
    zero_energy_strength: fields.Strength = 1.0
    axes: Annotated[tuple[Axes, ...], BeforeValidator(fields.as_list)] | None = None
    weights: Annotated[str, choice("moment matched", "volume", "energy", "none")] = "moment matched"
    partial_volume: Annotated[str, choice("auto", "full", "ramp", "thesis")] = "auto"
    regions: Annotated[tuple[StiffnessOn, ...], BeforeValidator(fields.as_list)] | None = None


class Displacement(Block):
    """Prescribed displacement components (m) in time."""

    x: DisplacementHistory | None = None
    y: DisplacementHistory | None = None
    z: DisplacementHistory | None = None


class Velocity(Block):
    """Prescribed velocity components (m/s) in time."""

    x: VelocityHistory | None = None
    y: VelocityHistory | None = None
    z: VelocityHistory | None = None


class Traction(Block):
    """Components of a force per area (Pa) in time."""

    x: TractionHistory | None = None
    y: TractionHistory | None = None
    z: TractionHistory | None = None


class InitialVelocity(Block):
    """Velocity components (m/s) at time zero."""

    x: fields.Velocity | None = None
    y: fields.Velocity | None = None
    z: fields.Velocity | None = None


class Load(Block):
    """What moves or pulls a node set: one of displacement, velocity, traction and initial velocity.

    Prescribed motion belongs to the geometric edge or to the nodes themselves; only displacements can be prescribed
    without dynamics.
    """

    kinds: ClassVar[tuple[str, ...]] = ("displacement", "velocity", "traction", "initial_velocity")

    on: fields.NodeSet
    displacement: Displacement | None = None
    velocity: Velocity | None = None
    traction: Traction | None = None
    initial_velocity: InitialVelocity | None = None
    at: Annotated[str, choice("edge", "nodes")] = "edge"

    @model_validator(mode="after")
    def _one_kind(self) -> "Load":
        given = [kind for kind in self.kinds if getattr(self, kind) is not None]
        if len(given) != 1:
            text = f"gives {' and '.join(f'`{kind}`' for kind in given)}" if given else "is missing"
            hint = "give one of `displacement`, `velocity`, `traction`, `initial_velocity`; another entry for another"
            raise problem(text, hint, given[-1] if given else "displacement")
        return self

    @property
    def kind(self) -> str:
        """Which of the four it is."""
        return next(kind for kind in self.kinds if getattr(self, kind) is not None)

    @property
    def components(self) -> dict[int, Any]:
        """What is given along x (0), y (1) and z (2)."""
        given = getattr(self, self.kind)
        return {axis: value for axis, value in enumerate((given.x, given.y, given.z)) if value is not None}

    @property
    def motion(self) -> dict[int, tuple[Callable[[float], float], tuple[float, ...]]]:
        """Prescribed displacement (m) as a function of time (s), and its corners, along x (0), y (1) and z (2)."""
        if self.kind == "displacement":
            return {axis: (history, history.corners) for axis, history in self.components.items()}
        if self.kind == "velocity":
            return {axis: (history.integral, history.corners) for axis, history in self.components.items()}
        return {}


class OwnToughness(Block):
    """A fracture energy other than that of the material: as such (J/m^2), or as a factor to that of the material."""

    critical_energy_release_rate: fields.EnergyReleaseRate | None = None
    factor: fields.Factor | None = None

    @model_validator(mode="after")
    def _one_value(self) -> "OwnToughness":
        if (self.critical_energy_release_rate is None) == (self.factor is None):
            raise problem("needs either `critical_energy_release_rate` or `factor`", "for example `factor: 0.25`")
        return self

    def over(self, toughness: float, place: Any = None) -> Any:
        """Fracture energy over that of the material, given the latter (J/m^2), at points (k, 2), m: one or (k,)."""
        given = self.critical_energy_release_rate
        return places.at(self.factor, place) if given is None else places.at(given, place) / toughness


class ToughnessOn(OwnToughness):
    """Fracture energy on a node set."""

    on: fields.NodeSet
    critical_energy_release_rate: places.EnergyReleaseRate | None = None
    factor: places.Factor | None = None


class Interface(OwnToughness):
    """Fracture energy of the bonds from one node set to another; `all` is what is outside the other one."""

    between: fields.NodeSetPair


class Split(Block):
    """Fracture energies of the dilatational and of the deviatoric part of a bond's energy.

    A part that is left out does not count: it breaks no bond by itself.
    """

    dilatational: OwnToughness | None = None
    deviatoric: OwnToughness | None = None

    @model_validator(mode="after")
    def _some_part(self) -> "Split":
        if self.dilatational is None and self.deviatoric is None:
            raise problem("needs `dilatational` or `deviatoric`", "for example `{deviatoric: {factor: 1}}`")
        return self

    def weights(self, toughness: float) -> tuple[float, float]:
        """What either part counts, given the fracture energy of the material (J/m^2)."""
        parts = self.dilatational, self.deviatoric
        return tuple(0.0 if part is None else 1.0 / part.over(toughness) for part in parts)


class Damage(Block):
    """When bonds break, the node sets whose bonds never do, and where they break at other values than elsewhere.

    With ``tension_only`` off, shortened bonds break like stretched ones. ``split`` is for the models ``state-based``
    and ``correspondence``: what either part of a bond's energy counts.
    """

    criterion: Annotated[str, choice("energy", "stretch", "energy density")] = "energy"
    tension_only: fields.Switch = True
    split: Split | None = None
    calibration: Annotated[str, choice("discrete", "continuum")] = "discrete"
    no_fail: Annotated[tuple[fields.NodeSet, ...], BeforeValidator(fields.as_list)] = ()
    regions: Annotated[tuple[ToughnessOn, ...], BeforeValidator(fields.as_list)] | None = None
    interfaces: Annotated[tuple[Interface, ...], BeforeValidator(fields.as_list)] | None = None


class CoverageCondition(Block):
    """Hydrogen coverage prescribed on a node set."""

    on: fields.NodeSet
    coverage: CoverageHistory


class Saturation(Block):
    """Nodes with more than this damage are held at this coverage: fresh crack faces meet the environment."""

    damage: fields.Fraction = 0.36
    coverage: fields.Fraction = 1.0


def _read_saturation(value: Any) -> Any:
    return None if value is None or value is False or value == "off" else value


class DiffusivityOn(Block):
    """A diffusivity on a node set, other than that of the material: as such (m^2/s), or as a factor to it."""

    on: fields.NodeSet
    diffusivity: places.Diffusivity | None = None
    factor: places.Factor | None = None

    @model_validator(mode="after")
    def _one_value(self) -> "DiffusivityOn":
        if (self.diffusivity is None) == (self.factor is None):
            raise problem("needs either `diffusivity` or `factor`", "for example `factor: 0.01`")
        return self

    def over(self, elsewhere: float, place: Any) -> Any:
        """Diffusivity over that of the material, given the latter (m^2/s), at points (k, 2), m: one or (k,)."""
        given = self.diffusivity
        return places.at(self.factor, place) if given is None else places.at(given, place) / elsewhere


class Hydrogen(Block):
    """Diffusion of hydrogen coverage (0 to 1) and how it embrittles."""

    null_means_off: ClassVar[frozenset[str]] = frozenset({"saturation"})

    kernel: Annotated[str, choice("inverse square", "inverse", "constant")] = "inverse square"
    initial: fields.Fraction = 0.0
    boundary: Annotated[tuple[CoverageCondition, ...], BeforeValidator(fields.as_list)] = ()
    law: Annotated[str, choice(*EMBRITTLEMENT_LAWS)] = "serebrinsky"
    degradation: Annotated[str, choice("stretch", "energy")] = "stretch"
    saturation: Annotated[Saturation | None, BeforeValidator(_read_saturation)] = Saturation()
    regions: Annotated[tuple[DiffusivityOn, ...], BeforeValidator(fields.as_list)] | None = None


class Time(Block):
    """The end of the simulation (s); it starts at zero."""

    end: fields.Time


class Stepping(Block):
    """How time advances: from one bond failure to the next, in fixed steps, or with inertia.

    With inertia (`dynamic`): the length of a step (s), or the share `safety` of the stable one; `damping` (1/s) times
    mass and velocity is a force against the motion.
    """

    mode: Annotated[str, choice("events", "fixed", "dynamic")] = "events"
    grouping: fields.Grouping | None = Field(default=None, validate_default=True)
    load_steps: fields.Count | None = Field(default=None, validate_default=True)
    diffusion_substeps: fields.Count | None = Field(default=None, validate_default=True)
    step: fields.PositiveTime | None = Field(default=None, validate_default=True)
    safety: fields.Safety | None = Field(default=None, validate_default=True)
    damping: fields.Rate | None = Field(default=None, validate_default=True)

    @field_validator("step", "safety", "damping", mode="after")
    @classmethod
    def _dynamic(cls, value: float | None, info: ValidationInfo) -> float | None:
        if info.data.get("mode", "dynamic") != "dynamic":
            if value is not None:
                raise problem("belongs to mode `dynamic`", "write `mode: dynamic`, or leave this key out")
            return None
        if info.field_name == "safety" and info.data.get("step") is not None:
            if value is not None:
                raise problem("is given as well as `step`", "give one of them")
            return None
        return value if value is not None else {"step": None, "safety": 0.8, "damping": 0.0}[info.field_name]

    @field_validator("grouping", "load_steps", "diffusion_substeps", mode="after")
    @classmethod
    def _fits_mode(cls, value: float | None, info: ValidationInfo) -> float | None:
        owner = "events" if info.field_name == "grouping" else "fixed"
        chosen = info.data.get("mode", owner)
        if value is not None and chosen != owner:
            raise problem(f"belongs to mode `{owner}`", f"write `mode: {owner}`, or leave this key out")
        if value is None and chosen == owner:
            if owner == "fixed":
                raise problem("is missing", "mode `fixed` needs `load_steps` and `diffusion_substeps`")
            return 0.01
        return value


class Solver(Block):
    """How an equilibrium is found: relative residual at which it counts as found, and most iterations.

    In a scene that gives no ``tolerance`` it is :func:`pdhe.fidelity.usual_tolerance`. ``precision`` is that in which
    bond weights and diffusion rates are stored; sums are double in any case.
    """

    removed: ClassVar[dict[str, str]] = {
        "method": "leave it out: conjugate gradients find the same equilibria in 14 to 110 times fewer force sweeps"
    }

    tolerance: fields.Tolerance | None = None
    max_iterations: fields.Count = 5000
    precision: Annotated[str, choice("double", "single")] = "double"


class Outputs(Block):
    """Output times (s): requested as `every`, `count` or `times`, and `times` alone once resolved.

    Without `error_estimate` a result does not tell its own error, and the scene is not run on a coarser mesh for it.
    """

    every: fields.PositiveTime | None = None
    count: fields.SmallCount | None = None
    times: Annotated[tuple[fields.Time, ...], BeforeValidator(fields.as_list)] | None = None
    error_estimate: bool = True

    def at(self, end: float) -> tuple[float, ...]:
        """Return the sorted output times for a run that ends at ``end`` (s), with 0 and ``end``."""
        given = [key for key in ("every", "count", "times") if getattr(self, key) is not None]
        if len(given) > 1:
            raise problem(f"gives {' and '.join(f'`{key}`' for key in given)}", "give one of `every`, `count`, `times`")
        if self.times is not None:
            for earlier, later in pairwise(self.times):
                if later <= earlier:
                    text = f"are not increasing, {later:g} s after {earlier:g} s"
                    raise problem(text, "write each time once, in increasing order", "times")
            if self.times and self.times[-1] > end:
                text = f"go beyond the end at {end:g} s ({self.times[-1]:g} s)"
                raise problem(text, "leave the later ones out, or raise `time.end`", "times")
            if len(self.times) > MAX_OUTPUTS:
                raise problem(f"are {len(self.times)}, more than {MAX_OUTPUTS}", "give fewer", "times")
            wanted = list(self.times)
        elif self.every is not None:
            intervals = end / self.every
            if intervals > MAX_OUTPUTS:
                text = f"gives {intervals:.3g} outputs, more than {MAX_OUTPUTS}"
                raise problem(text, f"use at least {end / MAX_OUTPUTS:.3g} s", "every")
            whole = int(intervals * (1.0 + 1e-9))
            wanted = [min(round15(self.every * k), end) for k in range(whole + 1)]
            if wanted and end > 0.0 and abs(wanted[-1] - end) <= 1e-9 * end:
                wanted[-1] = end
        else:
            count = self.count or 40
            wanted = [min(round15(end * k / count), end) for k in range(count)]
        return tuple(sorted({0.0, *wanted, end}))
