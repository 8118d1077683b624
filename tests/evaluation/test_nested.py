"""Intervals over evolution seeds and trials: closed forms where there are some, coverage where there are none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t

from evaluation.transfer import Nested, alike, regrets
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import make_aggregate
from tests.benchmarks.nested import coverage


def of(fitness: np.ndarray, controller: str = "c") -> Nested:
    return Nested.of(controller, np.asarray(fitness, dtype=float)[None])


@pytest.mark.parametrize("trials", [2, 5, 100])
def test_of_one_seed_the_interval_is_students_over_trials(rng: np.random.Generator, trials: int) -> None:
    fitness = rng.normal(size=(1, trials))
    found = of(fitness)
    error = fitness.std(ddof=1) / np.sqrt(trials)
    assert found.standard_error == pytest.approx(error)
    np.testing.assert_allclose(found.interval(), t.interval(0.9, trials - 1, fitness.mean(), error))
    np.testing.assert_allclose(found.interval(0.5), t.interval(0.5, trials - 1, fitness.mean(), error))


def test_where_trials_are_all_alike_the_interval_is_students_over_seeds(rng: np.random.Generator) -> None:
    seeds = rng.normal(size=(3, 1))
    found = of(seeds + np.zeros((3, 50)))
    error = seeds.std(ddof=1) / np.sqrt(3)
    assert found.degrees == pytest.approx(2)
    np.testing.assert_allclose(found.interval(), t.interval(0.9, 2, seeds.mean(), error))


def test_what_seeds_owe_to_the_trials_is_not_counted_twice(rng: np.random.Generator) -> None:
    squares = [of(rng.normal(size=(4, 25))).standard_error ** 2 for _ in range(500)]
    # of independent fitness the mean of 100 has a variance of 0.01, the sum of both parts would be 0.02
    assert 0.01 < np.mean(squares) < 0.014


def test_a_difference_of_one_controller_pairs_its_seeds_and_its_trials(rng: np.random.Generator) -> None:
    luck = rng.normal(size=(3, 1)) + rng.normal(size=(1, 20))
    noise = 0.01 * rng.normal(size=(3, 20))
    gap = of(luck + noise) - of(luck)
    expected = of(noise)
    assert gap.value == pytest.approx(expected.value)
    np.testing.assert_allclose(gap.interval(), expected.interval())
    assert gap.standard_error < 0.05 * of(luck).standard_error


def test_a_difference_of_two_controllers_pairs_their_trials_but_not_their_seeds(rng: np.random.Generator) -> None:
    trials, first, second = rng.normal(size=(1, 20)), rng.normal(size=(3, 1)), rng.normal(size=(4, 1))
    gap = of(first + trials, "a") - of(second + trials, "b")
    assert gap.standard_error**2 == pytest.approx(first.var(ddof=1) / 3 + second.var(ddof=1) / 4)
    assert gap.n_seeds == 3


def test_trials_that_only_one_figure_has_are_not_paired(rng: np.random.Generator) -> None:
    many, few = rng.normal(size=(1, 40)), rng.normal(size=(1, 5))
    gap = of(many) - of(few)
    alike = (of(many) - of(np.zeros((1, 5)))).standard_error
    assert alike == pytest.approx(of(many).standard_error)
    centred = [(many[0] - many.mean()) / np.sqrt(40 * 39), (few[0] - few.mean()) / np.sqrt(20)]
    centred[0][:5] -= centred[1]
    assert gap.standard_error == pytest.approx(np.sqrt((centred[0] ** 2).sum()))
    assert gap.n_trials == 5


def test_a_share_of_what_is_claimed_varies_as_its_parts_do(rng: np.random.Generator) -> None:
    claimed, achieved = 12.0 + rng.normal(size=(3, 50)), 9.0 + rng.normal(size=(3, 50))
    kept = of(achieved).over(of(claimed))
    assert kept.value == pytest.approx(achieved.mean() / claimed.mean())
    exact = of((achieved - kept.value * claimed) / claimed.mean())
    np.testing.assert_allclose(np.subtract(kept.interval(), kept.value), exact.interval(), atol=1e-12)
    assert of(claimed).over(of(claimed)).standard_error < 1e-12


def test_the_lowest_of_two_models_varies_as_the_lower_one_does(rng: np.random.Generator) -> None:
    low, high = rng.normal(size=(2, 3, 30))
    found = Nested.of("c", np.stack([low, high + 100.0]), make_aggregate("min"))
    np.testing.assert_allclose(found.interval(), of(low).interval())


def test_regret_is_what_the_best_other_one_has_more(rng: np.random.Generator) -> None:
    figures = {name: of(mean + rng.normal(size=(1, 30)), name) for name, mean in (("a", 9.0), ("b", 5.0), ("c", 7.0))}
    found = regrets(figures)
    assert {name: one.value for name, one in found.items()} == {
        "a": figures["c"].value - figures["a"].value,
        "b": figures["a"].value - figures["b"].value,
        "c": figures["a"].value - figures["c"].value,
    }
    assert regrets({"a": figures["a"]}) == {}


def test_a_single_trial_has_no_interval() -> None:
    assert np.isnan(of(np.array([[3.0]])).interval()).all()
    assert of(np.full((1, 2), 3.0)).interval() == (3.0, 3.0)


def test_the_shape_of_the_fitness_is_checked() -> None:
    with pytest.raises(InvalidArgument, match=r"expected \(models, seeds, trials\), got shape \(3, 4\)"):
        Nested.of("c", np.zeros((3, 4)))
    with pytest.raises(InvalidArgument, match="expected figures of the same evolution seeds, got 2 and 3"):
        of(np.zeros((2, 4))) - of(np.zeros((3, 4)))


@pytest.mark.parametrize("kind", ["normal", "no"])
def test_ninety_percent_intervals_hold_the_truth_with_three_evolution_seeds(kind: str) -> None:
    """Of 300 repetitions; a little wide is no fault, since parts of the variance cannot be below 0."""
    for name, share in coverage(kind, 3, 10, 300).items():
        assert 0.85 <= share <= 0.97, name


@pytest.mark.parametrize(("kind", "least"), [("basins", 0.85), ("odd", 0.82)])
def test_where_seeds_fall_into_basins_the_other_controllers_make_the_interval_wide_enough(
    kind: str, least: float
) -> None:
    """With three seeds of its own alone 80 to 92 % hold in basins; others that differ less must not mislead much."""
    for name, share in coverage(kind, 3, 20, 250).items():
        assert least <= share <= 0.98, name


def test_seeds_that_all_fall_into_one_basin_learn_from_the_others_how_far_seeds_differ() -> None:
    def of_seeds(*values: float, name: str) -> Nested:
        return of(np.array(values)[:, None] + np.zeros((3, 20)), name)

    figures = {
        "lucky": of_seeds(1.0, 1.0, 1.0, name="lucky"),
        "a": of_seeds(-1.0, 1.0, 1.0, name="a"),
        "b": of_seeds(-1.0, -1.0, 1.0, name="b"),
        "alone": of(np.ones((1, 20)), "alone"),
    }
    assert figures["lucky"].standard_error == 0.0
    found = alike(figures)
    prior = found["lucky"].priors["lucky"]
    assert (prior.variance, prior.degrees) == pytest.approx(
        (4.0 / 3.0, 8.0 / 3.0)
    )  # of two others with two degrees each
    degrees = 8.0 / 3.0 + 2.0
    assert found["lucky"].degrees == pytest.approx(degrees)
    assert found["lucky"].standard_error ** 2 == pytest.approx(8.0 / 3.0 * 4.0 / 3.0 / degrees / 3.0)
    further = alike({**figures, "far": of_seeds(-9.0, 9.0, 9.0, name="far")})["far"]
    assert further.standard_error == pytest.approx(np.sqrt(108.0 / 3.0))  # no less than its own seeds show
    assert further.degrees == pytest.approx(
        2.0 + further.priors["far"].degrees * further.priors["far"].variance / 108.0
    )
    assert found["alone"] == figures["alone"]


def test_a_controller_with_more_seeds_tells_more_of_how_far_seeds_differ() -> None:
    seeds = {"few": (-1.0, 1.0), "many": (-3.0, 3.0, -3.0, 3.0, 0.0), "own": (0.0, 0.0)}
    found = alike({name: of(np.array(values)[:, None] + np.zeros((1, 10)), name) for name, values in seeds.items()})
    prior = found["own"].priors["own"]
    assert prior.variance == pytest.approx((1.0 * 2.0 + 4.0 * 9.0) / 5.0)
    assert prior.degrees == pytest.approx(1.0 / (1.0 / 8.0 + 1.0 / 5.0))


def test_what_others_tell_of_seeds_stays_with_a_controller_when_figures_are_joined(rng: np.random.Generator) -> None:
    luck = rng.normal(size=(4, 3, 20)) + 3.0 * rng.normal(size=(4, 3, 1))
    one, two, three, four = alike({name: of(values, name) for name, values in zip("abcd", luck, strict=True)}).values()
    gap = one - two
    assert set(gap.priors) == {"a", "b"}
    assert gap.degrees > (of(luck[0], "a") - of(luck[1], "b")).degrees
    assert (one - one.over(three)).priors.keys() == {"c"}  # of one figure less another of `a` the others say nothing
    share = three.over(four)
    assert share.priors["c"].variance == pytest.approx(three.priors["c"].variance / four.value**2)
