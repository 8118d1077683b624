"""The contract of everything that steps: models and emulated robots."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array, check_shape

if TYPE_CHECKING:
    from sysid_evo.kernels import DynamicsKernel
    from sysid_evo.system import System


class Dynamics(ABC):
    """Anything that steps by one ``system.dt``.

    The *carry* (B, n_carry) is the state followed by whatever else is remembered; ``carry[:, :nx]``
    is the state. ``n_lags`` samples of history are wanted by `start`; ``n_noise`` standard normal
    numbers are given to every `step` and ``n_draws`` to every `start`, by whoever runs the loop:
    never drawn inside. What controllers and tasks observe of the state stands in the carry from
    ``observed_at`` on: the state itself, unless a wrapper puts an estimate beside it. A dynamics that
    counts how far it is to be doubted does so in the carry at ``doubt_at``; None if it does not.
    """

    observed_at: int = 0
    doubt_at: int | None = None
    if TYPE_CHECKING:  # a family answers them by properties, `PlainDynamics` has plain names

        @property
        def system(self) -> System: ...
        @property
        def n_carry(self) -> int: ...
        @property
        def n_lags(self) -> int: ...
        @property
        def n_noise(self) -> int: ...
        @property
        def n_draws(self) -> int: ...

    else:
        n_lags = n_noise = n_draws = 0

    @property
    def envelope(self) -> Array | None:
        """Lowest and highest value of each state, (2, nx), to which a loop clips; None for no clip."""
        return None

    @abstractmethod
    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        """Return the carry (B, n_carry) after a history.

        ``states`` (B, n_lags + 1, nx) ends at the present, ``controls`` (B, n_lags, nu) at the
        sample before it, ``draws`` is (B, n_draws).
        """

    @abstractmethod
    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        """Return the next carry (B, n_carry) under ``control`` (B, nu), with ``noise`` (B, n_noise).

        Pure: the same arguments give the same result, each row for itself.
        """

    def kernel(self) -> DynamicsKernel | None:
        """Return the compiled form of `step`, if it has one."""
        return None


class PlainDynamics(Dynamics):
    """A dynamics whose system and sizes are plain names, which its class or its constructor sets."""

    system: System
    n_carry: int
    n_lags: int = 0
    n_noise: int = 0
    n_draws: int = 0


def clip_state(carry: Array, envelope: Array | None) -> tuple[Array, np.ndarray]:
    """Clip the state at the head of ``carry`` to ``envelope``; also return which rows were changed (B,).

    A state that is not a number becomes the upper limit, so that a diverged simulation stays visible.
    """
    if envelope is None:
        return carry, np.zeros(len(carry), dtype=bool)
    low, high = envelope
    inside = np.ones(len(carry), dtype=bool)
    for value, least, most in zip(carry.T, low, high, strict=False):
        inside &= (value >= least) & (value <= most)
    if inside.all():
        return carry, ~inside
    clipped = carry.copy()
    for value, least, most in zip(clipped.T, low, high, strict=False):
        np.maximum(np.fmin(value, most), least, out=value)
    return clipped, ~inside


def of_each_row(dynamics: Dynamics, method: str, carry: Array, values: Array) -> Array:
    """Return what ``method`` gave for ``carry`` (B, n_carry) as an array (B, nx), or raise `ShapeError`."""
    checked = check_shape(f"{type(dynamics).__name__}.{method}", values, (*carry.shape[:-1], dynamics.system.nx))
    return values if isinstance(values, np.ndarray) else checked


def training_envelope(states: Array, multiple: float) -> Array:
    """Return the centre of ``states`` (N, nx) plus and minus ``multiple`` half ranges, (2, nx)."""
    low, high = states.min(axis=0), states.max(axis=0)
    centre, half = (low + high) / 2.0, np.maximum((high - low) / 2.0, np.finfo(float).tiny)
    return np.stack([centre - multiple * half, centre + multiple * half])
