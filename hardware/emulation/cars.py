"""The registered cars: emulated_car, awkward_car, and their dynamics, in NumPy and compiled."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from hardware.arguments import check_number
from hardware.connection import Connection
from hardware.emulation.car_physics import (
    BODY,
    BUFFER,
    CREEP_SPEED,
    FINE_DT,
    LATENCY,
    REST_SPEED,
    REST_YAW_RATE,
    CarParameters,
    Coefficients,
    Lane,
    car_step,
    coefficients,
)
from hardware.emulation.parameters import of_kind
from hardware.emulation.tracked_robots import TrackedConnection, TrackedRobot
from hardware.recording.record import RecordingJob, RecordingResult, record_through_loop
from hardware.toy_car import CAR
from sysid_evo.angles import frame_change
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import LANES, DynamicsKernel, KernelSource, Layout, load, store, view, where_at_most, where_less
from sysid_evo.models import Dynamics, PlainDynamics
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.randomness import keyed_generator
from sysid_evo.registry import register_robot
from sysid_evo.types import Array

REPEATS = 10  # fine steps of 5 ms in one sample of 50 ms


class ToyCarDynamics(PlainDynamics):
    """The toy car at 5 ms, the rate of the tracker; its 20 Hz form repeats this step.

    The carry is forward speed, lateral speed, yaw rate; the ten delayed commands; motor (lagged drive, -1 to 1), sag
    (share of the voltage), battery (1 is full), slack (-1 to 1, thrust passes at the end that the motor pushes to),
    steering angle (rad), force noise (m/s2), yaw noise (rad/s2). Friction is a projection and not a force, so the car
    comes to exact rest and stays there; noise decreases with speed and cannot move a car at rest.

    Draws: battery level (uniform over its spread), force noise, yaw noise. Noise: force, yaw.
    A start assumes that the oldest command has been held for long.
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
        if len(carry) == 1:
            first, push = carry[0].tolist(), [0.0, 0.0] if noise is None else noise[0].tolist()
            end = car_step(first[:3], first[BODY:], first[3], first[4], push[0], push[1], self.coefficients)
            return np.array([[*end[:3], *first[5:BODY], *control[0].tolist(), *end[3:]]])
        lanes: list[Lane] = list(carry.T)
        draws: list[Lane] = [0.0, 0.0] if noise is None else list(noise.T)
        end = car_step(lanes[:3], lanes[BODY:], lanes[3], lanes[4], draws[0], draws[1], self.coefficients)
        return np.array([*end[:3], *lanes[5:BODY], *control.T, *end[3:]]).T

    def kernel(self) -> DynamicsKernel:
        return self.held_kernel(1)

    def held_kernel(self, repeats: int) -> DynamicsKernel:
        """Return the compiled form of ``repeats`` steps: the delayed commands are shifted only once."""
        return DynamicsKernel(KernelSource(car), HEAD.pack(self.coefficients, repeats=repeats))


@register_robot("emulated_car")
def emulated_car(*, seed: int | None = None) -> TrackedRobot:
    """The toy car of the paper in simulation; with a ``seed`` a variant of it, see `CarParameters.perturbed`."""
    kind, parameters = of_kind("emulated_car", CarParameters(), seed)
    return TrackedRobot(kind, ToyCarDynamics(parameters), repeats=REPEATS)


AWKWARD = replace(CarParameters(), thrust_backward=0.0, start_speed=0.35, start_lag=0.5, start_level=0.5)
"""The toy car with a cheap motor controller for model planes: without a sensor, and without reverse.

At rest it pulls only after 0.35 s of uninterrupted full drive. Driven backward it only brakes.
"""


@register_robot("awkward_car")
class AwkwardCar(TrackedRobot):
    """The toy car with the drive of a model plane; with a ``seed`` a variant of it.

    From standstill it responds to forward drive after 0.7 of ``start_lag`` (s), to backward drive not at all; once it
    rolls it is as fast as any. In the share ``stuck`` of the manoeuvres of a recording, drawn from the seed of the
    recording, it is jammed and does not move under any command; in trials it is free.
    Raises `InvalidArgument`.
    """

    def __init__(self, *, seed: int | None = None, start_lag: float = AWKWARD.start_lag, stuck: float = 0.1) -> None:
        self.stuck = check_number("robot awkward_car: stuck", stuck, minimum=0.0)
        if self.stuck > 1.0:
            raise InvalidArgument(f"robot awkward_car: expected stuck as a share up to 1, got {stuck}")
        usual = replace(AWKWARD, start_lag=check_number("robot awkward_car: start_lag", start_lag, above=0.0))
        kind, parameters = of_kind("awkward_car", usual, seed)
        super().__init__(kind, ToyCarDynamics(parameters), repeats=REPEATS)

    def _record_excitation(self, duration: float, job: RecordingJob) -> RecordingResult:
        manoeuvres = self.manoeuvres(duration=duration, rng=np.random.default_rng(job.seed))
        return record_through_loop(_Jammed(self, keyed_generator(job.seed, 0)), manoeuvres, job)


class _Jammed:
    """The car while it is recorded: in some sessions, the share ``stuck`` of them, it does not move."""

    def __init__(self, car: AwkwardCar, rng: np.random.Generator) -> None:
        self.car, self.name, self.system = car, car.name, car.system
        self.dynamics: Dynamics | None = car.dynamics
        self._due = float(rng.random())

    def connect(self, *, seed: int | None = None) -> Connection:
        """Open the next session."""
        self._due += self.car.stuck
        if self._due < 1.0:
            return self.car.connect(seed=seed)
        self._due -= 1.0
        return _JammedConnection(self.car.name, self.car.physics, seed=seed, gate=self.car.gate)


class _JammedConnection(TrackedConnection):
    """A session in which the car does not move; the tracker's noise is unchanged."""

    def _advance(self) -> None:
        return


HEAD = Layout("repeats")
COMMANDS = BUFFER.start
NOISE_KEEP, FORCE_NOISE, YAW_NOISE = (
    Coefficients._fields.index(name) for name in ("noise_keep", "force_noise", "yaw_noise")
)
CREEP = 1.0 / CREEP_SPEED
SIXTH = 1.0 / 6.0


def car(carry, control, noise, parameters, scratch):
    """Make the fine steps, each under the command then due, and shift the delayed commands only once."""
    repeats, p = int(parameters[HEAD.repeats]), view(parameters, HEAD.size)
    commands, body = view(carry, COMMANDS * LANES), view(carry, BODY * LANES)
    u, v, r = load(carry, 0), load(carry, LANES), load(carry, 2 * LANES)
    motor, sag, battery, slack = load(body, 0), load(body, LANES), load(body, 2 * LANES), load(body, 3 * LANES)
    steering, force, yaw = load(body, 4 * LANES), load(body, 5 * LANES), load(body, 6 * LANES)
    for k in range(repeats):
        command = view(commands, 2 * k * LANES) if k < LATENCY else control
        force = force * p[NOISE_KEEP] + load(noise, 2 * k * LANES) * p[FORCE_NOISE]
        yaw = yaw * p[NOISE_KEEP] + load(noise, (2 * k + 1) * LANES) * p[YAW_NOISE]
        u, v, r, motor, sag, slack, steering = car_step_lanes(
            u, v, r, motor, sag, battery, slack, steering, force, yaw, load(command, 0), load(command, LANES), p
        )
    store(carry, 0, u)
    store(carry, LANES, v)
    store(carry, 2 * LANES, r)
    store(body, 0, motor)
    store(body, LANES, sag)
    store(body, 3 * LANES, slack)
    store(body, 4 * LANES, steering)
    store(body, 5 * LANES, force)
    store(body, 6 * LANES, yaw)
    for k in range(LATENCY):
        command = view(commands, 2 * (k + repeats) * LANES) if k + repeats < LATENCY else control
        copy(command, view(commands, 2 * k * LANES), 2 * LANES)


def car_step_lanes(u, v, r, motor, sag, battery, slack, steering, force_noise, yaw_noise, drive, steer, p):
    """One step of 5 ms; ``p`` are the `Coefficients` in their order.

    Friction is subtracted from the change before the change is added: rounding the speed first would, in float32, shift
    every step in the same direction, by 6e-6 m/s after some.
    """
    inverse_mass, inverse_inertia, front_axle, rear_axle = p[0], p[1], p[2], p[3]
    thrust_forward, thrust_backward, back_emf, coasting_drag = p[4], p[5], p[6], p[7]
    rolling_drag, rolling_loss, static_loss = p[8], p[9], p[10]
    motor_rate, sag_full, sag_rate, slack_rate = p[11], p[12], p[13], p[14]
    steer_mean, steer_difference, steer_offset, linkage_play, steering_rate = p[15], p[16], p[17], p[18], p[19]
    front_grip, rear_grip, thrust_grip_loss, traction_share = p[20], p[21], p[22], p[23]
    slip_gain, slip_floor = p[24], p[25]
    start_speed, slower, start_level = p[29], p[30] - p[11], p[31]

    speed = abs(u)
    starting = where_less(speed, start_speed, 1.0, 0.0)
    motor = motor + (drive - motor) * (motor_rate + slower * starting)
    power = abs(motor)
    sag = sag + (power * sag_full - sag) * sag_rate
    slack = min(max(slack + motor * slack_rate, -1.0), 1.0)
    strong = where_at_most(start_level * starting, power, 1.0, 0.0)
    meshed = where_at_most(power, motor * slack, strong, 0.0)
    pull = max(motor, 0.0) * thrust_forward + min(motor, 0.0) * thrust_backward
    braking = coasting_drag + (back_emf - coasting_drag) * power
    traction = pull * (battery - sag) * meshed - braking * u

    target = steer * (steer_mean + steer_difference * steer) + steer_offset
    steering = steering + (target - steering) * steering_rate
    per_pace = 1.0 / max(speed, slip_floor)
    angle = steering - linkage_play * u * per_pace
    square = angle * angle
    sine, cosine = angle * (1.0 - square * SIXTH), 1.0 - square * 0.5

    gain = slip_gain * per_pace
    front = math.tanh(gain * (u * sine - (v + front_axle * r) * cosine)) * front_grip
    grip = rear_grip * (1.0 - min(abs(traction) * traction_share, thrust_grip_loss))
    rear = math.tanh(gain * (rear_axle * r - v)) * grip
    across = front * cosine

    shake = speed * per_pace
    push = traction - rolling_drag * u - front * sine * inverse_mass
    along_turning, across_turning = frame_change(u, v, r)
    change = (push + along_turning + force_noise * shake) * FINE_DT
    v = v + ((across + rear) * inverse_mass + across_turning) * FINE_DT
    r = r + ((front_axle * across - rear_axle * rear) * inverse_inertia + yaw_noise * shake) * FINE_DT

    creep = max(1.0 - speed * CREEP, 0.0)
    loss = rolling_loss + (static_loss - rolling_loss) * creep
    u = max(u + (change - loss), 0.0) + min(u + (change + loss), 0.0)
    turning = where_less(REST_YAW_RATE, abs(r), 1.0, where_less(REST_SPEED, abs(v), 1.0, 0.0))
    moving = where_less(0.0, abs(u), 1.0, turning)
    return u, v * moving, r * moving, motor, sag, slack, steering
