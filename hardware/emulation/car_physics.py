"""The toy car in one step of 5 ms: parameters with units, coefficients, equations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from hardware.emulation.parameters import RobotParameters, parameter
from sysid_evo.angles import frame_change
from sysid_evo.errors import InvalidArgument

FINE_DT = 0.005  # s: the rate of the tracker, and short against every lag of the car


@dataclass(frozen=True, kw_only=True)
class CarParameters(RobotParameters):
    """A bang-bang toy car of 0.3 kg, 18 x 10 cm (paper, section 3).

    The metadata of each field have its unit, reason and spread. Thrust, drag and resistance are per unit of mass, so
    they are accelerations. Raises `InvalidArgument`.
    """

    mass: float = parameter(0.3, "kg", 0.1, "stated in the paper")
    yaw_inertia: float = parameter(0.00106, "kg m2", 0.1, "a uniform plate of 18 x 10 cm")
    front_axle: float = parameter(0.055, "m", 0.1, "centre of mass to the steered axle")
    rear_axle: float = parameter(0.055, "m", 0.1, "centre of mass to the driven axle")

    thrust_forward: float = parameter(3.2, "m/s2", 0.2, "at rest, full battery; reaches 2.0 m/s")
    thrust_backward: float = parameter(
        2.45, "m/s2", 0.2, "brushes and gears run worse backward; reaches 1.4 m/s; 0: no reverse", or_zero=True
    )
    back_emf: float = parameter(1.08, "1/s", 0.2, "loss of thrust with speed while the motor is powered")
    motor_lag: float = parameter(0.08, "s", 0.3, "current and gears take time to follow the switch")
    battery_spread: float = parameter(0.08, "1", 0.1, "charge differs from trial to trial by this share at most")
    sag: float = parameter(0.08, "1", 0.3, "share of the voltage lost under full load")
    sag_lag: float = parameter(0.4, "s", 0.3, "the cells' own time constant")
    slack_time: float = parameter(0.03, "s", 0.3, "full motor speed across the play of the worn gearbox")

    coasting_drag: float = parameter(0.6, "1/s", 0.3, "the unpowered motor turned by the wheels")
    rolling_drag: float = parameter(0.15, "1/s", 0.3, "bearings and paper, growing with speed")
    rolling_resistance: float = parameter(0.5, "m/s2", 0.2, "bearings and paper, at any speed; stops a coasting car")
    static_friction: float = parameter(0.9, "m/s2", 0.15, "thrust below this does not move a car at rest")

    steer_left: float = parameter(0.203, "rad", 0.1, "front wheels at full left lock")
    steer_right: float = parameter(0.177, "rad", 0.1, "front wheels at full right lock; the linkage is uneven")
    steer_offset: float = parameter(0.008, "rad", 0.3, "front wheels without a command; the linkage is bent")
    linkage_play: float = parameter(0.0125, "rad", 0.3, "front wheels flop right rolling forward, left backward")
    steering_lag: float = parameter(0.06, "s", 0.3, "the steering magnet works against a spring")

    front_grip: float = parameter(1.14, "N", 0.15, "largest sideways force of the front tyres")
    rear_grip: float = parameter(1.58, "N", 0.15, "largest sideways force of the rear tyres, without thrust")
    thrust_grip_loss: float = parameter(0.5, "1", 0.2, "most of the rear grip, as a share, that traction uses up")
    slip_gain: float = parameter(8.0, "1/rad", 0.1, "how soon a slip angle saturates a tyre")
    slip_floor: float = parameter(0.7, "m/s", 0.1, "slower than this, slip is measured against this speed")

    force_noise: float = parameter(0.25, "m/s2", 0.3, "uneven floor; standard deviation at speed")
    yaw_noise: float = parameter(2.0, "rad/s2", 0.3, "uneven floor; standard deviation at speed")
    noise_lag: float = parameter(0.1, "s", 0.3, "correlation time: a dozen centimetres of floor")

    start_speed: float = parameter(
        0.0, "m/s", 0.2, "slower than this a motor without a sensor cannot detect its rotation; 0: it always can",
        or_zero=True,
    )  # fmt: skip
    start_lag: float = parameter(0.08, "s", 0.2, "such a motor follows the switch with this lag, and it pulls only")
    start_level: float = parameter(0.5, "1", 0.1, "once it has reached this share of its full level")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("battery_spread", "sag", "thrust_grip_loss", "start_level"):
            if getattr(self, name) >= 1.0:
                raise InvalidArgument(f"car: {name} is a share below 1, got {getattr(self, name)}")
        if self.static_friction < self.rolling_resistance:
            raise InvalidArgument(
                "car: expected static_friction >= rolling_resistance, "
                f"got {self.static_friction} and {self.rolling_resistance} m/s2"
            )
        if self.stiffness * FINE_DT > 1.0:
            raise InvalidArgument(
                f"car: tyres as stiff as {self.stiffness:.0f} 1/s overshoot in steps of {FINE_DT} s; "
                f"raise slip_floor ({self.slip_floor} m/s) by {self.stiffness * FINE_DT:.2f} or lower slip_gain or grip"
            )

    @property
    def stiffness(self) -> float:
        """Fastest rate in 1/s at which tyres damp sideways motion of an axle."""
        front = self.front_grip * (1.0 / self.mass + self.front_axle**2 / self.yaw_inertia)
        rear = self.rear_grip * (1.0 / self.mass + self.rear_axle**2 / self.yaw_inertia)
        return max(front, rear) * self.slip_gain / self.slip_floor


LATENCY = 10  # fine steps: 50 ms from the parallel port through the remote to the car
CREEP_SPEED = 0.05  # m/s: friction falls from static to rolling up to here
REST_SPEED = 0.01  # m/s and
REST_YAW_RATE = 0.1  # rad/s: what static friction stops within one fine step

BUFFER = slice(3, 3 + 2 * LATENCY)
"""Slice of the carry with the delayed commands, (drive, steer) pairs, the oldest first."""
BODY = 3 + 2 * LATENCY
"""Start of motor, sag, battery, slack, steering, force noise, yaw noise in the carry."""


class Coefficients(NamedTuple):
    """Coefficients of `car_step`, in the order of the compiled form's parameter array."""

    inverse_mass: float
    inverse_inertia: float
    front_axle: float
    rear_axle: float
    thrust_forward: float
    thrust_backward: float
    back_emf: float
    coasting_drag: float
    rolling_drag: float
    rolling_loss: float
    static_loss: float
    motor_rate: float
    sag: float
    sag_rate: float
    slack_rate: float
    steer_mean: float
    steer_difference: float
    steer_offset: float
    linkage_play: float
    steering_rate: float
    front_grip: float
    rear_grip: float
    thrust_grip_loss: float
    traction_share: float
    slip_gain: float
    slip_floor: float
    noise_keep: float
    force_noise: float
    yaw_noise: float
    start_speed: float
    start_rate: float
    start_level: float


def coefficients(parameters: CarParameters) -> Coefficients:
    """Return the coefficients of one fine step: lags become exact shares of a step, friction a speed."""
    p = parameters
    noise_keep = math.exp(-FINE_DT / p.noise_lag)
    fresh = math.sqrt(1.0 - noise_keep**2)
    unchanged = {name: getattr(p, name) for name in Coefficients._fields if hasattr(p, name)}
    made = {
        "inverse_mass": 1.0 / p.mass,
        "inverse_inertia": 1.0 / p.yaw_inertia,
        "rolling_loss": p.rolling_resistance * FINE_DT,
        "static_loss": p.static_friction * FINE_DT,
        "motor_rate": -math.expm1(-FINE_DT / p.motor_lag),
        "sag_rate": -math.expm1(-FINE_DT / p.sag_lag),
        "slack_rate": 2.0 * FINE_DT / p.slack_time,
        "steer_mean": 0.5 * (p.steer_left + p.steer_right),
        "steer_difference": 0.5 * (p.steer_left - p.steer_right),
        "steering_rate": -math.expm1(-FINE_DT / p.steering_lag),
        "traction_share": p.thrust_grip_loss / p.thrust_forward,
        "noise_keep": noise_keep,
        "force_noise": p.force_noise * fresh,
        "yaw_noise": p.yaw_noise * fresh,
        "start_rate": -math.expm1(-FINE_DT / p.start_lag),
    }
    return Coefficients(**unchanged | made)


Lane: TypeAlias = Any
"""A number for each rollout, an `Array` (B,), or a float for a single one: the arithmetic is the same."""
ARRAYS = (np.maximum, np.minimum, np.tanh)
NUMBERS = (max, min, lambda x: float(np.tanh(x)))
"""Functions of `car_step` for arrays and for single numbers, which take a third of the time: the results are equal."""


def car_step(
    state: Sequence[Lane],
    hidden: Sequence[Lane],
    drive: Lane,
    steer: Lane,
    force_draw: Lane,
    yaw_draw: Lane,
    p: Coefficients,
) -> tuple[Lane, ...]:
    """Return the three states and seven hidden numbers 5 ms later, under the commands that have reached the car.

    Plain arithmetic, so the same lines work for a batch and for single numbers. A single-track car::

        du/dt = traction - drag u - F_f sin(d) / m + v r + noise   friction then reduces u
        dv/dt = (F_f cos(d) + F_r) / m - u r
        dr/dt = (a F_f cos(d) - b F_r) / I + noise
        F   = -grip tanh(gain slip / max(|u|, floor)),   slip: the axle's sideways speed in m/s

    At `start_speed` or slower a sensorless motor follows its switch with a lag, and pulls only above a level.
    The steering angle d stays below 0.26 rad, so two terms of its sine and cosine are right to 2e-4.
    """
    u, v, r = state
    larger, smaller, tanh = NUMBERS if isinstance(u, float) else ARRAYS
    motor, sag, battery, slack, steering, force_noise, yaw_noise = hidden

    speed = abs(u)
    starting = speed < p.start_speed
    motor = motor + (drive - motor) * (p.motor_rate + (p.start_rate - p.motor_rate) * starting)
    power = abs(motor)
    sag = sag + (power * p.sag - sag) * p.sag_rate
    slack = smaller(larger(slack + motor * p.slack_rate, -1.0), 1.0)
    meshed = (motor * slack >= power) * (power >= p.start_level * starting)
    pull = larger(motor, 0.0) * p.thrust_forward + smaller(motor, 0.0) * p.thrust_backward
    braking = p.coasting_drag + (p.back_emf - p.coasting_drag) * power
    traction = pull * (battery - sag) * meshed - braking * u

    target = steer * (p.steer_mean + p.steer_difference * steer) + p.steer_offset
    steering = steering + (target - steering) * p.steering_rate
    pace = larger(speed, p.slip_floor)
    angle = steering - p.linkage_play * u / pace
    square = angle * angle
    sine, cosine = angle * (1.0 - square * (1.0 / 6.0)), 1.0 - square * 0.5

    gain = p.slip_gain / pace
    front = tanh(gain * (u * sine - (v + p.front_axle * r) * cosine)) * p.front_grip
    grip = p.rear_grip * (1.0 - smaller(abs(traction) * p.traction_share, p.thrust_grip_loss))
    rear = tanh(gain * (p.rear_axle * r - v)) * grip
    across = front * cosine

    force_noise = force_noise * p.noise_keep + force_draw * p.force_noise
    yaw_noise = yaw_noise * p.noise_keep + yaw_draw * p.yaw_noise
    shake = speed / pace

    push = traction - p.rolling_drag * u - front * sine * p.inverse_mass
    along_turning, across_turning = frame_change(u, v, r)
    pushed = u + (push + along_turning + force_noise * shake) * FINE_DT
    v = v + ((across + rear) * p.inverse_mass + across_turning) * FINE_DT
    r = r + ((p.front_axle * across - p.rear_axle * rear) * p.inverse_inertia + yaw_noise * shake) * FINE_DT

    creep = larger(1.0 - speed * (1.0 / CREEP_SPEED), 0.0)
    loss = p.rolling_loss + (p.static_loss - p.rolling_loss) * creep
    u = larger(pushed - loss, 0.0) + smaller(pushed + loss, 0.0)
    moving = (u != 0.0) | (abs(v) > REST_SPEED) | (abs(r) > REST_YAW_RATE)
    return u, v * moving, r * moving, motor, sag, battery, slack, steering, force_noise, yaw_noise
