"""What one-step errors tell: white noise is called white, and an input that a model lacks is found."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from evaluation.prediction.cases import PredictionProtocol
from evaluation.prediction.regions import Region, candidate_regions, worst_region
from evaluation.prediction.residuals import AHEAD, LAGS, MOST_STEPS, OneStepErrors, analyse_residuals, step_errors
from evaluation.prediction.scores import ModelPrediction
from evaluation.prediction.scoring import assess_prediction
from evaluation.storage import load_result, save_result
from sysid_evo.data import Dataset
from sysid_evo.testing.examples import pendulum
from sysid_evo.validation.estimates import Draws, drawn_rms
from tests.fixtures.known_models import SYSTEM, Known, LosesGrip, Remembering, Sliding, Weak, fitted, noisy, recording

STEPS = 400


def held(rng, steps=STEPS):
    """Return a control (steps, 1) that changes every ten steps."""
    return np.repeat(rng.uniform(-1.0, 1.0, (steps // 10 + 1, 1)), 10, axis=0)[:steps]


def filtered(noise, share):
    """Return noise of which every sample keeps a ``share`` of the one before."""
    return lfilter([1.0], [1.0, -share], noise, axis=0)


def analysed(errors, controls):
    return analyse_residuals(OneStepErrors(errors, errors, controls))


def called_coloured(draws, loud, share=0.0):
    rng, found = np.random.default_rng(4), []
    for _ in range(draws):
        noise = filtered(rng.standard_normal((STEPS, 1)), share)
        controls = held(rng)
        noise = noise * np.where(np.abs(controls) > 0.7, 4.0, 1.0) if loud else noise
        found.append(not analysed(noise, controls).white[0])
    return float(np.mean(found))


@pytest.mark.parametrize("loud", [False, True], ids=["equally loud", "louder under strong controls"])
@pytest.mark.parametrize(("draws", "most"), [(100, 0.1), pytest.param(200, 0.09, marks=pytest.mark.nightly)])
def test_white_noise_is_called_white_nineteen_times_of_twenty(draws, most, loud):
    assert 0.01 <= called_coloured(draws, loud) <= most


def test_noise_that_remembers_a_third_of_itself_is_never_called_white():
    assert called_coloured(100, False, 0.33) > 0.95


def test_the_autocorrelation_is_that_of_theory():
    noise = filtered(np.random.default_rng(0).standard_normal((20_000, 1)), 0.5)
    found = analysed(noise, noise)
    np.testing.assert_allclose(found.autocorrelation[:4, 0], 0.5 ** np.arange(1, 5), atol=0.03)
    assert found.largest_lag(0) == 1
    np.testing.assert_allclose(found.band[-1, 0], 1.96 / np.sqrt(20_000), rtol=0.2)


def test_a_control_that_acts_later_than_the_model_knows_is_found_with_its_lag():
    rng = np.random.default_rng(1)
    controls = rng.uniform(-1.0, 1.0, (1200, 2))
    errors = rng.standard_normal((1200, 1))
    errors[6:, 0] += 0.8 * controls[:-6, 1]
    found = analysed(errors, controls)
    assert found.control_lag(1, 0) == 6
    assert found.cross_p[1, 0] < 0.001
    assert found.cross_p[0, 0] > 0.05
    assert found.cross[AHEAD + 6, 1, 0] == pytest.approx(0.8 / np.sqrt(3.0), abs=0.15)


def test_a_driver_who_reacts_to_noise_is_no_missing_control():
    rng = np.random.default_rng(2)
    errors = rng.standard_normal((STEPS, 1))
    controls = np.concatenate([np.zeros((2, 1)), errors[:-2]]) + 0.1 * rng.standard_normal((STEPS, 1))
    found = analysed(errors, controls)
    assert abs(found.cross[AHEAD - 2, 0, 0]) > 0.9
    assert found.cross_p[0, 0] > 0.05


def test_an_unrelated_control_is_rarely_taken_for_a_missing_one_although_both_change_slowly():
    rng, found = np.random.default_rng(3), []
    for _ in range(100):
        errors = filtered(rng.standard_normal((800, 1)), 0.6)
        found.append(analysed(errors, held(rng, 800)).cross_p[0, 0] < 0.05)
    assert np.mean(found) <= 0.09


def test_steps_are_those_of_the_recording_and_episodes_do_not_touch():
    data = recording(2, steps=60)
    steps = step_errors(fitted(Weak()), data)
    episode = data.episodes[1]
    begin = 61 + LAGS
    np.testing.assert_array_equal(steps.controls[begin : begin + 60], episode.controls)
    expected = episode.states[1:] - fitted(Weak()).next_state(episode.states[:-1], episode.controls)
    np.testing.assert_allclose(steps.errors[begin : begin + 60], expected, atol=1e-12)
    assert steps.scored.sum() == 120
    assert not steps.scored[60 : 60 + LAGS].any()


def test_steps_without_motion_and_without_the_history_that_a_model_wants_are_left_out():
    data = recording(1, steps=200, standstill=60)
    assert step_errors(fitted(Known()), data).scored.sum() == (data.moving[0][:-1] & data.moving[0][1:]).sum()
    assert step_errors(fitted(Remembering()), recording(1, steps=60)).scored.sum() == 52
    assert step_errors(fitted(Known()), recording(1, steps=60), first=20).scored.sum() == 40


def test_of_a_long_recording_pieces_are_looked_at():
    rng = np.random.default_rng(0)
    data = Dataset.from_arrays(SYSTEM, rng.uniform(-1, 1, (50_001, 3)), rng.uniform(-1, 1, (50_000, 2)))
    scored = step_errors(fitted(Known(), data), data).scored
    assert scored.sum() == MOST_STEPS
    assert scored[-2000 - LAGS - 1 :].sum() == 2000


def test_too_few_steps_for_a_band_have_no_missing_control():
    rng = np.random.default_rng(0)
    found = analyse_residuals(
        OneStepErrors(rng.standard_normal((60, 1)), np.zeros((60, 1)), rng.standard_normal((60, 2)))
    )
    assert np.isnan(found.cross_p).all()
    assert found.cross.shape == (AHEAD + 1 + LAGS, 2, 1)


PROTOCOL = PredictionProtocol(horizons=(1, 10, 20))


def assessed(model, test):
    return assess_prediction({"model": fitted(model)}, recording(), test, protocol=PROTOCOL).model("model")


def test_the_region_where_a_model_fails_is_named_with_its_size():
    row = assessed(LosesGrip(), noisy(2, 4))
    worst = worst_region(row.regions)
    assert (worst.region.channel, worst.region.kind) == ("forward_speed", "above")
    assert worst.ratio.value > 1.3
    assert worst.words.startswith(f"with forward_speed above {worst.region.limit:.2g} m/s, N is 1.")
    assert worst.n == pytest.approx(worst.ratio.value * row.curve[4])
    assert worst.share == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize(("draws", "most"), [(5, 0), pytest.param(15, 1, marks=pytest.mark.nightly)])
def test_a_model_that_is_equally_wrong_everywhere_rarely_has_a_worst_region(draws, most):
    found = [worst_region(assessed(Known(), noisy(seed, 1)).regions) for seed in range(draws)]
    assert sum(one is not None for one in found) <= most


def regions(states, controls):
    return {region.words: (region, inside) for region, inside in candidate_regions(pendulum(), states, controls)}


def test_regions_are_cut_by_value_where_there_are_few_and_on_both_sides_of_neutral():
    rng = np.random.default_rng(0)
    states = np.column_stack([rng.uniform(-9.0, 9.0, 500), rng.uniform(2.0, 3.0, 500)])
    controls = rng.choice([-2.0, 0.0, 2.0], (500, 1))
    found = regions(states, controls)
    at = [words for words in found if words.startswith("torque")]
    assert at == ["torque at -2 N m", "torque at 0 N m", "torque at 2 N m"]
    (beyond,) = [words for words in found if "|angle| above" in words]
    assert found[beyond][1].mean() == pytest.approx(0.2, abs=0.01)
    assert not any("|angular_speed|" in words for words in found)
    assert found["torque at 2 N m"][1].sum() == (controls == 2.0).sum()
    assert Region("tilt", "rad", "beyond", 0.5, 1.0).words == "|tilt - 1| above 0.5 rad"


def test_no_region_is_beyond_the_end_of_its_channel():
    torque, rng = pendulum().controls[0], np.random.default_rng(0)
    controls = np.clip(rng.normal(0.0, 3.0, (500, 1)), torque.low, torque.high)
    found = regions(rng.uniform(-1.0, 1.0, (500, 2)), controls)
    ends = [words for words, (region, _) in found.items() if region.channel == "torque"]
    assert ends == ["torque at -2 N m", "torque at 2 N m", "|torque| at 2 N m"]
    assert sum(region.end for region, _ in found.values()) == 3


def test_each_episode_has_its_own_error():
    easy, hard = recording(1, seed=5), noisy(6, 1)
    test = easy.with_episodes([easy.episodes[0], replace(hard.episodes[0], name="hard")])
    row = assessed(Known(), test)
    assert [episode.name for episode in row.episodes] == ["episode-0", "hard"]
    assert row.episodes[0].n.max() < 1e-9
    assert row.episodes[1].n.min() > 0.05


def test_the_fit_is_that_of_matlab():
    test = recording(1, seed=5)
    row = assessed(Weak(), test)
    measured = test.episodes[0].states[6:]
    off = np.linalg.norm(measured - row.free_states[0], axis=0)
    of_the_mean = np.linalg.norm(measured - measured.mean(axis=0), axis=0)
    np.testing.assert_allclose(row.episodes[0].fit, 100.0 * (1.0 - off / of_the_mean))


def test_the_interval_of_the_curve_is_that_of_the_scores():
    row = assessed(Weak(), noisy(3))
    assert row.curve_interval.shape == (2, 20)
    for score in row.scores:
        assert row.curve_interval[:, score.horizon - 1] == pytest.approx(score.estimate.interval)
    assert (row.curve_interval[0] < row.curve).all()
    assert (row.curve < row.curve_interval[1]).all()


def test_two_equally_good_models_have_no_significant_difference_nineteen_times_of_twenty():
    rng, blocks, found = np.random.default_rng(7), np.repeat(np.arange(40), 15), []
    for seed in range(100):
        errors = (np.repeat(rng.normal(size=(40, 1)), 15, axis=0) for _ in range(2))
        one, other = (Draws(drawn_rms(each, blocks, seed=seed)[:, 0], 40) for each in errors)
        found.append(not (one - other).estimate.differs_from(0.0))
    assert 0.87 <= np.mean(found) <= 0.99


def test_what_is_stored_comes_back(tmp_path):
    row = assessed(Sliding(), noisy(4))
    save_result(row, tmp_path / "row")
    again = load_result(ModelPrediction, tmp_path / "row")
    for name in ("autocorrelation", "band", "white_p", "cross", "cross_band", "cross_p"):
        np.testing.assert_array_equal(getattr(again.residuals, name), getattr(row.residuals, name))
    assert again.residuals.samples == row.residuals.samples
    assert again.regions == row.regions
    np.testing.assert_array_equal(again.curve_interval, row.curve_interval)
    assert [episode.name for episode in again.episodes] == [episode.name for episode in row.episodes]
    np.testing.assert_array_equal(again.episodes[0].fit, row.episodes[0].fit)
    for found, kept in zip((*again.scores, again.free_run), (*row.scores, row.free_run), strict=True):
        assert (found.horizon, found.samples, found.estimate) == (kept.horizon, kept.samples, kept.estimate)
    failed = ModelPrediction("failed", "linear")  # no free run, no residuals
    save_result(failed, tmp_path / "failed")
    again = load_result(ModelPrediction, tmp_path / "failed")
    assert again.free_run is again.residuals is None
