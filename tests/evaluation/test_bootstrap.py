"""Intervals: they must cover as often as they claim, on errors that come in clusters."""

from __future__ import annotations

import numpy as np

from evaluation.prediction.bootstrap import BlockErrors, draw_blocks, interval

CLUSTERS, SIZE = 40, 15


def _covered(errors: np.ndarray, blocks: np.ndarray, seed: int) -> bool:
    resampled = BlockErrors.of(errors, blocks).resampled_n(np.ones(1), 300, seed)
    return interval(resampled, 0.95).spans(1.0)


def test_block_intervals_cover_the_true_error_and_plain_ones_do_not(rng: np.random.Generator) -> None:
    blocks = np.repeat(np.arange(CLUSTERS), SIZE)
    rows = np.arange(CLUSTERS * SIZE)
    by_block, by_row = [], []
    for seed in range(60):
        errors = np.repeat(rng.normal(size=(CLUSTERS, 1)), SIZE, axis=0)
        by_block.append(_covered(errors, blocks, seed))
        by_row.append(_covered(errors, rows, seed))
    assert np.mean(by_block) > 0.8
    assert np.mean(by_row) < 0.6


def test_the_same_seed_draws_the_same_blocks_for_every_model() -> None:
    assert (draw_blocks(30, 50, 4) == draw_blocks(30, 50, 4)).all()
    assert (draw_blocks(30, 50, 4) != draw_blocks(30, 50, 5)).any()


def test_a_draw_of_all_blocks_once_is_the_plain_error(rng: np.random.Generator) -> None:
    errors = rng.normal(size=(31, 2))
    blocks = BlockErrors.of(errors, np.arange(31) // 4)
    once = blocks.rmse(np.arange(len(blocks.counts))[None])
    np.testing.assert_allclose(once[0], np.sqrt((errors**2).mean(axis=0)))


def test_an_interval_without_numbers_is_nan() -> None:
    assert np.isnan(interval(np.array([np.nan]), 0.95)).all()
