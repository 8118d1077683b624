"""What families of the zoo have in common: they beat standing still, and can hold a body at rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.models.base import make_model
from sysid_evo.registry import models
from sysid_evo.testing import example_dataset
from sysid_evo.types import Array
from sysid_evo.validation.simulation_error import judging_windows, relative_error
from tests.model_zoo.test_contract import SMALL as SMALL_BUDGETS

SMALL: dict[str, dict[str, Any]] = {"neural_ode": {"updates": 10}}


@pytest.fixture(scope="module")
def recording() -> Dataset:
    return example_dataset()


@pytest.mark.parametrize("name", ["backprop27", "evolved3", "nearest_neighbour", "parametrised"])
def test_a_family_of_the_paper_beats_persistence_at_one_second(name: str) -> None:
    learned, held = example_dataset(episodes=4, steps=500).split(["episode-2"])
    options = dict(models.get(name).presets.get("quick", {}))  # type: ignore[attr-defined]  # a class
    model = make_model(name, **options).fit(learned, rng=np.random.default_rng(3))
    windows = judging_windows(held, 0)
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)[:, -1]
    truth, persistence = windows.states[:, -1], windows.start_states

    def error(guess: Array) -> float:
        return float(np.mean(np.sqrt(np.mean((guess - truth) ** 2, axis=0)) / truth.std(axis=0)))

    assert error(simulated) < error(persistence)


@pytest.mark.parametrize("name", ["k_neighbours", "narx", "sindy", "sindy_discrete", "neural_ode"])
def test_rest_hold_keeps_a_resting_body_at_rest(name: str, recording: Dataset) -> None:
    options = dict(models.get(name).presets.get("quick", {}))  # type: ignore[attr-defined]  # a class
    model = make_model(name, **{**options, **SMALL.get(name, {})}, rest_hold=True)
    model.fit(recording, rng=np.random.default_rng(0))
    rest = model.start(np.zeros((1, model.n_lags + 1, 3)), np.zeros((1, model.n_lags, 2)))
    assert np.array_equal(model.step(rest, np.zeros((1, 2)))[:, :3], np.zeros((1, 3)))
    assert not np.array_equal(model.step(rest, np.ones((1, 2)))[:, :3], np.zeros((1, 3)))


def test_relative_error_of_the_mean_is_one(recording: Dataset) -> None:
    windows = judging_windows(recording, 0)
    mean = np.broadcast_to(windows.states.mean(axis=(0, 1)), windows.states.shape)
    assert 0.8 < relative_error(recording.system, mean, windows) < 1.2


def test_a_pulse_shorter_than_the_dead_time_moves_a_resting_car(recording) -> None:
    """One sample of drive, then neutral: the car moves two samples later, and rests until then."""
    model = make_model("parametrised", generations=3, control_lags=2, rest_hold=True)
    model.fit(recording, rng=np.random.default_rng(0))
    model.parameters_[[8, 9]] = 0.0  # no static friction: what is looked at is the hold
    carry, speeds = np.zeros((1, model.n_carry)), []
    for drive in (1.0, 0.0, 0.0, 0.0):
        control = np.array([[drive, 0.0]])
        carry = model.step(carry, control)
        speeds.append(carry[0, 0])
    assert speeds[:2] == [0.0, 0.0]
    assert speeds[2] > 0.05


ITERATIVE = [name for name in models.names() if name not in ("linear", "nearest_neighbour")]


@pytest.mark.parametrize("name", ITERATIVE)
def test_a_fit_that_takes_long_tells_often_how_far_it_is(name: str, recording: Dataset) -> None:
    """Every family reports at least ten times, also with a small budget."""
    options = dict(models.get(name).presets.get("quick", {}))  # type: ignore[attr-defined]  # a class
    searched = {key: None for key in ("state_lags", "control_lags", "degree", "terms", "neighbours") if key in options}
    told: list[int] = []
    model = make_model(name, **{**options, **SMALL_BUDGETS.get(name, {}), **searched})
    model.fit(recording, rng=np.random.default_rng(0), progress=lambda done, total: told.append(done))
    assert len(told) >= 10
    assert told == sorted(told)
