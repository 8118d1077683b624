"""The gate: what is held back, what counts as better, and how much is asked of short data."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.models.adaptation.selection import decided
from sysid_evo.validation.acceptance import Held, Kind, Trial, failed, judged, surely_positive
from sysid_evo.validation.folds import blocks_of
from tests.fixtures.systems import FloorCar, drive


def test_a_window_is_never_on_both_sides_and_every_block_is_held_back_once():
    first = np.arange(0, 580, 3)
    blocks = blocks_of(first, 20)
    held_back = np.array([block.held(first) for block in blocks])
    learned = np.array([block.learned(first) for block in blocks])
    assert len(blocks) == 3
    assert not (held_back & learned).any()
    assert (held_back.sum(axis=0) <= 1).all()
    for block, inside, outside in zip(blocks, held_back, learned, strict=True):
        assert (first[inside] >= block.low).all()
        assert not ((first[outside] < block.high) & (first[outside] + 20 > block.low)).any()


def test_the_rest_of_a_recording_is_all_but_the_block():
    data = drive(FloorCar(), seconds=10.0, seed=0)
    first = np.arange(0, 180)
    for block in blocks_of(first, 20):
        assert block.rest(data).n_steps == 200 - (block.high - block.low)


def held(errors):
    """Runs of which two begin in each second."""
    return Held(errors, np.arange(len(errors)) // 2)


@pytest.mark.parametrize(
    ("error", "sure", "chosen"), [(0.8, True, "a"), (0.8, False, "none"), (0.9, True, "none"), (1.2, False, "none")]
)
def test_a_correction_counts_only_if_it_is_much_better_and_surely(error, sure, chosen):
    assert decided([Trial("a", error, (error,) * 3, sure), Trial("b", 0.99, (0.9,) * 3, True)]) == chosen


@pytest.mark.parametrize(("in_one", "chosen"), [(1.1, "none"), (0.97, "none"), (0.93, "a")])
def test_a_correction_that_is_no_better_in_one_block_does_not_count(in_one, chosen):
    assert decided([Trial("a", 0.5, (0.2, 0.3, in_one), True)]) == chosen


def test_of_corrections_about_as_good_the_simplest_is_taken():
    shares = {"strong": 0.62, "weak": 0.52, "weaker": 0.5}
    assert decided([Trial(name, share, (share,) * 3, True) for name, share in shares.items()]) == "weak"


@pytest.mark.parametrize("kind", ["further", "mean"])
def test_more_training_or_a_mean_is_taken_if_it_is_better_than_the_simplest_that_is_about_as_good(kind):
    shares = {"weak": 0.52, "weaker": 0.5}
    others = [Trial(name, share, (share,) * 3, True) for name, share in shares.items()]
    for error, chosen in ((0.51, "other"), (0.53, "weak")):
        assert decided([*others, Trial("other", error, (error,) * 3, True, kind)]) == chosen


@pytest.mark.parametrize("kind", ["further", "mean"])
def test_of_more_training_the_best_is_taken(kind):
    assert decided([Trial(f"{error}", error, (error,) * 3, True, kind) for error in (0.501, 0.5, 0.502)]) == "0.5"


@pytest.mark.parametrize(
    ("t", "believed"), [(2.0, ""), (2.4, "alone beside"), (2.55, "alone beside"), (2.7, "alone beside further mean")]
)
def test_more_training_must_be_surer_than_a_correction(t, believed):
    """Of 15 seconds Student's t is 2.14 at 97.5 % and 2.62 at 99 %."""
    apart = np.tile([0.3, -0.3, 0.1, -0.1, 0.0], 3)
    gains = apart + t * apart.std(ddof=1) / np.sqrt(15)
    plain = [np.full((10, 5, 2), np.sqrt(2.0))] * 3
    better = [np.repeat(np.sqrt(2.0 - part), 2)[:, None, None] * np.ones((10, 5, 2)) for part in np.split(gains, 3)]
    kinds: tuple[Kind, ...] = ("alone", "beside", "further", "mean")
    sure = [kind for kind in kinds if judged("a", list(map(held, plain)), list(map(held, better)), kind).sure]
    assert " ".join(sure) == believed


def test_a_mean_is_taken_if_it_is_good_and_better_than_more_training():
    most = Trial("most", 0.5, (0.5,) * 3, True, "further")
    assert decided([most, Trial("mean", 0.49, (0.49,) * 3, True, "mean")]) == "mean"
    assert decided([most, Trial("mean", 0.51, (0.51,) * 3, True, "mean")]) == "most"
    assert decided([most, Trial("mean", 0.4, (0.1, 0.1, 1.0), True, "mean")]) == "most"


@pytest.mark.parametrize(("error", "chosen"), [(0.43, "b and anew"), (0.45, "anew"), (0.38, "b and anew")])
def test_another_fit_gives_way_to_its_mean_with_a_correction_that_is_about_as_good(error, chosen):
    trials = [Trial("b", 0.6, (0.6,) * 3, True), Trial("anew", 0.4, (0.4,) * 3, True)]
    trials.append(Trial("b and anew", error, (error,) * 3, True, "beside"))
    assert decided(trials) == chosen


def test_the_mean_of_a_fit_that_is_not_taken_is_none():
    trials = [Trial("b", 0.6, (0.6,) * 3, True), Trial("anew", 0.58, (0.58,) * 3, True)]
    assert decided([*trials, Trial("b and anew", 0.4, (0.4,) * 3, True, "beside")]) == "b"
    assert decided([trials[1], Trial("b and anew", 0.6, (0.6, 0.6, 1.1), True, "beside")]) == "anew"


def test_half_the_error_in_every_second_is_a_share_of_a_half_and_sure():
    plain = [np.full((8, 5, 2), size) for size in (1.0, 2.0)]
    trial = judged("half", [held(one) for one in plain], [held(0.5 * one) for one in plain])
    assert trial.error == pytest.approx(0.5)
    assert trial.each == pytest.approx((0.5, 0.5))
    assert trial.good


def test_an_error_that_is_lower_in_one_second_alone_is_not_surely_lower():
    before, after = np.ones((12, 5, 2)), np.ones((12, 5, 2))
    before[:2] = 10.0
    trial = judged("luck", [held(before)], [held(after)])
    assert trial.error < 0.5
    assert not trial.good


def test_fewer_seconds_must_show_more():
    gains = np.array([1.0, 3.0, -0.6])
    assert not surely_positive(gains)
    assert surely_positive(np.tile(gains, 5))
    assert not surely_positive(np.array([1.0, 1.0]))


@pytest.mark.parametrize(("seconds", "share"), [(4, 0.5), (25, 0.2), (100, 0.15)])
def test_of_more_training_more_is_asked_the_fewer_seconds_are_compared(seconds, share):
    plain = [held(np.ones((2 * seconds, 5, 2)))]
    better = [held(np.full((2 * seconds, 5, 2), 0.6))]
    kinds: tuple[Kind, ...] = ("alone", "beside", "further", "mean")
    assert [judged("a", plain, better, kind).asked for kind in kinds] == pytest.approx([0.15, 0.15, share, share])
    for error, good in ((1.0 - share + 0.001, False), (1.0 - share, True)):
        assert Trial("a", error, (0.5,), True, "further", share).good == good


@pytest.mark.parametrize(("last", "no_good"), [(0.949, False), (0.951, True)])
def test_what_is_hardly_better_in_one_block_has_failed_in_those_that_it_knows(last, no_good):
    plain = [np.ones((8, 5, 2))] * 3
    seen = [held(0.2 * plain[0]), held(last * plain[1])]
    assert failed(list(map(held, plain)), seen) == no_good
    assert judged("a", list(map(held, plain)), seen).each == pytest.approx((0.2, last))
