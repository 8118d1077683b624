"""Intervals: they must cover as often as they claim, on errors that come in clusters."""

import numpy as np
import pytest

from evaluation.prediction import PERSISTENCE, PredictionProtocol, assess_prediction
from sysid_evo.validation.bootstrap import BlockErrors, draw_blocks, interval
from tests.fixtures.known_models import Sliding, Weak, fitted, recording

CLUSTERS, SIZE = 40, 15


def _covered(errors, blocks, seed):
    resampled = BlockErrors.of(errors, blocks).resampled_n(np.ones(1), 300, seed)
    return interval(resampled, 0.95).spans(1.0)


def test_block_intervals_cover_the_true_error_and_plain_ones_do_not(rng):
    blocks = np.repeat(np.arange(CLUSTERS), SIZE)
    rows = np.arange(CLUSTERS * SIZE)
    by_block, by_row = [], []
    for seed in range(60):
        errors = np.repeat(rng.normal(size=(CLUSTERS, 1)), SIZE, axis=0)
        by_block.append(_covered(errors, blocks, seed))
        by_row.append(_covered(errors, rows, seed))
    assert np.mean(by_block) > 0.8
    assert np.mean(by_row) < 0.6


def test_the_same_seed_draws_the_same_blocks_for_every_model():
    assert (draw_blocks(30, 50, 4) == draw_blocks(30, 50, 4)).all()
    assert (draw_blocks(30, 50, 4) != draw_blocks(30, 50, 5)).any()


def test_a_draw_of_all_blocks_once_is_the_plain_error(rng):
    errors = rng.normal(size=(31, 2))
    blocks = BlockErrors.of(errors, np.arange(31) // 4)
    once = blocks.rmse(np.arange(len(blocks.counts))[None])
    np.testing.assert_allclose(once[0], np.sqrt((errors**2).mean(axis=0)))


def test_an_interval_without_numbers_is_nan():
    assert np.isnan(interval(np.array([np.nan]), 0.95)).all()


def test_an_interval_of_95_per_cent_leaves_a_fortieth_at_either_end():
    assert interval(np.linspace(0.0, 1.0, 1001), 0.95) == pytest.approx((0.025, 0.975))


def test_scores_and_differences_have_intervals_of_95_per_cent():
    models = {"one": fitted(Weak()), "two": fitted(Sliding())}
    prediction = assess_prediction(models, recording(), recording(1, seed=5))
    one, two = (prediction.model(name).score(20) for name in models)
    assert one is not None
    assert two is not None
    assert one.interval == pytest.approx(np.percentile(one.resampled_n, (2.5, 97.5)))
    difference = prediction.compare("one", "two", 20)
    assert difference is not None
    assert difference.interval == pytest.approx(np.percentile(one.resampled_n - two.resampled_n, (2.5, 97.5)))
    assert "95 % intervals" in prediction.cases.protocol.describe(0.05)


def test_a_free_run_of_two_blocks_has_three_draws():
    protocol = PredictionProtocol(block_samples=100, resamples=100)
    test = recording(1, steps=200 + protocol.first)
    score = assess_prediction({}, recording(), test, protocol=protocol).model(PERSISTENCE).free_run
    assert score is not None
    assert len(np.unique(score.resampled_n.round(9))) == 3  # one of them twice, the other twice, both
