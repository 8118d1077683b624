"""The physics of a car while their parameters are trained: rates, and their derivatives by hand."""

from __future__ import annotations

from typing import final

import numpy as np

from model_zoo.car.family import CarRoles
from model_zoo.car.physics import positive_part
from model_zoo.networks.layers import Single


@final
class CarPhysics:
    """The known part of dx/dt of `HybridOde`, under controls that are given before the steps begin.

    What the controls do is worked out once for all steps: the thrust (H, ...), and the yaw acceleration per forward
    speed (H, ...).
    """

    def __init__(self, roles: CarRoles) -> None:
        self.forward, self.lateral, self.yaw_rate, self.drive, self.steer = roles

    def hold(self, controls: Single, parameters: Single) -> None:
        """Expect these ``controls`` (H, ..., nu) and ``parameters`` (9,)."""
        drive, steer = controls[..., self.drive], controls[..., self.steer]
        self.controlled = [positive_part(sign * control) for control in (drive, steer) for sign in (1.0, -1.0)]
        ahead, back, left, right = self.controlled
        self.thrust = parameters[0] * ahead - parameters[1] * back
        self.turning = parameters[2] * left - parameters[3] * right
        self.drags = parameters[4:]

    def rate(self, step: int, state: Single) -> Single:
        u, r, (d_ul, d_uv, d_rl, d_rv, d_v) = state[..., self.forward], state[..., self.yaw_rate], self.drags
        found = np.zeros_like(state)
        found[..., self.forward] = self.thrust[step] - u * (d_ul + d_uv * np.abs(u))
        found[..., self.yaw_rate] = u * self.turning[step] - r * (d_rl + d_rv * np.abs(r))
        if self.lateral is not None:
            found[..., self.lateral] = -d_v * state[..., self.lateral]
        return found

    def by_state(self, step: int, state: Single, gradient: Single) -> Single:
        u, r, (d_ul, d_uv, d_rl, d_rv, d_v) = state[..., self.forward], state[..., self.yaw_rate], self.drags
        along, turn = gradient[..., self.forward], gradient[..., self.yaw_rate]
        found = np.zeros_like(state)
        found[..., self.forward] = turn * self.turning[step] - along * (d_ul + 2.0 * d_uv * np.abs(u))
        found[..., self.yaw_rate] = -turn * (d_rl + 2.0 * d_rv * np.abs(r))
        if self.lateral is not None:
            found[..., self.lateral] = -d_v * gradient[..., self.lateral]
        return found

    def by_parameters(self, states: Single, gradients: Single) -> Single:
        u, r = states[..., self.forward], states[..., self.yaw_rate]
        along, turn = gradients[..., self.forward], gradients[..., self.yaw_rate]
        ahead, back, left, right = (part[:, None] for part in self.controlled)  # the same in all calls of a step
        found = [
            np.sum(along * ahead),
            -np.sum(along * back),
            np.sum(turn * u * left),
            -np.sum(turn * u * right),
            -np.sum(along * u),
            -np.sum(along * u * np.abs(u)),
            -np.sum(turn * r),
            -np.sum(turn * r * np.abs(r)),
            0.0 if self.lateral is None else -np.sum(gradients[..., self.lateral] * states[..., self.lateral]),
        ]
        return np.array(found, dtype=np.float32)
