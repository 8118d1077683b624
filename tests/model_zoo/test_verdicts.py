"""Single lines that a family's verdict hangs on: each test fails when its line is changed."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
import pytest

from model_zoo.evolved3 import Evolved3
from model_zoo.networks.training import FLOOR, SHARPNESS, Shots, Trainings, TrainingSchedule, step_weights, train
from sysid_evo.carry import CarryLayout
from sysid_evo.data import Dataset
from sysid_evo.evolution import model_evolution
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from sysid_evo.types import Array
from sysid_evo.validation import intervals
from sysid_evo.validation.held_out import DIVERGED, HeldOut
from tests.fixtures.systems import DRIVEN

pytestmark = pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # the recordings stand still

LINE = System((Channel("x"),), (Channel("u", low=-1.0, high=1.0),), dt=0.1)


class Shaken(DynamicsModel):
    """Stands still; with ``stochastic`` it walks at random."""

    envelope = None

    def __init__(self, *, stochastic: bool = False) -> None:
        self.stochastic = stochastic

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        self.noise_scale_ = np.ones(1)
        return self

    @property
    def n_noise(self) -> int:
        return 1 if self.stochastic else 0

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        return carry if noise is None else carry + self.noise_scale_ * noise


@pytest.mark.parametrize(("windows", "rank"), [(19, -1), (29, -2)])
def test_few_windows_widen_the_intervals_by_n_plus_1_over_n(
    windows: int, rank: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Split conformal: of n = 19 errors the 0.9 (n + 1) / n quantile is the largest, of 29 the largest but one."""
    data = Dataset.from_arrays(LINE, [np.zeros((60, 1))], [np.zeros((59, 1))])
    model = Shaken().fit(data)
    cut = data.windows(1)[:windows]
    errors = np.linspace(0.5, 2.0, windows)[:, None]
    monkeypatch.setattr(intervals, "normalised_errors", lambda *_, **__: errors)
    scale = intervals.conformal_scale([(model, cut)], np.random.default_rng(0), rounds=1)
    assert scale[0] == errors[rank, 0]


def test_earlier_samples_count_half_in_the_distance_and_controls_as_much_as_asked() -> None:
    model = make_model("k_neighbours", neighbours=4, state_lags=1, control_lags=2, control_weight=3.0)
    learned = DRIVEN.recording(seed=1)
    metric = model.fit(learned).metric_
    np.testing.assert_allclose(metric[2:4] / metric[:2], 0.5)
    np.testing.assert_allclose(metric[4:6] / metric[6], 0.5 / 3.0)


class Runaway(DynamicsModel):
    """Predicts the truth of `LINE` at rest, zero; with ``gain`` it runs away instead."""

    def __init__(self, *, gain: float = 0.0) -> None:
        self.gain = gain

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        return self

    def next_state(self, carry: Array, control: Array) -> Array:
        return carry + self.gain


def wave() -> Dataset:
    states = np.sin(np.arange(121) / 5.0)[:, None]
    return Dataset.from_arrays(LINE, [states], [np.zeros((120, 1))])


def test_a_setting_that_diverges_on_held_out_time_is_worse_than_any_that_does_not() -> None:
    blocks = HeldOut.of(wave())
    calm, wild = (blocks.error(lambda part, gain=gain: Runaway(gain=gain).fit(part)) for gain in (0.0, 0.5))
    assert calm < 10.0
    assert wild > 3 * DIVERGED
    model = Runaway().fit(wave())
    assert blocks.diverges(model, np.full((1, 1, 1), 2.0 * np.abs(wave().episodes[0].states).max()))
    assert not blocks.diverges(model, np.full((1, 1, 1), 1.5))


def test_narx_never_chooses_a_setting_that_diverges(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one it would choose, said to diverge."""
    learned = DRIVEN.recording(seed=3)
    free = make_model("narx", degree=1, state_lags=0, control_lags=0, terms=None).fit(learned)
    usual = free.terms_
    diverges = HeldOut.diverges
    monkeypatch.setattr(
        HeldOut, "diverges", lambda self, model, run: model.terms == usual or diverges(self, model, run)
    )
    assert make_model("narx", degree=1, state_lags=0, control_lags=0).fit(learned).terms_ != usual


def test_evolved3_looks_as_many_steps_ahead_as_its_horizon(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    error = model_evolution.final_error

    def watched(step: Any, population: Array, windows: Any, *rest: Any, **more: Any) -> Array:
        asked.append(windows.controls.shape[1])
        return error(step, population, windows, *rest, **more)

    monkeypatch.setattr(model_evolution, "final_error", watched)
    monkeypatch.setattr(Evolved3, "_kernels", lambda self, parameters: None)
    for horizon in (3, 12):
        make_model("evolved3", generations=1, windows=5, horizon=horizon).fit(DRIVEN.recording())
    assert asked == [3, 3, 12, 12]
    assert make_model("evolved3").horizon == 10


def test_the_steps_of_a_free_run_weigh_by_the_inverse_of_their_error_to_the_power_of_2_5() -> None:
    error = np.array([[0.1, 0.3], [0.4, 0.4], [0.9, 1.1]])
    weight = (np.array([0.2, 0.4, 1.0]) + FLOOR) ** -SHARPNESS
    np.testing.assert_allclose(step_weights(error), weight / weight.sum(), rtol=1e-5)
    assert SHARPNESS == 2.5
    assert step_weights(np.zeros((3, 1))) == pytest.approx([1 / 3] * 3)


class Drifting:
    """A model of one number p that predicts p after one step and 4 p after two."""

    layout = CarryLayout(1, 0)

    def __init__(self) -> None:
        self.parameters: Array = np.full((1, 1), 0.5)

    def run(self, samples: Array) -> Array:
        steps, size = len(samples) - 1, samples.shape[2]
        return self.parameters[0, 0] * np.tile(4.0 ** np.arange(steps)[:, None, None, None], (1, 1, size, 1))

    def gradient(self, by_states: Array) -> Array:
        steps = 4.0 ** np.arange(len(by_states))[:, None, None, None]
        return np.sum(by_states * steps).reshape(1, 1)

    def augmented(self, samples: Array, rng: np.random.Generator) -> Array:
        return samples

    def as_recorded(self) -> None:
        return


def test_training_follows_the_weights_of_the_steps() -> None:
    """The steps ask for p = 1 and p = 2; the first decides, though the second has the larger error."""
    shots = Shots(np.tile([[0.0], [1.0], [8.0]], (4, 1)), np.arange(0, 12, 3), 2)
    plan = TrainingSchedule(1, 300, 2, batch=4, learning_rate=0.05, weight_decay=0.0, input_noise=0.0, averaging=0.5)
    one = np.ones(1)
    trainings = Trainings(np.random.default_rng(0))
    found = train(Drifting(), [shots], plan, state_scale=one, change_scale=one, trainings=trainings)
    assert float(found[0, 0]) == pytest.approx(1.0, abs=0.1)


def test_a_short_history_is_padded_alike_by_every_family_with_lags() -> None:
    """The first state stands for the missing ones and the neutral control for the missing commands."""
    learned = DRIVEN.recording()
    model = make_model("linear", state_lags=2, control_lags=2).fit(learned)
    x0, u = np.array([0.3, -0.2]), np.full((5, 1), 0.4)
    padded = model.simulate(np.tile(x0, (1, 3, 1)), np.zeros((1, 2, 1)), u[None])[0]
    np.testing.assert_array_equal(model.simulate(x0, u), padded)
    assert not np.array_equal(model.simulate(np.tile(x0, (1, 3, 1)), np.full((1, 2, 1), 0.4), u[None])[0], padded)
