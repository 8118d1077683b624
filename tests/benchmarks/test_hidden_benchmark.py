"""The benchmark of systems with one measured output: its systems, and errors after a number of steps."""

import numpy as np
import pytest

from sysid_evo.models.base import make_model
from tests.benchmarks.hidden.__main__ import BEGIN, free_run_error
from tests.benchmarks.hidden.check_systems import CHECKS
from tests.benchmarks.hidden.systems import SYSTEMS


def test_an_error_after_some_steps_is_that_of_the_last_sample_of_a_simulation():
    training, test = SYSTEMS["tanks"].recordings(0)
    model = make_model("linear", state_lags=2, control_lags=2).fit(training)
    short = test.with_episodes([test.episodes[0][: BEGIN + 12]])
    run = short.episodes[0]
    simulated = model.simulate(run.states[BEGIN - 2 : BEGIN + 1], run.controls[BEGIN - 2 : BEGIN], run.controls[BEGIN:])
    last = abs(simulated[-1, 0] - run.states[-1, 0])
    assert free_run_error(model, short, 12) == pytest.approx(last / run.states.std())
    assert free_run_error(model, short) != pytest.approx(last / run.states.std())


@pytest.mark.parametrize("name", CHECKS)
def test_check_systems_answer_the_control_and_repeat_with_the_seed(name):
    system = CHECKS[name]
    training, _ = system.recordings(1)
    output = training.episodes[0].states
    assert np.isfinite(output).all()
    assert len(output) == system.steps + 1
    np.testing.assert_array_equal(output, system.recordings(1)[0].episodes[0].states)
    still = system.simulate(system.parameters, np.zeros(200))
    assert np.abs(system.simulate(system.parameters, np.full(200, 0.5)) - still)[-1] > 0.1 * output.std()
    assert name not in SYSTEMS
