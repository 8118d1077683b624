"""What one-step errors tell: white noise is called white, and an input that a model lacks is found."""

import numpy as np
import pytest

from evaluation.prediction import StepErrors, analyse, step_errors
from evaluation.prediction.residuals import AHEAD, LAGS, MOST_STEPS
from tests.fixtures.known_models import SYSTEM, Known, Remembering, Weak, fitted, recording

STEPS, SEEDS = 400, 200


def held(rng, steps=STEPS):
    """Return a control (steps, 1) that changes every ten steps."""
    return np.repeat(rng.uniform(-1.0, 1.0, (steps // 10 + 1, 1)), 10, axis=0)[:steps]


def filtered(noise, share):
    """Return noise of which every sample keeps a ``share`` of the one before."""
    coloured = noise.copy()
    for k in range(1, len(noise)):
        coloured[k] += share * coloured[k - 1]
    return coloured


def called_coloured(loud, share=0.0):
    rng, found = np.random.default_rng(4), []
    for _ in range(SEEDS):
        noise = filtered(rng.standard_normal((STEPS, 1)), share)
        controls = held(rng)
        noise = noise * np.where(np.abs(controls) > 0.7, 4.0, 1.0) if loud else noise
        found.append(not analyse(StepErrors(noise, noise, controls)).white[0])
    return float(np.mean(found))


@pytest.mark.parametrize("loud", [False, True], ids=["equally loud", "louder under strong controls"])
def test_white_noise_is_called_white_nineteen_times_of_twenty(loud):
    assert 0.01 <= called_coloured(loud) <= 0.09


def test_noise_that_remembers_a_third_of_itself_is_never_called_white():
    assert called_coloured(False, 0.33) > 0.95


def test_the_autocorrelation_is_that_of_theory():
    noise = filtered(np.random.default_rng(0).standard_normal((20_000, 1)), 0.5)
    found = analyse(StepErrors(noise, noise, noise))
    np.testing.assert_allclose(found.autocorrelation[:4, 0], 0.5 ** np.arange(1, 5), atol=0.03)
    assert found.largest_lag(0) == 1
    np.testing.assert_allclose(found.band[-1, 0], 1.96 / np.sqrt(20_000), rtol=0.2)


def test_a_control_that_acts_later_than_the_model_knows_is_found_with_its_lag():
    rng = np.random.default_rng(1)
    controls = rng.uniform(-1.0, 1.0, (1200, 2))
    errors = rng.standard_normal((1200, 1))
    errors[6:, 0] += 0.8 * controls[:-6, 1]
    found = analyse(StepErrors(errors, errors, controls))
    assert found.control_lag(1, 0) == 6
    assert found.cross_p[1, 0] < 0.001
    assert found.cross_p[0, 0] > 0.05
    assert found.cross_at(6)[1, 0] == pytest.approx(0.8 / np.sqrt(3.0), abs=0.15)


def test_a_driver_who_reacts_to_noise_is_no_missing_control():
    rng = np.random.default_rng(2)
    errors = rng.standard_normal((STEPS, 1))
    controls = np.concatenate([np.zeros((2, 1)), errors[:-2]]) + 0.1 * rng.standard_normal((STEPS, 1))
    found = analyse(StepErrors(errors, errors, controls))
    assert abs(found.cross_at(-2)[0, 0]) > 0.9
    assert found.cross_p[0, 0] > 0.05


def test_an_unrelated_control_is_rarely_taken_for_a_missing_one_although_both_change_slowly():
    rng, found = np.random.default_rng(3), []
    for _ in range(100):
        errors = filtered(rng.standard_normal((800, 1)), 0.6)
        found.append(analyse(StepErrors(errors, errors, held(rng, 800))).cross_p[0, 0] < 0.05)
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
    data = type(recording(1)).from_arrays(SYSTEM, rng.uniform(-1, 1, (50_001, 3)), rng.uniform(-1, 1, (50_000, 2)))
    scored = step_errors(fitted(Known(), data), data).scored
    assert scored.sum() == MOST_STEPS
    assert scored[-2000 - LAGS - 1 :].sum() == 2000


def test_too_few_steps_for_a_band_have_no_missing_control():
    rng = np.random.default_rng(0)
    found = analyse(StepErrors(rng.standard_normal((60, 1)), np.zeros((60, 1)), rng.standard_normal((60, 2))))
    assert np.isnan(found.cross_p).all()
    assert found.cross.shape == (AHEAD + 1 + LAGS, 2, 1)
