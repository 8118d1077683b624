"""A made-up car of known physics, on two floors."""

from __future__ import annotations

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.models import Dynamics
from sysid_evo.testing.examples import continuous_car
from sysid_evo.types import Array


class FloorCar(Dynamics):
    """A car without lags: ``thrust`` m/s2, and ``turn`` rad/s per m of way and full steering."""

    n_carry = 3

    def __init__(self, thrust: float = 3.0, turn: float = 4.0) -> None:
        self.system, self.thrust, self.turn = continuous_car(), thrust, turn

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return states[:, -1].copy()

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        u, v, r = carry.T
        drive, steer = control.T
        acceleration = np.stack(
            [self.thrust * drive - 1.5 * u, -5.0 * v + 0.2 * u * r, self.turn * u * steer - 3.0 * r], axis=1
        )
        return self.system.integrate(carry, acceleration)


def drive(car: Dynamics, *, seconds: float, seed: int, noise: float = 0.01) -> Dataset:
    """Return one episode under random commands that are held for a quarter of a second."""
    rng, steps = np.random.default_rng(seed), round(seconds / car.system.dt)
    controls = np.repeat(rng.uniform(-1.0, 1.0, (steps // 5 + 1, 2)), 5, axis=0)[:steps]
    states = np.zeros((steps + 1, 3))
    for k in range(steps):
        states[k + 1] = car.step(states[k : k + 1], controls[k : k + 1])[0] + noise * rng.standard_normal(3)
    return Dataset.from_arrays(car.system, states, controls, names=[f"drive-{seed}"])
