"""Default examples of the checks: made-up cars, a pendulum, a recording, dynamics for any system."""

from __future__ import annotations

import numpy as np

from sysid_evo.data.dataset import Dataset
from sysid_evo.kernels import LANES, DynamicsKernel, KernelSource, Layout
from sysid_evo.models.dynamics import PlainDynamics
from sysid_evo.motion import PlanarBody
from sysid_evo.rigid_body import RigidBody
from sysid_evo.system import Channel, System, rigid_body_states
from sysid_evo.types import Array

DECAY = 0.9
"""Factor per step of the deviation of a state from neutral in `ExampleDynamics`."""
PUSH = 0.3
"""Largest effect per step of a control on a state in `ExampleDynamics`."""


def example_systems() -> tuple[System, ...]:
    """Return a made-up car with switches, one with continuous controls, a pendulum, a bare system, and a drone."""
    return switched_car(), continuous_car(), pendulum(), bare_system(), drone()


def switched_car() -> System:
    """Return a planar body with two three-way switches, at 20 Hz."""
    return _car(Channel("drive", levels=(-1.0, 0.0, 1.0)), Channel("steer", levels=(-1.0, 0.0, 1.0)))


def continuous_car() -> System:
    """Return a planar body with two continuous controls, at 20 Hz."""
    return _car(Channel("drive", low=-1.0, high=1.0), Channel("steer", low=-1.0, high=1.0))


def pendulum() -> System:
    """Return a periodic angle, its rate and a torque, without a motion, at 50 Hz."""
    states = (Channel("angle", "rad", period=2.0 * np.pi), Channel("angular_speed", "rad/s"))
    return System(states, (Channel("torque", "N m", -2.0, 2.0),), dt=0.02, name="made-up pendulum")


def drone(frame: str = "ENU") -> System:
    """Return a rigid body in space with thrust and three torques, at 50 Hz."""
    motion = RigidBody(frame=frame)
    controls = [Channel(name, low=-1.0, high=1.0) for name in ("thrust", "roll", "pitch", "yaw")]
    return System(rigid_body_states(motion), controls, dt=0.02, motion=motion, name="made-up drone")


def bare_system() -> System:
    """Return a system with one state and one control without roles."""
    return System((Channel("some_state"),), (Channel("some_control", low=0.0, high=1.0),), dt=0.1, name="bare system")


def example_dataset(seed: int = 0, episodes: int = 3, steps: int = 200) -> Dataset:
    """Return a small recording of a made-up car with drag, thrust and steering, and a little noise."""
    system = switched_car()
    rng = np.random.default_rng(seed)
    states = np.zeros((episodes, steps + 1, system.nx))
    controls = np.repeat(rng.integers(-1, 2, (episodes, steps // 5 + 1, 2)), 5, axis=1)[:, :steps].astype(float)
    for k in range(steps):
        u, v, r = states[:, k].T
        drive, steer = controls[:, k].T
        acceleration = np.stack([3.0 * drive - 1.5 * u, -5.0 * v + 0.2 * u * r, 4.0 * u * steer - 3.0 * r], axis=1)
        noise = 0.01 * rng.standard_normal((episodes, system.nx))
        states[:, k + 1] = system.integrate(states[:, k], acceleration) + noise
    return Dataset.from_arrays(system, list(states), list(controls))


class ExampleDynamics(PlainDynamics):
    """A stable linear system for any states and controls: x' = x_n + 0.9 (x - x_n) + B (u - u_n).

    The subscript n means neutral. B (nx, nu) consists of cosines, so that every control acts on every state.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.n_carry = system.nx
        places = np.arange(system.nx)[:, None] + 2.0 * np.arange(system.nu)
        self.push = PUSH * np.cos(places)
        self.offset = (1.0 - DECAY) * system.neutral_state - self.push @ system.neutral_control

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return states[:, -1].copy()

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        after = DECAY * carry + self.offset
        for j in range(self.system.nu):
            after = after + control[:, j : j + 1] * self.push[:, j]
        return after

    def kernel(self) -> DynamicsKernel:
        parameters = HEAD.pack(self.offset, self.push, nx=self.system.nx, nu=self.system.nu, decay=DECAY)
        return DynamicsKernel(KernelSource(decay_and_push), parameters)


def _car(drive: Channel, steer: Channel) -> System:
    states = (Channel("forward_speed", "m/s"), Channel("lateral_speed", "m/s"), Channel("yaw_rate", "rad/s"))
    return System(states, (drive, steer), dt=0.05, motion=PlanarBody(), name="made-up car")


HEAD = Layout("nx", "nu", "decay")


def decay_and_push(carry, control, noise, parameters, scratch):
    """x' = decay x + offset + B u; the offset (nx,) and B (nx, nu) follow the head."""
    nx, nu = int(parameters[HEAD.nx]), int(parameters[HEAD.nu])
    for i in range(nx):
        for lane in range(LANES):
            after = parameters[HEAD.decay] * carry[i * LANES + lane] + parameters[HEAD.size + i]
            for j in range(nu):
                after += control[j * LANES + lane] * parameters[HEAD.size + nx + i * nu + j]
            carry[i * LANES + lane] = after
