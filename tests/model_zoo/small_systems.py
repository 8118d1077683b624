"""Linear systems without noise, with few states or without controls: recordings whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

STATES = (Channel("angle", "rad"), Channel("rate", "rad/s"))
FORCE = Channel("force", "N", low=-1.0, high=1.0)
TURNING = np.array([[0.99, 0.1], [-0.1, 0.97]])
"""A damped oscillation of about six seconds at 10 Hz."""


@dataclass(frozen=True)
class LinearSystem:
    """x_{k+1} = ``a`` x_k + ``b`` u_k without noise; ``constant`` is the control, if it never changes."""

    system: System
    a: Array
    b: Array
    constant: float | None = None

    def recording(self, seed: int = 0, episodes: int = 2, steps: int = 150) -> Dataset:
        """Return episodes from random states under random steps of the control."""
        rng = np.random.default_rng(seed)
        states, controls = [], []
        for _ in range(episodes):
            control = np.repeat(rng.uniform(-1.0, 1.0, (steps // 5, self.system.nu)), 5, axis=0)
            control = control if self.constant is None else np.full_like(control, self.constant)
            state = [rng.uniform(-1.0, 1.0, self.system.nx)]
            for u in control:
                state.append(self.a @ state[-1] + self.b @ u)
            states.append(np.array(state))
            controls.append(control)
        return Dataset.from_arrays(self.system, states, controls)


DRIVEN = LinearSystem(System(STATES, (FORCE,), dt=0.1), TURNING, np.array([[0.0], [0.1]]))
AUTONOMOUS = LinearSystem(System(STATES, (), dt=0.1), TURNING, np.zeros((2, 0)))
ONE_STATE = LinearSystem(System(STATES[1:], (FORCE,), dt=0.1), np.array([[0.9]]), np.array([[0.3]]))
CONSTANT = LinearSystem(DRIVEN.system, TURNING, DRIVEN.b, constant=0.3)
SMALL_SYSTEMS = {"autonomous": AUTONOMOUS, "one state": ONE_STATE, "constant control": CONSTANT}
