"""How far copied equations are from the simulator that they were copied from."""

from __future__ import annotations

import numpy as np

from hardware.simulators.simulator import ExternalSimulator
from sysid_evo.models.dynamics import PlainDynamics


def agreement(
    copy: PlainDynamics, simulator: ExternalSimulator, *, amplitude: float, episodes: int = 5, steps: int = 50
) -> float:
    """Return the largest difference of a state over ``episodes`` of ``steps`` under random commands.

    ``amplitude`` is the largest command, as a share of the limits of the controls.
    """
    system, rng, worst = copy.system, np.random.default_rng(0), 0.0
    with simulator.open() as session:
        for seed in range(episodes):
            state = session.reset(seed)
            carry = copy.start(state[None, None], np.zeros((1, 0, system.nu)))
            command = system.actuate(rng.uniform(-amplitude, amplitude, system.nu))
            for k in range(steps):
                if k % 5 == 0:
                    command = system.actuate(rng.uniform(-amplitude, amplitude, system.nu))
                state, _, ended, _ = session.step(command)
                carry = copy.step(carry, command[None])
                if ended:
                    break
                worst = max(worst, float(np.abs(carry[0, : system.nx] - state).max()))
    return worst
