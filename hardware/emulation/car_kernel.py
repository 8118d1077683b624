"""Compiled form of the emulated car: `hardware.emulation.car_physics.car_step` and the delayed commands."""

from __future__ import annotations

import math

from hardware.emulation.car_physics import (
    BODY,
    BUFFER,
    CREEP_SPEED,
    FINE_DT,
    LATENCY,
    REST_SPEED,
    REST_YAW_RATE,
    Coefficients,
)
from sysid_evo.angles import frame_change
from sysid_evo.kernels import LANES, Layout, load, store, view, where_at_most, where_less
from sysid_evo.models.kernels.stepping import copy

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
