"""States that only add up others: found in the data, and no wall where the recording ends."""

from dataclasses import replace

import numpy as np
import pytest

from model_zoo.features import between_limits, integrals
from sysid_evo.data import Dataset
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel
from tests.fixtures.systems import CART, cart

FAMILIES = ("backprop27", "narx", "sindy", "sindy_discrete")
NO_LAGS = {"state_lags": 0, "control_lags": 0}
QUICK = {**dict.fromkeys(FAMILIES, NO_LAGS), "backprop27": {"epochs": 600}}


@pytest.fixture(scope="module", autouse=True)
def pysindy():
    """SINDy imports it in its first fit, which takes longer than a unit test may."""
    return pytest.importorskip("pysindy")


def test_a_position_is_an_integral_a_speed_with_drag_is_none():
    assert integrals(cart()).tolist() == [True, False]


def test_a_position_that_is_pulled_back_is_none():
    assert integrals(cart(pull=0.5)).tolist() == [False, False]


def test_a_position_on_a_hill_is_an_integral_although_it_decides_how_fast_it_will_be():
    """In steps of semi-implicit Euler the change of a position is the speed after the step."""
    rng = np.random.default_rng(1)
    states, controls = [], []
    for _ in range(4):
        state, forces = [np.array([-0.5, 0.0])], np.repeat(rng.uniform(-1.0, 1.0, 20), 10)
        for force in forces:
            speed = state[-1][1] + 0.0015 * force - 0.0025 * np.cos(3.0 * state[-1][0])
            state.append(np.array([state[-1][0] + speed, speed]))
        states.append(np.array(state))
        controls.append(forces[:, None])
    assert integrals(Dataset.from_arrays(CART, states, controls))[0]


@pytest.mark.parametrize("family", FAMILIES)
def test_a_cart_continues_where_the_recordings_turned_back(family):
    dataset = cart()
    farthest = max(episode.states[:, 0].max() for episode in dataset)
    model = make_model(family, **QUICK[family]).fit(dataset, rng=0)
    simulated = model.simulate(np.array([farthest, 0.3]), np.full((4, 1), 0.3))
    expected = farthest + 0.1 * 0.3 * 4
    assert simulated[-1, 0] == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("family", FAMILIES)
def test_no_cart_runs_beyond_the_limits_of_its_channel(family):
    dataset = cart()
    farthest = max(episode.states[:, 0].max() for episode in dataset)
    limited = replace(CART, states=(Channel("position", "m", -2.0, farthest + 0.05), CART.states[1]))
    model = make_model(family, **QUICK[family]).fit(cart(limited), rng=0)
    simulated = model.simulate(np.array([farthest, 0.3]), np.ones((8, 1)))
    assert simulated[:, 0].max() == farthest + 0.05


def test_samples_at_a_limit_are_not_used_for_the_fit():
    """A cart without drag, faster than its speed can show: its pull is learned from where the speed is free."""
    rng = np.random.default_rng(0)
    system = replace(CART, states=(CART.states[0], Channel("speed", "m/s", -0.5, 0.5)))
    states, controls = [], []
    for _ in range(4):
        state, forces = [np.zeros(2)], np.repeat(rng.uniform(-1.0, 1.0, 25), 6)
        for force in forces:
            speed = np.clip(state[-1][1] + 0.1 * force, -0.5, 0.5)
            state.append(np.array([state[-1][0] + 0.1 * speed, speed]))
        states.append(np.array(state))
        controls.append(forces[:, None])
    dataset = Dataset.from_arrays(system, states, controls)
    data = dataset.transitions()
    assert 0.3 < between_limits(system, data.after).mean() < 0.9
    for family in ("narx", "sindy", "sindy_discrete", "linear"):
        model = make_model(family, **NO_LAGS).fit(dataset, rng=0)
        simulated = model.simulate(np.array([0.0, 0.3]), np.ones((6, 1)))[:, 1]
        np.testing.assert_allclose(simulated, [0.4, 0.5, 0.5, 0.5, 0.5, 0.5], atol=0.01, err_msg=family)


def test_if_all_samples_are_at_a_limit_all_are_used():
    system = replace(CART, states=(CART.states[0], Channel("speed", "m/s", 0.0, 0.5)))
    assert between_limits(system, np.zeros((4, 2))).all()
