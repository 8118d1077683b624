"""The shipped rules on numbers that can be followed by hand."""

import numpy as np
import pytest

from evaluation.cells.controllers import EQUIVALENT_AGGREGATES
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.aggregates import make_aggregate
from sysid_evo.registry import aggregates

FITNESS = np.array([[[1.0, 3.0], [5.0, 5.0]], [[0.0, 8.0], [9.0, 9.0]], [[9.0, 9.0], [0.0, 2.0]]])
"""Three models, two candidates, two trials; the models' means are 2, 4, 9 and 5, 9, 1."""


@pytest.mark.parametrize(("name", "expected"), [("min", [2.0, 1.0]), ("mean", [5.0, 5.0]), ("median", [4.0, 5.0])])
def test_the_rule_is_taken_over_the_models_of_their_means_over_the_trials(name, expected):
    np.testing.assert_array_equal(make_aggregate(name)(FITNESS), expected)


def test_cvar_is_the_mean_of_the_worst_outcomes_of_which_the_last_counts_in_part():
    # in order: 0, 1, 3, 8, 9, 9 and 0, 2, 5, 5, 9, 9; 40 % of six outcomes are 2.4
    expected = [(0.0 + 1.0 + 0.4 * 3.0) / 2.4, (0.0 + 2.0 + 0.4 * 5.0) / 2.4]
    np.testing.assert_allclose(make_aggregate("cvar(share=0.4)")(FITNESS), expected)
    np.testing.assert_allclose(make_aggregate("cvar(share=0.01)")(FITNESS), [0.0, 0.0])
    np.testing.assert_allclose(make_aggregate("cvar(share=1)")(FITNESS), [5.0, 5.0])


@pytest.mark.parametrize(
    ("spec", "reason"),
    [
        ("cvar(share=0)", "cvar: expected share"),
        ("cvar(share=1.1)", "cvar: expected share"),
        ("cvar(weight=1)", r"'cvar' has no parameter 'weight'\. It takes share \(0\.3\)\."),
    ],
)
def test_a_parameter_that_makes_no_sense_is_refused_before_anything_is_run(spec, reason):
    with pytest.raises(InvalidArgument, match=reason):
        make_aggregate(spec)


@pytest.mark.parametrize("name", aggregates.names())
def test_every_rule_keeps_the_laws_of_aggregates(name, rng):
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


@pytest.mark.parametrize("name", EQUIVALENT_AGGREGATES)
def test_of_one_model_these_rules_take_the_mean_over_its_trials_to_the_last_bit(name, rng):
    rule, fitness = make_aggregate(name), rng.uniform(-10.0, 10.0, (1, 7, 5))
    np.testing.assert_array_equal(rule(fitness), fitness.mean(axis=2)[0])
