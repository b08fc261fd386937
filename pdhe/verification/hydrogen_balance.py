"""Hydrogen balance: the content changes by what came in, whatever happens in the run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pdhe.scene import Scene
from pdhe.simulation import simulate
from pdhe.verification.drawing import COLOURS, label, panels
from pdhe.verification.report import Report, Row
from pdhe.verification.slabs import case_of, plate_scene

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

TEXT = """\
Every node counts what entered through it from outside: through a prescribed edge, by being held at a prescribed
coverage, or by being saturated when the crack laid it bare. The sum of these counts must equal the change of the
content, `sum psi V`, at every recorded instant, since the exchange between two nodes takes from one what it gives to
the other. Runs with wet edges, with coverage that varies in time, with holes and cracks, on triangles, and with a
growing crack whose failures interrupt the diffusion steps are summed here; what remains is round-off."""

#: Largest imbalance over the content that is allowed.
LIMIT = 1e-10
END = 4e5
GROWTH_END = 1.2e7
CRACK = {"name": "notch", "from": [0.0, 0.05], "to": [0.05, 0.05]}
TENT = {"times": [0.0, 1e5, 2e5, END], "values": [0.0, 1.0, 0.2, 0.6]}


def scenes(spacing: float = 5e-3, growth_spacing: float = 5e-3) -> dict[str, Scene]:
    """Scenes whose balance is checked, by what is special about them; spacings m."""

    def plate(boundary: dict[str, float], **options: Any) -> Scene:
        return plate_scene(0.2, 0.1, spacing, boundary, END, outputs={"count": 10}, **options)

    varying = {"boundary": [{"on": "left", "coverage": TENT}, {"on": "top", "coverage": TENT}], "initial": 0.3}
    varying_set = {"boundary": [{"on": "notch", "coverage": TENT}, {"on": "right", "coverage": TENT}]}
    hole = {"holes": [{"name": "bore", "centre": [0.12, 0.05], "radius": 0.02}]}
    return {
        "one wet edge": plate({"left": 1.0}),
        "all edges wet": plate(dict.fromkeys(("left", "right", "top", "bottom"), 1.0)),
        "through the plate": plate({"left": 1.0, "right": 0.0}),
        "edges that vary in time, hydrogen at first": plate({}, hydrogen=varying),
        "wet crack, sealed edges": plate({"notch": 1.0}, geometry={"cracks": [CRACK]}),
        "crack and edge that vary in time": plate({}, hydrogen=varying_set, geometry={"cracks": [CRACK]}),
        "wet hole, dry edge, triangles": plate({"bore": 1.0, "left": 0.0}, geometry=hole, cells="triangle"),
        "fixed stepping": plate({"left": 1.0}, stepping={"mode": "fixed", "load_steps": 20, "diffusion_substeps": 10}),
        "growing crack": growing_crack(growth_spacing),
    }


def growing_crack(spacing: float, end: float = GROWTH_END) -> Scene:
    """The plate of the thesis with a wet notch under fixed grips, opened within 4e6 s."""
    loads = [
        {"on": on, "displacement": {"y": {"times": [0.0, 4e6], "values": [0.0, sign * 2e-5]}}}
        for on, sign in (("top", 1.0), ("bottom", -1.0))
    ]
    return plate_scene(
        0.2, 0.1, spacing, {"notch": 1.0}, end, geometry={"cracks": [CRACK]}, loads=loads,
        damage={"criterion": "energy"}, outputs={"count": 12},
    )  # fmt: skip


def run(spacing: float = 4e-3, growth_spacing: float = 4e-3) -> Report:
    """Run the topic; spacings in m."""
    rows, histories = [], {}
    for name, scene in scenes(spacing, growth_spacing).items():
        result = simulate(case_of(scene))
        time, content, influx, rest = _balance(result, scene)
        histories[name] = time, rest / content.max()
        rows.append(
            Row(
                f"largest imbalance over the content: {name}",
                LIMIT,
                float(np.abs(rest).max() / content.max()),
                kind="at most",
                reason="round-off of all steps; measured 1e-16 to 8e-16",
            )
        )
        rows.append(
            Row(
                f"hydrogen that came in over the content: {name}",
                0.01,
                float(np.abs(influx).max() / content.max()),
                kind="at least",
                reason="so that there is something to balance",
            )
        )
        if name == "growing crack":
            rows.append(
                Row(
                    "crack extension of the growing crack",
                    10e-3,
                    float(result["crack_extension"].values[-1]),
                    unit="m",
                    kind="at least",
                    reason="so that saturation and interrupted steps are part of the balance",
                )
            )
            grown = time, content, influx
    return Report("hydrogen_balance", "Hydrogen balance", TEXT, rows, lambda figure: _draw(figure, grown, histories))


def _balance(result: xr.Dataset, scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times, content, influx and what does not add up, at every recorded instant."""
    content, influx = result["hydrogen_content"].values, result["hydrogen_influx"].values
    first = scene.hydrogen.initial * float(result["volume"].values.sum())
    return result["history_time"].values, content, influx, content - first - influx


def _draw(figure: Figure, grown: Sequence[np.ndarray], histories) -> None:
    left, right = panels(figure, 2)
    time, content, influx = grown
    left.plot(time / 1e6, content * 1e6, color=COLOURS[0], linewidth=1.4, label="content")
    some = np.unique(np.linspace(0, time.size - 1, 25).astype(int))
    style = {"color": COLOURS[1], "markersize": 4, "markerfacecolor": "none"}
    left.plot(time[some] / 1e6, influx[some] * 1e6, "o", label="came in", **style)
    left.legend(fontsize=8, frameon=False)
    label(left, "time ($10^6$ s)", "hydrogen, growing crack (cm$^3$ at full coverage)")
    names = list(histories)
    largest = [max(float(np.abs(rest).max()), 1e-17) for _, rest in histories.values()]
    right.barh(range(len(names)), largest, height=0.35, color=COLOURS[0])
    for place, name in enumerate(names):
        right.text(1.5e-17, place - 0.3, name, fontsize=7, va="bottom")
    right.axvline(LIMIT, color="0.3", linewidth=1.0, linestyle="--", label="allowed")
    right.set(xscale="log", xlim=(1e-17, 1e-8), ylim=(len(names) - 0.5, -0.8), yticks=[])
    right.legend(fontsize=8, frameon=False, loc="lower right")
    label(right, "largest imbalance over content", "")
