"""Two bodies of the same dynamics, side by side."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics, PlainDynamics
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.system import Channel, System

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import DynamicsKernel

RIVAL = "rival_"


def two_bodies(system: System) -> System:
    """Return the system of two bodies; the motion is that of the first, and what is the second's is called rival."""
    states, controls = (
        (*channels, *(replace(channel, name=f"{RIVAL}{channel.name}") for channel in channels))
        for channels in (system.states, system.controls)
    )
    return System(states, controls, system.dt, system.motion, f"two of {system.name}")


def one_body(system: System) -> System:
    """Return the system of one of `two_bodies`. Raises `IncompatibleTask` for another system."""
    states, controls = _own(system.states), _own(system.controls)
    if not states or not controls:
        raise IncompatibleTask(f"a race needs the system of two bodies, see TwoBodies; got {system.name or 'another'}")
    return System(states, controls, system.dt, system.motion, system.name.removeprefix("two of "))


def _own(channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
    half = len(channels) // 2
    second = tuple(f"{RIVAL}{channel.name}" for channel in channels[:half])
    return channels[:half] if tuple(channel.name for channel in channels[half:]) == second else ()


class TwoBodies(PlainDynamics):
    """Two bodies of the dynamics ``inner``, each with noise and draws of its own.

    The carry is the state of the first, that of the second, then what else the first and the second remember.
    """

    def __init__(self, inner: Dynamics) -> None:
        if inner.observed_at != 0:
            raise InvalidArgument("two bodies: expected a dynamics whose state is observed at once, got an estimate")
        self.inner = inner
        self.system = two_bodies(inner.system)
        self.n_carry, self.n_lags = 2 * inner.n_carry, inner.n_lags
        self.n_noise, self.n_draws = 2 * inner.n_noise, 2 * inner.n_draws

    @property
    def envelope(self) -> Array | None:
        return None if self.inner.envelope is None else np.tile(self.inner.envelope, 2)

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        drawn = (None, None) if draws is None else np.split(draws, 2, axis=1)
        histories = zip(np.split(states, 2, axis=2), np.split(controls, 2, axis=2), drawn, strict=True)
        return self._joined(*(self.inner.start(*history) for history in histories))

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        nx, rest = self.inner.system.nx, self.inner.n_carry - self.inner.system.nx
        bodies = [
            np.concatenate([carry[:, i * nx : (i + 1) * nx], carry[:, 2 * nx + i * rest : 2 * nx + (i + 1) * rest]], 1)
            for i in (0, 1)
        ]
        drawn = (None, None) if noise is None else np.split(noise, 2, axis=1)
        pairs = zip(bodies, np.split(control, 2, axis=1), drawn, strict=True)
        return self._joined(*(self.inner.step(*pair) for pair in pairs))

    def kernel(self) -> DynamicsKernel | None:
        inner = self.inner.kernel()
        if inner is None:
            return None
        from sysid_evo.engine.kernels.race import bodies_kernel

        return bodies_kernel(inner, self.inner.system.nx, self.inner.system.nu, self.inner.n_carry, self.inner.n_noise)

    def _joined(self, first: Array, second: Array) -> Array:
        nx = self.inner.system.nx
        return np.concatenate([first[:, :nx], second[:, :nx], first[:, nx:], second[:, nx:]], axis=1)
