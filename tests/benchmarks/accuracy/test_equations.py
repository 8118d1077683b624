"""The reference of the benchmark has the equations of the environments."""

import numpy as np
import pytest

from hardware.simulators.gymnasium_robot import GymnasiumRobot
from tests.benchmarks.environments import EQUATIONS, Equations


@pytest.mark.parametrize("name", EQUATIONS)
def test_one_step_of_the_equations_is_one_of_the_environment(name):
    robot = GymnasiumRobot(id=name)
    own, rng = Equations(name, robot.system), np.random.default_rng(0)
    low = np.array([max(c.low, -3.0) for c in robot.system.states])
    high = np.array([min(c.high, 3.0) for c in robot.system.states])
    states = rng.uniform(low, high, (40, robot.system.nx))
    controls = robot.system.actuate(rng.uniform(-1.0, 1.0, (40, 1)))
    found = own.step(states, controls)
    with robot.simulator.open() as session:
        for state, control, after in zip(states, controls, found, strict=True):
            session.reset(0, state)
            expected = session.step(control)[0]
            np.testing.assert_allclose(robot.system.difference(after, expected), 0.0, atol=1e-5)
