"""The plan: what a scene switches on, why, and what it will take."""

from __future__ import annotations

import numpy as np

from pdhe.case import Case
from pdhe.errors import SceneError
from pdhe.transport import STEP_SAFETY, DiffusionStep


def make_plan(case: Case) -> str:
    """Describe a case before it runs: physics and reasons, sizes, limits and steps.

    Raises
    ------
    SceneError
        If fixed stepping asks for diffusion steps beyond the explicit limit.
    """
    scene, d = case.scene, case.discretization
    lines = [
        f"scene: {scene.title}",
        f"nodes: {d.volume.size}, spacing {np.median(d.spacing):.6g} m, horizon {case.bonds.horizon:.6g} m, "
        f"bonds: {case.bonds.length.size // 2}, bond memory {_bond_bytes(case) / 1e6:.1f} MB",
        _mechanics(case),
        _damage(case),
        _hydrogen(case),
        f"time: 0 to {scene.time.end:.6g} s, {len(scene.outputs.times)} outputs, stepping: {_stepping(case)}",
    ]
    return "\n".join(lines)


def _bond_bytes(case: Case) -> int:
    arrays = [getattr(case.bonds, name) for name in ("neighbours", "reverse", "length", "nx", "ny", "weight", "cut")]
    if case.body is not None:
        arrays += [case.body.cubed, case.body.intact]
    if case.diffusion is not None:
        arrays.append(case.diffusion.rate)
    if case.rule is not None:
        arrays.append(case.rule.may_fail)
    return sum(a.nbytes for a in arrays)


def _mechanics(case: Case) -> str:
    if case.equilibrium is None:
        return "mechanics: off (the scene has no loads)"
    cut = int(case.bonds.cut.sum()) // 2
    return (
        f"mechanics: on, {case.scene.mechanics.model}, weights {case.scene.mechanics.weights}, "
        f"{cut} bonds cut by pre-cracks, equilibrium by {case.scene.solver.method} to {case.equilibrium.tolerance:g}"
        + (", weights in single precision" if case.body.cubed.dtype == np.float32 else "")
    )


def _damage(case: Case) -> str:
    if case.rule is None:
        return "damage: off (the scene has no damage block): no bond bookkeeping"
    rule = case.rule
    return (
        f"damage: on, criterion {'energy' if rule.by_energy else 'stretch'}, critical stretch {rule.critical:.6g} dry, "
        f"{rule.weakest:.6g} saturated"
    )


def _hydrogen(case: Case) -> str:
    if case.diffusion is None:
        return "hydrogen: off (the scene has no hydrogen block): no coverage arrays"
    limit = case.diffusion.stable_step(np.zeros(case.discretization.volume.size, bool))
    stepping = case.scene.stepping
    if stepping.mode == "fixed":
        step = case.scene.time.end / (stepping.load_steps * stepping.diffusion_substeps)
        if step > limit > 0.0:
            least = int(np.ceil(case.scene.time.end / (stepping.load_steps * limit)))
            raise SceneError(
                "scene", "stepping.diffusion_substeps", stepping.diffusion_substeps,
                f"gives diffusion steps of {step:.4g} s, beyond the explicit limit of {limit:.4g} s",
                f"use at least {least}",
            )  # fmt: skip
    else:
        step = STEP_SAFETY * limit
    count = DiffusionStep.sweeps * case.scene.time.end / step if np.isfinite(step) and step > 0.0 else 0
    return f"hydrogen: on, explicit steps of at most {step:.4g} s (limit {limit:.4g} s), at least {count:.0f} sweeps"


def _stepping(case: Case) -> str:
    stepping = case.scene.stepping
    if stepping.mode == "fixed":
        return f"fixed, {stepping.load_steps} load steps with {stepping.diffusion_substeps} diffusion sub-steps"
    if case.rule is None:
        return "to the next output or load corner; nothing can break"
    return f"to the next failure, output or load corner; failures within {stepping.grouping:g} of the worst together"
