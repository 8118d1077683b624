"""A pendulum on a motor too weak to lift it, to be swung up; its encoder measures the angle only."""

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
STICKING = 0.1  # rad/s: dry friction grows up to this speed
TORQUE = 0.45  # N m, of the motor; holding the pendulum level takes 1.2
ENCODER = TURN / 4096.0  # rad


@dataclass(frozen=True, kw_only=True)
class PendulumParameters(RobotParameters):
    """A rod with a weight at its end, on the shaft of a small motor."""

    weight: float = parameter(1.2, "N m", 0.1, "m g l of 0.3 kg at 0.41 m: the torque of gravity when level")
    inertia: float = parameter(0.05, "kg m2", 0.1, "m l^2; it swings at 0.78 Hz")
    viscous: float = parameter(0.02, "N m s/rad", 0.3, "back-EMF, bearings and air; full torque spins it at 22 rad/s")
    dry: float = parameter(0.012, "N m", 0.3, "brushes, at any speed")
    motor_lag: float = parameter(0.03, "s", 0.3, "the current takes time to follow")
    torque_noise: float = parameter(0.05, "N m", 0.3, "cogging and air, standard deviation of each fine step")


def pendulum_step(x: Any, u: Any, w: Any, p: Any) -> Any:
    """The next carry of `PendulumPhysics`; ``p`` are the parameters in their order and the share of a lag."""
    torque = x[2] + (u[0] - x[2]) * p[6]
    push = torque - p[0] * math.sin(x[0]) - p[2] * x[1] - p[3] * math.tanh(x[1] / STICKING) + p[5] * w[0]
    speed = x[1] + FINE_DT / p[1] * push
    return x[0] + FINE_DT * speed, speed, torque


class PendulumPhysics(ScalarPhysics):
    """The pendulum in steps of 5 ms; the angle is 0 hanging, counter-clockwise, and counts whole turns.

    The carry is angle, angular speed, and the torque of the motor (N m)::

        d angle / dt = speed
        I d speed / dt = torque - weight sin(angle) - viscous speed - dry tanh(speed / 0.1) + noise
        d torque / dt = (command - torque) / motor_lag
    """

    system = System(
        states=(
            Channel("angle", "rad", period=TURN, description="0 hanging, pi upright, positive counter-clockwise"),
            Channel("angular_speed", "rad/s"),
        ),
        controls=(Channel("torque", "N m", -TORQUE, TORQUE),),
        dt=FINE_DT,
        name="pendulum",
    )
    sensors: ClassVar[Mapping[str, Sensor]] = {"angle": Sensor(0.0005, ENCODER)}
    estimated_rates: ClassVar[Mapping[str, str]] = {"angular_speed": "angle"}
    law = pendulum_step
    nominal = PendulumParameters()
    n_carry = 3

    def release_state(self, rng: np.random.Generator) -> Array:
        """Return any angle, held at rest."""
        return np.array([rng.uniform(-math.pi, math.pi), 0.0])


@register_robot("pendulum")
def pendulum(*, seed: int | None = None) -> SensedRobot:
    """A pendulum with a weak motor and an encoder, in simulation; with a ``seed`` a variant of it."""
    kind, parameters = of_kind("pendulum", PendulumParameters(), seed)
    return SensedRobot(kind, PendulumPhysics(parameters), repeats=REPEATS, default_task="swing_up")
