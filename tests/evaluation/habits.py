"""Robots with one wrong habit planted into them, and trajectories of driving them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from hardware.emulation.held_control import HeldControl
from hardware.emulation.pendulum import PendulumParameters, PendulumPhysics
from sysid_evo.data import Trajectory
from sysid_evo.kernels import LANES, DynamicsKernel, KernelSource, Layout, view
from sysid_evo.models import Dynamics
from sysid_evo.registry import make_robot
from sysid_evo.types import Array

Numbers: TypeAlias = tuple[float, ...]
Habit: TypeAlias = Callable[[Numbers, Numbers, Numbers], Numbers]
"""What becomes of the next state of the toy car, given the state before, the control, and that next state."""
TRIALS, STEPS = 8, 500
SLOW = 0.18  # m/s, a tenth of the fastest in the data
STARTING = 0.5  # m/s, a quarter of the fastest
HEAD = Layout("rows", align=16)


def as_it_is(x: Numbers, u: Numbers, y: Numbers) -> Numbers:
    return y[0], y[1], y[2]


def spins_on_the_spot(x: Numbers, u: Numbers, y: Numbers) -> Numbers:
    return y[0], y[1], 3.0 * u[1] if abs(y[0]) < SLOW else y[2]


def turns_tight_when_slow(x: Numbers, u: Numbers, y: Numbers) -> Numbers:
    slow = abs(y[0]) > SLOW and abs(y[0]) < 3.5 * SLOW
    return y[0], y[1], 4.0 * y[0] * u[1] if slow else y[2]


def starts_with_twice_the_power(x: Numbers, u: Numbers, y: Numbers) -> Numbers:
    return y[0] + (y[0] - x[0] if abs(x[0]) < STARTING else 0.0), y[1], y[2]


def slides_sideways(x: Numbers, u: Numbers, y: Numbers) -> Numbers:
    return y[0], y[1] + 0.5 * u[1], y[2]


def gains_energy(x: Numbers, u: Numbers, y: Numbers) -> Numbers:
    return 1.05 * x[0] if u[0] == 0.0 else y[0], y[1], y[2]


def answers_at_once(x: Numbers, u: Numbers, y: Numbers) -> Numbers:
    return 0.9 * x[0] + 0.3 * u[0], y[1], y[2]


def steers_the_other_way_when_fast(x: Numbers, u: Numbers, y: Numbers) -> Numbers:
    return y[0], y[1], 0.8 * x[2] - 0.4 * u[1] if abs(x[0]) > 1.0 else y[2]


def does_not_steer_when_fast(x: Numbers, u: Numbers, y: Numbers) -> Numbers:
    return y[0], y[1], 0.9 * x[2] if abs(x[0]) > 1.0 else y[2]


def does_not_brake_when_fast(x: Numbers, u: Numbers, y: Numbers) -> Numbers:
    return max(y[0], x[0]) if x[0] > 1.0 else y[0], y[1], y[2]


@dataclass(frozen=True)
class Fault:
    """A wrong ``habit`` of the toy car, or friction that a pendulum lacks, and what must name it.

    ``named`` are probes, or states of which a fact of the data is broken; one of them is enough. ``gains`` says
    whether it helps a controller: then the search must find it.
    """

    name: str
    named: tuple[str, ...]
    habit: Habit | None = None
    gains: bool = True

    @property
    def robot(self) -> str:
        """The robot that the fault is planted into."""
        return "pendulum" if self.habit is None else "emulated_car"

    def planted(self) -> Dynamics:
        """Return the robot with the fault."""
        if self.habit is not None:
            return Planted(equations(self.robot), self.habit)
        return HeldControl(PendulumPhysics(PendulumParameters(viscous=1e-9, dry=1e-9)), 10)


FAULTS = (
    Fault("spins on the spot", ("spinning",), spins_on_the_spot),
    Fault("turns too tight when slow", ("curvature",), turns_tight_when_slow),
    Fault("twice the acceleration from rest", ("acceleration",), starts_with_twice_the_power),
    Fault("slides sideways", ("sideways",), slides_sideways),
    Fault("answers without a lag", ("at_once",), answers_at_once),
    Fault("gains energy", ("coasting", "forward_speed"), gains_energy),
    Fault("steers the other way when fast", ("yaw_rate",), steers_the_other_way_when_fast, gains=False),
    Fault("does not steer when fast", ("yaw_rate",), does_not_steer_when_fast, gains=False),
    Fault("a pendulum without friction", ("angular_speed",)),
)


def equations(robot: str) -> Dynamics:
    """Return the equations of an emulated robot."""
    dynamics: Dynamics | None = make_robot(robot).dynamics
    assert dynamics is not None
    return dynamics


class Planted(Dynamics):
    """``base``, a toy car, with a ``habit``: it changes the state that every step leads to."""

    def __init__(self, base: Dynamics, habit: Habit) -> None:
        self.base, self.habit = base, habit
        self.system, self.n_carry, self.n_lags = base.system, base.n_carry, base.n_lags
        self.n_noise, self.n_draws = base.n_noise, base.n_draws

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return self.base.start(states, controls, draws)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        after = self.base.step(carry, control, noise)
        rows = zip(carry[:, :3].tolist(), control.tolist(), after[:, :3].tolist(), strict=True)
        changed = np.array([self.habit(tuple(x), tuple(u), tuple(y)) for x, u, y in rows]).reshape(-1, 3)
        return np.concatenate([changed, after[:, 3:]], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        inner = self.base.kernel()
        if inner is None:
            return None
        source = KernelSource(step_and_change, {"inner": inner.source, "habit": self.habit})
        return DynamicsKernel(source, HEAD.pack(inner.parameters, rows=3), 3 + inner.n_scratch, inner.precision)


def step_and_change(carry, control, noise, parameters, scratch):
    """Step the car, and change the state."""
    rows = int(parameters[HEAD.rows])
    for i in range(rows * LANES):
        scratch[i] = carry[i]
    inner(carry, control, noise, view(parameters, HEAD.size), view(scratch, rows * LANES))  # noqa: F821  # bound by `KernelSource`
    for lane in range(LANES):
        y = habit(  # noqa: F821  # bound by `KernelSource`
            (scratch[lane], scratch[LANES + lane], scratch[2 * LANES + lane]),
            (control[lane], control[LANES + lane]),
            (carry[lane], carry[LANES + lane], carry[2 * LANES + lane]),
        )
        carry[lane] = y[0]
        carry[LANES + lane] = y[1]
        carry[2 * LANES + lane] = y[2]


def driven(dynamics: Dynamics, *, seed: int = 1, let_go: bool = False) -> list[Trajectory]:
    """Drive from rest with commands that are held for 0.3 to 1.2 s; with ``let_go`` from anywhere and without any."""
    rng, system = np.random.default_rng(seed), dynamics.system
    holds = rng.integers(6, 25, (TRIALS, STEPS, 1))
    at = np.minimum(np.argmax(np.cumsum(holds, axis=1) > np.arange(STEPS)[:, None, None].T, axis=1), STEPS - 1)
    raw = rng.choice([-1.0, 0.0, 1.0], (TRIALS, STEPS, system.nu))
    commands = np.take_along_axis(raw, np.broadcast_to(at.reshape(TRIALS, STEPS, 1), raw.shape), axis=1)
    controls = system.actuate(0.0 * commands if let_go else commands)
    begin = system.neutral_state + rng.uniform(-2.5, 2.5, (TRIALS, system.nx)) * let_go
    history = np.repeat(begin[:, None], dynamics.n_lags + 1, axis=1)
    carry = dynamics.start(history, np.tile(system.neutral_control, (TRIALS, dynamics.n_lags, 1)))
    states = [begin]
    for k in range(STEPS):
        carry = dynamics.step(carry, controls[:, k])
        states.append(carry[:, : system.nx])
    runs = np.stack(states, axis=1)
    return [Trajectory(runs[i], controls[i], system.dt, name=str(i)) for i in range(TRIALS)]
