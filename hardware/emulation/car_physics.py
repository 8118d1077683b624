"""The physics of the emulated toy car in steps of 5 ms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from scipy.special import ndtr

from hardware.emulation.car_parameters import FINE_DT, CarParameters
from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics
from sysid_evo.motion import PlanarBody, frame_change
from sysid_evo.system import Channel, System

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import DynamicsKernel

CAR = System(
    states=(
        Channel("forward_speed", "m/s"),
        Channel("lateral_speed", "m/s"),
        Channel("yaw_rate", "rad/s"),
    ),
    controls=(Channel("drive", levels=(-1.0, 0.0, 1.0)), Channel("steer", levels=(-1.0, 0.0, 1.0))),
    dt=0.05,
    motion=PlanarBody(),
    name="toy car",
)

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

    The steering angle d stays below 0.26 rad, so two terms of its sine and cosine are right to 2e-4.
    """
    u, v, r = state
    motor, sag, battery, slack, steering, force_noise, yaw_noise = hidden

    motor = motor + (drive - motor) * p.motor_rate
    power = abs(motor)
    sag = sag + (power * p.sag - sag) * p.sag_rate
    slack = np.minimum(np.maximum(slack + motor * p.slack_rate, -1.0), 1.0)
    meshed = motor * slack >= power
    pull = np.maximum(motor, 0.0) * p.thrust_forward + np.minimum(motor, 0.0) * p.thrust_backward
    braking = p.coasting_drag + (p.back_emf - p.coasting_drag) * power
    traction = pull * (battery - sag) * meshed - braking * u

    target = steer * (p.steer_mean + p.steer_difference * steer) + p.steer_offset
    steering = steering + (target - steering) * p.steering_rate
    speed = abs(u)
    pace = np.maximum(speed, p.slip_floor)
    angle = steering - p.linkage_play * u / pace
    square = angle * angle
    sine, cosine = angle * (1.0 - square * (1.0 / 6.0)), 1.0 - square * 0.5

    gain = p.slip_gain / pace
    front = np.tanh(gain * (u * sine - (v + p.front_axle * r) * cosine)) * p.front_grip
    grip = p.rear_grip * (1.0 - np.minimum(abs(traction) * p.traction_share, p.thrust_grip_loss))
    rear = np.tanh(gain * (p.rear_axle * r - v)) * grip
    across = front * cosine

    force_noise = force_noise * p.noise_keep + force_draw * p.force_noise
    yaw_noise = yaw_noise * p.noise_keep + yaw_draw * p.yaw_noise
    shake = speed / pace

    push = traction - p.rolling_drag * u - front * sine * p.inverse_mass
    along_turning, across_turning = frame_change(u, v, r)
    pushed = u + (push + along_turning + force_noise * shake) * FINE_DT
    v = v + ((across + rear) * p.inverse_mass + across_turning) * FINE_DT
    r = r + ((p.front_axle * across - p.rear_axle * rear) * p.inverse_inertia + yaw_noise * shake) * FINE_DT

    creep = np.maximum(1.0 - speed * (1.0 / CREEP_SPEED), 0.0)
    loss = p.rolling_loss + (p.static_loss - p.rolling_loss) * creep
    u = np.maximum(pushed - loss, 0.0) + np.minimum(pushed + loss, 0.0)
    moving = (u != 0.0) | (abs(v) > REST_SPEED) | (abs(r) > REST_YAW_RATE)
    return u, v * moving, r * moving, motor, sag, battery, slack, steering, force_noise, yaw_noise


class CarPhysics(Dynamics):
    """The toy car at 5 ms, the rate of the tracker: what its 20 Hz form repeats.

    The carry is forward speed, lateral speed, yaw rate; the ten commands under way; motor (lagged
    drive, -1 to 1), sag (share of the voltage), battery (1 is full), slack (-1 to 1, thrust passes
    at the end that the motor pushes to), steering angle (rad), force noise (m/s2), yaw noise
    (rad/s2). Friction is a projection and not a force, so the car comes to exact rest and stays
    there; noise fades with speed and cannot move a standing car.

    Draws: battery level (uniform over its spread), force noise, yaw noise. Noise: force, yaw.
    A start takes the oldest command for one that has been held for long.
    """

    n_carry = BODY + 7
    n_lags = LATENCY
    n_noise = 2
    n_draws = 3

    def __init__(self, parameters: CarParameters | None = None) -> None:
        self.parameters = CarParameters() if parameters is None else parameters
        self.coefficients = coefficients(self.parameters)
        self.system = CAR.with_dt(FINE_DT)

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        p, batch = self.parameters, len(states)
        draws = np.zeros((batch, self.n_draws)) if draws is None else draws
        carry = np.zeros((self.n_carry, batch)).T
        carry[:, :3] = states[:, -1]
        carry[:, BUFFER] = controls[:, -LATENCY:].reshape(batch, 2 * LATENCY)
        drive, steer = controls[:, -LATENCY, 0], controls[:, -LATENCY, 1]
        c = self.coefficients
        carry[:, BODY] = drive
        carry[:, BODY + 1] = p.sag * np.abs(drive)
        carry[:, BODY + 2] = 1.0 + p.battery_spread * (2.0 * ndtr(draws[:, 0]) - 1.0)
        carry[:, BODY + 3] = np.sign(drive)
        carry[:, BODY + 4] = steer * (c.steer_mean + c.steer_difference * steer) + c.steer_offset
        carry[:, BODY + 5] = p.force_noise * draws[:, 1]
        carry[:, BODY + 6] = p.yaw_noise * draws[:, 2]
        return carry

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        before = carry.T
        after = np.empty((self.n_carry, len(carry)))
        if len(carry) == 1:
            lanes: list[Lane] = before[:, 0].tolist()
            draws: list[Lane] = [0.0, 0.0] if noise is None else noise[0].tolist()
        else:
            lanes = list(before)
            draws = [0.0, 0.0] if noise is None else list(noise.T)
        results = fine_step(lanes[:3], lanes[BODY:], lanes[3], lanes[4], draws[0], draws[1], self.coefficients)
        after[3 : BODY - 2] = before[5:BODY]
        after[BODY - 2 : BODY] = control.T
        for row, result in zip((*range(3), *range(BODY, self.n_carry)), results, strict=True):
            after[row] = result
        return after.T

    def kernel(self) -> DynamicsKernel:
        return self.held_kernel(1)

    def held_kernel(self, repeats: int) -> DynamicsKernel:
        """Return the compiled form of ``repeats`` steps: the commands under way move only once."""
        from hardware.emulation.kernels.car import car_kernel

        return car_kernel(self.coefficients, repeats)
