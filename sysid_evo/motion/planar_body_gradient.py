"""The derivatives of a body on a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid_evo.motion.gradient_form import Numbers
from sysid_evo.motion.planar_body import turn


@dataclass(frozen=True)
class PlanarBodyGradient:
    """`PlanarBody` backwards, with its roles in these columns of the state.

    A velocity w that is turned by the angle a becomes R(a) w; of a number with the gradient g by it, the gradient by w
    is h = R(a)^T g, and that by a is w x h.
    """

    forward: int
    lateral: int | None
    yaw_rate: int

    def integrated(
        self, state: Numbers, acceleration: Numbers, dt: float, gradient: Numbers
    ) -> tuple[Numbers, Numbers]:
        by_state = gradient.copy()
        if self.lateral is None:
            return by_state, dt * gradient
        angle = state[..., self.yaw_rate] * dt
        along, across = turn(gradient[..., self.forward], gradient[..., self.lateral], np.cos(angle), np.sin(angle))
        by_state[..., self.forward], by_state[..., self.lateral] = along, across
        by_acceleration = dt * by_state
        before = state + acceleration * dt
        by_state[..., self.yaw_rate] -= dt * (before[..., self.forward] * across - before[..., self.lateral] * along)
        return by_state, by_acceleration

    def turned(self, state: Numbers, gradient: Numbers) -> Numbers:
        found = np.zeros_like(state)
        if self.lateral is not None:
            along, across = gradient[..., self.forward], gradient[..., self.lateral]
            yaw_rate = state[..., self.yaw_rate]
            found[..., self.forward], found[..., self.lateral] = -yaw_rate * across, yaw_rate * along
            found[..., self.yaw_rate] = state[..., self.lateral] * along - state[..., self.forward] * across
        return found
