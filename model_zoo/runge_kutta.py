"""One step of the classical fourth-order Runge-Kutta method with the control held."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System


def rk4(rate: Callable[[Array], Array], state: Array, dt: float) -> Array:
    """Return the state (B, nx) after ``dt`` seconds of d state / dt = ``rate(state)``."""
    k1 = rate(state)
    k2 = rate(state + 0.5 * dt * k1)
    k3 = rate(state + 0.5 * dt * k2)
    k4 = rate(state + dt * k3)
    return state + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def frame_rotation(system: System, state: Array) -> Array:
    """Return how the turning frame of a planar body changes its velocities: (r v, -r u), zero elsewhere."""
    turning = np.zeros_like(state)
    if isinstance(system.motion, PlanarBody):
        forward, lateral, yaw_rate = system.motion.indices(system.state_names)
        if lateral is not None:
            turning[:, forward] = state[:, yaw_rate] * state[:, lateral]
            turning[:, lateral] = -state[:, yaw_rate] * state[:, forward]
    return turning
