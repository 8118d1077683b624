"""A passenger car of the package commonroad-vehicle-models, which slides and drifts: single-track or multi-body."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hardware.arguments import check_choice, check_integer, check_number
from hardware.simulators.simulator import ExternalSimulator, SimulatorSession
from hardware.simulators.simulator_robot import SimulatorRobot
from sysid_evo.engine.compiled.plain import compile_plain
from sysid_evo.extras import check_installed
from sysid_evo.motion import PlanarBody
from sysid_evo.registry import register_robot
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

MODELS = {"drift": "std", "multi_body": "mb"}
"""The short names of the package."""
WHEELS = {"drift": slice(7, 9), "multi_body": slice(23, 27)}
"""Places of the speeds of the wheels (rad/s) in the state of each model."""
SLOWEST, FASTEST = 1.0, 30.0
"""Forward speeds (m/s) beyond which an episode ends: both models are stiff near standstill."""
BRAKES = 2.0
"""Speed (m/s) below which the brakes do not act."""
ROLLING = 5.0
"""Forward speed (m/s) at the start of a trial; recorded episodes begin with half to three times of it."""
STRONGEST = 6.0
"""Largest request of acceleration (m/s^2); more only spins or locks the wheels."""
SERVO = 0.1
"""Time constant (s) of the steering, which turns at 0.4 rad/s at most."""
STEP = 1e-3
"""Longest step (s) of the integration: locked wheels make a variable one fail."""


@register_robot("drift_car")
class DriftCar(SimulatorRobot):
    """A passenger car on a plane, simulated by the models of CommonRoad.

    ``model`` is "drift" (single-track with combined slip and wheel speeds) or "multi_body" (29 states, of which roll,
    pitch and suspension are not measured). ``vehicle`` is 1 (Ford Escort), 2 (BMW 320i) or 3 (VW Vanagon). The controls
    are the acceleration (m/s^2) that engine and brakes request and the steering angle (rad) that a servo approaches.
    States besides those of `PlanarBody` are the steering angle and the speeds of the wheels at their rims. A trial
    begins rolling at 5 m/s; the brakes act above 2 m/s. An episode ends beyond 30 m/s, below 1 m/s, and when it slides
    backwards. ``dt`` is in s. Raises `InvalidArgument`, `MissingExtra`.

    Source: Althoff, Würsching, CommonRoad: vehicle models, version 2020a.
    """

    requires: ClassVar[tuple[str, ...]] = ("vehiclemodels",)
    default_task = "point_to_point(arena_radius=40, waypoint_radius=8, horizon=600)"

    def __init__(self, *, model: str = "drift", vehicle: int = 2, dt: float = 0.05) -> None:
        check_choice("robot drift_car: model", model, MODELS)
        check_integer("robot drift_car: vehicle", vehicle, minimum=1, maximum=3)
        check_number("robot drift_car: dt", dt, above=0.0)
        check_installed("robot 'drift_car'", self.requires)
        parameters = _function(f"parameters_vehicle{vehicle}")()
        steering, most = parameters.steering, min(STRONGEST, float(parameters.longitudinal.a_max))
        states = (
            Channel("forward_speed", "m/s", neutral=ROLLING),
            Channel("lateral_speed", "m/s"),
            Channel("yaw_rate", "rad/s"),
            Channel("steering_angle", "rad", float(steering.min), float(steering.max)),
            Channel("front_wheels", "m/s", neutral=ROLLING, description="speed at the rim"),
            Channel("rear_wheels", "m/s", neutral=ROLLING, description="speed at the rim"),
        )
        controls = (
            Channel("acceleration", "m/s^2", -most, most),
            Channel("steering", "rad", float(steering.min), float(steering.max), description="commanded angle"),
        )
        name = f"{model} car {vehicle}"
        system = System(states, controls, dt, PlanarBody(), name)
        super().__init__(DriftCarSimulator(name, system, model, vehicle, parameters))


@dataclass(frozen=True)
class DriftCarSimulator(ExternalSimulator):
    """A ``vehicle`` with its ``parameters`` of the package, simulated by ``model``."""

    name: str
    system: System
    model: str
    vehicle: int
    parameters: Any

    def open(self) -> DriftCarSession:
        return DriftCarSession(self)


class DriftCarSession(SimulatorSession):
    """Drives of one vehicle, one after the other."""

    def __init__(self, simulator: DriftCarSimulator) -> None:
        short = MODELS[simulator.model]
        self._dt, self._parameters, self._radius = simulator.system.dt, simulator.parameters, simulator.parameters.R_w
        self._multi_body = simulator.model == "multi_body"
        self._wheels = WHEELS[simulator.model]
        self._advance = compiled_advance(simulator.model, simulator.vehicle)
        self._begin = _function(f"init_{short}")
        self._state = np.zeros(0)

    def reset(self, seed: int, at: Array | None = None) -> Array:
        rolling = ROLLING * np.random.default_rng(seed).uniform(0.5, 3.0)
        forward, lateral, yaw_rate, steering, front, rear = (
            (rolling, 0.0, 0.0, 0.0, rolling, rolling) if at is None else map(float, at)
        )
        core = [0.0, 0.0, steering, math.hypot(forward, lateral), 0.0, yaw_rate, math.atan2(lateral, forward)]
        self._state = np.array(self._begin(core, self._parameters), dtype=np.float64)
        wheels = [front, front, rear, rear] if self._multi_body else [front, rear]
        self._state[self._wheels] = np.array(wheels) / self._radius
        return self._measured()

    def step(self, control: Array) -> tuple[Array, float, bool, bool]:
        acceleration, steering = map(float, control)
        before, steps = self._measured(), math.ceil(self._dt / STEP)
        try:
            state = self._advance(self._state, acceleration, steering, self._dt / steps, steps)
        except ZeroDivisionError:  # the multi-body model divides by the ground speed of each wheel
            return before, 0.0, True, False
        if not np.isfinite(state).all():
            return before, 0.0, True, False
        self._state = state
        after = self._measured()
        return after, 0.0, not SLOWEST <= after[0] <= FASTEST, False

    def _measured(self) -> Array:
        x = self._state
        if self._multi_body:
            wheels = 0.5 * self._radius * np.array([x[23] + x[24], x[25] + x[26]])
            return np.array([x[3], x[10], x[5], x[2], *wheels])
        return np.array([x[3] * math.cos(x[6]), x[3] * math.sin(x[6]), x[5], x[2], *(self._radius * x[7:9])])


@cache
def compiled_advance(model: str, vehicle: int) -> Callable[..., Any]:
    """Return `advance_car` with the equations of a model and the parameters of a vehicle."""
    wheels = WHEELS[model]
    bindings = {
        "equations": _function(f"vehicle_dynamics_{MODELS[model]}"),
        "vehicle": _function(f"parameters_vehicle{vehicle}")(),
        "first": wheels.start,
        "end": wheels.stop,
    }
    compiled: Callable[..., Any] = compile_plain(advance_car, bindings)
    return compiled


if TYPE_CHECKING:  # bound when the functions are compiled
    equations: Callable[..., Any]
    vehicle: Any
    first: int
    end: int


def rate_of_car(state: Array, acceleration: float, steering: float) -> Array:
    """The rate of change of the state; the model limits the speed of the steering."""
    request = 0.0 if acceleration < 0.0 and state[3] < BRAKES else acceleration
    return np.array(equations(list(state), [(steering - state[2]) / SERVO, request], vehicle))


def advance_car(state: Array, acceleration: float, steering: float, dt: float, steps: int) -> Array:
    """Return the state after ``steps`` steps of the classical Runge-Kutta method; no wheel turns backwards."""
    for _ in range(steps):
        k1 = rate_of_car(state, acceleration, steering)
        k2 = rate_of_car(state + 0.5 * dt * k1, acceleration, steering)
        k3 = rate_of_car(state + 0.5 * dt * k2, acceleration, steering)
        k4 = rate_of_car(state + dt * k3, acceleration, steering)
        state = state + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        for wheel in range(first, end):
            state[wheel] = max(state[wheel], 0.0)
    return state


def _function(name: str) -> Callable[..., Any]:
    """Return a function of the package, whose modules have the same names."""
    found: Callable[..., Any] = getattr(import_module(f"vehiclemodels.{name}"), name)
    return found
