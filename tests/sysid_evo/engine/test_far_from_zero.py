"""States far from zero for how much they change: the compiled engine takes the precision that they need."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.controllers import make_controller
from sysid_evo.data import Dataset
from sysid_evo.engine import rollout
from sysid_evo.models.base import make_model
from sysid_evo.models.dynamics import enough, far_from_zero
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel, System
from sysid_evo.tasks import SetPoint

DEVIATION = 0.5
STEPS = 30
"""Three seconds at 10 Hz."""


def recording(ratio: float) -> Dataset:
    """Return a damped oscillation under a force, so many deviations from zero, as a position in UTM metres is."""
    rng, centre = np.random.default_rng(4), ratio * DEVIATION
    states = (Channel("position", "m", neutral=centre), Channel("speed", "m/s"))
    system = System(states, (Channel("force", "N", -2.0, 2.0),), dt=0.1)
    force = np.repeat(rng.uniform(-2.0, 2.0, (3, 50, 1)), 4, axis=1)
    runs = np.zeros((3, 201, 2))
    for k in range(200):
        position, speed = runs[:, k].T
        change = np.stack([speed, force[:, k, 0] - 2.0 * position - 0.6 * speed], axis=1)
        runs[:, k + 1] = runs[:, k] + 0.1 * change + 0.002 * rng.standard_normal((3, 2))
    return Dataset.from_arrays(system, list(runs + np.array([centre, 0.0])), list(force))


@pytest.mark.parametrize("family", ["linear", "nearest_neighbour", "linear_state_space"])
@pytest.mark.parametrize("ratio", [0.0, 1e3, 1e5, 1e7])
def test_after_three_seconds_the_compiled_state_is_that_of_the_reference(family: str, ratio: float) -> None:
    dataset = recording(ratio)
    model = make_model(family).fit(dataset, rng=0)
    task = SetPoint(channels="position", low=ratio * DEVIATION, high=ratio * DEVIATION, horizon=STEPS)
    law = make_controller("linear(inputs=position_error)")
    parameters, seeds = np.array([[0.7, 0.2], [-0.3, 0.5]]), trial_seeds(1, 4)
    runs = [
        rollout(model, law, parameters, task, seeds, record=True, engine=engine) for engine in ("auto", "reference")
    ]
    assert runs[0].engine == ("compiled float64" if ratio else "compiled float32")
    ends = [np.array([trajectory.states[-1] for trajectory in run.trajectories]) for run in runs]
    assert np.abs(ends[0] - ends[1]).max() < 1e-3 * DEVIATION
    assert np.abs(ends[1][:, 0] - ratio * DEVIATION).max() > 0.01  # something moved
    assert ("double precision" in model.fit_note) == bool(ratio)


def test_only_what_moves_within_limits_far_from_zero_counts() -> None:
    far, near = [1e6 - 1.0, 1e6 + 1.0], [-1.0, 3.0]
    constant, turning = [12.0, 12.0], [-np.inf, np.inf]
    envelope = np.array([near, constant, turning, far]).T
    assert far_from_zero(envelope).tolist() == [3]
    assert enough("float32", envelope) == "float64"
    assert enough("float32", envelope[:, :3]) == "float32"
    assert enough("float64", None) == "float64"
    assert enough("float32", None) == "float32"
