"""The acceptance test: held-out blocks, improvement that is required, and what is required of short data."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.errors import PluginError
from sysid_evo.models.adaptation import held_out_error, selection
from sysid_evo.models.adaptation.selection import (
    MAX_ERROR_WINDOWS,
    NONE,
    UNCHANGED_RATIO,
    AdaptationDecision,
    adaptation,
    decided,
    error_ratio,
    moving_seconds,
    refitted,
    unchanged_ratio,
)
from sysid_evo.models.base import make_model
from sysid_evo.validation.acceptance import (
    AcceptanceResult,
    HeldOutErrors,
    acceptance_result,
    failed,
    inside,
    within_margin,
)
from sysid_evo.validation.folds import Block, blocks_of
from tests.fixtures.systems import FloorCar, drive


def test_a_window_is_never_on_both_sides_and_every_block_is_held_back_once():
    first = np.arange(0, 580, 3)
    blocks = blocks_of(first, 20)
    held_back = np.array([block.held(first) for block in blocks])
    learned = np.array([block.learned(first) for block in blocks])
    assert len(blocks) == 3
    assert not (held_back & learned).any()
    assert (held_back.sum(axis=0) <= 1).all()
    for block, within, outside in zip(blocks, held_back, learned, strict=True):
        assert (first[within] >= block.low).all()
        assert not ((first[outside] < block.high) & (first[outside] + 20 > block.low)).any()


def test_the_rest_of_a_recording_is_all_but_the_block():
    data = drive(FloorCar(), seconds=10.0, seed=0)
    first = np.arange(0, 180)
    for block in blocks_of(first, 20):
        assert block.rest(data).n_steps == 200 - (block.high - block.low)


def held(errors):
    """Runs of which two begin in each second."""
    return HeldOutErrors(errors, np.arange(len(errors)) // 2)


def alike(name, error, kind="fit", *, sure=True):
    """A trial that is as good in each of three blocks."""
    return AcceptanceResult(name, error, (error,) * 3, sure, kind)


WEAK, WEAKER = alike("weak", 0.52), alike("weaker", 0.5)
B, ANEW, MOST = alike("b", 0.6), alike("anew", 0.4), alike("most", 0.5, "fine_tuned")


@pytest.mark.parametrize(
    ("trials", "chosen"),
    [
        ([alike("a", 0.8), alike("b", 0.99)], "a"),
        ([alike("a", 0.8, sure=False), alike("b", 0.99)], "none"),
        ([alike("a", 0.9), alike("b", 0.99)], "none"),
        ([alike("a", 1.2), alike("b", 0.99)], "none"),
        ([AcceptanceResult("a", 0.5, (0.2, 0.3, 1.11), True)], "none"),
        ([AcceptanceResult("a", 0.5, (0.2, 0.3, 1.09), True)], "a"),
        ([alike("strong", 0.62), WEAK, WEAKER], "weak"),  # the simplest of those that are about as good
        ([MOST, alike("mean", 0.49, "fine_tuned_mean")], "mean"),  # a mean must be better than more training
        ([MOST, alike("mean", 0.51, "fine_tuned_mean")], "most"),
        ([MOST, AcceptanceResult("mean", 0.4, (0.1, 0.1, 1.2), True, "fine_tuned_mean")], "most"),
        (
            [B, ANEW, alike("b and anew", 0.43, "fit_mean")],
            "b and anew",
        ),  # another fit gives way to its mean with a correction
        ([B, ANEW, alike("b and anew", 0.45, "fit_mean")], "anew"),
        ([B, ANEW, alike("b and anew", 0.38, "fit_mean")], "b and anew"),
        ([B, alike("anew", 0.58), alike("b and anew", 0.4, "fit_mean")], "b"),  # but not of a fit that is not taken
        ([alike("anew", 0.58), AcceptanceResult("b and anew", 0.6, (0.6, 0.6, 1.2), True, "fit_mean")], "anew"),
    ],
)
def test_the_accepted_candidate_is_much_better_significantly_in_no_block_much_worse_and_the_simplest(trials, chosen):
    assert decided(trials) == chosen


@pytest.mark.parametrize("kind", ["fine_tuned", "fine_tuned_mean"])
def test_a_fine_tuned_model_or_its_mean_is_accepted_if_a_tenth_better_than_the_simplest_fit(kind):
    for error, chosen in ((0.46, "other"), (0.48, "weak")):
        assert decided([WEAK, WEAKER, alike("other", error, kind)]) == chosen
    assert decided([alike(f"{error}", error, kind) for error in (0.501, 0.5, 0.502)]) == "0.5", "of these the best"


KINDS = ("fit", "fit_mean", "fine_tuned", "fine_tuned_mean")


@pytest.mark.parametrize(
    ("t", "accepted"), [(1.9, ""), (2.6, "fit fit_mean"), (2.8, "fit fit_mean fine_tuned fine_tuned_mean")]
)
def test_fine_tuning_must_be_significant_as_one_of_three_amounts(t, accepted):
    """Of 15 seconds Student's t is 2.14 for a single one, and 2.7 for three that are looked at together."""
    apart = np.tile([0.3, -0.3, 0.1, -0.1, 0.0], 3)
    gains = apart + t * apart.std(ddof=1) / np.sqrt(15)
    plain = [np.full((10, 5, 2), 2.0)] * 3
    better = [np.repeat(2.0 - part, 2)[:, None, None] * np.ones((10, 5, 2)) for part in np.split(gains, 3)]
    sure = [
        kind for kind in KINDS if acceptance_result("a", list(map(held, plain)), list(map(held, better)), kind).sure
    ]
    assert " ".join(sure) == accepted


def test_shares_of_an_error_do_not_depend_on_its_size_and_that_of_none_is_finite():
    rng = np.random.default_rng(0)
    plain = [1e-9 * rng.normal(size=(20, 5, 2)) for _ in range(3)]
    tiny = acceptance_result("tiny", [held(one) for one in plain], [held(0.5 * one) for one in plain])
    assert (tiny.error, *tiny.each) == pytest.approx((0.5,) * 4, rel=1e-6)
    none = [held(np.zeros((20, 5, 2)))] * 3
    exact = acceptance_result("exact", none, none)
    assert (exact.error, *exact.each) == (0.0,) * 4
    assert not acceptance_result("worse", none, [held(one) for one in plain]).consistent


def test_half_the_error_in_every_second_is_a_share_of_a_half_and_sure():
    plain = [np.full((8, 5, 2), size) for size in (1.0, 2.0)]
    trial = acceptance_result("half", [held(one) for one in plain], [held(0.5 * one) for one in plain])
    assert (trial.error, *trial.each) == pytest.approx((0.5, 0.5, 0.5))
    assert trial.good


def test_an_error_that_is_lower_in_one_second_alone_is_not_surely_lower():
    before, after = np.ones((12, 5, 2)), np.ones((12, 5, 2))
    before[:2] = 10.0
    trial = acceptance_result("luck", [held(before)], [held(after)])
    assert trial.error < 0.5
    assert not trial.good


@pytest.mark.parametrize(
    ("gains", "sure"),
    [
        ([1.0, 3.0, -0.6], False),
        ([1.0, 3.0, -0.6] * 5, True),  # fewer seconds must show more
        ([5.0, 5.0], False),  # two are never sure
        ([5.0, 5.0, 5.0], True),
        ([0.7, 1.0, 1.3], True),  # Student's t of two degrees is 4.30: of (1 - d, 1, 1 + d) that is d = 0.403
        ([0.5, 1.0, 1.5], False),
    ],
)
def test_a_mean_gain_that_chance_explains_once_in_forty_is_sure(gains, sure):
    plain, better = (
        held(np.repeat(9.0 - part, 2)[:, None, None] * np.ones((1, 5, 2)))
        for part in (np.zeros(len(gains)), np.array(gains))
    )
    assert acceptance_result("a", [plain], [better]).sure == sure


@pytest.mark.parametrize(("seconds", "share"), [(4, 0.5), (25, 0.2), (100, 0.15)])
def test_fine_tuning_must_be_better_by_more_the_fewer_seconds_are_compared(seconds, share):
    plain = [held(np.ones((2 * seconds, 5, 2)))]
    better = [held(np.full((2 * seconds, 5, 2), 0.6))]
    assert [acceptance_result("a", plain, better, kind).required for kind in KINDS] == pytest.approx(
        [0.15, 0.15, share, share]
    )
    for error, good in ((1.0 - share + 0.001, False), (1.0 - share, True)):
        assert AcceptanceResult("a", error, (0.5,), True, "fine_tuned", share).good == good


def test_evidence_is_pooled_over_blocks():
    """Ten seconds, of which one block is hardly better: together they show what no block shows alone."""
    before = [np.ones((6, 5, 2))] * 3
    after = [size * one for size, one in zip((0.6, 0.98, 0.7), before, strict=True)]
    trial = acceptance_result("a", list(map(held, before)), list(map(held, after)))
    assert trial.good
    assert not any(
        acceptance_result("a", [held(b)], [held(a)]).good
        for b, a in zip(before, after, strict=True)
        if a[0, 0, 0] > 0.9
    )


@pytest.mark.parametrize(("last", "no_good"), [(1.099, False), (1.101, True)])
def test_what_is_much_worse_in_one_block_has_failed_in_those_that_it_knows(last, no_good):
    plain = [np.ones((8, 5, 2))] * 3
    seen = [held(0.2 * plain[0]), held(last * plain[1])]
    assert failed(list(map(held, plain)), seen) == no_good
    assert acceptance_result("a", list(map(held, plain)), seen).each == pytest.approx((0.2, last))


@pytest.fixture
def model():
    return make_model("linear").fit(drive(FloorCar(), seconds=30.0, seed=0), rng=0)


def errors_by_hand(model, seed):
    """Return the errors (N, 20, nx) of free runs of one second that begin at every third sample."""
    windows = drive(FloorCar(), seconds=20.0, seed=seed).windows(20, stride=3, moving=True)
    return model.simulate(windows.past_states, windows.past_controls, windows.controls) - windows.states


def test_the_held_out_error_is_the_median_over_the_cases_in_the_units_of_the_states(model):
    """One fit that fails does not hide a change of the condition."""
    failed = make_model("linear").fit(drive(FloorCar(), seconds=30.0, seed=0), rng=0)
    failed.state_bounds_ = np.zeros((2, 3))
    each = [np.sqrt(np.mean(errors_by_hand(model, seed) ** 2, axis=(0, 1))) for seed in (1, 2)]
    cases = [(model, drive(FloorCar(), seconds=20.0, seed=seed)) for seed in (1, 2)]
    np.testing.assert_allclose(held_out_error(cases), np.mean(each, axis=0), rtol=1e-6)
    found = held_out_error([*cases, (failed, cases[0][1])])
    np.testing.assert_allclose(found, np.max(each, axis=0), rtol=1e-6)
    assert found[0] != pytest.approx(found[2], rel=0.2)


def test_of_a_long_recording_so_many_runs_are_made_from_its_beginning_to_its_end():
    class Counting(FloorCar):
        most = 0

        def step(self, carry, control, noise=None):
            self.most = max(self.most, len(carry))
            return super().step(carry, control, noise)

    car, held = Counting(), drive(FloorCar(), seconds=200.0, seed=1, noise=0.0)
    found = held_out_error([(car, held)])
    assert found.max() < 1e-9
    assert car.most == MAX_ERROR_WINDOWS


def test_data_too_short_for_a_simulation_give_no_error_ratio(model):
    assert held_out_error([(model, drive(FloorCar(), seconds=20.0, seed=1))]) is not None
    both = [(model, drive(FloorCar(), seconds=seconds, seed=1)) for seconds in (20.0, 0.5)]
    assert held_out_error(both) is None


def test_the_state_with_the_largest_error_ratio_counts_in_its_own_unit():
    """Errors of 2 and 4 scales of 10 and 0.1 are 20 and 0.4; at home they were 10 and 0.1."""
    errors = np.broadcast_to(np.array([2.0, -4.0]), (7, 5, 2))
    assert error_ratio(errors, np.array([10.0, 0.1]), np.array([10.0, 0.1])) == pytest.approx(4.0)
    assert error_ratio(errors, np.array([10.0, 0.1]), np.array([1.0, 0.1])) == pytest.approx(20.0)


def test_a_held_out_error_of_another_shape_is_refused(model):
    model.held_out_error_ = np.ones(2)
    with pytest.raises(PluginError, match=r"a number for each of 3 states, got the shape \(2,\)"):
        model.adapt(drive(FloorCar(), seconds=20.0, seed=1), rng=0)


def test_nothing_is_tried_if_the_error_has_hardly_grown(model, monkeypatch):
    """Pieces that reach over the edges of blocks are left out there, so that the two differ by a few percent."""
    monkeypatch.setattr(selection, "KINDS", ("linear",))
    monkeypatch.setattr(selection, "RIDGES", (0.03,))
    new = drive(FloorCar(thrust=1.5), seconds=16.0, seed=3)
    at_home = held_out_error([(model, new)])
    free = adaptation(model, new, rng=np.random.default_rng(0)).decision
    assert free.chosen != NONE
    least = unchanged_ratio(16)
    model.held_out_error_ = at_home / (least * 1.04)
    assert adaptation(model, new, rng=np.random.default_rng(0)).decision == free
    model.held_out_error_ = at_home / (least * 0.96)
    found = adaptation(model, new, rng=np.random.default_rng(0))
    assert not found.decision.trials
    assert found.decision.chosen == NONE
    assert found.learned.model is model
    assert not found.learned.coefficients.any()
    times = found.decision.error_ratio
    assert times == pytest.approx(least * 0.96, rel=0.04)
    assert found.decision.least_ratio == pytest.approx(least, rel=0.02)
    least, seconds = found.decision.least_ratio, found.decision.seconds
    assert found.decision.sentence == (
        f"not adapted: the 1 s simulation error is at most {times:.2f} times the held-out training error in every "
        f"state; with {seconds:.0f} s, corrections are tried above {least:.2f}"
    )


@pytest.mark.parametrize(("dt", "seconds"), [(0.05, 1.0), (0.2, 2.0)])
def test_errors_are_compared_second_by_second_or_by_simulations_that_last_longer(dt, seconds, monkeypatch):
    counted = []
    monkeypatch.setattr(selection, "unchanged_ratio", lambda intervals: counted.append(intervals) or 10.0)
    data = drive(FloorCar(), seconds=30.0, seed=0)
    slow = data.system.with_dt(dt)
    data = Dataset(slow, tuple(replace(one, dt=dt) for one in data))
    model = make_model("linear").fit(data, rng=0)
    model.held_out_error_ = held_out_error([(model, data)])
    assert adaptation(model, data, rng=np.random.default_rng(0)).decision.chosen == NONE
    assert counted[0] == pytest.approx(data.n_steps * dt / seconds, abs=4)


def test_the_error_ratio_of_an_unchanged_condition_is_larger_for_short_recordings():
    assert [unchanged_ratio(n) for n in (9, 27)] == pytest.approx([1.33, 1.19], abs=0.01)
    assert (unchanged_ratio(1000), unchanged_ratio(0)) == UNCHANGED_RATIO


GOOD = AcceptanceResult("linear, ridge 3", 0.6, (0.5, 0.6, 0.7), True)
BETTER = AcceptanceResult("gains, ridge 3", 0.58, (0.5, 0.6, 0.7), True)
WORST, GAINS = alike("products", 1.3), alike("gains", 0.9)
MEAN = AcceptanceResult("mean", 0.7, (0.7, 0.7, 0.7), True, "fine_tuned_mean", 0.35)


@pytest.mark.parametrize(
    ("trials", "reason"),
    [
        ([WORST, GAINS], "gains) is 10 % better, 15 % are required"),
        ([WORST], "products) is 30 % worse, 15 % are required"),
        (
            [WORST, AcceptanceResult("gains", 0.6, (0.5, 0.6, 0.7), False)],
            "gains) is 40 % better, which may be chance",
        ),
        ([WORST, MEAN], "mean) is 30 % better, 35 % are required"),
        ([AcceptanceResult("given up", 0.4, (0.2, 0.96), True), GAINS], "gains) is 10 % better, 15 % are required"),
        (
            [WORST, AcceptanceResult("gains", 0.6, (0.2, 0.6, 1.3), True)],
            "gains) is 40 % better, but 30 % worse in one of 3 blocks",
        ),
    ],
)
def test_a_decision_gives_the_reason_for_no_adaptation(trials, reason):
    expected = f"not adapted: the best candidate ({reason}"
    assert AdaptationDecision(24.6, 3, tuple(trials), "none").sentence == expected


def test_a_decision_names_the_accepted_candidate_though_another_was_better_or_reports_too_few_data():
    taken = AdaptationDecision(24.6, 3, (WORST, GOOD, BETTER), GOOD.name).sentence
    assert taken == "linear, ridge 3: error 40 % lower on 3 blocks it was not fitted to (50, 40, 30 %)"
    too_short = AdaptationDecision(24.6, 3, (), "none").sentence
    assert too_short == "not adapted: 25 s in motion are too short for three blocks"


@pytest.mark.parametrize(
    ("error", "each", "good"),
    [
        (0.85, (0.8, 0.8, 0.9), True),  # fifteen percent are enough
        (0.851, (0.8, 0.8, 0.9), False),
        (0.8, (0.5, 1.1, 0.5), True),  # a block may be ten percent worse
        (0.8, (0.5, 1.101, 0.5), False),
    ],
)
def test_fifteen_percent_are_enough_if_no_block_is_more_than_ten_percent_worse(error, each, good):
    assert AcceptanceResult("a", error, each, True).good == good


def test_what_is_shared_out_over_blocks_is_compared_second_by_second():
    """A second that only one of the two runs through says nothing; of several windows in it the mean counts."""
    rng = np.random.default_rng(0)
    plain = HeldOutErrors(1.0 + 0.01 * rng.random((6, 4, 1)), np.array([0, 0, 1, 1, 2, 9]))
    after = HeldOutErrors(np.full((6, 4, 1), 0.5), np.array([0, 0, 1, 1, 2, 8]))
    assert plain.sizes()[0] == pytest.approx(float((plain.errors[:2] ** 2).mean()) ** 0.5)
    assert acceptance_result("a", [plain], [after]).sure
    few = HeldOutErrors(plain.errors, np.array([0, 0, 1, 1, 9, 9]))
    assert not acceptance_result("a", [few], [after]).sure  # two seconds are common


def episodes(*lengths):
    data = drive(FloorCar(), seconds=10.0, seed=0)
    (whole,) = data
    ends = np.cumsum([0, *lengths])
    return data.with_episodes([whole[a:b] for a, b in pairwise(ends)])


def test_a_block_and_the_rest_are_all_of_a_recording_over_the_edges_of_episodes():
    data, block = episodes(40, 60, 50), Block(30, 110, 20)
    assert [len(episode) for episode in block.part(data)] == [10, 60, 10]
    assert [len(episode) for episode in block.rest(data)] == [30, 40]
    (first, _, last), (_, second, third) = list(block.part(data)), list(data)
    assert np.array_equal(first.states, next(iter(data)).states[30:])
    assert np.array_equal(last.controls, third.controls[:10])
    assert np.array_equal(list(block.part(data))[1].states, second.states)


def test_windows_at_the_edge_of_a_block_are_on_its_side_if_they_lie_inside():
    block = Block(30, 110, 20)
    first = np.array([10, 11, 29, 30, 90, 91, 109, 110])
    assert block.held(first).tolist() == [False, False, False, True, True, False, False, False]
    assert block.learned(first).tolist() == [True, False, False, False, False, False, False, True]


def test_where_a_block_has_nothing_to_be_judged_by_there_are_none():
    assert blocks_of(np.arange(0, 30), 20) == []
    blocks = blocks_of(np.arange(0, 300), 20)
    assert (blocks[0].low, blocks[-1].high) == (0, 319)
    assert [one.high for one in blocks[:-1]] == [one.low for one in blocks[1:]]


def test_time_at_rest_is_no_time_in_motion():
    data = drive(FloorCar(), seconds=10.0, seed=0)
    (whole,) = data
    still = data.with_episodes([whole, type(whole)(np.zeros((101, 3)), np.zeros((100, 2)), whole.dt)])
    assert moving_seconds(still) == moving_seconds(data) <= 10.0
    assert moving_seconds(data) > 8.0


def test_a_refit_counts_the_new_seconds_as_much_as_all_the_old_ones():
    """A linear model of both lies in the middle, though the new recording is a quarter as long."""
    old, new = (
        drive(FloorCar(thrust=thrust), seconds=s, seed=1, noise=0.0) for thrust, s in ((4.0, 40.0), (2.0, 10.0))
    )
    model = make_model("linear").fit(old, rng=np.random.default_rng(0))

    def pull(one):
        at_rest, full = np.zeros((1, 3)), np.array([[1.0, 0.0]])
        return float((one.step(at_rest, full) - one.step(at_rest, 0.0 * full))[0, 0])

    rng = np.random.default_rng(0)
    both, alone = refitted(model, old, new, rng), refitted(model, None, new, rng)
    assert pull(alone) == pytest.approx(0.5 * pull(model), rel=0.1)
    assert pull(both) == pytest.approx(0.5 * (pull(alone) + pull(model)), rel=0.06)


def test_what_is_within_a_margin_exceeds_the_reference_by_at_most_that_share_of_its_size():
    assert inside([0.3, 0.2, np.nan, 0.25, 0.2501], 1.25) == [1, 3]
    for median, fitness in ((10.0, [6.9, 7.1, 12.0]), (-10.0, [-13.1, -12.9, -1.0])):
        assert within_margin(-np.array(fitness), -median, 0.3).tolist() == [False, True, True]
