"""States that only add up others: found in the data, and no wall where the recording ends."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from model_zoo.features import between_limits, integrals
from sysid_evo.data import Dataset
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System

CART = System((Channel("position", "m"), Channel("speed", "m/s")), (Channel("force", "N", low=-1.0, high=1.0),), dt=0.1)
FAMILIES = ("backprop27", "narx", "sindy", "sindy_discrete")
QUICK: dict[str, dict[str, Any]] = {"backprop27": {"epochs": 600}}


def driven(system: System = CART, pull: float = 0.0) -> Dataset:
    """Return recordings of a cart with drag that stays within 1 m, and is pulled towards 0 by ``pull`` 1/s."""
    rng = np.random.default_rng(3)
    states, controls = [], []
    for _ in range(12):
        state, episode, forces = np.array([rng.uniform(-0.7, 0.7), 0.0]), [], []
        for k in range(60):
            if k % 5 == 0:
                towards = -0.5 * state[0] - 0.5 * state[1]
                force = float(np.clip(towards + rng.uniform(-0.5, 0.5), -1.0, 1.0))
            episode.append(state)
            forces.append([force])
            state = state + 0.1 * np.array([state[1] - pull * state[0], force - 0.8 * state[1]])
        states.append(np.array([*episode, state]))
        controls.append(np.array(forces))
    return Dataset.from_arrays(system, states, controls)


def test_a_position_is_an_integral_a_speed_with_drag_is_none() -> None:
    assert integrals(driven()).tolist() == [True, False]


def test_a_position_that_is_pulled_back_is_none() -> None:
    assert integrals(driven(pull=0.5)).tolist() == [False, False]


def test_a_position_on_a_hill_is_an_integral_although_it_decides_how_fast_it_will_be() -> None:
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
def test_a_cart_runs_on_where_the_recordings_turned_back(family: str) -> None:
    dataset = driven()
    farthest = max(episode.states[:, 0].max() for episode in dataset)
    model = make_model(family, **QUICK.get(family, {})).fit(dataset, rng=0)
    simulated = model.simulate(np.array([farthest, 0.3]), np.full((4, 1), 0.3))
    expected = farthest + 0.1 * 0.3 * 4
    assert simulated[-1, 0] == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("family", FAMILIES)
def test_no_cart_runs_beyond_the_limits_of_its_channel(family: str) -> None:
    dataset = driven()
    farthest = max(episode.states[:, 0].max() for episode in dataset)
    limited = replace(CART, states=(Channel("position", "m", -2.0, farthest + 0.05), CART.states[1]))
    model = make_model(family, **QUICK.get(family, {})).fit(driven(limited), rng=0)
    simulated = model.simulate(np.array([farthest, 0.3]), np.ones((8, 1)))
    assert simulated[:, 0].max() == farthest + 0.05


def test_what_stands_at_a_limit_is_not_learned_as_what_drove_it_there() -> None:
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
        model = make_model(family).fit(dataset, rng=0)
        simulated = model.simulate(np.array([0.0, 0.3]), np.ones((6, 1)))[:, 1]
        np.testing.assert_allclose(simulated, [0.4, 0.5, 0.5, 0.5, 0.5, 0.5], atol=0.01, err_msg=family)


def test_where_everything_stands_at_a_limit_everything_is_learned_from() -> None:
    system = replace(CART, states=(CART.states[0], Channel("speed", "m/s", 0.0, 0.5)))
    assert between_limits(system, np.zeros((4, 2))).all()
