"""The sanity check of fitted models: only one that is worse than both references, at every horizon, fails."""

import numpy as np
import pytest

from model_zoo.linear import Linear
from sysid_evo.models.sanity import SanityCheck
from tests.fixtures.known_models import Known, Undefined, Weak, fitted, noisy, recording


class Off(Known):
    """The truth with an error in every step, in metres per second and radians per second."""

    error = 0.0

    def next_state(self, carry, control):
        return super().next_state(carry, control) + self.error


class Still(Known):
    """Predicts zero, near the mean of the recording."""

    def next_state(self, carry, control):
        return np.zeros_like(carry)


def off(error):
    model = fitted(Off())
    model.error, model.state_bounds_ = error, None
    return model


@pytest.fixture(scope="module")
def check():
    return SanityCheck.of((noisy(2), noisy(3)))


def test_a_model_worse_than_both_references_after_a_step_and_after_a_second_fails(check):
    warning = check.warning(off(2.0))
    assert warning.startswith("is worse than both no change (persistence) and a linear model on held-out data: N ")
    (first, at_a_second), (linear, linear_later) = check.references
    assert f"after 1 step ({first:.3g} and {linear:.3g})" in warning
    assert f"after 20 steps ({at_a_second:.3g} and {linear_later:.3g})" in warning
    assert not check.warning(fitted(Known()))


def errors_of(check, model):
    return check.scorer.errors([check.scorer.trials[0].run(model)]).at


def test_a_model_that_is_worse_after_one_step_alone_passes(check):
    still = fitted(Still())
    assert errors_of(check, still)[0] > 1.2 * check.references[:, 0].max()
    assert not check.warning(still)


def test_a_model_must_be_a_tenth_worse_than_each_reference(check):
    model = fitted(Weak())
    errors = errors_of(check, model)
    for kept, linear, fails in ((1.15, 1.15, True), (1.05, 1.15, False), (1.15, 1.05, False)):
        assert bool(SanityCheck(check.scorer, np.stack([errors / kept, errors / linear])).warning(model)) == fails


def test_a_simulation_that_is_not_a_number_fails(check):
    assert "inf after 1 step" in check.warning(fitted(Undefined()))


def test_a_linear_model_passes_its_own_check_and_folds_count_together():
    pairs = [(noisy(2), noisy(3)), (noisy(4), noisy(5))]
    models = [Linear().fit(training, rng=0) for training, _ in pairs]
    assert not SanityCheck.of(*pairs).warning(*models)
    assert SanityCheck.of(*pairs).warning(off(2.0), off(2.0))
    assert not SanityCheck.of(*pairs).warning(fitted(Known()), fitted(Known()))


def test_an_error_of_a_hundredth_of_the_motion_never_fails():
    """Where both references are nearly exact, such as in slow motion that is sampled fast."""
    exact = SanityCheck.of((recording(), recording(2, seed=9)))
    exact = SanityCheck(exact.scorer, np.zeros((2, 2)))
    for error, fails in ((0.0005, False), (0.02, True)):
        assert bool(exact.warning(off(error))) == fails
    assert 0.001 < errors_of(exact, off(0.0005))[0] < 0.02 < errors_of(exact, off(0.02))[0]


def test_where_a_second_does_not_fit_the_first_step_decides():
    training, held = noisy(2), noisy(3, episodes=1, steps=15)
    check = SanityCheck.of((training, held))
    assert check.scorer.trials[0].horizons == (1,)
    assert "after 1 step" in check.warning(off(2.0))
    assert not SanityCheck.of((recording(), recording(1, 15, seed=9))).warning(fitted(Known()))
