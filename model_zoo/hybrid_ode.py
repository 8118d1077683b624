"""The physics of a car with a learned residual: the parametrised model's equation plus a network."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from model_zoo.car.family import CarFamily
from model_zoo.car.physics import accelerations
from model_zoo.flows.network_rate import NetworkRate
from sysid_evo import register_model
from sysid_evo.arrays import Array

if TYPE_CHECKING:
    from model_zoo.car.trained_physics import CarPhysics
    from sysid_evo.engine.kernels import Predictor


@register_model("hybrid_ode")
class HybridOde(NetworkRate, CarFamily):
    """dx/dt = physics(x, u) + network(x, u, earlier samples) + w(x), w the rotation of the frame.

    The physics are those of the paper's Equation 1 without its thresholds, with drag on the lateral
    speed, u forward speed, v lateral speed, r yaw rate, u1 drive and u2 steer (+1 = left)::

        du/dt = U_f max(u1, 0) - U_b max(-u1, 0) - u D_ul - u |u| D_uv
        dv/dt = - v D_v
        dr/dt = u (R_l max(u2, 0) - R_r max(-u2, 0)) - r D_rl - r |r| D_rv

    ``physical_`` holds U_f, U_b (m/s^2), R_l, R_r (rad/m/s), D_ul (1/s), D_uv (1/m), D_rl (1/s),
    D_rv (1/rad), D_v (1/s), all positive. They and the residual are trained together as `NetworkRate` says;
    this is the paper's outlook of injecting physics that are not specific to the car (section 6).
    ``drive`` and ``steer`` name the controls with these roles.
    """

    knowledge = "grey"
    structure = "physics"
    initial: ClassVar[Array] = np.array([3.0, 3.0, 4.0, 4.0, 1.0, 0.2, 3.0, 0.2, 3.0])

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

    def known_predictor(self) -> Predictor:
        from model_zoo.kernels.car import car_rate
        from sysid_evo.engine.kernels import Predictor

        parameters = np.concatenate([self.kernel_parameters(), self.physical_])
        return Predictor(car_rate, parameters, n_scratch=0)

    def physics(self) -> CarPhysics:
        from model_zoo.car.trained_physics import CarPhysics

        return CarPhysics(self.roles)
