"""Models and a data set whose behaviour is known exactly."""

from __future__ import annotations

from typing import Self

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.models import DynamicsModel
from sysid_evo.motion import PlanarBody
from sysid_evo.progress import Progress
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

SYSTEM = System(
    states=(Channel("forward_speed", "m/s"), Channel("lateral_speed", "m/s"), Channel("yaw_rate", "rad/s")),
    controls=(Channel("drive", low=-1.0, high=1.0), Channel("steer", low=-1.0, high=1.0)),
    dt=0.05,
    motion=PlanarBody(),
    name="linear car",
)
DECAY = np.array([0.92, 0.7, 0.8])
GAIN = np.array([[0.12, 0.0, 0.0], [0.0, 0.01, 0.5]])


class Known(DynamicsModel):
    """x_{k+1} = DECAY x_k + GAIN' u_k, exactly the truth of `recording`; there is nothing to learn."""

    def __init__(self) -> None:
        """Take no arguments."""

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        return self

    def next_state(self, carry: Array, control: Array) -> Array:
        return carry * DECAY + control @ GAIN


class Weak(Known):
    """Believes that the motor has half its power."""

    def next_state(self, carry: Array, control: Array) -> Array:
        return carry * DECAY + (control * [0.5, 1.0]) @ GAIN


class Sliding(Known):
    """Believes that steering moves the car sideways."""

    def next_state(self, carry: Array, control: Array) -> Array:
        after = carry * DECAY + control @ GAIN
        after[:, 1] = 0.9 * carry[:, 1] + 0.3 * control[:, 1]
        return after


class Boxed(Known):
    """Is clipped at a fifth of what the training data show."""

    envelope_multiple = 0.2


class Exploding(Known):
    """Doubles its state at every step."""

    def next_state(self, carry: Array, control: Array) -> Array:
        return 2.0 * carry


class Undefined(Known):
    """Stops being a number after the first step."""

    envelope_multiple = np.inf

    def next_state(self, carry: Array, control: Array) -> Array:
        return np.full_like(carry, np.nan)


class Broken(Known):
    """Cannot be stepped."""

    def next_state(self, carry: Array, control: Array) -> Array:
        raise RuntimeError("the network is not there")


class Stopped(Known):
    """Is stopped by Ctrl-C at its first step."""

    def next_state(self, carry: Array, control: Array) -> Array:
        raise KeyboardInterrupt


class Remembering(Known):
    """Asks for eight earlier samples and ignores them."""

    state_lags = 8

    def next_state(self, carry: Array, control: Array) -> Array:
        return carry[:, :3] * DECAY + control @ GAIN


def recording(episodes: int = 3, steps: int = 300, *, seed: int = 1, standstill: int = 0) -> Dataset:
    """Return episodes of the known car under slowly changing random controls.

    ``standstill`` samples without any motion are put into the middle of each episode.
    """
    rng = np.random.default_rng(seed)
    states, controls = [], []
    for _ in range(episodes):
        u = np.repeat(rng.uniform(-1.0, 1.0, (steps // 5 + 1, 2)), 5, axis=0)[:steps]
        x = np.zeros((steps + 1, 3))
        x[0] = [0.5, 0.0, 0.0]
        for k in range(steps):
            x[k + 1] = x[k] * DECAY + u[k] @ GAIN
        if standstill:
            middle = slice(steps // 2, steps // 2 + standstill)
            x[middle], u[middle] = 0.0, 0.0
        states.append(x)
        controls.append(u)
    return Dataset.from_arrays(SYSTEM, states, controls)


def fitted(model: Known, dataset: Dataset | None = None) -> Known:
    """Return ``model`` with its system and envelope recorded."""
    return model.fit(recording() if dataset is None else dataset, rng=np.random.default_rng(0))
