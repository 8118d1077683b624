"""Intervals: they must cover as often as they claim, of few blocks and of errors that come in clusters."""

import numpy as np
import pytest
from scipy.stats import norm, t

from evaluation.prediction.cases import PredictionProtocol
from evaluation.prediction.scores import PERSISTENCE
from evaluation.prediction.scoring import assess_prediction
from sysid_evo.validation.estimates import (
    CONFIDENCE,
    Draws,
    Estimate,
    across,
    draw_blocks,
    drawn_rms,
    drawn_sums,
    paired,
    standard_errors,
)
from tests.fixtures.known_models import Sliding, Weak, fitted, recording

CLUSTERS, SIZE = 40, 15


def held(found, truth):
    return not found.differs_from(truth)


@pytest.mark.parametrize("count", [2, 3, 10, 100])
def test_an_interval_is_students_of_the_means_of_blocks(rng, count):
    """But for the draws, by which the standard error is off by some per cent."""
    means = rng.normal(size=count)
    found = paired(np.repeat(means, 4), np.repeat(np.arange(count), 4))
    error = means.std(ddof=1) / np.sqrt(count)
    assert found.value == pytest.approx(means.mean())
    assert found.standard_error == pytest.approx(error, rel=0.08)
    reach = t.ppf(0.5 + CONFIDENCE / 2, count - 1) * found.standard_error
    assert found.interval == pytest.approx((found.value - reach, found.value + reach))


@pytest.mark.parametrize("count", [2, 4, 10])
def test_of_few_blocks_nineteen_of_twenty_intervals_hold_the_truth(rng, count):
    share = np.mean([held(paired(rng.normal(size=count)), 0.0) for _ in range(500)])
    assert 0.925 <= share <= 0.98


def test_intervals_over_blocks_hold_the_true_error_and_those_over_rows_do_not(rng):
    blocks = np.repeat(np.arange(CLUSTERS), SIZE)
    rows = np.arange(CLUSTERS * SIZE)
    by_block, by_row = [], []
    for _ in range(40):
        errors = np.repeat(rng.normal(size=(CLUSTERS, 1)), SIZE, axis=0)
        for found, numbers in ((by_block, blocks), (by_row, rows)):
            drawn = Draws(drawn_rms(errors, numbers)[:, 0], len(np.unique(numbers)))
            found.append(held(drawn.estimate, 1.0))
    assert np.mean(by_block) > 0.85
    assert np.mean(by_row) < 0.6


def test_what_hangs_together_is_drawn_together():
    """Of a difference that is the same in every block there is no uncertainty, however much both vary."""
    luck = np.random.default_rng(0).normal(size=30)
    one, other = (Draws.of(rows[:, None], np.arange(30), lambda sums: sums[:, 0]) for rows in (luck, luck - 0.1))
    assert one.estimate.standard_error > 1.0
    assert (one - other).estimate.interval == pytest.approx((3.0, 3.0))
    assert (one / one).estimate.interval == pytest.approx((1.0, 1.0))
    assert Draws.joined([one, None, other, other], np.median).value == other.value
    assert Draws.joined([None]) is None


def test_of_figures_over_other_numbers_of_blocks_the_fewest_count(rng):
    many, few = (Draws.of(rng.normal(size=(n, 1)), np.arange(n), lambda sums: sums[:, 0]) for n in (40, 5))
    assert (many - few).blocks == (few / many).blocks == Draws.joined([many, few]).blocks == 5
    high = Draws(np.exp(many.values), 40).times(Draws(np.exp(few.values), 5)).high
    assert high == pytest.approx(np.exp((many - few).estimate.high))
    apart = np.hypot(many.estimate.standard_error, few.estimate.standard_error)
    assert (many - few).estimate.standard_error == pytest.approx(apart, rel=0.3)


def test_how_many_times_one_error_is_another_holds_as_often_on_either_side(rng):
    missed = []
    for _ in range(300):
        one, other = (Draws(drawn_rms(rng.normal(size=(8, 1)), np.arange(8), seed=s)[:, 0], 8) for s in (1, 2))
        found = one.times(other)
        assert found.value == pytest.approx(one.value / other.value)
        assert np.log(found.high / found.value) == pytest.approx(t.ppf(0.975, 7) * found.standard_error / found.value)
        missed.append((found.low > 1.0) - (found.high < 1.0))
    assert 0.9 <= np.mean(np.equal(missed, 0)) <= 0.99
    assert abs(np.mean(missed)) < 0.03


def test_intervals_of_several_figures_hold_together():
    """Of twenty looked at, each is as wide as one of 99.75 %."""
    drawn = Draws(np.concatenate([[0.0], norm.ppf((np.arange(1000) + 0.5) / 1000)]), 10**9)
    assert drawn.one_of(20).high / drawn.estimate.high == pytest.approx(norm.ppf(1 - 0.025 / 20) / norm.ppf(0.975))


def test_the_same_seed_draws_the_same_blocks_for_every_model():
    assert (draw_blocks(30, 50, 4) == draw_blocks(30, 50, 4)).all()
    assert (draw_blocks(30, 50, 4) != draw_blocks(30, 50, 5)).any()


def test_a_draw_is_the_sum_over_its_blocks_in_any_order_of_rows(rng):
    rows, blocks = rng.normal(size=(31, 2)), rng.permutation(np.arange(31) // 4)
    found = drawn_sums(rows, blocks, resamples=20, seed=3)
    picks = draw_blocks(8, 20, 3)
    np.testing.assert_allclose(found[0], rows.sum(axis=0))
    of_block = np.stack([rows[blocks == number].sum(axis=0) for number in range(8)])
    np.testing.assert_allclose(found[1:], of_block[picks].sum(axis=1))
    np.testing.assert_allclose(drawn_rms(rows, blocks)[0], np.sqrt((rows**2).mean(axis=0)))


def test_many_blocks_are_drawn_in_batches(rng, monkeypatch):
    rows = rng.normal(size=(50, 2))
    whole = drawn_sums(rows, np.arange(50))
    monkeypatch.setattr("sysid_evo.validation.estimates.PICKS", 130)
    np.testing.assert_allclose(drawn_sums(rows, np.arange(50)), whole)


def test_a_single_block_and_no_number_have_no_interval():
    for found in (paired(np.array([3.0])), Draws(np.full(5, np.nan), 9).estimate, across([3.0], ["a"])):
        assert np.isnan(found.interval).all()
        assert not found.differs_from(0.0)
    assert np.isnan(standard_errors(np.zeros((5, 2, 3)), 1)).all()
    assert standard_errors(np.zeros((5, 2, 3)), 1).shape == (2, 3)
    assert not drawn_sums(np.zeros((0, 3)), np.zeros(0, int), resamples=4).any()
    assert drawn_sums(np.zeros((0, 3)), np.zeros(0, int), resamples=4).shape == (5, 3)
    assert paired(np.full(2, 3.0)).interval == (3.0, 3.0)
    assert np.isfinite(Draws(np.array([1.0, np.nan, 0.9, 1.1, np.inf]), 9).estimate.low)


def test_a_figure_is_cut_off_at_what_it_can_be():
    assert Estimate(-0.1, 0.5, -1.0, 0.8).clipped(low=0.0) == Estimate(0.0, 0.5, 0.0, 0.8)
    assert Estimate(0.9, 0.5, 0.1, 1.8).clipped(high=1.0) == Estimate(0.9, 0.5, 0.1, 1.0)


def test_scores_and_differences_have_intervals_over_the_same_draws():
    models = {"one": fitted(Weak()), "two": fitted(Sliding())}
    prediction = assess_prediction(models, recording(), recording(1, seed=5))
    one, two = (prediction.model(name).score(20) for name in models)
    assert one.draws.value == pytest.approx(one.n)
    assert one.draws.blocks == prediction.cases.blocks(20)
    assert one.estimate == one.draws.estimate
    assert prediction.compare("one", "two", 20).difference == (one.draws - two.draws).estimate
    assert "95 % intervals" in prediction.cases.protocol.describe(0.05)


def test_a_simulation_of_two_blocks_has_three_draws():
    protocol = PredictionProtocol(block_samples=100)
    test = recording(1, steps=200 + protocol.first)
    score = assess_prediction({}, recording(), test, protocol=protocol).model(PERSISTENCE).free_run
    assert len(np.unique(score.draws.values.round(9))) == 3  # one of them twice, the other twice, both


def numbers(rng, robots, seeds, among, within):
    """Return numbers about 0: robots ``among`` each other, seeds ``within`` each; and the robot of each."""
    means = np.repeat(among * rng.normal(size=robots), seeds)
    return means + within * rng.normal(size=len(means)), np.repeat(np.arange(robots), seeds)


@pytest.mark.parametrize("robots, seeds", [(3, 3), (5, 5), (1, 5)])
@pytest.mark.parametrize("among", [0.0, 3.0])
def test_an_interval_holds_the_truth_in_nineteen_of_twenty_studies(rng, robots, seeds, among):
    among *= robots > 1
    share = np.mean([held(across(*numbers(rng, robots, seeds, among, 1.0)), 0.0) for _ in range(1000)])
    assert 0.93 <= share <= 0.97


def test_every_robot_counts_alike_however_many_seeds_it_has():
    found = across([1.0, 1.0, 1.0, 3.0], ["a", "a", "a", "b"])
    assert found.value == 2.0
    assert found.standard_error == 1.0
    assert found.interval == pytest.approx(t.interval(CONFIDENCE, 1, 2.0, 1.0))


def test_of_a_single_robot_the_interval_is_over_its_seeds():
    values = np.array([4.0, 5.0, 6.0])
    found = across(values, ["a"] * 3)
    assert found.interval == pytest.approx(t.interval(CONFIDENCE, 2, 5.0, 1.0 / np.sqrt(3)))
