"""Errors, distances and plots of an angle that passes pi."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from evaluation.exploitability import Steps, training_support
from evaluation.plots import plot_free_run
from evaluation.prediction import PERSISTENCE, PredictionProtocol, assess_prediction
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.models import DynamicsModel
from sysid_evo.system import Channel, System

TURN = 2.0 * np.pi
PENDULUM = System(
    (Channel("angle", "rad", period=TURN), Channel("rate", "rad/s")), (Channel("torque", "N m", -1.0, 1.0),), 0.05
)
PROTOCOL = PredictionProtocol(resamples=50)


class TurnedRound(DynamicsModel):
    """Predicts a pendulum that spins evenly, exactly, but one whole turn away from where it is."""

    def fit(self, dataset, **keywords):
        return self

    def next_state(self, carry, control):
        return carry + np.array([0.05, 0.0]) * carry[:, 1:] + np.array([TURN, 0.0])


def spinning(steps=200):
    rate = 2.0 + 0.0 * np.arange(steps + 1)
    return Dataset.from_arrays(
        PENDULUM, [np.stack([3.0 + np.cumsum(0.05 * rate), rate], axis=1)], [np.zeros((steps, 1))]
    )


def test_a_prediction_that_is_a_whole_turn_away_is_right():
    model = TurnedRound().fit(spinning(), rng=np.random.default_rng(0))
    row = assess_prediction({"turned": model}, spinning(), spinning(), protocol=PROTOCOL).model("turned")
    assert row.free_run is not None
    assert row.divergence is not None
    for score in (*row.at, row.free_run):
        assert score.rmse[0] < 1e-9
    assert row.curve.max() < 1e-9
    assert row.divergence.share == 0.0, "the guard must not stop an angle that turns on"


def test_the_error_of_persistence_is_the_short_way_round():
    row = assess_prediction({}, spinning(), spinning(), protocol=PROTOCOL).model(PERSISTENCE)
    for score in row.at:
        assert score.horizon is not None
        off = 0.1 * score.horizon
        assert score.rmse[0] == pytest.approx(abs(off - TURN * np.round(off / TURN)))


def test_the_spread_of_an_angle_does_not_grow_with_its_turns():
    short, long = (assess_prediction({}, spinning(), spinning(n), protocol=PROTOCOL).cases.std for n in (126, 1260))
    assert short[0] == pytest.approx(long[0], rel=0.01)
    assert short[0] == pytest.approx(TURN / np.sqrt(12.0), rel=0.02)


def test_states_a_turn_apart_are_equally_far_outside_the_data():
    rng = np.random.default_rng(0)
    states = np.stack([rng.uniform(-1.0, 1.0, 301), rng.uniform(-1.0, 1.0, 301)], axis=1)
    support = training_support(Dataset.from_arrays(PENDULUM, [states], [np.zeros((300, 1))]))
    here, there = (
        Steps.of(PENDULUM, [Trajectory(states + turns * np.array([TURN, 0.0]), np.zeros((300, 1)), 0.05)])
        for turns in (0, 2)
    )
    np.testing.assert_allclose(there.distances(support), here.distances(support), atol=1e-9)
    assert there.share_outside(support) < 0.05


def test_the_line_of_an_angle_breaks_where_it_jumps():
    model = TurnedRound().fit(spinning(), rng=np.random.default_rng(0))
    prediction = assess_prediction({"turned": model}, spinning(), spinning(), protocol=PROTOCOL)
    ax = plot_free_run(prediction, 0, seconds=(0.0, 10.0))
    for line in ax.lines[:1]:
        values = np.asarray(line.get_ydata(), dtype=float)
        assert np.isnan(values).any()
        assert np.nanmax(np.abs(values)) <= np.pi + 1e-9
        assert np.nanmax(np.abs(np.diff(values))) < 1.0
    plt.close(ax.figure)
