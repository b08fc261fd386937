"""Long diffusion steps while bonds may break: the same failures, at nearly the same times, for fewer sweeps."""

import numpy as np
import pytest

from pdhe import advance
from pdhe.benchmarks.problems import mode_i
from pdhe.simulation import simulate
from pdhe.transport import STEP_SAFETY

SCENES = {
    "held load": ({}, 2.0),
    "energy criterion, load that moves": ({"damage.criterion": "energy", "time.end": "1.95e6 s"}, 1.5),
}


@pytest.mark.parametrize("name", SCENES)
def test_failures_are_those_of_plain_steps(name, monkeypatch):
    changes, saving = SCENES[name]
    case = mode_i(3200, {"outputs": {"count": 5}, **changes})
    plain_step = STEP_SAFETY * case.diffusion.stable_step(np.zeros(3200, bool))
    long = simulate(case)
    monkeypatch.setattr(advance, "stride", lambda *rest: None)
    plain = simulate(mode_i(3200, {"outputs": {"count": 5}, **changes}))
    assert plain.broken_bonds.values[-1] > 10
    for end in ("broken_i", "broken_j"):
        assert np.array_equal(long[end].values, plain[end].values)
    # Measured 0.23 and 0.01; sweeps 2.5 and 1.9 times fewer.
    assert np.abs(long.broken_time.values - plain.broken_time.values).max() < 0.5 * plain_step
    assert float(long.diffusion_sweeps[-1]) < float(plain.diffusion_sweeps[-1]) / saving
    for result in (long, plain):
        # What has entered is what is there: measured 1e-14.
        assert result.hydrogen_influx.values[-1] == pytest.approx(result.hydrogen_content.values[-1], rel=1e-11)
