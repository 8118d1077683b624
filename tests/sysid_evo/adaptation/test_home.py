"""A model that knows how far off it was on what it did not learn from is adapted only where it is farther off."""

import numpy as np
import pytest

from sysid_evo.errors import PluginError
from sysid_evo.models.adaptation import NONE, adaptation, held_out_error
from sysid_evo.models.adaptation.selection import AS_AT_HOME, MOST_PIECES, times_home
from sysid_evo.models.base import make_model
from tests.fixtures.systems import FloorCar, drive


def fitted():
    return make_model("linear").fit(drive(FloorCar(), seconds=30.0, seed=0), rng=0)


def errors_by_hand(model, seed):
    """Return the errors (N, 20, nx) of free runs of one second that begin at every third sample."""
    windows = drive(FloorCar(), seconds=20.0, seed=seed).windows(20, stride=3, moving=True)
    return model.simulate(windows.past_states, windows.past_controls, windows.controls) - windows.states


def test_errors_of_all_that_was_held_out_are_pooled_in_the_units_of_the_states():
    model = fitted()
    cases = [(model, drive(FloorCar(), seconds=20.0, seed=seed)) for seed in (1, 2)]
    squares = [(errors_by_hand(model, seed) ** 2).reshape(-1, 3) for seed in (1, 2)]
    found = held_out_error(cases)
    assert found is not None
    np.testing.assert_allclose(found, np.sqrt(np.concatenate(squares).mean(axis=0)), rtol=1e-6)
    assert found[0] != pytest.approx(found[2], rel=0.2)


def test_of_a_long_recording_so_many_runs_are_made_from_its_beginning_to_its_end():
    class Counting(FloorCar):
        most = 0

        def step(self, carry, control, noise=None):
            self.most = max(self.most, len(carry))
            return super().step(carry, control, noise)

    car, held = Counting(), drive(FloorCar(), seconds=200.0, seed=1, noise=0.0)
    found = held_out_error([(car, held)])
    assert found is not None
    assert found.max() < 1e-9
    assert car.most == MOST_PIECES


def test_what_is_too_short_for_a_run_says_nothing():
    model = fitted()
    assert held_out_error([(model, drive(FloorCar(), seconds=20.0, seed=1))]) is not None
    both = [(model, drive(FloorCar(), seconds=seconds, seed=1)) for seconds in (20.0, 0.5)]
    assert held_out_error(both) is None


def test_the_state_that_is_farthest_from_what_it_was_at_home_counts_in_its_own_unit():
    """Errors of 2 and 4 scales of 10 and 0.1 are 20 and 0.4; at home they were 10 and 0.1."""
    errors = np.broadcast_to(np.array([2.0, -4.0]), (7, 5, 2))
    assert times_home(errors, np.array([10.0, 0.1]), np.array([10.0, 0.1])) == pytest.approx(4.0)
    assert times_home(errors, np.array([10.0, 0.1]), np.array([1.0, 0.1])) == pytest.approx(20.0)


def test_a_family_that_says_it_otherwise_is_told_what_is_expected():
    model = fitted()
    model.held_out_error_ = np.ones(2)
    with pytest.raises(PluginError, match=r"a number for each of 3 states, got the shape \(2,\)"):
        model.adapt(drive(FloorCar(), seconds=20.0, seed=1), rng=0)


@pytest.mark.parametrize(("share", "tried"), [(0.96, False), (1.04, True)])
def test_nothing_is_tried_where_a_model_is_hardly_farther_off_than_it_was(share, tried):
    """Pieces that reach over the edges of blocks are left out there, so that the two differ by a few percent."""
    model, new = fitted(), drive(FloorCar(thrust=1.5), seconds=20.0, seed=3)
    at_home = held_out_error([(model, new)])
    free = adaptation(model, new, rng=np.random.default_rng(0)).verdict
    assert free.chosen != NONE
    assert at_home is not None
    model.held_out_error_ = at_home / (AS_AT_HOME * share)
    found = adaptation(model, new, rng=np.random.default_rng(0))
    assert bool(found.verdict.trials) == tried
    if tried:
        assert found.verdict == free
        return
    assert found.verdict.chosen == NONE
    assert found.learned.model is model
    assert not found.learned.coefficients.any()
    assert found.verdict.plain == pytest.approx(free.plain)
    times = found.verdict.times_home
    assert times is not None
    assert times == pytest.approx(AS_AT_HOME * share, rel=0.04)
    assert found.verdict.sentence == (
        f"no correction: nothing much has shifted, free runs of a second are in no state more than {times:.2f} times "
        "as far off as on what was held out from the training"
    )
