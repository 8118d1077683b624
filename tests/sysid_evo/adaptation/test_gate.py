"""The gate: what is held back, what counts as better, and how much is asked of short data."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.adaptation.gate import Trial, blocks_of, decided, judged, needed

from .cars import FloorCar, drive


def test_a_window_is_never_on_both_sides_and_every_block_is_held_back_once() -> None:
    first = np.arange(0, 580, 3)
    blocks = blocks_of(first, 20)
    held = np.array([block.held(first) for block in blocks])
    learned = np.array([block.learned(first) for block in blocks])
    assert len(blocks) == 3
    assert not (held & learned).any()
    assert (held.sum(axis=0) <= 1).all()
    for block, inside, outside in zip(blocks, held, learned, strict=True):
        assert (first[inside] >= block.low).all()
        assert not ((first[outside] < block.high) & (first[outside] + 20 > block.low)).any()


def test_the_rest_of_a_recording_is_all_but_the_block() -> None:
    data = drive(FloorCar(), seconds=10.0, seed=0)
    first = np.arange(0, 180)
    for block in blocks_of(first, 20):
        assert block.rest(data).n_steps == 200 - (block.high - block.low)


@pytest.mark.parametrize(
    ("error", "each", "chosen"),
    [
        (0.85, (0.8, 0.9, 0.85), "a"),
        (0.95, (0.9, 0.95, 0.99), "none"),
        (0.80, (0.5, 0.8, 1.1), "none"),
    ],
)
def test_a_correction_counts_only_if_it_is_much_better_and_nowhere_worse(
    error: float, each: tuple[float, ...], chosen: str
) -> None:
    assert decided([Trial("a", error, each), Trial("b", 0.99, (0.98, 0.99, 0.99))], needed(30.0)) == chosen


def test_more_is_asked_of_shorter_data() -> None:
    assert needed(60.0) == needed(30.0) == pytest.approx(0.1)
    assert needed(10.0) > needed(20.0) > 0.1


def test_half_the_error_is_a_share_of_a_half() -> None:
    plain = [np.ones((4, 5, 2)), 2.0 * np.ones((4, 5, 2))]
    trial = judged("half", plain, [0.5 * one for one in plain])
    assert trial.error == pytest.approx(0.5)
    assert trial.each == pytest.approx((0.5, 0.5))
