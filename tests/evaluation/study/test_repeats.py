"""Means and intervals over robots and seeds, on numbers whose truth is known."""

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

from evaluation.study import Spread, paired


def drawn(rng, robots, seeds, among, within):
    """Return numbers about 0: robots ``among`` each other, seeds ``within`` each."""
    return {
        (f"r{robot}", str(seed)): value + within * rng.normal()
        for robot, value in enumerate(among * rng.normal(size=robots))
        for seed in range(seeds)
    }


def test_every_robot_counts_alike_however_many_seeds_it_has():
    spread = Spread.of({("a", "0"): 1.0, ("a", "1"): 1.0, ("a", "2"): 1.0, ("b", "0"): 3.0})
    assert spread is not None
    assert spread.mean == 2.0
    assert (spread.lowest, spread.highest, spread.robots, spread.points) == (1.0, 3.0, 2, 4)


@pytest.mark.parametrize(
    "robots, seeds, there", [(1, 1, False), (2, 9, False), (1, 2, False), (1, 3, True), (3, 1, True)]
)
def test_there_is_no_interval_of_too_few_robots_or_seeds(robots, seeds, there):
    spread = Spread.of(drawn(np.random.default_rng(0), robots, seeds, 1.0, 1.0))
    assert spread is not None
    assert (spread.low is not None) == there
    assert (spread.high is not None) == there


@pytest.mark.parametrize("among, within", [(0.3, 1.0), (3.0, 1.0)])
def test_an_interval_holds_the_truth_in_nineteen_of_twenty_studies(among, within):
    rng, held = np.random.default_rng(1), []
    for _ in range(100):
        spread = Spread.of(drawn(rng, 5, 5, among, within))
        assert spread is not None
        assert spread.low is not None
        assert spread.high is not None
        held.append(spread.low <= 0.0 <= spread.high)
    assert np.mean(held) >= 0.90  # plain percentiles hold it in 0.85


def test_of_robots_with_one_seed_each_the_interval_is_as_wide_as_students():
    """Of eight normal numbers: the percentiles alone would be 7 % narrower than that."""
    values = norm.ppf((np.arange(8) + 0.5) / 8)
    spreads = [Spread.of({(str(i), "0"): x for i, x in enumerate(values)}, seed=seed) for seed in range(10)]
    width = np.mean([one.high - one.low for one in spreads if one is not None and one.high and one.low])
    students = 2.0 * student.ppf(0.975, 7) * values.std(ddof=1) / np.sqrt(8)
    assert 0.95 < width / students < 1.03


def test_seeds_alone_and_robots_alone_make_an_interval():
    """Robots, or seeds, that do not differ add nothing to it."""
    among = Spread.of({(robot, seed): float(robot) for robot in "123" for seed in "456"})
    within = Spread.of({(robot, seed): float(seed) for robot in "123" for seed in "456"})
    alone = Spread.of({("1", seed): float(seed) for seed in "456"})
    assert among is not None
    assert (among.low, among.high) == (1.0, 3.0)
    for spread in (within, alone):
        assert spread is not None
        assert spread.low is not None
        assert spread.high is not None
        assert 4.0 <= spread.low < 5.0 < spread.high <= 6.0
    assert within is not None
    assert within.high is not None
    assert within.high < 5.9  # the mean of three robots, of which each would have to be drawn so


def test_what_differs_between_robots_makes_an_interval_wider_than_what_differs_between_seeds():
    rng = np.random.default_rng(2)
    spreads = [Spread.of(drawn(rng, 5, 5, *sizes)) for sizes in ((2.0, 0.1), (0.1, 2.0))]
    widths = [one.high - one.low for one in spreads if one is not None and one.low is not None and one.high is not None]
    assert widths[0] > 1.3 * widths[1]


def test_a_paired_difference_is_that_of_robots_and_seeds_that_both_have():
    first = {("a", "0"): 5.0, ("a", "1"): 7.0, ("b", "0"): 9.0}
    assert paired(first, {("a", "0"): 1.0, ("b", "0"): 2.0, ("c", "0"): 3.0}) == {("a", "0"): 4.0, ("b", "0"): 7.0}


def test_what_is_no_number_is_left_out_and_of_nothing_there_is_no_spread():
    spread = Spread.of({("a", "0"): 1.0, ("a", "1"): float("nan")})
    assert spread is not None
    assert spread.points == 1
    assert Spread.of({("a", "1"): float("nan")}) is None
