"""Every family on a system without controls, on one state, and under a control that never changes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System
from sysid_evo.testing.models import rows_are_independent
from tests.fixtures.systems import AUTONOMOUS, DRIVEN, SMALL_SYSTEMS
from tests.model_zoo.test_contract import OFTEN, SMALL

CARS = ("hybrid_ode", "parametrised", "single_track")


def fitted(family: str, dataset: Dataset) -> DynamicsModel:
    options: dict[str, Any] = {"control_lags": 1} if family in ("linear", "nearest_neighbour") else {}
    network = {"hidden": [4], "one_step_updates": 4, "updates": 2, "horizon": 3, "control_lags": 1, "state_lags": 0}
    options = network if "one_step_updates" in SMALL.get(family, {}) else options
    return make_model(family, **{**SMALL.get(family, {}), **options}).fit(dataset, rng=np.random.default_rng(0))


@pytest.mark.parametrize("case", SMALL_SYSTEMS)
@pytest.mark.parametrize("family", OFTEN)
def test_a_family_works_on_a_small_system_or_says_why_not(family: str, case: str) -> None:
    """It runs free without leaving the envelope for good."""
    dataset = SMALL_SYSTEMS[case].recording()
    if family in CARS:
        with pytest.raises(IncompatibleSystem, match="describes a planar body, but the system has no motion"):
            fitted(family, dataset)
        return
    model = fitted(family, dataset)
    windows = dataset.windows(10, stride=10, history=model.n_lags)
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    assert np.isfinite(simulated).all()
    rows_are_independent(model, dataset)


@pytest.mark.parametrize("family", CARS)
def test_a_car_without_controls_is_refused_in_a_sentence(family: str) -> None:
    channels = (Channel("forward_speed"), Channel("lateral_speed"), Channel("yaw_rate"))
    with pytest.raises(IncompatibleSystem, match="there is no 'drive' among no controls; name it with drive="):
        make_model(family).check_system(System(channels, (), 0.05, PlanarBody()))


def test_without_controls_the_distance_of_k_neighbours_weighs_states_fully_and_earlier_ones_half() -> None:
    model = make_model("k_neighbours", neighbours=4, state_lags=1, control_lags=0, control_weight=9.0)
    model.fit(AUTONOMOUS.recording(), rng=np.random.default_rng(0))
    np.testing.assert_allclose(model.metric_[2:] / model.metric_[:2], 0.5)


def test_a_gaussian_process_fits_linear_data_without_noise() -> None:
    """Its covariance is singular in double precision."""
    for system in (AUTONOMOUS, DRIVEN):
        learned, fresh = system.recording(seed=1), system.recording(seed=2)
        model = make_model("gaussian_process", inducing=40, state_lags=0, control_lags=0)
        model.fit(learned, rng=np.random.default_rng(0))
        windows = fresh.windows(20, stride=10)
        simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
        assert np.abs(simulated - windows.states).max() < 0.01
