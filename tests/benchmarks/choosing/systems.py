"""Two systems that are simulated from equations outside every family, and are known by their logs alone.

Both are recorded in closed loop, as such systems are: a hand or a simple controller keeps them in place and a random
target or push moves them. Everything is measured with noise.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

DT, FINE = 0.05, 10
"""Seconds of a sample, and steps of the simulation in each."""
EPISODES, EPISODE_STEPS = 6, 1200
GRAVITY = 9.81


class Simulated(ABC):
    """A system with ``n_hidden`` unmeasured states; ``noise`` (nx,) is the standard deviation of the sensor noise.

    All episodes are simulated side by side: ``x`` (episodes, nx + hidden), ``u`` (episodes, nu).
    """

    system: ClassVar[System]
    noise: ClassVar[tuple[float, ...]]
    n_hidden: ClassVar[int]
    longest_push: ClassVar[int]

    @abstractmethod
    def rates(self, x: Array, u: Array) -> Array:
        """Return the change of ``x`` per second."""

    @abstractmethod
    def control(self, measured: Array, push: Array) -> Array:
        """Return the controls (episodes, nu) of the controller with a random ``push`` (episodes,) from -1 to 1."""

    @abstractmethod
    def begin(self, rng: np.random.Generator, count: int) -> Array:
        """Return where ``count`` episodes begin."""

    def recording(self, seed: int) -> Dataset:
        """Return six minutes in six episodes."""
        rng, nx = np.random.default_rng(seed), self.system.nx
        x, driven = self.begin(rng, EPISODES), self.system.controls[0]
        states, controls = np.empty((EPISODES, EPISODE_STEPS + 1, nx)), np.empty((EPISODES, EPISODE_STEPS, 1))
        push, held = np.zeros(EPISODES), np.zeros(EPISODES)
        for k in range(EPISODE_STEPS):
            states[:, k] = x[:, :nx] + np.array(self.noise) * rng.standard_normal((EPISODES, nx))
            new = held <= 0
            push = np.where(new, rng.uniform(-1.0, 1.0, EPISODES), push)
            held = np.where(new, rng.integers(2, self.longest_push + 1, EPISODES), held) - 1
            controls[:, k] = np.clip(self.control(states[:, k], push), driven.low, driven.high)
            for _ in range(FINE):
                middle = x + 0.5 * DT / FINE * self.rates(x, controls[:, k])
                x = x + DT / FINE * self.rates(middle, controls[:, k])
        states[:, -1] = x[:, :nx] + np.array(self.noise) * rng.standard_normal((EPISODES, nx))
        names = [f"flight-{number}-{seed}" for number in range(EPISODES)]
        return Dataset.from_arrays(self.system, list(states), list(controls), names=names)


class CartPole(Simulated):
    """A cart with a hanging pole: motor with back-EMF and lag, dry friction of wheels and hinge.

    F motor force, M cart, m pole, l to its middle, J its inertia about that; a = 0 hanging::

        (M + m) x'' + m l (a'' cos a - a'^2 sin a) = F - c x' - dry tanh(x' / 0.03)
        (J + m l^2) a'' + m l (x'' cos a + g sin a) = -d a' - stick tanh(a' / 0.1)
        F' = (k (u - x' / v) - F) / lag
    """

    system = System(
        states=(
            Channel("position", "m"),
            Channel("speed", "m/s"),
            Channel("angle", "rad"),
            Channel("angular_speed", "rad/s"),
        ),
        controls=(Channel("voltage", low=-1.0, high=1.0),),
        dt=DT,
        name="cart and pole",
    )
    noise = (0.003, 0.015, 0.005, 0.03)
    n_hidden = 1
    longest_push = 24

    def rates(self, x: Array, u: Array) -> Array:
        _, speed, angle, turning, force = x.T
        cart, pole, length, inertia = 0.6, 0.2, 0.25, 0.2 * 0.5**2 / 12.0
        sine, cosine = np.sin(angle), np.cos(angle)
        along = force - 0.8 * speed - 0.35 * np.tanh(speed / 0.03) + pole * length * turning**2 * sine
        round_hinge = -0.002 * turning - 0.004 * np.tanh(turning / 0.1) - pole * length * GRAVITY * sine
        a, b, c = cart + pole, pole * length * cosine, inertia + pole * length**2
        determinant = a * c - b * b
        speed_rate, turning_rate = (
            (c * along - b * round_hinge) / determinant,
            (a * round_hinge - b * along) / determinant,
        )
        force_rate = (6.0 * (u[:, 0] - speed / 4.0) - force) / 0.04
        return np.stack([speed, speed_rate, turning, turning_rate, force_rate], axis=1)

    def control(self, measured: Array, push: Array) -> Array:
        return (0.6 * push - 0.5 * measured[:, 0])[:, None]

    def begin(self, rng: np.random.Generator, count: int) -> Array:
        x = np.zeros((count, 5))
        x[:, 2] = rng.uniform(-1.0, 1.0, count)
        return x


class HoverChannel(Simulated):
    """How high a quadrotor hovers: four rotors that follow with a lag, ground effect, drag, a battery that sags.

    w rotor speed and s sag as shares, h height, v climb, thrust T in units of weight::

        w' = ((1 - s) (0.25 + 0.75 u) - w) / lag, the lag 50 ms up and 90 ms down
        T = 2.4 w^2 / (1 - 0.09 / (h + 0.35)^2) (1 - 0.04 v)
        v' = g (T - 1) - 0.25 v - 0.12 v |v|
        s' = (0.12 w^3 - s) / 3
    """

    system = System(
        states=(Channel("height", "m"), Channel("climb", "m/s")),
        controls=(Channel("throttle", low=0.0, high=1.0),),
        dt=DT,
        name="hover channel",
    )
    noise = (0.01, 0.03)
    n_hidden = 2
    longest_push = 60

    def rates(self, x: Array, u: Array) -> Array:
        height, climb, rotor, sag = x.T
        wanted = (1.0 - sag) * (0.25 + 0.75 * u[:, 0])
        rotor_rate = (wanted - rotor) / np.where(wanted > rotor, 0.05, 0.09)
        near = 1.0 / (1.0 - 0.09 / (np.maximum(height, 0.0) + 0.35) ** 2)
        thrust = 2.4 * rotor**2 * near * (1.0 - 0.04 * climb)
        climb_rate = GRAVITY * (thrust - 1.0) - 0.25 * climb - 0.12 * climb * np.abs(climb)
        return np.stack([climb, climb_rate, rotor_rate, (0.12 * rotor**3 - sag) / 3.0], axis=1)

    def control(self, measured: Array, push: Array) -> Array:
        height, climb = measured.T
        return (0.53 + 0.4 * (1.4 + 1.3 * push - height) - 0.22 * climb)[:, None]

    def begin(self, rng: np.random.Generator, count: int) -> Array:
        return np.stack(
            [rng.uniform(0.5, 1.5, count), np.zeros(count), np.full(count, 0.63), np.full(count, 0.03)], axis=1
        )


SIMULATED = {"own_cart_pole": CartPole, "hover_channel": HoverChannel}
