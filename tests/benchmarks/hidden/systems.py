"""Three systems of which one output is measured: equations outside every family, recorded with noise.

Each is simulated from rest by a compiled function of its parameters, so that the true structure can be fitted too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.system import Channel, System

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


@njit
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


@njit
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


@njit
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


SYSTEMS = {
    system.name: system
    for system in (
        HiddenSystem(
            "wiener_hammerstein",
            wiener_hammerstein,
            np.array([0.7, 0.35, 0.75, 2.0, 0.3, 0.2, 0.5, 0.88]),
            lambda rng, steps: smooth_noise(rng, steps, 0.7, 0.5),
            3000,
            0.05,
        ),
        HiddenSystem(
            "two_masses",
            two_masses,
            np.array([0.02, 0.03, 0.03, 0.02, 4.0, 0.04, 0.08, 1.0, 0.05]),
            lambda rng, steps: steps_and_noise(rng, steps, 25),
            2500,
            0.02,
        ),
        HiddenSystem(
            "hydraulic",
            hydraulic,
            np.array([0.15, 1.5, 8.0, 0.6, 3.0, 1.5, 1.0, 1.0]),
            lambda rng, steps: steps_and_noise(rng, steps, 30),
            1000,
            0.05,
        ),
    )
}
