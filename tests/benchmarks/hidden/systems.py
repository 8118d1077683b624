"""Systems of which one output is measured, recorded with noise; their equations are in no family.

Each is simulated from rest under controls by a compiled function of its parameters ``p``, so that the true structure
can be fitted too.
Families were tuned while looking at all but the tanks and the heater; these two are a check. The last three came later,
with half the noise: of them more orders and wider networks were learned. From the stirred tank on nothing was changed
after they were simulated: they are what a user brings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numba import njit

from sysid_evo.data import Dataset
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

TEST_STEPS = 1000


@dataclass(frozen=True)
class HiddenSystem:
    """A system with ``simulate(parameters, controls (T,)) -> outputs (T + 1,)``, its true ``parameters``, and noise.

    The recording has ``steps``; ``excite(rng, steps)`` drives it; ``noise`` is a share of the output's deviation.
    """

    name: str
    simulate: Callable[[Array, Array], Array]
    parameters: Array
    excite: Callable[[np.random.Generator, int], Array]
    steps: int
    dt: float
    noise: float = 0.02

    def recordings(self, seed: int) -> tuple[Dataset, Dataset]:
        """Return a recording to learn from and one to test on, each from rest."""
        rng = np.random.default_rng([seed, self.steps])
        system = System((Channel("output"),), (Channel("input", low=-1.0, high=1.0),), dt=self.dt, name=self.name)
        parts = []
        for name, steps in (("training", self.steps), ("test", TEST_STEPS)):
            controls = self.excite(rng, steps)
            clean = self.simulate(self.parameters, controls)
            measured = clean + self.noise * clean.std() * rng.standard_normal(len(clean))
            parts.append(Dataset.from_arrays(system, [measured[:, None]], [controls[:, None]], names=[name]))
        return parts[0], parts[1]


def smooth_noise(rng: np.random.Generator, steps: int, pole: float, size: float) -> Array:
    """Return noise through a low pass of first order with ``pole``, of deviation ``size``, within -1 and 1."""
    values, last = np.empty(steps), 0.0
    for k, drawn in enumerate(rng.standard_normal(steps)):
        last = pole * last + np.sqrt(1.0 - pole**2) * drawn
        values[k] = last
    return np.clip(size * values, -1.0, 1.0)


def steps_and_noise(rng: np.random.Generator, steps: int, longest: int) -> Array:
    """Return levels between -1 and 1 that are held for up to ``longest`` samples, with a little noise on top."""
    levels: list[Array] = []
    while sum(map(len, levels)) < steps:
        levels.append(np.full(rng.integers(3, longest + 1), rng.uniform(-1.0, 1.0)))
    return np.clip(np.concatenate(levels)[:steps] + 0.05 * rng.standard_normal(steps), -1.0, 1.0)


def held_steps(rng: np.random.Generator, steps: int, shortest: int, longest: int) -> Array:
    """Return levels between -1 and 1 that are held for ``shortest`` to ``longest`` samples."""
    levels: list[Array] = []
    while sum(map(len, levels)) < steps:
        levels.append(np.full(rng.integers(shortest, longest + 1), rng.uniform(-1.0, 1.0)))
    return np.concatenate(levels)[:steps]


def multisine(rng: np.random.Generator, steps: int, highest: float) -> Array:
    """Return sines of equal size and random phase, of all frequencies to ``highest`` per sample, within -1 and 1."""
    turns = np.outer(np.arange(steps), np.arange(1, int(highest * steps))) / steps
    total = np.cos(2.0 * np.pi * (turns + rng.uniform(0.0, 1.0, turns.shape[1]))).sum(axis=1)
    return np.asarray(total / np.abs(total).max())


SYSTEMS: dict[str, HiddenSystem] = {}


def hidden_system(
    systems: dict[str, HiddenSystem],
    parameters: list[float],
    excite: Callable[[np.random.Generator, int], Array],
    *,
    steps: int,
    dt: float,
    noise: float = 0.02,
) -> Callable[[Callable[[Array, Array], Array]], Callable[[Array, Array], Array]]:
    """Compile a simulation and enter it in ``systems`` under its name."""

    def enter(simulate: Callable[[Array, Array], Array]) -> Callable[[Array, Array], Array]:
        name = simulate.__name__
        systems[name] = HiddenSystem(name, njit(simulate), np.array(parameters), excite, steps, dt, noise)
        return systems[name].simulate

    return enter


@hidden_system(
    SYSTEMS, [0.7, 0.35, 0.75, 2.0, 0.3, 0.2, 0.5, 0.88], partial(smooth_noise, pole=0.7, size=0.5), steps=3000, dt=0.05
)
def wiener_hammerstein(p, u):
    """Two low passes in a row, a curve that saturates on one side, an oscillator.

    p: pole, frequency and damping of the first filter, gain, level, softness, then those of the oscillator.
    """
    y = np.zeros(len(u) + 1)
    a = b = s = c = d = 0.0
    cos1 = 2.0 * p[2] * np.cos(p[1])
    cos2 = 2.0 * p[7] * np.cos(p[6])
    for k in range(len(u)):
        a_next = p[0] * a + (1.0 - p[0]) * u[k]
        b_next = cos1 * b - p[2] ** 2 * s + (1.0 - cos1 + p[2] ** 2) * a
        v = p[3] * b
        z = v - p[4]
        w = v - 0.5 * (z + np.sqrt(z * z + p[5] ** 2))
        c_next = cos2 * c - p[7] ** 2 * d + (1.0 - cos2 + p[7] ** 2) * w
        a, s, b, d, c = a_next, b, b_next, c, c_next
        y[k + 1] = c
    return y


@hidden_system(
    SYSTEMS,
    [0.02, 0.03, 0.03, 0.02, 4.0, 0.04, 0.08, 1.0, 0.05],
    partial(steps_and_noise, longest=25),
    steps=2500,
    dt=0.02,
)
def two_masses(p, u):
    """A motor, a shaft with backlash, and a load; the speed of the motor is measured.

    p: inertias, frictions, stiffness, damping of the shaft, half the gap, torque per control, dry friction of the load.
    """
    y = np.zeros(len(u) + 1)
    v1 = v2 = twist = 0.0
    dt = 0.02 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            beyond = max(twist - p[6], 0.0) + min(twist + p[6], 0.0)
            shaft = 0.0
            if beyond != 0.0:
                shaft = p[4] * beyond + p[5] * (v1 - v2)
            v1 += dt * (p[7] * u[k] - p[2] * v1 - shaft) / p[0]
            v2 += dt * (shaft - p[3] * v2 - p[8] * np.tanh(v2 / 0.05)) / p[1]
            twist += dt * (v1 - v2)
        y[k + 1] = v1
    return y


@hidden_system(
    SYSTEMS, [0.15, 1.5, 8.0, 0.6, 3.0, 1.5, 1.0, 1.0], partial(steps_and_noise, longest=30), steps=1000, dt=0.05
)
def hydraulic(p, u):
    """A valve with a dead band, oil that is compressed, a piston against a spring; its position is measured.

    p: dead band, flow, stiffness of the oil, leak, area per mass, friction, spring, supply pressure.
    """
    y = np.zeros(len(u) + 1)
    x = v = q = 0.0
    dt = 0.05 / 20.0
    for k in range(len(u)):
        opened = max(u[k] - p[0], 0.0) + min(u[k] + p[0], 0.0)
        for _ in range(20):
            drop = max(p[7] - (q if opened > 0.0 else -q), 0.0)
            q += dt * p[2] * (p[1] * opened * np.sqrt(drop) - v - p[3] * q)
            v += dt * (p[4] * q - p[5] * v - p[6] * x)
            x += dt * v
        y[k + 1] = x
    return y


@hidden_system(SYSTEMS, [60.0, 3.0, 120.0, 40.0], partial(smooth_noise, pole=0.5, size=0.5), steps=2000, dt=0.05)
def cubic_spring(p, u):
    """A mass on a spring that hardens with the cube (as in the Silverbox); its position is measured.

    p: stiffness, damping, stiffness of the cube, push per control.
    """
    y = np.zeros(len(u) + 1)
    x = v = 0.0
    dt = 0.05 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            v += dt * (p[3] * u[k] - p[1] * v - p[0] * x - p[2] * x * x * x)
            x += dt * v
        y[k + 1] = x
    return y


@hidden_system(
    SYSTEMS, [2.0, 10.0, 8.0, 40.0, 12.0, 8.0, 12.0], partial(smooth_noise, pole=0.8, size=0.5), steps=2500, dt=0.05
)
def hysteresis(p, u):
    """A mass on a spring with a hysteretic force (Bouc and Wen); its position is measured.

    p: damping, stiffness, force's share, push, then how the force grows with speed, and the two ways it yields.
    """
    y = np.zeros(len(u) + 1)
    x = v = z = 0.0
    dt = 0.05 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            z += dt * (p[4] * v - p[5] * abs(v) * z - p[6] * v * abs(z))
            v += dt * (p[3] * u[k] - p[0] * v - p[1] * x - p[2] * z)
            x += dt * v
        y[k + 1] = x
    return y


@hidden_system(SYSTEMS, [0.8, 0.35, 0.85, 0.45], partial(smooth_noise, pole=0.8, size=0.5), steps=2000, dt=0.05)
def saturated_sensor(p, u):
    """A low pass and an oscillator behind it, seen by a sensor that is at its end on one side.

    p: pole of the low pass, frequency and damping of the oscillator, the end of the sensor.
    """
    y = np.zeros(len(u) + 1)
    a = b = c = 0.0
    cosine = 2.0 * p[2] * np.cos(p[1])
    for k in range(len(u)):
        a_next = p[0] * a + (1.0 - p[0]) * u[k]
        b, c = cosine * b - p[2] ** 2 * c + (1.0 - cosine + p[2] ** 2) * a, b
        a = a_next
        y[k + 1] = min(b, p[3])
    return y


@hidden_system(SYSTEMS, [1.4, 0.6, 0.5, 1.0, 0.3], partial(steps_and_noise, longest=20), steps=1000, dt=0.5)
def tanks(p, u):
    """Two tanks one above the other, the upper one flows over; the lower level is measured.

    p: inflow per control, outlet of the upper and of the lower tank, height of the upper, share of what flows over
    that the lower one gets.
    """
    y = np.zeros(len(u) + 1)
    upper = lower = 0.0
    dt = 0.5 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            inflow = p[0] * max(0.5 * (u[k] + 1.0), 0.0) * 0.7
            down = p[1] * np.sqrt(max(upper, 0.0))
            upper = max(upper + dt * (inflow - down), 0.0)
            over = max(upper - p[3], 0.0)
            upper -= over
            lower = max(lower + dt * (down - p[2] * np.sqrt(max(lower, 0.0))) + p[4] * over, 0.0)
        y[k + 1] = lower
    return y


@hidden_system(SYSTEMS, [0.15, 2.5, 6.0, 1.5, 0.5], partial(steps_and_noise, longest=20), steps=1500, dt=0.05)
def rate_limit(p, u):
    """An actuator with a lag and a limited rate drives a wheel against drag; the wheel's speed is measured.

    p: lag, limit of the rate, push, friction, drag.
    """
    y = np.zeros(len(u) + 1)
    a = v = 0.0
    dt = 0.05 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            a += dt * min(max((u[k] - a) / p[0], -p[1]), p[1])
            v += dt * (p[2] * a - p[3] * v - p[4] * v * abs(v))
        y[k + 1] = v
    return y


@hidden_system(SYSTEMS, [3.0, 1.2, 0.12, 0.08, 0.3], partial(steps_and_noise, longest=30), steps=1500, dt=0.2)
def heater(p, u):
    """A heating element in a wall, loss by radiation and to the room; the element's temperature is measured.

    p: power, exchange with the wall, the wall's warming by it, the wall's loss to the room, radiation.
    """
    y = np.zeros(len(u) + 1)
    element = wall = 0.0
    dt = 0.2 / 20.0
    for k in range(len(u)):
        power = p[0] * max(u[k], 0.0) ** 2
        for _ in range(20):
            radiated = p[4] * ((1.0 + element) ** 4 - 1.0) * 0.25
            element += dt * (power - p[1] * (element - wall) - radiated)
            wall += dt * (p[2] * (element - wall) - p[3] * wall)
        y[k + 1] = element
    return y


@hidden_system(
    SYSTEMS,
    [0.4, 0.8, 4.5, 0.8, 0.6, 0.9, 0.85, 0.2, 1.5],
    partial(multisine, highest=0.2),
    steps=4000,
    dt=0.001,
    noise=0.01,
)
def parallel_branches(p, u):
    """Two branches side by side: an oscillator, a curve and a low pass; a low pass, a dead band and an oscillator.

    p: frequency and damping of the first oscillator, slope of the curve, the two poles, frequency and damping of the
    second oscillator, dead band, gain of the second branch.
    """
    y = np.zeros(len(u) + 1)
    a = b = c = d = e = f = 0.0
    cos1 = 2.0 * p[1] * np.cos(p[0])
    cos2 = 2.0 * p[6] * np.cos(p[5])
    for k in range(len(u)):
        a, b = cos1 * a - p[1] ** 2 * b + (1.0 - cos1 + p[1] ** 2) * u[k], a
        c = p[3] * c + (1.0 - p[3]) * np.tanh(p[2] * a)
        d = p[4] * d + (1.0 - p[4]) * u[k]
        beyond = max(d - p[7], 0.0) + min(d + p[7], 0.0)
        e, f = cos2 * e - p[6] ** 2 * f + (1.0 - cos2 + p[6] ** 2) * p[8] * beyond, e
        y[k + 1] = c + e
    return y


@hidden_system(
    SYSTEMS,
    [2.0, 0.04, 0.03, 60.0, 4.0, 150.0, 100.0, 5.0, 30.0],
    partial(held_steps, shortest=10, longest=50),
    steps=2500,
    dt=0.02,
    noise=0.01,
)
def stage(p, u):
    """A stage with dry friction, driven by a limited position controller; the position is measured, in mm.

    p: stiffness and damping of the controller, lag of the current, push, friction, dry friction, how much more of it
    there is at rest, the speed at which that is over, limit of the current.
    """
    y = np.zeros(len(u) + 1)
    x = v = i = 0.0
    dt = 0.02 / 40.0
    for k in range(len(u)):
        aim = 50.0 * (u[k] + 1.0)
        for _ in range(40):
            asked = min(max(p[0] * (aim - x) - p[1] * v, -p[8]), p[8])
            i += dt * (asked - i) / p[2]
            dry = (p[5] + p[6] * np.exp(-((v / p[7]) ** 2))) * np.tanh(v / 0.5)
            v += dt * (p[3] * i - p[4] * v - dry)
            x += dt * v
        y[k + 1] = x
    return y


@hidden_system(
    SYSTEMS,
    [1.2, 4.0, 0.02, 0.8, 0.1, 0.3],
    partial(held_steps, shortest=5, longest=30),
    steps=2000,
    dt=0.02,
    noise=0.01,
)
def pneumatic(p, u):
    """A valve with a dead band between 6 bar and the air, a vessel, a tube and a second vessel; its pressure in Pa.

    p: flow of the valve, of the tube, where that becomes laminar, ratio of the volumes, dead band, leak.
    """
    y = np.empty(len(u) + 1)
    first = second = 2e5
    dt = 0.02 / 20.0
    y[0] = second
    for k in range(len(u)):
        opened = max(u[k] - p[4], 0.0) + min(u[k] + p[4], 0.0)
        for _ in range(20):
            high, low = (6e5, first) if opened > 0.0 else (first, 1e5)
            choked = high if low < 0.5 * high else 2.0 * np.sqrt(max(low * (high - low), 0.0))
            drop = first - second
            through = p[1] * drop / np.sqrt(abs(drop) / 1e5 + p[2])
            first = max(first + dt * (p[0] * opened * choked - through), 1e5)
            second += dt * (p[3] * through - p[5] * (second - 1e5))
        y[k + 1] = second
    return y


@hidden_system(SYSTEMS, [0.1, 7.0, 20.0, 1.5, 1.5], partial(held_steps, shortest=5, longest=30), steps=2000, dt=0.2)
def stirred_tank(p, u):
    """A reaction that gives off heat in a cooled, stirred tank (dimensionless); the temperature is measured.

    p: rate (Damkoehler number), heat of reaction, activation energy, cooling, how far the coolant goes with u.
    """
    y = np.zeros(len(u) + 1)
    turned, warm = 0.15, 0.6
    y[0] = warm
    dt = 0.2 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            rate = p[0] * (1.0 - turned) * np.exp(warm / (1.0 + warm / p[2]))
            turned += dt * (rate - turned)
            warm += dt * (p[1] * rate - warm - p[3] * (warm - p[4] * u[k]))
        y[k + 1] = warm
    return y


@hidden_system(
    SYSTEMS, [0.02, 0.05, 1.5, 0.05, 0.02, 0.5, 0.3], partial(held_steps, shortest=5, longest=30), steps=2000, dt=0.05
)
def flexible_arm(p, u):
    """A motor that lifts a heavy arm through an elastic joint; the angle of the motor is measured.

    p: inertias of motor and arm, stiffness, friction of motor and arm, weight of the arm, torque per control.
    """
    y = np.zeros(len(u) + 1)
    a = v = b = w = 0.0
    dt = 0.05 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            joint = p[2] * (a - b)
            v += dt * (p[6] * u[k] - p[3] * v - joint) / p[0]
            w += dt * (joint - p[4] * w - p[5] * np.sin(b)) / p[1]
            a += dt * v
            b += dt * w
        y[k + 1] = a
    return y


@hidden_system(
    SYSTEMS, [600.0, 0.15, 60.0, 3.0, 9.0, 0.06], partial(smooth_noise, pole=0.7, size=0.6), steps=2500, dt=0.02
)
def quarter_car(p, u):
    """A wheel that follows a road and can leave it, a body on a spring and a damper of two slopes; the body's height.

    p: stiffness and mass ratio of the tyre, stiffness of the spring, slopes of the damper (in, out), height of road.
    """
    y = np.zeros(len(u) + 1)
    body = v = wheel = w = 0.0
    dt = 0.02 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            gap, speed = wheel - body, w - v
            strut = p[2] * gap + (p[3] if speed > 0.0 else p[4]) * speed
            tyre = max(p[0] * (p[5] * u[k] - wheel) + (1.0 + p[1]) * 9.81, 0.0) - (1.0 + p[1]) * 9.81
            v += dt * strut
            w += dt * (tyre - strut) / p[1]
            body += dt * v
            wheel += dt * w
        y[k + 1] = body
    return y


@hidden_system(SYSTEMS, [0.5, 0.4, 0.4, 0.3, 0.02], partial(held_steps, shortest=10, longest=40), steps=2000, dt=0.5)
def three_tanks(p, u):
    """Three tanks in a row, joined below, with water running both ways; the level of the last one is measured.

    p: inflow, pipes between the first two and the last two, outlet, and the level at which a pipe is laminar.
    """
    y = np.zeros(len(u) + 1)
    a = b = c = 0.0
    dt = 0.5 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            first = p[1] * (a - b) / np.sqrt(abs(a - b) + p[4])
            second = p[2] * (b - c) / np.sqrt(abs(b - c) + p[4])
            a = max(a + dt * (0.5 * p[0] * (u[k] + 1.0) - first), 0.0)
            b = max(b + dt * (first - second), 0.0)
            c = max(c + dt * (second - p[3] * np.sqrt(c)), 0.0)
        y[k + 1] = c
    return y


@hidden_system(
    SYSTEMS, [0.2, 30.0, 3.0, 8.0, 14.0, 0.12], partial(smooth_noise, pole=0.8, size=0.6), steps=2000, dt=0.05
)
def dead_sensor(p, u):
    """An oscillator with a spring that softens, behind a lag, seen by a sensor that does not notice small movements.

    p: lag, stiffness, damping, by how much the spring softens, push, half the width of what is not noticed.
    """
    y = np.zeros(len(u) + 1)
    a = x = v = 0.0
    dt = 0.05 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            a += dt * (u[k] - a) / p[0]
            v += dt * (p[4] * a - p[2] * v - p[1] * x / np.sqrt(1.0 + p[3] * x * x))
            x += dt * v
        y[k + 1] = max(x - p[5], 0.0) + min(x + p[5], 0.0)
    return y


@hidden_system(
    SYSTEMS, [60.0, 60.0, 400.0, 1.0, 3000.0, 30.0], partial(held_steps, shortest=4, longest=25), steps=2500, dt=0.005
)
def magnet(p, u):
    """A coil that pulls an armature against a spring, the nearer the stronger; the position is measured.

    p: resistance by inductance, voltage by inductance, force, gap at rest, stiffness, damping.
    """
    y = np.zeros(len(u) + 1)
    x = v = i = 0.0
    dt = 0.005 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            i += dt * (0.5 * p[1] * (u[k] + 1.0) - p[0] * i)
            v += dt * (p[2] * i * i / (p[3] - x) ** 2 - p[5] * v - p[4] * x)
            x = min(x + dt * v, 0.9 * p[3])
        y[k + 1] = x
    return y


@hidden_system(
    SYSTEMS, [0.5, 0.8, 6.0, 0.5, 10.0, 0.2, 0.12], partial(held_steps, shortest=8, longest=40), steps=1500, dt=0.25
)
def bioreactor(p, u):
    """Cells that eat a substrate, of which too much harms them, and are diluted; the mass of cells is measured.

    p: highest growth, half saturation, harm, yield, what is fed, mean dilution and by how much the control changes it.
    """
    y = np.zeros(len(u) + 1)
    cells, food = 4.0, 2.0
    y[0] = cells
    dt = 0.25 / 20.0
    for k in range(len(u)):
        dilution = p[5] + p[6] * u[k]
        for _ in range(20):
            growth = p[0] * food / (p[1] + food + food * food / p[2]) * cells
            cells += dt * (growth - dilution * cells)
            food = max(food + dt * (dilution * (p[4] - food) - growth / p[3]), 0.0)
        y[k + 1] = cells
    return y
