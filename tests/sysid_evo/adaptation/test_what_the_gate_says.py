"""What the gate says it saw, and what is held back of a recording of several episodes."""

from itertools import pairwise

import numpy as np
import pytest

from sysid_evo.models.adaptation.selection import Verdict, moving_seconds, refitted
from sysid_evo.models.base import make_model
from sysid_evo.validation.acceptance import Held, Trial, judged, surely_positive
from sysid_evo.validation.folds import Block, blocks_of
from tests.fixtures.systems import FloorCar, drive


def verdict(chosen, *trials):
    return Verdict(24.6, 3, 0.5, trials, chosen).sentence


def trial(name, error, each, *, sure=True):
    return Trial(name, error, each, sure)


GOOD = trial("linear, ridge 3", 0.6, (0.5, 0.6, 0.7))
WORST = trial("products", 1.3, (1.3, 1.3, 1.3))


@pytest.mark.parametrize(
    ("trials", "said"),
    [
        ((), "no correction: 25 s in motion are too short to hold a block back"),
        (
            (WORST, trial("gains", 0.9, (0.9, 0.9, 0.9))),
            "no correction: the best, gains, is 10 % better than none on 3 blocks it did not learn from; "
            "15 % are asked",
        ),
        (
            (WORST,),
            "no correction: the best, products, is 30 % worse than none on 3 blocks it did not learn from; "
            "15 % are asked",
        ),
        (
            (WORST, trial("gains", 0.6, (0.5, 0.6, 0.7), sure=False)),
            "no correction: the best, gains, is 40 % better than none on 3 blocks it did not learn from; "
            "which may be chance",
        ),
        (
            (WORST, Trial("mean", 0.7, (0.7, 0.7, 0.7), True, "mean", 0.35)),
            "no correction: the best, mean, is 30 % better than none on 3 blocks it did not learn from; 35 % are asked",
        ),
        (
            (trial("given up", 0.4, (0.2, 0.96)), trial("gains", 0.9, (0.9, 0.9, 0.9))),
            "no correction: the best, gains, is 10 % better than none on 3 blocks it did not learn from; "
            "15 % are asked",
        ),
        (
            (WORST, trial("gains", 0.6, (0.2, 0.6, 1.0))),
            "no correction: the best, gains, is 40 % better than none on 3 blocks it did not learn from; "
            "but not on each of them",
        ),
    ],
)
def test_a_verdict_says_why_nothing_was_taken(trials, said):
    assert verdict("none", *trials) == said


def test_a_verdict_says_what_was_taken_though_another_was_better():
    better = trial("gains, ridge 3", 0.58, (0.5, 0.6, 0.7))
    assert verdict(GOOD.name, WORST, GOOD, better) == (
        "linear, ridge 3: 40 % better than none on 3 blocks it did not learn from"
    )


@pytest.mark.parametrize(("error", "good"), [(0.85, True), (0.851, False)])
def test_fifteen_percent_are_enough(error, good):
    assert trial("a", error, (0.8, 0.8, 0.9)).good == good


def test_five_percent_in_each_block_are_enough():
    assert trial("a", 0.8, (0.5, 0.95, 0.5)).good
    assert not trial("a", 0.8, (0.5, 0.951, 0.5)).good


def test_two_seconds_are_never_sure():
    assert not surely_positive(np.array([5.0, 5.0]))
    assert surely_positive(np.array([5.0, 5.0, 5.0]))


def test_a_mean_that_chance_explains_once_in_forty_is_sure_and_one_that_it_explains_more_often_is_not():
    """Student's t of two degrees is 4.30 at 97.5 %: of (1 - d, 1, 1 + d) that is d = 0.403."""
    assert surely_positive(np.array([0.6, 1.0, 1.4]))
    assert not surely_positive(np.array([0.59, 1.0, 1.41]))


def test_what_is_shared_out_over_blocks_is_compared_second_by_second():
    """A second that only one of the two runs through says nothing; of several windows in it the mean counts."""
    rng = np.random.default_rng(0)
    plain = Held(1.0 + 0.01 * rng.random((6, 4, 1)), np.array([0, 0, 1, 1, 2, 9]))
    after = Held(np.full((6, 4, 1), 0.5), np.array([0, 0, 1, 1, 2, 8]))
    assert plain.squares()[0] == pytest.approx(float((plain.errors[:2] ** 2).mean()))
    assert judged("a", [plain], [after]).sure
    few = Held(plain.errors, np.array([0, 0, 1, 1, 9, 9]))
    assert not judged("a", [few], [after]).sure  # two seconds are common


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
        return float((one.step(at_rest, full) - one.step(at_rest, 0.0 * full))[0, 0])  # type: ignore[attr-defined]

    rng = np.random.default_rng(0)
    both, alone = refitted(model, old, new, rng), refitted(model, None, new, rng)
    assert pull(alone) == pytest.approx(0.5 * pull(model), rel=0.1)
    assert pull(both) == pytest.approx(0.5 * (pull(alone) + pull(model)), rel=0.06)
