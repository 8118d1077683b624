"""The physics of the emulated toy car: what happens in one step of 5 ms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from hardware.emulation.car_parameters import FINE_DT, CarParameters
from sysid_evo.angles import frame_change

LATENCY = 10  # fine steps: 50 ms from the parallel port through the remote to the car
CREEP_SPEED = 0.05  # m/s: friction falls from static to rolling up to here
REST_SPEED = 0.01  # m/s and
REST_YAW_RATE = 0.1  # rad/s: what static friction stops within one fine step

BUFFER = slice(3, 3 + 2 * LATENCY)
"""Where the carry holds the commands under way, (drive, steer) pairs, the oldest first."""
BODY = 3 + 2 * LATENCY
"""Where the carry holds motor, sag, battery, slack, steering, force noise, yaw noise."""

Lane: TypeAlias = Any
"""A number for each rollout, an `Array` (B,), or a float for the only one: the same arithmetic for both."""
ARRAYS = (np.maximum, np.minimum, np.tanh)
NUMBERS = (max, min, lambda x: float(np.tanh(x)))
"""What `fine_step` calls for lanes of numbers and for single ones, which take a third of the time: the same values."""


class Coefficients(NamedTuple):
    """What `fine_step` computes with, in the order of the compiled form's parameter array."""

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
    return Coefficients(
        inverse_mass=1.0 / p.mass,
        inverse_inertia=1.0 / p.yaw_inertia,
        front_axle=p.front_axle,
        rear_axle=p.rear_axle,
        thrust_forward=p.thrust_forward,
        thrust_backward=p.thrust_backward,
        back_emf=p.back_emf,
        coasting_drag=p.coasting_drag,
        rolling_drag=p.rolling_drag,
        rolling_loss=p.rolling_resistance * FINE_DT,
        static_loss=p.static_friction * FINE_DT,
        motor_rate=-math.expm1(-FINE_DT / p.motor_lag),
        sag=p.sag,
        sag_rate=-math.expm1(-FINE_DT / p.sag_lag),
        slack_rate=2.0 * FINE_DT / p.slack_time,
        steer_mean=0.5 * (p.steer_left + p.steer_right),
        steer_difference=0.5 * (p.steer_left - p.steer_right),
        steer_offset=p.steer_offset,
        linkage_play=p.linkage_play,
        steering_rate=-math.expm1(-FINE_DT / p.steering_lag),
        front_grip=p.front_grip,
        rear_grip=p.rear_grip,
        thrust_grip_loss=p.thrust_grip_loss,
        traction_share=p.thrust_grip_loss / p.thrust_forward,
        slip_gain=p.slip_gain,
        slip_floor=p.slip_floor,
        noise_keep=noise_keep,
        force_noise=p.force_noise * fresh,
        yaw_noise=p.yaw_noise * fresh,
        start_speed=p.start_speed,
        start_rate=-math.expm1(-FINE_DT / p.start_lag),
        start_level=p.start_level,
    )


def fine_step(
    state: Sequence[Lane],
    hidden: Sequence[Lane],
    drive: Lane,
    steer: Lane,
    force_draw: Lane,
    yaw_draw: Lane,
    p: Coefficients,
) -> tuple[Lane, ...]:
    """Return the three states and seven hidden numbers 5 ms later, under the commands that have reached the car.

    Plain arithmetic on lanes: the same lines serve a batch and single numbers. A single-track car::

        du/dt = traction - drag u - F_f sin(d) / m + v r + noise     friction then takes its share of u
        dv/dt = (F_f cos(d) + F_r) / m - u r
        dr/dt = (a F_f cos(d) - b F_r) / I + noise
        F     = -grip tanh(gain slip / max(|u|, floor)),   slip: the axle's sideways speed in m/s

    A motor that is `start_speed` slow or slower follows its switch late, and pulls only above a level.
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
