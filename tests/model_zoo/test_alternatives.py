"""Models that are a mean of several give these several by themselves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sysid_evo.dynamics import DynamicsModel
from sysid_evo.engine import DynamicsRunner
from sysid_evo.evolution import ControllerEvolution
from sysid_evo.evolution.meeting import met
from sysid_evo.registry import make_model
from sysid_evo.testing import example_dataset
from sysid_evo.wrappers import Switching, one_of_its_members

MEANS: dict[str, dict[str, Any]] = {
    "mlp_ensemble": {
        "members": 3,
        "hidden": [4],
        "state_lags": 1,
        "control_lags": 1,
        "one_step_updates": 5,
        "updates": 2,
    },
    "sindy_bagged": {"bags": 6, "kept": 0.5, "degree": 2, "threshold": 0.1, "control_lags": 1, "state_lags": 0},
}


def fitted(name: str, **changed: Any) -> DynamicsModel:
    return make_model(name, **{**MEANS[name], **changed}).fit(example_dataset(episodes=2), rng=0)


@pytest.mark.parametrize("name", MEANS)
def test_the_right_hand_side_of_a_model_is_the_mean_of_those_of_its_alternatives(name: str) -> None:
    model = fitted(name)
    members = model.alternatives()
    assert len(members) == 3
    windows = example_dataset().windows(1, stride=50, history=model.n_lags)
    carry = model.start(windows.past_states, windows.past_controls)
    control = windows.controls[:, 0]

    def rate(one: Any) -> np.ndarray:
        if name == "sindy_bagged":
            return np.asarray(one.polynomial(carry, control))
        return np.asarray(one.network(np.concatenate([carry, control], axis=1)).mean(axis=0))

    rates = [rate(member) for member in members]
    np.testing.assert_allclose(np.mean(rates, axis=0), rate(model), atol=1e-9)
    assert np.ptp(rates, axis=0).max() > 1e-3, "they differ"


def test_a_trial_meets_one_member_where_there_are_several() -> None:
    model = fitted("sindy_bagged")
    several = one_of_its_members(model)
    assert isinstance(several, Switching)
    assert len(several.members) == 3
    assert one_of_its_members(fitted("sindy_bagged", kept=0.1)) is not None
    linear = make_model("linear").fit(example_dataset(), rng=0)
    assert one_of_its_members(linear) is linear
    noise = "envelope(members=true)"
    (runner,) = met({"bags": DynamicsRunner(model)}, ControllerEvolution(noise=noise)).values()
    assert isinstance(runner, DynamicsRunner)
    assert isinstance(runner.dynamics, Switching)
    assert runner.dynamics.kernel() is not None
