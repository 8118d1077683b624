"""Intervals over trials: closed forms where there are some, coverage where there are none."""

import numpy as np
import pytest
from scipy.stats import t

from evaluation.transfer import PairedEstimate
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.aggregates import make_aggregate


def of(fitness, controller="c"):
    return PairedEstimate.of(controller, np.asarray(fitness, dtype=float)[None])


@pytest.mark.parametrize("trials", [2, 5, 100])
def test_the_interval_is_students_over_trials(rng, trials):
    fitness = rng.normal(size=trials)
    found = of(fitness)
    error = fitness.std(ddof=1) / np.sqrt(trials)
    assert found.degrees == pytest.approx(trials - 1)
    assert found.standard_error == pytest.approx(error)
    np.testing.assert_allclose(found.interval(), t.interval(0.9, trials - 1, fitness.mean(), error))
    np.testing.assert_allclose(found.interval(0.5), t.interval(0.5, trials - 1, fitness.mean(), error))


@pytest.mark.parametrize("other", ["c", "another"])
def test_a_difference_pairs_the_trials_of_one_controller_and_of_two(rng, other):
    luck = rng.normal(size=20)
    noise = 0.01 * rng.normal(size=20)
    gap = of(luck + noise) - of(luck, other)
    expected = of(noise)
    assert gap.value == pytest.approx(expected.value)
    np.testing.assert_allclose(gap.interval(), expected.interval())
    assert gap.standard_error < 0.05 * of(luck).standard_error


def test_trials_that_only_one_figure_has_are_not_paired(rng):
    many, few = rng.normal(size=40), rng.normal(size=5)
    gap = of(many) - of(few)
    alike = (of(many) - of(np.zeros(5))).standard_error
    assert alike == pytest.approx(of(many).standard_error)
    centred = [(many - many.mean()) / np.sqrt(40 * 39), (few - few.mean()) / np.sqrt(20)]
    centred[0][:5] -= centred[1]
    assert gap.standard_error == pytest.approx(np.sqrt((centred[0] ** 2).sum()))
    parts = (centred[0][:5] ** 2).sum(), (centred[0][5:] ** 2).sum()
    assert gap.degrees == pytest.approx(sum(parts) ** 2 / (parts[0] ** 2 / 4 + parts[1] ** 2 / 34))


def test_a_share_of_what_is_claimed_varies_as_its_parts_do(rng):
    claimed, achieved = 12.0 + rng.normal(size=50), 9.0 + rng.normal(size=50)
    kept = of(achieved).over(of(claimed))
    assert kept.value == pytest.approx(achieved.mean() / claimed.mean())
    exact = of((achieved - kept.value * claimed) / claimed.mean())
    np.testing.assert_allclose(np.subtract(kept.interval(), kept.value), exact.interval(), atol=1e-12)
    assert of(claimed).over(of(claimed)).standard_error < 1e-12


def test_the_lowest_of_two_models_varies_as_the_lower_one_does(rng):
    low, high = rng.normal(size=(2, 30))
    found = PairedEstimate.of("c", np.stack([low, high + 100.0]), make_aggregate("min"))
    np.testing.assert_allclose(found.interval(), of(low).interval())


def test_a_single_trial_has_no_interval():
    assert np.isnan(of(np.array([3.0])).interval()).all()
    assert of(np.full(2, 3.0)).interval() == (3.0, 3.0)


def test_the_shape_of_the_fitness_is_checked():
    with pytest.raises(InvalidArgument, match=r"expected \(models, trials\), got shape \(1, 3, 4\)"):
        PairedEstimate.of("c", np.zeros((1, 3, 4)))


def test_ninety_percent_intervals_hold_the_truth(rng):
    """Of 400 repetitions with ten trials, whose luck is shared by all systems and controllers."""
    held = dict.fromkeys(("claimed", "gap", "kept", "regret"), 0)
    for _ in range(400):
        claimed, achieved, other = 2.0 * rng.normal(size=10) + rng.normal(size=(3, 10)) + [[12.0], [9.0], [10.0]]
        found = {
            "claimed": (of(claimed), 12.0),
            "gap": (of(claimed) - of(achieved), 3.0),
            "kept": (of(achieved).over(of(claimed)), 0.75),
            "regret": (of(other, "other") - of(achieved), 1.0),
        }
        for name, (figure, truth) in found.items():
            low, high = figure.interval()
            held[name] += low <= truth <= high
    for name, count in held.items():
        assert 0.86 <= count / 400 <= 0.94, name
