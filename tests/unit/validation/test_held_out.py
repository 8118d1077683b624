"""Simulations from held-out windows: their error, what diverges, and the history that they begin with."""

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset
from sysid_evo.validation.folds import FOLDS, make_folds
from sysid_evo.validation.held_out import DIVERGED, NEGLIGIBLE_ERROR, HeldOutError
from sysid_evo.validation.simulation_error import (
    LONGEST_HISTORY,
    HeldOutTest,
    Scorer,
    error_windows,
    history_of,
    relative_error,
)
from tests.benchmarks.coverage import coverage
from tests.fixtures.systems import DRIVEN

LINE = System((Channel("x"),), (Channel("u", low=-1.0, high=1.0),), dt=0.1)


def test_an_error_is_that_of_simulations_and_a_copy_is_no_significant_improvement():
    """A model that is right has no error, one that stands still has that of the spread of the changes."""
    data = example_dataset()
    (_, held), *_ = make_folds(data, 3)
    trial = HeldOutTest.of(held, [1, 10], 2)
    judge = Scorer.of(data, [trial])
    still = judge.errors([np.repeat(trial.windows.start_states[:, None], 2, axis=1)])
    assert judge.errors([trial.truth]).mean == 0.0
    off = data.system.difference(np.repeat(trial.windows.start_states[:, None], 2, axis=1), trial.truth)
    np.testing.assert_allclose(still.at, np.sqrt((off**2).mean(axis=0) / judge.spread**2).mean(axis=1))
    close = judge.errors([trial.truth + 0.01])
    assert still.above(close).low > 0.0
    shifted = judge.errors([trial.truth - 0.01])
    np.testing.assert_allclose(shifted.above(close).interval, 0.0, atol=1e-12)


def test_simulations_get_a_third_of_what_the_horizon_leaves_as_history():
    """A model with hidden states needs it; the rest is where runs begin."""
    for steps, horizon, history in ((166, 60, 35), (166, 20, 48), (90, 80, 3), (50, 60, 0), (600, 60, LONGEST_HISTORY)):
        held = example_dataset(episodes=1, steps=steps)
        assert history_of([(held, held)], [10, horizon]) == history


def test_relative_error_of_the_mean_is_one(car_data):
    windows = error_windows(car_data, 0)
    mean = np.broadcast_to(windows.states.mean(axis=(0, 1)), windows.states.shape)
    assert 0.8 < relative_error(car_data.system, mean, windows) < 1.2


def test_coverage_of_a_normal_is_ninety_per_cent():
    rng = np.random.default_rng(0)
    share = coverage(rng.standard_normal((400, 2000, 1)), rng.standard_normal((2000, 1)))
    assert abs(share[0] - 0.9) < 0.03


def test_errors_that_are_as_good_as_none_are_equal():
    """So the first of several such models is taken, which has no lags."""
    blocks = HeldOutError.of(DRIVEN.recording())
    perfect, nearly = (
        blocks.error(lambda part, ridge=ridge: make_model("linear", ridge=ridge).fit(part)) for ridge in (0.0, 1e-4)
    )
    assert perfect == nearly == pytest.approx(FOLDS * NEGLIGIBLE_ERROR)
    assert blocks.error(lambda part: make_model("linear", ridge=1.0).fit(part)) > 2.0 * perfect


class Runaway(DynamicsModel):
    """Predicts the truth of `LINE` at rest, zero; with ``gain`` it runs away instead."""

    def __init__(self, *, gain: float = 0.0) -> None:
        self.gain = gain

    def fit(self, dataset, *, rng, progress=None):
        return self

    def next_state(self, carry, control):
        return carry + self.gain


def wave():
    states = np.sin(np.arange(121) / 5.0)[:, None]
    return Dataset.from_arrays(LINE, [states], [np.zeros((120, 1))])


def test_a_setting_that_diverges_on_held_out_time_is_worse_than_any_that_does_not():
    blocks = HeldOutError.of(wave())
    calm, wild = (blocks.error(lambda part, gain=gain: Runaway(gain=gain).fit(part)) for gain in (0.0, 0.5))
    assert calm < 10.0
    assert wild > 3 * DIVERGED
    model = Runaway().fit(wave())
    assert blocks.diverges(model, np.full((1, 1, 1), 2.0 * np.abs(wave().episodes[0].states).max()))
    assert not blocks.diverges(model, np.full((1, 1, 1), 1.5))


def test_a_short_history_is_padded_alike_by_every_family_with_lags():
    """The first state stands for the missing ones and the neutral control for the missing commands."""
    learned = DRIVEN.recording()
    model = make_model("linear", state_lags=2, control_lags=2).fit(learned)
    x0, u = np.array([0.3, -0.2]), np.full((5, 1), 0.4)
    padded = model.simulate(np.tile(x0, (1, 3, 1)), np.zeros((1, 2, 1)), u[None])[0]
    np.testing.assert_array_equal(model.simulate(x0, u), padded)
    assert not np.array_equal(model.simulate(np.tile(x0, (1, 3, 1)), np.full((1, 2, 1), 0.4), u[None])[0], padded)
