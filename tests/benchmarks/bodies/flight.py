"""The equations of rotorpy's `Multirotor` under thrust and rates, compiled, for evolution on the simulator itself.

A step of rotorpy takes milliseconds, so an evolution on it takes days. This copy takes microseconds.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hardware.simulators.quadrotor import GRAVITY, Quadrotor
from sysid_evo.kernels import DynamicsKernel, ScalarStep
from sysid_evo.laws import array_form
from sysid_evo.models.dynamics import PlainDynamics
from sysid_evo.types import Array

SUBSTEPS = 8
"""Runge-Kutta steps in one sample: 2.5 ms, half the lag of the motors of a Hummingbird."""


class Flight(PlainDynamics):
    """A `Quadrotor` with the command "rates": the carry is the state, and the speeds of the four rotors (rad/s)."""

    def __init__(self, robot: Quadrotor) -> None:
        self.system, self.n_carry = robot.system, robot.system.nx + 4
        p = robot.simulator.parameters
        places = np.array([p["rotor_pos"][f"r{i}"] for i in range(1, 5)])
        yaw = p["k_m"] / p["k_eta"] * np.asarray(p["rotor_directions"])
        mixing = np.linalg.inv(np.stack([np.ones(4), places[:, 1], -places[:, 0], yaw]))
        self.hover = math.sqrt(0.25 * p["mass"] * GRAVITY / p["k_eta"])
        inertia = [p[name] for name in ("Ixx", "Iyy", "Izz")]
        drag = [p[name] for name in ("c_Dx", "c_Dy", "c_Dz")]
        head = [p[name] for name in ("mass", "k_eta", "k_m", "k_d", "k_z", "k_h", "k_flap", "tau_m")]
        limits = [p["rotor_speed_min"], p["rotor_speed_max"], p["k_w"], self.system.dt / SUBSTEPS]
        self.parameters = np.concatenate(
            [head, limits, inertia, drag, places.ravel(), p["rotor_directions"], mixing.ravel()]
        )

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return np.concatenate([states[:, -1], np.full((len(states), 4), self.hover)], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        return np.stack(np.broadcast_arrays(*array_form(fly)(carry.T, control.T, self.parameters)), axis=1)

    def kernel(self) -> DynamicsKernel:
        return DynamicsKernel(ScalarStep(fly, n_carry=self.n_carry, nu=self.system.nu), self.parameters)


def rotor(i: Any, u: Any, moments: Any, p: Any) -> Any:
    """The commanded speed of rotor ``i`` for a thrust and three moments."""
    force = p[34 + 4 * i] * u[0] + p[35 + 4 * i] * moments[0] + p[36 + 4 * i] * moments[1] + p[37 + 4 * i] * moments[2]
    return min(max(math.sqrt(max(force, 0.0) / p[1]), p[8]), p[9])


def wrench(i: Any, x: Any, p: Any) -> Any:
    """Force and moment of rotor ``i``."""
    px, py, pz = p[18 + 3 * i], p[19 + 3 * i], p[20 + 3 * i]
    speed = x[9 + i]
    vx = x[0] + x[4] * pz - x[5] * py
    vy = x[1] + x[5] * px - x[3] * pz
    vz = x[2] + x[3] * py - x[4] * px
    fx, fy = -speed * p[3] * vx, -speed * p[3] * vy
    fz = p[1] * speed * speed + p[5] * (vx * vx + vy * vy) - speed * p[4] * vz
    mx = py * fz - pz * fy - p[6] * speed * vy
    my = pz * fx - px * fz + p[6] * speed * vx
    mz = px * fy - py * fx + p[30 + i] * p[2] * speed * speed
    return fx, fy, fz, mx, my, mz


def rate(x: Any, command: Any, p: Any) -> Any:
    """The change per second of velocities, rates, up and rotor speeds."""
    a, b, c, d = wrench(0, x, p), wrench(1, x, p), wrench(2, x, p), wrench(3, x, p)
    speed = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    fx = a[0] + b[0] + c[0] + d[0] - speed * p[15] * x[0]
    fy = a[1] + b[1] + c[1] + d[1] - speed * p[16] * x[1]
    fz = a[2] + b[2] + c[2] + d[2] - speed * p[17] * x[2]
    mx = a[3] + b[3] + c[3] + d[3] - (p[14] - p[13]) * x[4] * x[5]
    my = a[4] + b[4] + c[4] + d[4] - (p[12] - p[14]) * x[5] * x[3]
    mz = a[5] + b[5] + c[5] + d[5] - (p[13] - p[12]) * x[3] * x[4]
    return (
        fx / p[0] - 9.81 * x[6] - (x[4] * x[2] - x[5] * x[1]),
        fy / p[0] - 9.81 * x[7] - (x[5] * x[0] - x[3] * x[2]),
        fz / p[0] - 9.81 * x[8] - (x[3] * x[1] - x[4] * x[0]),
        mx / p[12],
        my / p[13],
        mz / p[14],
        x[7] * x[5] - x[8] * x[4],
        x[8] * x[3] - x[6] * x[5],
        x[6] * x[4] - x[7] * x[3],
        (command[0] - x[9]) / p[7],
        (command[1] - x[10]) / p[7],
        (command[2] - x[11]) / p[7],
        (command[3] - x[12]) / p[7],
    )


def along(x: Any, k: Any, h: Any) -> Any:
    """The state after ``h`` s at the rate ``k``."""
    return (
        x[0] + h * k[0], x[1] + h * k[1], x[2] + h * k[2], x[3] + h * k[3], x[4] + h * k[4], x[5] + h * k[5],
        x[6] + h * k[6], x[7] + h * k[7], x[8] + h * k[8], x[9] + h * k[9], x[10] + h * k[10], x[11] + h * k[11],
        x[12] + h * k[12],
    )  # fmt: skip


def fly(x: Any, u: Any, p: Any) -> Any:
    """One sample: the rate controller acts at its beginning, then four rotors follow their commands."""
    moments = (-p[10] * (x[3] - u[1]) * p[12], -p[10] * (x[4] - u[2]) * p[13], -p[10] * (x[5] - u[3]) * p[14])
    command = (rotor(0, u, moments, p), rotor(1, u, moments, p), rotor(2, u, moments, p), rotor(3, u, moments, p))
    y, h = (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8], x[9], x[10], x[11], x[12]), p[11]
    for _ in range(SUBSTEPS):
        k1 = rate(y, command, p)
        k2 = rate(along(y, k1, 0.5 * h), command, p)
        k3 = rate(along(y, k2, 0.5 * h), command, p)
        k4 = rate(along(y, k3, h), command, p)
        y = along(along(along(along(y, k1, h / 6.0), k2, h / 3.0), k3, h / 3.0), k4, h / 6.0)
    return y
