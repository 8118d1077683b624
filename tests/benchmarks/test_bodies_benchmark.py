"""The equations on which the benchmark of bodies searches are those of the package."""

import numpy as np
import pytest

from hardware.robot import find_robot
from sysid_evo.engine.compiled.open_loop import kernel_step

pytest.importorskip("rotorpy", reason="the benchmark needs the extra quadrotor")
from tests.benchmarks.bodies.flight import Flight, agreement


@pytest.mark.parametrize("vehicle", ["hummingbird", "crazyflie"])
def test_compiled_equations_of_a_quadrotor_agree_with_the_package(vehicle):
    assert agreement(find_robot(f"quadrotor(vehicle={vehicle})")) < 0.02


def test_compiled_equations_are_those_in_numpy():
    robot = find_robot("quadrotor")
    flight, rng = Flight(robot), np.random.default_rng(0)
    states = np.stack([robot.simulator.open().reset(seed) for seed in range(5)])
    carry = flight.start(states[:, None], np.zeros((5, 0, 4)))
    control = robot.system.actuate(rng.uniform(-0.7, 0.7, (5, 4)))
    compiled = kernel_step(flight.kernel(), carry, control, precision="float64")
    np.testing.assert_allclose(compiled, flight.step(carry, control), rtol=1e-9, atol=1e-12)
