"""What the tests of the families share: three recordings, and a car whose parameters are known."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset

TRUTH = {
    "thrust_forward": 4.0,
    "thrust_backward": 2.4,
    "turn_left": 6.0,
    "turn_right": 3.6,
    "drag_linear": 1.0,
    "drag_viscous": 0.4,
    "yaw_drag_linear": 2.0,
    "yaw_drag_viscous": 0.3,
    "min_speed": 0.05,
    "min_yaw_rate": 0.1,
    "max_speed": 2.5,
    "max_yaw_rate": 4.0,
}


@pytest.fixture(scope="session")
def switched() -> Dataset:
    """The made-up car under three-way switches."""
    return example_dataset()


@pytest.fixture(scope="session")
def proportional() -> Dataset:
    """A made-up car under proportional controls: throttle from 0 to 1, steering from -1 to 1."""
    rng = np.random.default_rng(3)
    system = System(
        states=(Channel("forward_speed", "m/s"), Channel("lateral_speed", "m/s"), Channel("yaw_rate", "rad/s")),
        controls=(Channel("drive", low=0.0, high=1.0), Channel("steer", low=-1.0, high=1.0)),
        dt=0.05,
        motion=example_dataset(steps=1).system.motion,
        name="made-up proportional car",
    )
    controls = np.repeat(rng.uniform([0.0, -1.0], [1.0, 1.0], (3, 40, 2)), 5, axis=1)
    states = np.zeros((3, 201, 3))
    for k in range(200):
        u, v, r = states[:, k].T
        drive, steer = controls[:, k].T
        acceleration = np.stack([3.0 * drive - 1.5 * u, -5.0 * v + 0.2 * u * r, 4.0 * u * steer - 3.0 * r], axis=1)
        states[:, k + 1] = system.integrate(states[:, k], acceleration) + 0.01 * rng.standard_normal((3, 3))
    return Dataset.from_arrays(system, list(states), list(controls))


@pytest.fixture(scope="session")
def oscillator() -> Dataset:
    """A damped oscillator under a force: no motion, nothing of a car."""
    rng = np.random.default_rng(4)
    system = System((Channel("position", "m"), Channel("speed", "m/s")), (Channel("force", "N", -2.0, 2.0),), dt=0.1)
    force = np.repeat(rng.uniform(-2.0, 2.0, (2, 50, 1)), 4, axis=1)
    states = np.zeros((2, 201, 2))
    for k in range(200):
        position, speed = states[:, k].T
        change = np.stack([speed, force[:, k, 0] - 2.0 * position - 0.3 * speed], axis=1)
        states[:, k + 1] = states[:, k] + 0.1 * change + 0.002 * rng.standard_normal((2, 2))
    return Dataset.from_arrays(system, list(states), list(force))


@pytest.fixture(scope="session")
def known_car(car: System):
    """A parametrised car with the parameters `TRUTH`, as if it had been fitted."""
    model = make_model("parametrised")
    model.system_ = car
    model.parameters_ = np.array(list(TRUTH.values()))
    return model
