"""Prediction error: against theory first, then against published figures for the same recording."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from evaluation.plot_style import new_figure
from evaluation.plots import plot_free_run
from evaluation.prediction.cases import PredictionProtocol
from evaluation.prediction.scores import PERSISTENCE
from evaluation.prediction.scoring import assess_prediction
from evaluation.steps import Steps, training_support
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.models import DynamicsModel
from tests.fixtures import known_models as models
from tests.fixtures.known_models import SYSTEM, Known, Weak, fitted, recording
from tests.fixtures.systems import SWING

PROTOCOL = PredictionProtocol()


def assessed(test, **compared):
    """Return the prediction of models by name on ``test``."""
    return assess_prediction(
        {name: fitted(model) for name, model in compared.items()}, recording(), test, protocol=PROTOCOL
    )


def test_a_perfect_model_has_no_error_at_any_horizon_or_in_free_run():
    prediction = assessed(recording(2, seed=9), known=Known())
    assert prediction.names == (PERSISTENCE, "known")
    row = prediction.model("known")
    assert [score.horizon for score in row.scores] == [1, 10, 20, 60]
    for score in (*row.scores, row.free_run):
        assert score.n < 1e-12
        assert score.fit_percent == pytest.approx(100.0)
    assert row.curve.shape == (60,)
    assert row.curve.max() < 1e-12
    assert row.divergence.share == 0.0


def test_the_error_counts_at_the_horizon_where_the_body_moves():
    test = recording(1, steps=200, standstill=60)
    row = assessed(test).model(PERSISTENCE)
    states, moving = test.episodes[0].states, test.moving[0]
    assert not moving.all()
    starts = [k for k in range(5, 200 - 60 + 1, 4) if moving[k]]
    for horizon in (1, 10, 20, 60):
        errors = np.array([states[k] - states[k + horizon] for k in starts if moving[k + horizon]])
        score = row.score(horizon)
        assert score.samples == len(errors)
        np.testing.assert_allclose(score.rmse, np.sqrt((errors**2).mean(axis=0)))
        np.testing.assert_allclose(score.nrmse, score.rmse / states[moving].std(axis=0))
        rms = np.sqrt((states[moving] ** 2).mean(axis=0))
        np.testing.assert_allclose(score.relative_percent, 100 * score.rmse / rms)


def test_the_free_run_starts_once_and_is_scored_to_the_end():
    test = recording(1, steps=120)
    row = assessed(test).model(PERSISTENCE)
    states = test.episodes[0].states
    assert row.free_run.samples == 115
    np.testing.assert_allclose(row.free_run.rmse, np.sqrt(((states[5] - states[6:]) ** 2).mean(axis=0)))


def test_the_curve_passes_through_the_scores():
    row = assessed(recording(2, seed=3)).model(PERSISTENCE)
    for score in row.scores:
        assert row.curve[score.horizon - 1] == pytest.approx(score.n)


def test_identical_models_have_no_significant_difference():
    prediction = assessed(recording(2, seed=5), one=Weak(), two=Weak())
    for horizon in prediction.horizons:
        difference = prediction.compare("one", "two", horizon)
        assert difference.difference.value == 0.0
        assert difference.verdict == "no significant difference"


def test_a_better_model_is_significantly_better():
    prediction = assessed(recording(2, seed=5), weak=Weak(), known=Known())
    difference = prediction.compare("weak", "known", 20)
    assert difference.difference.value > 0
    assert difference.verdict == "known better than weak"
    assert prediction.ranking(20)[0].name == "known"
    others = [(one.first, one.second) for one in prediction.differences(20)]
    assert sorted(others) == [("persistence", "known"), ("weak", "known")]
    assert prediction.facts()["scored over"] == "1 steps, 10 steps, 20 steps, 60 steps, whole episodes"


def test_a_model_that_doubles_reaches_the_guard_at_the_time_of_theory():
    prediction = assessed(recording(1, seed=5), exploding=models.Exploding())
    row, cases = prediction.model("exploding"), prediction.cases
    envelope = fitted(models.Exploding()).state_bounds
    limit = np.minimum(cases.guard[1], np.minimum(envelope[1], -envelope[0]))
    steps = np.log2(limit / np.abs(cases.test.episodes[0].states[cases.protocol.first])).min()
    assert row.divergence.free_run_times[0] == pytest.approx(np.ceil(steps) * 0.05, abs=0.051)
    assert row.divergence.share > 0.95
    assert all(np.isfinite(score.n) for score in row.scores)


def test_a_model_that_is_not_a_number_is_scored_at_the_guard():
    row = assessed(recording(1), undefined=models.Undefined()).model("undefined")
    assert row.divergence.share == 1.0
    assert row.divergence.median_time == pytest.approx(0.05)
    assert all(np.isfinite(score.n) for score in row.scores)


def test_horizons_longer_than_every_episode_are_left_out_with_a_note():
    prediction = assessed(recording(2, steps=30), known=Known())
    assert prediction.cases.horizons == (1, 10, 20)
    assert any("horizon 60 left out" in note for note in prediction.cases.notes)
    assert prediction.model("known").curve.shape == (20,)


def test_an_episode_too_short_for_anything_leaves_only_notes():
    prediction = assessed(recording(1, steps=5), known=Known())
    assert prediction.horizons == ()
    assert prediction.model("known").scores == ()
    assert prediction.model("known").free_run is None
    assert any("no simulation of whole episode" in note for note in prediction.cases.notes)


def test_a_broken_model_is_a_row_with_its_reason_and_the_others_go_on():
    prediction = assessed(recording(1), broken=models.Broken(), known=Known())
    reason = prediction.model("broken").reason
    assert reason.startswith("RuntimeError: the network is not there (known_models.py, line ")
    assert prediction.model("broken").curve.shape == (0,)
    assert prediction.model("broken").curve_interval.shape == (2, 0)
    assert prediction.compare("broken", "known", 1) is prediction.compare("known", "broken", 1) is None
    assert prediction.model("known").scores


def test_ctrl_c_while_a_model_predicts_ends_the_assessment():
    with pytest.raises(KeyboardInterrupt):
        assessed(recording(1), stopped=models.Stopped())


def test_a_model_that_uses_more_history_gets_it_padded_with_a_note():
    row = assessed(recording(1), long=models.Remembering()).model("long")
    assert row.scores[0].n < 1e-12
    assert "padded" in row.notes[0]


def test_a_constant_channel_is_left_out_of_n_with_a_note():
    states = recording(1).episodes[0].states.copy()
    states[:, 1] = 0.0
    test = Dataset.from_arrays(SYSTEM, [states], [recording(1).episodes[0].controls])
    prediction = assessed(test, weak=Weak())
    assert any("lateral_speed is constant" in note for note in prediction.cases.notes)
    assert np.isfinite(prediction.model("weak").scores[0].n)


def test_a_test_set_without_motion_is_refused():
    still = Dataset.from_arrays(SYSTEM, [np.zeros((100, 3))], [np.zeros((99, 2))])
    with pytest.raises(InvalidData, match="nothing moves in"):
        assess_prediction({}, recording(), still)


def test_a_protocol_that_makes_no_sense_is_refused():
    with pytest.raises(InvalidArgument, match="horizons"):
        PredictionProtocol(horizons=(0,))
    with pytest.raises(InvalidArgument, match="history"):
        PredictionProtocol(history=6, first=5)


def test_persistence_on_the_slippery_log_scores_the_published_figures(slippery):
    row = assess_prediction({}, *slippery, protocol=PROTOCOL).model(PERSISTENCE)
    assert [round(score.n, 3) for score in row.scores] == [0.197, 1.127, 1.339, 1.447]
    assert row.free_run.n == pytest.approx(1.903, abs=5e-4)
    assert row.scores[2].estimate.interval == pytest.approx((1.19, 1.48), abs=0.04)


TURN = 2.0 * np.pi
OF_ANGLES = PredictionProtocol()


class TurnedRound(DynamicsModel):
    """Predicts a pendulum that spins evenly, exactly, but one whole turn away from where it is."""

    def fit(self, dataset, **keywords):
        return self

    def next_state(self, carry, control):
        return carry + np.array([0.05, 0.0]) * carry[:, 1:] + np.array([TURN, 0.0])


def spinning(steps=200):
    rate = np.full(steps + 1, 2.0)
    angle = 3.0 + np.cumsum(0.05 * rate)
    return Dataset.from_arrays(SWING, [np.stack([angle, rate], axis=1)], [np.zeros((steps, 1))])


def turned_round():
    model = TurnedRound().fit(spinning(), rng=np.random.default_rng(0))
    return assess_prediction({"turned": model}, spinning(), spinning(), protocol=OF_ANGLES)


def test_a_prediction_that_is_a_whole_turn_away_is_right():
    row = turned_round().model("turned")
    for score in (*row.scores, row.free_run):
        assert score.rmse[0] < 1e-9
    assert row.curve.max() < 1e-9
    assert row.divergence.share == 0.0, "the guard must not stop an angle that turns on"


def test_the_error_of_persistence_is_the_short_way_round():
    row = assess_prediction({}, spinning(), spinning(), protocol=OF_ANGLES).model(PERSISTENCE)
    for score in row.scores:
        off = 0.1 * score.horizon
        assert score.rmse[0] == pytest.approx(abs(off - TURN * np.round(off / TURN)))


def test_the_spread_of_an_angle_does_not_grow_with_its_turns():
    short, long = (assess_prediction({}, spinning(), spinning(n), protocol=OF_ANGLES).cases.std for n in (126, 1260))
    assert short[0] == pytest.approx(long[0], rel=0.01)
    assert short[0] == pytest.approx(TURN / np.sqrt(12.0), rel=0.02)


def test_states_a_turn_apart_are_equally_far_outside_the_data():
    rng = np.random.default_rng(0)
    states = rng.uniform(-1.0, 1.0, (301, 2))
    support = training_support(Dataset.from_arrays(SWING, [states], [np.zeros((300, 1))]))
    here, there = (
        Steps.of(SWING, [Trajectory(states + turns * np.array([TURN, 0.0]), np.zeros((300, 1)), 0.05)])
        for turns in (0, 2)
    )
    np.testing.assert_allclose(there.distances(support), here.distances(support), atol=1e-9)
    assert there.share_outside(support) < 0.05


def test_the_line_of_an_angle_breaks_where_it_jumps():
    ax = plot_free_run(turned_round(), 0, new_figure(4.0, 3.0).add_subplot(), models=["turned"])
    values = np.asarray(ax.lines[0].get_ydata(), dtype=float)
    assert np.isnan(values).any()
    assert np.nanmax(np.abs(values)) <= np.pi + 1e-9
    assert np.nanmax(np.abs(np.diff(values))) < 1.0
    plt.close(ax.figure)
