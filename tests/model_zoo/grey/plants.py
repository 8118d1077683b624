"""Systems whose parameters are known, recorded in steps finer than those of the models."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from model_zoo.grey_box import GreyBox, Hidden, Parameter
from sysid_evo.data import Dataset
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

ANGLE, SPIN = Channel("angle", "rad", period=2.0 * np.pi), Channel("spin", "rad/s")
PENDULUM = System((ANGLE, SPIN), (Channel("torque", "N m", -2.0, 2.0),), 0.05)
CYLINDER = System((Channel("position", "m"), Channel("speed", "m/s")), (Channel("spool", "", -1.0, 1.0),), 0.05)
FINE = 10
"""Steps of the plant to a sample."""


class Pendulum(GreyBox):
    """A pendulum under a torque."""

    parameters = (
        Parameter("stiffness", 5.0, 0.5, 50.0, "1/s^2"),
        Parameter("friction", 0.3, 0.0, 5.0, "1/s"),
        Parameter("gain", 1.0, 0.1, 10.0, "rad/s^2 per N m"),
    )

    @staticmethod
    def rate(state, control, p):
        angle, spin = state
        (torque,) = control
        stiffness, friction, gain = p
        return spin, -stiffness * math.sin(angle) - friction * spin + gain * torque


class HeavyPendulum(GreyBox):
    """The same with a mass and a motor of which only the ratio shows."""

    parameters = (
        Parameter("stiffness", 5.0, 0.5, 50.0, "1/s^2"),
        Parameter("friction", 0.3, 0.0, 5.0, "1/s"),
        Parameter("motor", 1.0, 0.1, 10.0, "1"),
        Parameter("inertia", 1.0, 0.1, 10.0, "kg m^2"),
        Parameter("unused", 1.0, 0.0, 2.0, "m"),
    )

    @staticmethod
    def rate(state, control, p):
        angle, spin = state
        (torque,) = control
        stiffness, friction, motor, inertia, _ = p
        return spin, -stiffness * math.sin(angle) - friction * spin + motor / inertia * torque


class Cylinder(GreyBox):
    """A cylinder whose pressure nobody measures."""

    parameters = (
        Parameter("valve", 10.0, 1.0, 300.0, "bar/s"),
        Parameter("leak", 1.0, 0.0, 20.0, "1/s"),
        Parameter("friction", 2.0, 0.0, 50.0, "1/m"),
    )
    hidden = (Hidden("pressure", "bar", 0.0, -60.0, 60.0),)

    @staticmethod
    def rate(state, control, p):
        position, speed, pressure = state
        (spool,) = control
        valve, leak, friction = p
        push = 0.4 * pressure - 4.0 * position - friction * speed * abs(speed)
        return speed, push, valve * spool - leak * pressure - 12.0 * speed


def recorded(
    system: System,
    rate: Callable[[Array, float], list[float]],
    start: Array,
    *,
    noise: tuple[float, ...],
    seed: int = 0,
    steps: int = 300,
    episodes: int = 2,
    lag: float = 0.0,
    delay: int = 0,
    held: int = 6,
) -> Dataset:
    """Return episodes under random steps of one control; what ``noise`` has no entry for is not measured."""
    rng = np.random.default_rng(seed)
    low, high = system.controls[0].low, system.controls[0].high
    states, controls = [], []
    for _ in range(episodes):
        commands = np.repeat(rng.uniform(low, high, -(-steps // held)), held)[:steps]
        x, actual, run = np.array(start, dtype=float), 0.0, [np.array(start, dtype=float)]
        h = system.dt / FINE
        for k in range(steps):
            for _ in range(FINE):
                command = commands[k - delay] if k >= delay else 0.0
                actual = actual + h * (command - actual) / lag if lag else command
                middle = x + 0.5 * h * np.array(rate(x, actual))
                x = x + h * np.array(rate(middle, actual))
            run.append(x)
        measured = np.array(run)[:, : len(noise)]
        states.append(measured + rng.standard_normal(measured.shape) * np.array(noise))
        controls.append(commands[:, None])
    return Dataset.from_arrays(system, states, controls)


def pendulum(**options: object) -> Dataset:
    """Return a pendulum with stiffness 9, friction 0.5 and gain 2."""
    given = {"noise": (0.01, 0.03), **options}
    return recorded(PENDULUM, lambda x, u: [x[1], -9.0 * math.sin(x[0]) - 0.5 * x[1] + 2.0 * u], [1.0, 0.0], **given)


def cylinder(**options: object) -> Dataset:
    """Return a cylinder with valve 40, leak 2.5 and friction 3."""
    given = {"noise": (0.003, 0.01), "steps": 600, **options}
    return recorded(
        CYLINDER,
        lambda x, u: [x[1], 0.4 * x[2] - 4.0 * x[0] - 3.0 * x[1] * abs(x[1]), 40.0 * u - 2.5 * x[2] - 12.0 * x[1]],
        [0.0, 0.0, 0.0],
        **given,
    )
