"""The history that a model is given when fewer samples were measured than it wants."""

import numpy as np

from evaluation.prediction.cases import PredictionProtocol, measured_cases
from evaluation.prediction.scoring import simulate_cases
from sysid_evo.data import Dataset
from sysid_evo.models import DynamicsModel
from sysid_evo.system import Channel, System

SYSTEM = System((Channel("place"),), (Channel("push", low=0.25, high=5000.0),), 0.1)
STEPS = 60


class Echo(DynamicsModel):
    """The next state is the state ``reach`` samples ago plus 10,000 times the control as long ago."""

    def __init__(self, *, state_lags=4, control_lags=4, reach=4):
        self.state_lags = state_lags
        self.control_lags = control_lags
        self.reach = reach

    def fit(self, dataset, *, rng, progress=None):
        return self

    @property
    def state_bounds(self):
        """No limits."""

    def next_state(self, carry, control):
        return carry[:, [self.reach]] + 1e4 * carry[:, [self.state_lags + self.reach]]


def reached_back_to(*, history, lags, reach):
    """Return the state and the control that the first step from sample 20 used; both are the number of their sample."""
    numbers = np.arange(STEPS + 1.0)
    data = Dataset.from_arrays(SYSTEM, numbers, np.maximum(numbers, 0.25))
    protocol = PredictionProtocol(horizons=(1,), history=history, first=20, stride=1, guard_multiple=1e9)
    model = Echo(state_lags=lags, control_lags=lags, reach=reach).fit(data, rng=np.random.default_rng(0))
    found = float(simulate_cases(model, measured_cases(data, data, protocol)).windows[0, 0, 0])
    state = found % 100.0
    return state, (found - state) / 1e4


def test_a_history_that_is_long_enough_is_the_measured_one():
    assert reached_back_to(history=6, lags=6, reach=6) == (14.0, 14.0)
    assert reached_back_to(history=6, lags=4, reach=1) == (19.0, 19.0)


def test_a_model_is_given_what_it_wants_as_far_back_as_the_record_goes():
    assert reached_back_to(history=None, lags=12, reach=12) == (8.0, 8.0)
    assert reached_back_to(history=None, lags=25, reach=20) == (0.0, 0.25)
    assert reached_back_to(history=None, lags=25, reach=22) == (0.0, 0.25)


def test_a_short_history_is_padded_with_the_first_state_and_neutral_controls():
    assert reached_back_to(history=3, lags=6, reach=6) == (17.0, 0.25)
    assert reached_back_to(history=3, lags=6, reach=4) == (17.0, 0.25)
    assert reached_back_to(history=3, lags=6, reach=3) == (17.0, 17.0)
    assert reached_back_to(history=3, lags=6, reach=1) == (19.0, 19.0)
