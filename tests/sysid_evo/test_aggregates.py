"""The shipped rules on numbers that can be followed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import aggregates, make_aggregate

FITNESS = np.array(
    [
        [[1.0, 3.0], [5.0, 5.0]],
        [[0.0, 8.0], [9.0, 9.0]],
        [[9.0, 9.0], [0.0, 2.0]],
    ]
)
"""Three models, two candidates, two trials; the models' means are 2, 4, 9 and 5, 9, 1."""


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("min", [2.0, 1.0]),
        ("mean", [5.0, 5.0]),
        ("median", [4.0, 5.0]),
        ("rank_mean", [5.0, 5.0]),
        ("random_subset", [2.0, 1.0]),
        ("random_subset(rule=mean)", [5.0, 5.0]),
    ],
)
def test_the_rule_is_taken_over_the_models_of_their_means_over_the_trials(name: str, expected: list[float]) -> None:
    np.testing.assert_array_equal(make_aggregate(name)(FITNESS), expected)


def test_cvar_is_the_mean_of_the_worst_outcomes_of_which_the_last_counts_in_part() -> None:
    # in order: 0, 1, 3, 8, 9, 9 and 0, 2, 5, 5, 9, 9; 40 % of six outcomes are 2.4
    expected = [(0.0 + 1.0 + 0.4 * 3.0) / 2.4, (0.0 + 2.0 + 0.4 * 5.0) / 2.4]
    np.testing.assert_allclose(make_aggregate("cvar(share=0.4)")(FITNESS), expected)
    np.testing.assert_allclose(make_aggregate("cvar(share=0.01)")(FITNESS), [0.0, 0.0])
    np.testing.assert_allclose(make_aggregate("cvar(share=1)")(FITNESS), [5.0, 5.0])


def test_lower_confidence_takes_the_standard_error_off_the_mean_on_each_model() -> None:
    # standard errors of two trials are half their difference: 1, 4, 0 and 0, 0, 1
    rule = make_aggregate("lower_confidence(weight=0.75)")
    np.testing.assert_allclose(rule(FITNESS), [4.0 - 3.0, 1.0 - 0.75])
    steady = np.array([[[4.0, 4.0], [0.0, 9.0]]])
    assert np.argmax(rule(steady)) == 0  # of means 4 and 4.5 the steady one
    np.testing.assert_allclose(rule(FITNESS[:, :, :1]), [0.0, 0.0])


def test_a_model_that_denies_a_candidate_takes_no_more_than_its_share_of_the_median() -> None:
    rule = make_aggregate("credible(share=0.7)")
    np.testing.assert_allclose(rule(FITNESS), [0.7 * 4.0, 0.7 * 5.0])
    np.testing.assert_allclose(rule(FITNESS[:, :, 1:]), [0.7 * 8.0, 0.7 * 5.0])
    agreed = np.array([9.0, 10.0, 12.0]).reshape(3, 1, 1)
    np.testing.assert_allclose(rule(agreed), [9.0])
    np.testing.assert_allclose(rule(-agreed), [-12.0])
    np.testing.assert_allclose(rule(np.array([-50.0, -10.0, -2.0]).reshape(3, 1, 1)), [-13.0])


def test_doing_worse_on_the_model_that_denies_it_never_raises_a_candidate() -> None:
    rule = make_aggregate("credible")
    other = np.array([10.0, 12.0])
    lowered = [rule(np.array([denying, *other]).reshape(3, 1, 1))[0] for denying in np.linspace(12.0, -20.0, 60)]
    assert (np.diff(lowered) <= 1e-12).all()


def test_the_mean_rank_is_turned_back_into_the_fitness_that_stands_there() -> None:
    # on the second model all is a hundred times as large; ranks 0, 1, 2 and 2, 1, 0, then 0.5, 0.5, 2
    means = np.array([[1.0, 2.0, 6.0], [300.0, 200.0, 100.0]])[:, :, None]
    rule = make_aggregate("rank_mean")
    np.testing.assert_allclose(rule.in_population(means), [101.0, 101.0, 101.0])
    np.testing.assert_allclose(rule(means), [150.5, 101.0, 53.0])
    np.testing.assert_allclose(rule.in_population(np.array([[3.0, 3.0, 8.0]])[:, :, None]), [3.0, 3.0, 8.0])


def test_a_random_subset_is_another_one_in_other_generations_and_with_another_seed() -> None:
    rule, other = make_aggregate("random_subset(size=2)"), make_aggregate("random_subset(size=2, seed=1)")
    drawn = [tuple(rule.models(4, generation)) for generation in range(60)]
    assert set(map(len, drawn)) == {2}
    assert len(set(drawn)) == 6  # every pair of the four
    assert drawn != [tuple(other.models(4, generation)) for generation in range(60)]
    assert rule.models(1, 0).tolist() == [0]


@pytest.mark.parametrize(
    "spec",
    ["cvar(share=0)", "cvar(share=1.1)", "lower_confidence(weight=-1)", "credible(share=2)", "random_subset(size=0)"],
)
def test_a_parameter_that_makes_no_sense_is_refused(spec: str) -> None:
    with pytest.raises(InvalidArgument, match=f"{spec.partition('(')[0]}: expected "):
        make_aggregate(spec)


@pytest.mark.parametrize("name", aggregates.names())
def test_every_rule_keeps_the_laws_of_aggregates(name: str, rng: np.random.Generator) -> None:
    rule, fitness = make_aggregate(name), rng.uniform(-10.0, 10.0, (3, 7, 5))
    kept, result = fitness.copy(), rule(fitness)
    assert (result.shape, result.dtype) == ((7,), np.float64)
    np.testing.assert_array_equal(fitness, kept)
    alone = [rule(fitness[:, i : i + 1])[0] for i in range(7)]
    np.testing.assert_allclose(result, alone, rtol=1e-12)
    np.testing.assert_allclose(rule(fitness[::-1, :, ::-1]), result, rtol=1e-9)
    assert (rule(fitness + 1.0) > result).all()
    np.testing.assert_allclose(rule(np.full((3, 1, 5), 2.5)), 2.5, rtol=1e-9)
    assert np.isfinite(rule(fitness[:1, :1, :1])).all()


@pytest.mark.parametrize("name", ["min", "mean", "median"])
def test_of_one_model_these_rules_take_the_mean_over_its_trials_to_the_last_bit(
    name: str, rng: np.random.Generator
) -> None:
    rule, fitness = make_aggregate(name), rng.uniform(-10.0, 10.0, (1, 7, 5))
    assert rule.mean_of_one
    np.testing.assert_array_equal(rule(fitness), fitness.mean(axis=2)[0])
