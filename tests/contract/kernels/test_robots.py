"""The compiled form of the emulated car, and of a control that is held, against their NumPy steps."""

import numpy as np
import pytest

from hardware.emulation.car_physics import BODY, BUFFER, CarParameters
from hardware.emulation.cars import AWKWARD, ToyCarDynamics
from hardware.emulation.held_control import HeldControl
from sysid_evo.kernels import LANES, DynamicsKernel, ScalarStep
from tests.fixtures.by_hand import Delayed
from tests.fixtures.lanes import step_between_guards


def any_carry(rng):
    """64 carries (64, n_carry): any speed, commands under way, battery; some at rest or close to it."""
    carry = np.zeros((LANES, ToyCarDynamics.n_carry))
    carry[:, :3] = rng.uniform(-1.0, 1.0, (LANES, 3)) * [2.0, 0.7, 6.0] * rng.choice([1.0, 1e-2, 0.0], (LANES, 1))
    carry[:, BUFFER] = rng.integers(-1, 2, (LANES, BODY - 3))
    motor, slack = rng.uniform(-1.0, 1.0, LANES), rng.choice([-1.0, -0.4, 1.0], LANES)
    sag, battery = rng.uniform(0.0, 0.08, LANES), rng.uniform(0.9, 1.1, LANES)
    steering, noises = rng.uniform(-0.2, 0.2, LANES), rng.normal(0.0, [[0.25], [2.0]], (2, LANES))
    carry[:, BODY:] = np.stack([motor, sag, battery, slack, steering, *noises], axis=1)
    return carry


def any_control(rng):
    return rng.integers(-1, 2, (LANES, 2)).astype(float)


@pytest.mark.parametrize(
    "precision, tolerance", [("float32", 1e-5), pytest.param("float64", 1e-12, marks=pytest.mark.nightly)]
)
@pytest.mark.parametrize(
    "car", [CarParameters(), CarParameters().perturbed(3), AWKWARD], ids=["car", "other", "awkward"]
)
def test_one_fine_step_is_that_of_numpy_from_any_carry(rng, car, precision, tolerance):
    physics = ToyCarDynamics(car)
    for _ in range(30):
        given = any_carry(rng), any_control(rng), rng.standard_normal((LANES, 2))
        found = step_between_guards(physics.kernel(), *given, precision=precision)
        assert np.abs(found - physics.step(*given)).max() < tolerance


@pytest.mark.parametrize("repeats", [3, 10, 13])
def test_commands_arrive_when_they_are_due_however_long_they_are_held(rng, repeats):
    held = HeldControl(ToyCarDynamics(), repeats)
    carry = other = any_carry(rng)
    for _ in range(12):
        control, noise = any_control(rng), rng.standard_normal((LANES, 2 * repeats))
        carry = step_between_guards(held.kernel(), carry, control, noise, precision="float64")
        other = held.step(other, control, noise)
        assert np.array_equal(carry[:, BUFFER], other[:, BUFFER])
        assert np.abs(carry - other).max() < 1e-11


def test_rounding_does_not_add_up_in_float32(rng):
    held = HeldControl(ToyCarDynamics(), 10)
    carry = other = held.start(np.zeros((LANES, 2, 3)), np.zeros((LANES, 1, 2)), rng.standard_normal((LANES, 3)))
    full_speed = np.tile([1.0, 0.0], (LANES, 1))
    for _ in range(100):
        noise = rng.standard_normal((LANES, 20))
        carry = step_between_guards(held.kernel(), carry, full_speed, noise, precision="float32")
        other = held.step(other, full_speed, noise)
    assert other[:, 0].min() > 1.5
    assert np.abs((carry - other)[:, 0]).max() < 2e-6
    assert abs((carry - other)[:, 0].mean()) < 1e-6


class Compiled(Delayed):
    """It, with a scalar step of its own."""

    def kernel(self):
        return DynamicsKernel(ScalarStep(delayed, n_carry=4, nu=1, n_noise=1), np.array([0.9]))


def delayed(x, u, w, p):
    return p[0] * x[0] + x[1] + w[0], x[2], x[3], u[0]


def test_any_fine_kernel_can_be_held_and_without_one_there_is_none(rng):
    held = HeldControl(Compiled(), 5)
    carry, control, noise = (rng.standard_normal((LANES, size)) for size in (4, 1, 5))
    found = step_between_guards(held.kernel(), carry, control, noise, precision="float32")
    assert np.abs(found - held.step(carry, control, noise)).max() < 1e-5
    assert HeldControl(Delayed(), 5).kernel() is None
