"""An equation goes on bounded outside the data, and what is unstable in it is said."""

from __future__ import annotations

import numpy as np
import pytest

from model_zoo.polynomial.model import growth
from model_zoo.polynomial.sindy import MARGIN, continuation_limits, continued
from sysid_evo.data import Dataset
from sysid_evo.models.base import make_model
from sysid_evo.registry import make_robot
from sysid_evo.system import Channel, System

SYSTEM = System((Channel("x"), Channel("y")), (Channel("u", low=-1.0, high=1.0),), dt=0.05)


def moved(matrix: np.ndarray, episodes: int = 20, steps: int = 30) -> Dataset:
    """Short runs of x' = (I + dt A) x + dt u from rest."""
    rng = np.random.default_rng(0)
    control = np.repeat(rng.uniform(-1.0, 1.0, (episodes, steps // 10, 1)), 10, axis=1)
    states = np.zeros((episodes, steps + 1, 2))
    for k in range(steps):
        states[:, k + 1] = states[:, k] + SYSTEM.dt * (states[:, k] @ matrix.T + control[:, k])
    return Dataset.from_arrays(SYSTEM, list(states), list(control))


def test_beyond_the_margin_every_state_moves_back_whatever_the_polynomial_says() -> None:
    rng = np.random.default_rng(1)
    states, rates = rng.uniform(-1.0, 1.0, (50, 3)), rng.uniform(-5.0, 5.0, (50, 3))
    bounds = continuation_limits(states, rates, np.array([False, False, True]))
    low, high = states.min(axis=0), states.max(axis=0)
    beyond = np.where(
        rng.random((200, 3)) < 0.5, high + 1.01 * MARGIN * (high - low), low - 1.01 * MARGIN * (high - low)
    )
    pushed = continued(1e3 * rng.standard_normal((200, 3)), rng.standard_normal((200, 3)), beyond, bounds, 0.05)
    assert (pushed[:, :2] * np.sign(beyond[:, :2]) < 0).all()
    assert (np.sign(pushed[:, 2]) != -np.sign(beyond[:, 2])).any()  # a position runs on


def test_inside_the_data_the_continuation_changes_nothing() -> None:
    rng = np.random.default_rng(1)
    states, rates, turning = (rng.uniform(-1.0, 1.0, (50, 2)) for _ in range(3))
    bounds = continuation_limits(states, rates, np.array([False, False]))
    np.testing.assert_array_equal(continued(rates, turning, states, bounds, 0.05), rates + turning)


@pytest.mark.parametrize(
    ("car", "duration"), [(2, 60.0), *(pytest.param(n, 360.0, marks=pytest.mark.nightly) for n in range(5))]
)
def test_a_cubic_equation_of_a_car_runs_free_for_a_whole_trial_without_diverging(car: int, duration: float) -> None:
    robot = make_robot(f"emulated_car:{car}" if car else "emulated_car")
    data = robot.record(seed=0, duration=duration).dataset
    model = make_model("sindy", degree=3, threshold=0.01, control_lags=0).fit(data)
    rng = np.random.default_rng(0)
    start = model.pairs_[rng.integers(len(model.pairs_), size=100)][:, :3]
    commands = model.system.actuate(rng.uniform(-1.0, 1.0, (100 * 50, 2))).reshape(100, 50, 2)
    runs = model.simulate(start[:, None], None, np.repeat(commands, 10, axis=1))
    low, high = model.envelope_
    assert ((runs > low) & (runs < high)).all()
    assert model.stability.escaped == 0.0


def test_growth_is_that_of_the_equation_also_with_lags() -> None:
    """Eigenvalues -2 and -3 of a linear equation, found from steps of its carry."""
    matrix = np.array([[-2.0, 1.0], [0.0, -3.0]])
    data = moved(matrix)
    for lags in (0, 1):
        model = make_model("sindy_discrete", degree=1, threshold=1e-6, ridge=0.0, state_lags=lags, control_lags=lags)
        rate = growth(model.fit(data), np.zeros((1, 2)), np.zeros((1, 1)))
        np.testing.assert_allclose(rate, np.log(1.0 - 2.0 * SYSTEM.dt) / SYSTEM.dt, rtol=1e-3)
        assert model.stability.sentence == ""
        assert model.fit_note == ""


def test_an_equation_that_grows_at_rest_is_said_to() -> None:
    model = make_model("sindy_discrete", degree=1, threshold=1e-3, state_lags=0, control_lags=0)
    model.fit(moved(np.array([[2.0, 0.0], [0.0, -3.0]])))
    assert "small disturbances at rest grow by" in model.fit_note
