"""A cart on a rail with a hanging pole, to be balanced or swung up; two encoders measure the two positions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hardware.emulation.parameters import RobotParameters, of_kind, parameter
from hardware.emulation.sensed_robot import ScalarPhysics, SensedRobot, Sensor
from sysid_evo.angles import TURN
from sysid_evo.registry import register_robot
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

FINE_DT = 0.005  # s
REPEATS = 10  # fine steps in one sample of 50 ms
GRAVITY = 9.81  # m/s2
FORCE = 5.0  # N, of the motor
ENCODER = TURN / 4096.0  # rad


@dataclass(frozen=True, kw_only=True)
class CartPoleParameters(RobotParameters):
    """A cart of half a kilogram, a pole with a weight at its end, and rubber bands that keep the cart on its rail."""

    cart: float = parameter(0.5, "kg", 0.1, "cart and belt")
    bob: float = parameter(0.12, "kg", 0.1, "the weight at the end of the pole")
    length: float = parameter(0.4, "m", 0.1, "from the cart to the weight")
    bands: float = parameter(3.0, "N/m", 0.2, "rubber bands to both ends of the rail; full force reaches 1.7 m")
    rail_friction: float = parameter(2.0, "N s/m", 0.3, "bearings and belt")
    hinge_friction: float = parameter(0.0015, "N m s/rad", 0.3, "the hinge of the pole")
    motor_lag: float = parameter(0.03, "s", 0.3, "the current takes time to follow")
    force_noise: float = parameter(0.4, "N", 0.3, "teeth of the belt, standard deviation of each fine step")


def cart_pole_step(x: Any, u: Any, w: Any, p: Any) -> Any:
    """The next carry of `CartPolePhysics`; ``p`` are the parameters in their order and the share of a lag."""
    cart, bob, length = p[0], p[1], p[2]
    force = x[4] + (u[0] - x[4]) * p[8]
    sine, cosine, turning = math.sin(x[2]), math.cos(x[2]), x[3]
    hinge = p[5] * turning / length
    push = force - p[3] * x[0] - p[4] * x[1] + hinge * cosine + p[7] * w[0]
    pull = bob * sine * (length * turning * turning + GRAVITY * cosine)
    along = (push + pull) / (cart + bob * sine * sine)
    speed = x[1] + FINE_DT * along
    turning = turning - FINE_DT / length * (along * cosine + GRAVITY * sine + hinge / bob)
    return x[0] + FINE_DT * speed, speed, x[2] + FINE_DT * turning, turning, force


class CartPolePhysics(ScalarPhysics):
    """The cart-pole in steps of 5 ms; the angle is 0 hanging, counter-clockwise, and counts whole turns.

    The carry is position x, speed, angle a, angular speed w, and the force F of the motor (N). M cart, m bob, l
    length, k bands, b and d frictions of rail and hinge::

        (M + m sin^2 a) x'' = F - k x - b x' + m sin a (l w^2 + g cos a) + d w cos a / l + noise
        l w' = -x'' cos a - g sin a - d w / (m l)
        F' = (command - F) / motor_lag
    """

    system = System(
        states=(
            Channel("position", "m", -2.0, 2.0, description="0 in the middle of the rail"),
            Channel("speed", "m/s"),
            Channel("angle", "rad", period=TURN, description="0 hanging, pi upright, positive counter-clockwise"),
            Channel("angular_speed", "rad/s"),
        ),
        controls=(Channel("force", "N", -FORCE, FORCE, description="positive pushes towards larger positions"),),
        dt=FINE_DT,
        name="cart-pole",
    )
    sensors: ClassVar[Mapping[str, Sensor]] = {"position": Sensor(0.0002, 0.0001), "angle": Sensor(0.0005, ENCODER)}
    estimated_rates: ClassVar[Mapping[str, str]] = {"speed": "position", "angular_speed": "angle"}
    law = cart_pole_step
    nominal = CartPoleParameters()
    n_carry = 5

    def release_state(self, rng: np.random.Generator) -> Array:
        """Return the cart in the middle and the pole at any angle, held at rest."""
        return np.array([0.0, 0.0, rng.uniform(-math.pi, math.pi), 0.0])


@register_robot("cart_pole")
def cart_pole(*, seed: int | None = None) -> SensedRobot:
    """A cart with a pole and two encoders, in simulation; with a ``seed`` a variant of it."""
    kind, parameters = of_kind("cart_pole", CartPoleParameters(), seed)
    return SensedRobot(kind, CartPolePhysics(parameters), repeats=REPEATS, default_task="swing_up")
