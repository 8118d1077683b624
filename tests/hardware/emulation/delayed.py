"""A fine dynamics that can be written down in a line, to be held at a coarser rate."""

from __future__ import annotations

import numpy as np

from sysid_evo.models import Dynamics
from sysid_evo.system import Channel, System
from sysid_evo.types import Array


class Delayed(Dynamics):
    """x_{t+1} = 0.9 x_t + u_{t-3} + w_t."""

    n_carry, n_lags, n_noise = 4, 3, 1

    def __init__(self) -> None:
        self.system = System((Channel("x"),), (Channel("u", low=-1.0, high=1.0),), dt=0.01)

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return np.concatenate([states[:, -1], controls[:, -3:, 0]], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        shaken = 0.0 if noise is None else noise
        return np.concatenate([0.9 * carry[:, :1] + carry[:, 1:2] + shaken, carry[:, 2:], control], axis=1)
