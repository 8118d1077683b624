"""A fine dynamics at a coarser rate."""

import numpy as np
import pytest

from hardware.emulation.cars import ToyCarDynamics
from hardware.emulation.held_control import HeldControl
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import make_robot
from tests.fixtures.by_hand import Delayed


def test_coarse_step_equals_ten_fine_ones_exactly(rng):
    fine = ToyCarDynamics()
    coarse = HeldControl(fine, 10)
    draws = rng.standard_normal((20, 3))
    carry = coarse.start(np.zeros((20, 2, 3)), np.zeros((20, 1, 2)), draws)
    other = fine.start(np.zeros((20, 11, 3)), np.zeros((20, 10, 2)), draws)
    assert np.array_equal(carry, other)
    for _ in range(40):
        control = rng.integers(-1, 2, (20, 2)).astype(float)
        noise = rng.standard_normal((20, 20))
        carry = coarse.step(carry, control, noise)
        for k in range(10):
            other = fine.step(other, control, noise[:, 2 * k : 2 * k + 2])
        assert np.array_equal(carry, other)


def test_history_is_held_as_the_controls_are():
    fine = Delayed()
    coarse = HeldControl(fine, 2)
    assert (coarse.n_lags, coarse.n_noise, coarse.n_carry, coarse.system.dt) == (2, 2, 4, 0.02)
    carry = coarse.start(np.array([[[5.0], [6.0], [7.0]]]), np.array([[[0.1], [0.2]]]))
    assert carry[0].tolist() == [7.0, 0.1, 0.2, 0.2]


def test_any_fine_dynamics_can_be_held(rng):
    fine, steps = Delayed(), 5
    coarse = HeldControl(fine, 3)
    controls, noise = rng.uniform(-1, 1, (steps, 1, 1)), rng.standard_normal((steps, 1, 3))
    carry = coarse.start(np.ones((1, 2, 1)), np.zeros((1, 1, 1)))
    for k in range(steps):
        carry = coarse.step(carry, controls[k], noise[k])
    x, sent = 1.0, np.concatenate([np.zeros(3), np.repeat(controls.ravel(), 3)])
    for k in range(3 * steps):
        x = 0.9 * x + sent[k] + noise.ravel()[k]
    assert carry[0, 0] == pytest.approx(x)


def test_latency_is_exactly_one_sample():
    car = make_robot("emulated_car").dynamics
    carry = car.start(np.tile([1.0, 0.0, 0.0], (3, 2, 1)), np.tile([1.0, 0.0], (3, 1, 1)))
    carry = car.step(carry, np.array([[1.0, 0.0], [-1.0, 0.0], [1.0, 1.0]]))
    assert np.array_equal(carry[0, :3], carry[1, :3])
    assert np.array_equal(carry[0, :3], carry[2, :3])
    carry = car.step(carry, np.zeros((3, 2)))
    assert carry[1, 0] < carry[0, 0]
    assert carry[2, 2] > carry[0, 2]


def test_held_control_refuses_no_steps():
    with pytest.raises(InvalidArgument, match="at least one fine step"):
        HeldControl(ToyCarDynamics(), 0)
