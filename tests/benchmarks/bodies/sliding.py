"""The equations of CommonRoad's single-track drift model, compiled for 64 rollouts at once: evolution on the simulator.

A step of `DriftCar` takes about 0.3 ms, and its rollouts run one after the other; in this copy a step takes 6 us. It
leaves out the blend with a kinematic model, which has no weight above 1 m/s; below that a trial is over.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hardware.simulators.drift_car import BRAKES, FASTEST, ROLLING, SERVO, SLOWEST, STEP, DriftCar
from sysid_evo.kernels import LANES, DynamicsKernel, KernelSource, Layout
from sysid_evo.laws import array_form
from sysid_evo.models.dynamics import PlainDynamics
from sysid_evo.types import Array

GRAVITY = 9.81
TIRE = (
    "p_cx1", "p_dx1", "p_ex1", "p_kx1", "p_hx1", "p_vx1", "r_bx1", "r_bx2", "r_cx1", "r_ex1", "r_hx1", "p_cy1", "p_dy1",
    "p_ey1", "p_ky1", "r_by1", "r_by2", "r_by3", "r_cy1", "r_ey1", "r_hy1", "r_vy1", "r_vy4", "r_vy5", "r_vy6",
)  # fmt: skip
BODY = ("m", "a", "b", "h_s", "I_z", "I_y_w", "R_w", "T_sb", "T_se")
AT = Layout(*TIRE, *BODY, "low", "high", "turn", "v_switch", "a_max", "h", "steps")


class Slide(PlainDynamics):
    """A `DriftCar` with the model "drift"; its state stays at zero after a trial is over, so that nothing moves."""

    def __init__(self, robot: DriftCar) -> None:
        self.system = robot.system
        self.n_carry = robot.system.nx
        p = robot.simulator.parameters
        self.steps = math.ceil(self.system.dt / STEP)
        limits = [p.steering.min, p.steering.max, p.steering.v_max, p.longitudinal.v_switch, p.longitudinal.a_max]
        numbers = [getattr(p.tire, name) for name in TIRE] + [getattr(p, name) for name in BODY]
        self.parameters = np.array([*numbers, *limits, self.system.dt / self.steps, self.steps])

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return states[:, -1].copy()

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        y = array_form(inside)(carry.T, self.parameters)
        for _ in range(self.steps):
            y = array_form(substep)(y, control.T, self.parameters)
        return np.stack(np.broadcast_arrays(*array_form(outside)(carry.T, y, self.parameters)), axis=1)

    def kernel(self) -> DynamicsKernel:
        return DynamicsKernel(KernelSource(slide), self.parameters, n_scratch=self.n_carry)


def arc_tangent(z: Any) -> Any:
    """The arc tangent, by the function of two arguments, which lanes have."""
    return math.atan2(z, 1.0)


def bent(z: Any, shape: Any, bend: Any) -> Any:
    """The angle inside a magic formula: ``shape`` times the arc tangent of ``z`` bent by ``bend``."""
    return shape * arc_tangent(z - bend * (z - arc_tangent(z)))


def flat(z: Any) -> Any:
    """The cosine of the arc tangent of ``z``."""
    return 1.0 / math.sqrt(1.0 + z * z)


def tire(slip: Any, angle: Any, load: Any, p: Any) -> Any:
    """Longitudinal and lateral force under combined slip, without camber."""
    bx = p[AT.p_kx1] / (p[AT.p_cx1] * p[AT.p_dx1])
    by = p[AT.p_ky1] / (p[AT.p_cy1] * p[AT.p_dy1])
    fx = p[AT.p_dx1] * load * math.sin(
        bent(bx * (p[AT.p_hx1] - slip), p[AT.p_cx1], p[AT.p_ex1]) + load * p[AT.p_vx1]
    )  # fmt: skip
    fy = p[AT.p_dy1] * load * math.sin(bent(by * angle, p[AT.p_cy1], p[AT.p_ey1]))
    b = p[AT.r_bx1] * flat(p[AT.r_bx2] * slip)
    fx = fx / math.cos(bent(b * p[AT.r_hx1], p[AT.r_cx1], p[AT.r_ex1]))
    fx = fx * math.cos(bent(b * (angle + p[AT.r_hx1]), p[AT.r_cx1], p[AT.r_ex1]))
    b = p[AT.r_by1] * flat(p[AT.r_by2] * (angle - p[AT.r_by3]))
    fy = fy / math.cos(bent(b * p[AT.r_hy1], p[AT.r_cy1], p[AT.r_ey1]))
    fy = fy * math.cos(bent(b * (slip + p[AT.r_hy1]), p[AT.r_cy1], p[AT.r_ey1]))
    shift = p[AT.p_dy1] * load * p[AT.r_vy1] * flat(p[AT.r_vy4] * angle)
    return fx, fy + shift * math.sin(p[AT.r_vy5] * arc_tangent(p[AT.r_vy6] * slip))


def rate(x: Any, u: Any, p: Any) -> Any:
    """The change per second of steering angle, speed, yaw rate, slip angle and wheel speeds (rad/s)."""
    steer, v, yaw_rate, slip, front, rear = x[0], x[1], x[2], x[3], x[4], x[5]
    turn = min(max((u[1] - steer) / SERVO, -p[AT.turn]), p[AT.turn])
    turn = 0.0 if steer <= p[AT.low] and turn <= 0.0 else turn
    turn = 0.0 if steer >= p[AT.high] and turn >= 0.0 else turn
    most = p[AT.a_max] * p[AT.v_switch] / v if v > p[AT.v_switch] else p[AT.a_max]
    drive = 0.0 if u[0] < 0.0 and v < BRAKES else min(max(u[0], -p[AT.a_max]), most)
    m, lf, lr = p[AT.m], p[AT.a], p[AT.b]
    along, across = v * math.cos(slip), v * math.sin(slip)
    angle_f = arc_tangent((across + yaw_rate * lf) / along) - steer
    angle_r = arc_tangent((across - yaw_rate * lr) / along)
    ground_f = max(0.0, along * math.cos(steer) + (across + lf * yaw_rate) * math.sin(steer))
    slip_f = 1.0 - p[AT.R_w] * front / max(ground_f, 0.1)
    slip_r = 1.0 - p[AT.R_w] * rear / max(along, 0.1)
    fxf, fyf = tire(slip_f, angle_f, m * (lr * GRAVITY - drive * p[AT.h_s]) / (lf + lr), p)
    fxr, fyr = tire(slip_r, angle_r, m * (lf * GRAVITY + drive * p[AT.h_s]) / (lf + lr), p)
    torque = m * p[AT.R_w] * drive
    share = p[AT.T_se] if drive > 0.0 else p[AT.T_sb]
    towards = steer - slip
    return (
        turn,
        (-fyf * math.sin(towards) + fyr * math.sin(slip) + fxr * math.cos(slip) + fxf * math.cos(towards)) / m,
        (fyf * math.cos(steer) * lf - fyr * lr + fxf * math.sin(steer) * lf) / p[AT.I_z],
        (fyf * math.cos(towards) + fyr * math.cos(slip) - fxr * math.sin(slip) + fxf * math.sin(towards)) / (m * v)
        - yaw_rate,
        0.0 if front < 0.0 else (share * torque - p[AT.R_w] * fxf) / p[AT.I_y_w],
        0.0 if rear < 0.0 else ((1.0 - share) * torque - p[AT.R_w] * fxr) / p[AT.I_y_w],
    )


def along_rate(x: Any, k: Any, h: Any) -> Any:
    """The state after ``h`` s at the rate ``k``."""
    return (
        x[0] + h * k[0], x[1] + h * k[1], x[2] + h * k[2], x[3] + h * k[3], x[4] + h * k[4], x[5] + h * k[5]
    )  # fmt: skip


def inside(x: Any, p: Any) -> Any:
    """Steering angle, speed, yaw rate, slip angle and wheel speeds (rad/s) of a measured state."""
    forward = x[0] if x[0] >= SLOWEST else ROLLING  # of a trial that is over
    radius = p[AT.R_w]
    return (
        x[3],
        math.sqrt(forward * forward + x[1] * x[1]),
        x[2],
        math.atan2(x[1], forward),
        x[4] / radius,
        x[5] / radius,
    )


def substep(y: Any, u: Any, p: Any) -> Any:
    """One step of the classical Runge-Kutta method; no wheel turns backwards."""
    h = p[AT.h]
    k1 = rate(y, u, p)
    k2 = rate(along_rate(y, k1, 0.5 * h), u, p)
    k3 = rate(along_rate(y, k2, 0.5 * h), u, p)
    k4 = rate(along_rate(y, k3, h), u, p)
    y = along_rate(along_rate(along_rate(along_rate(y, k1, h / 6.0), k2, h / 3.0), k3, h / 3.0), k4, h / 6.0)
    return y[0], max(y[1], 0.2), y[2], y[3], max(y[4], 0.0), max(y[5], 0.0)


def outside(x: Any, y: Any, p: Any) -> Any:
    """The measured state after ``x``: at rest if the trial was over there."""
    going = 0.0 if x[0] < SLOWEST else 0.0 if x[0] > FASTEST else 1.0
    forward, lateral = going * y[1] * math.cos(y[3]), going * y[1] * math.sin(y[3])
    return forward, lateral, going * y[2], y[0], p[AT.R_w] * y[4], p[AT.R_w] * y[5]


def slide(carry: Any, control: Any, noise: Any, parameters: Any, scratch: Any) -> None:
    """One sample in the lanes of a kernel."""
    for lane in range(LANES):
        write(scratch, lane, inside(numbers(carry, lane), parameters))
    for _ in range(int(parameters[AT.steps])):
        for lane in range(LANES):
            u = control[lane], control[LANES + lane]
            write(scratch, lane, substep(numbers(scratch, lane), u, parameters))
    for lane in range(LANES):
        write(carry, lane, outside(numbers(carry, lane), numbers(scratch, lane), parameters))


def numbers(rows: Any, lane: Any) -> Any:
    """The six numbers of a lane."""
    return (
        rows[lane], rows[LANES + lane], rows[2 * LANES + lane], rows[3 * LANES + lane], rows[4 * LANES + lane],
        rows[5 * LANES + lane],
    )  # fmt: skip


def write(rows: Any, lane: Any, y: Any) -> None:
    """Write the six numbers ``y`` of a lane."""
    rows[lane], rows[LANES + lane], rows[2 * LANES + lane] = y[0], y[1], y[2]
    rows[3 * LANES + lane], rows[4 * LANES + lane], rows[5 * LANES + lane] = y[3], y[4], y[5]
