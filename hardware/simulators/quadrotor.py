"""A quadrotor of the package rotorpy: aerodynamics, motor lag, rates or single motors as commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from hardware.arguments import check_choice, check_number
from hardware.simulators.simulator import ExternalSimulator, SimulatorSession
from hardware.simulators.simulator_robot import SimulatorRobot
from sysid_evo.extras import check_installed
from sysid_evo.registry import register_robot
from sysid_evo.rigid_body import RigidBody, quaternion, rotated
from sysid_evo.system import Channel, System, rigid_body_states
from sysid_evo.types import Array

GRAVITY = 9.81  # m/s^2
RATE_GAINS = {"hummingbird": 20.0, "crazyflie": 4.0}
"""Gain of the rate controller in 1/s of each vehicle: it is critically damped or slower at 50 Hz."""
COMMANDS = ("rates", "motors")
FASTEST, FASTEST_TURN = 15.0, 25.0  # m/s, rad/s: an episode ends beyond
LARGEST_RATE = 3.0  # rad/s, of a command
START = (0.5, 0.5, 0.2)
"""Largest speed (m/s), rate (rad/s) and tilt (rad) at the start of a recorded episode."""


@register_robot("quadrotor")
class Quadrotor(SimulatorRobot):
    """A quadrotor in free flight, simulated by rotorpy.

    ``vehicle`` is "hummingbird" (0.5 kg, motor lag 5 ms) or "crazyflie" (0.03 kg, 72 ms). With ``command`` "rates" the
    controls are the thrust (0 to twice the weight) and three body rates for its rate controller with the gain
    ``rate_gain`` (1/s, by default 20 or 4); with "motors" they are the four thrusts. The states are those of
    `RigidBody` in ENU; motor speeds are not measured. An episode ends when it turns over, or beyond 15 m/s or 25 rad/s.
    ``dt`` is in s. Raises `InvalidArgument`, `MissingExtra`.

    Source: Folk, Paulos, Kumar, RotorPy, 2023.
    """

    requires: ClassVar[tuple[str, ...]] = ("rotorpy",)
    default_task = "hover"

    def __init__(
        self,
        *,
        vehicle: str = "hummingbird",
        command: str = "rates",
        rate_gain: float | None = None,
        dt: float = 0.02,
    ) -> None:
        check_choice("robot quadrotor: vehicle", vehicle, RATE_GAINS)
        check_choice("robot quadrotor: command", command, COMMANDS)
        gain = RATE_GAINS[vehicle] if rate_gain is None else rate_gain
        check_number("robot quadrotor: rate_gain", gain, above=0.0)
        check_number("robot quadrotor: dt", dt, above=0.0)
        check_installed("robot 'quadrotor'", self.requires)
        known = import_module(f"rotorpy.vehicles.{vehicle}_params").quad_params
        parameters = {**known, "k_w": gain, "motor_noise_std": 0.0}
        weight, motion = parameters["mass"] * GRAVITY, RigidBody()
        if command == "motors":
            controls = [Channel(f"thrust_{i}", "N", 0.0, weight / 2.0, neutral=weight / 4.0) for i in range(1, 5)]
        else:
            limits = (-LARGEST_RATE, LARGEST_RATE)
            controls = [
                Channel("thrust", "N", 0.0, 2.0 * weight, neutral=weight),
                *(Channel(f"{axis}_command", "rad/s", *limits) for axis in ("roll", "pitch", "yaw")),
            ]
        states = rigid_body_states(motion, speed=FASTEST, rate=FASTEST_TURN)
        system = System(states, controls, dt, motion, vehicle)
        super().__init__(QuadrotorSimulator(vehicle, system, command, parameters))


@dataclass(frozen=True)
class QuadrotorSimulator(ExternalSimulator):
    """A vehicle with these ``parameters`` of rotorpy, without noise of its motors; ``command`` as for `Quadrotor`."""

    name: str
    system: System
    command: str
    parameters: Mapping[str, Any]

    def open(self) -> QuadrotorSession:
        return QuadrotorSession(self)


class QuadrotorSession(SimulatorSession):
    """Flights of one vehicle, one after the other."""

    def __init__(self, simulator: QuadrotorSimulator) -> None:
        self._simulator, self._system = simulator, simulator.system
        abstraction = "cmd_motor_thrusts" if simulator.command == "motors" else "cmd_ctbr"
        make = import_module("rotorpy.vehicles.multirotor").Multirotor
        self._vehicle = make(simulator.parameters, control_abstraction=abstraction)
        self._state: dict[str, Array] = {}

    def reset(self, seed: int, at: Array | None = None) -> Array:
        given = self._drawn(seed) if at is None else np.array(at, dtype=np.float64)
        up = given[6:] / np.linalg.norm(given[6:])
        pose = self._system.initial_pose(np.concatenate([given[:6], up]))
        speed = self._simulator.parameters
        hover = np.sqrt(0.25 * speed["mass"] * GRAVITY / speed["k_eta"])
        self._state = {
            "x": np.zeros(3),
            "v": np.array(rotated(*pose[3:], *given[:3])),
            "q": pose[[4, 5, 6, 3]],
            "w": given[3:6],
            "wind": np.zeros(3),
            "rotor_speeds": np.full(4, hover),
        }
        return self._measured()

    def step(self, control: Array) -> tuple[Array, float, bool, bool]:
        if self._simulator.command == "motors":
            command: dict[str, Any] = {"cmd_motor_thrusts": np.asarray(control)}
        else:
            command = {"cmd_thrust": float(control[0]), "cmd_w": np.asarray(control[1:])}
        self._state = self._vehicle.step(self._state, command, self._system.dt)
        after = self._measured()
        fast = np.abs(after[:3]).max() > FASTEST or np.abs(after[3:6]).max() > FASTEST_TURN
        return after, 0.0, bool(fast or after[8] < 0.0), False

    def _measured(self) -> Array:
        x, y, z, w = self._state["q"]
        speeds = rotated(w, -x, -y, -z, *self._state["v"])
        return np.array([*speeds, *self._state["w"], *rotated(w, -x, -y, -z, 0.0, 0.0, 1.0)])

    @staticmethod
    def _drawn(seed: int) -> Array:
        """Return a random start (9,), level to within a small tilt."""
        drawn = np.random.default_rng(seed).uniform(-1.0, 1.0, (3, 3))
        speed, rate, tilt = START
        w, x, y, z = quaternion(tilt * drawn[2, 0], tilt * drawn[2, 1], 0.0)
        return np.array([*(speed * drawn[0]), *(rate * drawn[1]), *rotated(w, -x, -y, -z, 0.0, 0.0, 1.0)])
