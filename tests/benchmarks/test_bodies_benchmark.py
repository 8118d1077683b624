"""The equations on which the benchmark of bodies searches are those of the package."""

import numpy as np
import pytest

from hardware.robot import find_robot
from sysid_evo.engine.compiled.open_loop import kernel_step

pytest.importorskip("rotorpy", reason="the benchmark needs the extra quadrotor")
pytest.importorskip("vehiclemodels", reason="the benchmark needs the extra drift-car")
from tests.benchmarks.bodies.agreement import agreement
from tests.benchmarks.bodies.flight import Flight
from tests.benchmarks.bodies.sliding import Slide


@pytest.mark.parametrize("vehicle", ["hummingbird", "crazyflie"])
def test_compiled_equations_of_a_quadrotor_agree_with_the_package(vehicle):
    robot = find_robot(f"quadrotor(vehicle={vehicle})")
    assert agreement(Flight(robot), robot.simulator, amplitude=0.7) < 0.02


def test_compiled_equations_of_a_sliding_car_agree_with_the_package():
    robot = find_robot("drift_car")
    assert agreement(Slide(robot), robot.simulator, amplitude=1.0, episodes=3, steps=15) < 1e-9


@pytest.mark.parametrize(("robot", "equations"), [("quadrotor", Flight), ("drift_car", Slide)])
def test_compiled_equations_are_those_in_numpy(robot, equations):
    robot = find_robot(robot)
    dynamics, rng, nu = equations(robot), np.random.default_rng(0), robot.system.nu
    states = np.stack([robot.simulator.open().reset(seed) for seed in range(5)])
    carry = dynamics.start(states[:, None], np.zeros((5, 0, nu)))
    control = robot.system.actuate(rng.uniform(-0.7, 0.7, (5, nu)))
    compiled = kernel_step(dynamics.kernel(), carry, control, precision="float64")
    np.testing.assert_allclose(compiled, dynamics.step(carry, control), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("speed", [0.9, 30.1])
def test_a_sliding_car_whose_trial_is_over_does_not_move(speed):
    car = Slide(find_robot("drift_car"))
    state = np.array([[speed, 0.3, 0.2, 0.0, speed, speed]])
    after = car.step(state, np.array([[6.0, 0.5]]))
    assert not after[:, :3].any()
    assert not car.step(after, np.array([[6.0, 0.5]]))[:, :3].any()
