"""Family hybrid_ode: the equation of the car plus a network, trained together."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, final

import numpy as np

from model_zoo.car.planar_car import CarRoles, PlanarCarModel, accelerations, car_rate, positive_part
from model_zoo.networks.network import Array32
from model_zoo.networks.neural_ode import QUICK, NeuralOde
from sysid_evo import register_model
from sysid_evo.models.kernels import Predictor
from sysid_evo.types import Array, check_shape


@register_model("hybrid_ode")
class HybridOde(NeuralOde, PlanarCarModel):
    """Car physics plus a neural network for effects that the physics lack, trained together as one equation.

    dx/dt = physics(x, u) + network(x, u, earlier samples) + w(x), with w the rotation of the body frame. The physics
    are Equation 1 of the paper without its thresholds, with drag on the lateral speed; u forward speed, v lateral
    speed, r yaw rate, u1 drive, u2 steer (+1 = left)::

        du/dt = U_f max(u1, 0) - U_b max(-u1, 0) - u D_ul - u |u| D_uv
        dv/dt = - v D_v
        dr/dt = u (R_l max(u2, 0) - R_r max(-u2, 0)) - r D_rl - r |r| D_rv

    ``physical_`` holds U_f, U_b (m/s^2), R_l, R_r (rad/m/s), D_ul (1/s), D_uv (1/m), D_rl (1/s), D_rv (1/rad), D_v
    (1/s), all positive. Training and the other parameters are those of neural_ode. ``drive`` and ``steer`` name the
    controls with these roles. The paper suggests such a combination in section 6.
    """

    knowledge = "grey"
    model_class = "physics"
    presets: ClassVar[dict[str, dict[str, Any]]] = {
        **NeuralOde.presets,
        "quick": {**QUICK, "state_lags": 0, "control_lags": 2},
    }
    initial: ClassVar[Array] = np.array([3.0, 3.0, 4.0, 4.0, 1.0, 0.2, 3.0, 0.2, 3.0])

    lag_search: Literal["all"] | None = "all"

    def known_rate(self, state: Array, control: Array) -> Array:
        forward, lateral, yaw_rate, drive, steer = self.roles
        found = np.zeros_like(state)
        found[..., forward], found[..., yaw_rate] = accelerations(
            state[..., forward],
            state[..., yaw_rate],
            control[..., drive],
            control[..., steer],
            list(self.physical_[:8]),
        )
        if lateral is not None:
            found[..., lateral] = -state[..., lateral] * self.physical_[8]
        return found

    def _known_predictor(self) -> Predictor:
        parameters = np.concatenate(
            [self.kernel_parameters(), check_shape("physical_", self.physical_, self.initial.shape)]
        )
        return Predictor(car_rate, parameters, n_scratch=0)

    def physics(self) -> CarRateGradient:
        return CarRateGradient(self.roles)


@final
class CarRateGradient:
    """The known part of dx/dt of `HybridOde` and its gradient, for controls given in advance.

    Thrust (H, ...) and yaw acceleration per forward speed (H, ...) are computed once for all steps.
    """

    def __init__(self, roles: CarRoles) -> None:
        self.forward, self.lateral, self.yaw_rate, self.drive, self.steer = roles

    def hold(self, controls: Array32, parameters: Array32) -> None:
        """Set the ``controls`` (H, ..., nu) and ``parameters`` (9,) of the following steps."""
        drive, steer = controls[..., self.drive], controls[..., self.steer]
        self.controlled = [positive_part(sign * control) for control in (drive, steer) for sign in (1.0, -1.0)]
        ahead, back, left, right = self.controlled
        self.thrust = parameters[0] * ahead - parameters[1] * back
        self.turning = parameters[2] * left - parameters[3] * right
        self.drags = parameters[4:]

    def rate(self, step: int, state: Array32) -> Array32:
        u, r, (d_ul, d_uv, d_rl, d_rv, d_v) = state[..., self.forward], state[..., self.yaw_rate], self.drags
        found = np.zeros_like(state)
        found[..., self.forward] = self.thrust[step] - u * (d_ul + d_uv * np.abs(u))
        found[..., self.yaw_rate] = u * self.turning[step] - r * (d_rl + d_rv * np.abs(r))
        if self.lateral is not None:
            found[..., self.lateral] = -d_v * state[..., self.lateral]
        return found

    def by_state(self, step: int, state: Array32, gradient: Array32) -> Array32:
        u, r, (d_ul, d_uv, d_rl, d_rv, d_v) = state[..., self.forward], state[..., self.yaw_rate], self.drags
        along, turn = gradient[..., self.forward], gradient[..., self.yaw_rate]
        found = np.zeros_like(state)
        found[..., self.forward] = turn * self.turning[step] - along * (d_ul + 2.0 * d_uv * np.abs(u))
        found[..., self.yaw_rate] = -turn * (d_rl + 2.0 * d_rv * np.abs(r))
        if self.lateral is not None:
            found[..., self.lateral] = -d_v * gradient[..., self.lateral]
        return found

    def by_parameters(self, states: Array32, gradients: Array32) -> Array32:
        u, r = states[..., self.forward], states[..., self.yaw_rate]
        along, turn = gradients[..., self.forward], gradients[..., self.yaw_rate]
        ahead, back, left, right = (part[:, None] for part in self.controlled)  # equal in all calls of a step
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
