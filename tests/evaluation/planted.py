"""Recordings of a made-up machine with one fault planted, and without."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.system import Channel, System

MACHINE = System(
    states=(Channel("speed", "m/s"), Channel("turn", "rad/s")),
    controls=(Channel("push", low=-1.0, high=1.0), Channel("steer", low=-1.0, high=1.0)),
    dt=0.05,
    name="machine",
)
DECAY, GAIN = np.array([0.92, 0.8]), np.array([0.12, 0.5])


@dataclass(frozen=True)
class Fault:
    """What is wrong: the plain machine has none of it.

    ``late`` steps pass before push acts; ``drift`` is the size of a slow push that nobody measures; ``measured`` the
    standard deviation of the noise on measured states; ``bend`` how strongly speed bends the answer to steer; ``grip``
    the share of steer that works in the last recording; with ``dead`` steer does nothing below a speed of 0;
    ``push`` the largest push; ``loud`` how many times louder the noise is above a speed of 0.5.
    """

    late: int = 0
    drift: float = 0.0
    measured: float = 0.0
    bend: float = 0.0
    grip: float = 1.0
    dead: bool = False
    push: float = 1.0
    loud: float = 1.0


def drive(
    fault: Fault = Fault(), seed: int = 0, *, episodes: int = 3, steps: int = 800, noise: float = 0.02
) -> Dataset:
    """Return recordings of the machine under random controls that are held for five steps."""
    rng = np.random.default_rng(seed)
    states, controls = [], []
    for number in range(episodes):
        u = np.repeat(rng.uniform(-1.0, 1.0, (steps // 5 + 1, 2)), 5, axis=0)[:steps] * [fault.push, 1.0]
        x, drift = np.zeros((steps + 1, 2)), 0.0
        grip = fault.grip if number == episodes - 1 else 1.0
        for k in range(steps):
            push = u[max(k - fault.late, 0), 0]
            speed = x[k, 0]
            steer = u[k, 1] * grip * (0.0 if fault.dead and speed < 0.0 else 1.0) * (1.0 + fault.bend * speed)
            drift = 0.95 * drift + np.sqrt(1.0 - 0.95**2) * fault.drift * rng.standard_normal()
            size = noise * (fault.loud if speed > 0.5 else 1.0)
            x[k + 1] = DECAY * x[k] + GAIN * [push, steer] + [drift, 0.0] + size * rng.standard_normal(2)
        states.append(x + fault.measured * rng.standard_normal(x.shape))
        controls.append(u)
    return Dataset.from_arrays(MACHINE, states, controls, names=[f"day {number + 1}" for number in range(episodes)])
