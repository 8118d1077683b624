"""The carry: positions of states, lags and controls, and clipping."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from sysid_evo.types import Array

T = TypeVar("T")


@dataclass(frozen=True)
class CarryLayout:
    """The state (nx), ``state_lags`` earlier states, ``control_lags`` earlier controls (nu), newest first.

    Its methods only return parts; the caller concatenates them along the last axis, with its own library.
    """

    nx: int
    nu: int
    state_lags: int = 0
    control_lags: int = 0

    @property
    def size(self) -> int:
        """Length of the carry."""
        return self.nx * (1 + self.state_lags) + self.nu * self.control_lags

    @property
    def n_lags(self) -> int:
        """Number of samples before the present one that are needed to start."""
        return max(self.state_lags, self.control_lags)

    @property
    def earlier_controls(self) -> slice:
        """The indices of the earlier controls."""
        return slice(self.nx * (1 + self.state_lags), self.size)

    def initial_parts(self, states: Any, controls: Any) -> list[Any]:
        """Return the parts of a carry after a history of states (..., L + 1, nx) and controls (..., L, nu)."""
        parts = [states[..., -1 - lag, :] for lag in range(self.state_lags + 1)]
        return parts + [controls[..., -1 - lag, :] for lag in range(self.control_lags)]

    def shifted_parts(self, carry: Any, control: Any, after: Any) -> list[Any]:
        """Return the parts of the next carry (..., size), with states and controls shifted by one place."""
        parts = [after, carry[..., : self.nx * self.state_lags]] if self.state_lags else [after]
        if self.control_lags:
            first = self.earlier_controls.start
            parts += [control, carry[..., first : first + self.nu * (self.control_lags - 1)]]
        return parts

    def each_input(self, of_states: Iterable[T], of_controls: Iterable[T]) -> list[T]:
        """Return one value for every number of (carry, control), from one for every state and control."""
        return [*of_states] * (1 + self.state_lags) + [*of_controls] * (self.control_lags + 1)

    def input_names(self, states: Sequence[str], controls: Sequence[str]) -> list[str]:
        """Return the names of (carry, control); ``speed[-1]`` is the speed one sample ago."""
        earlier = [f"{name}[-{lag}]" for lag in range(1, self.state_lags + 1) for name in states]
        held = [f"{name}[-{lag}]" for lag in range(1, self.control_lags + 1) for name in controls]
        return [*states, *earlier, *held, *controls]


def pad_history(states: Array, controls: Array, lags: int, neutral: Array) -> tuple[Array, Array]:
    """Return a history of at least ``lags`` samples, padded with the first state and neutral controls.

    ``states`` are (..., L + 1, nx), ``controls`` (..., L, nu), ``neutral`` (nu,).
    """
    missing = max(0, lags - controls.shape[-2])
    states = np.concatenate([np.repeat(states[..., :1, :], missing, axis=-2), states], axis=-2)
    idle = np.broadcast_to(neutral, (*controls.shape[:-2], missing, len(neutral)))
    return states, np.concatenate([idle, controls], axis=-2)


def recent(states: Array, controls: Array, lags: int) -> tuple[Array, Array]:
    """Return the end of a history (B, L + 1, nx), (B, L, nu): its last ``lags`` samples, and the present state."""
    return states[:, states.shape[1] - 1 - lags :], controls[:, controls.shape[1] - lags :]


def latest(states: Array, controls: Array, lags: int, neutral: Array) -> tuple[Array, Array]:
    """Return the end of a history like `recent`; a shorter one is padded, see `pad_history`."""
    return recent(*pad_history(states, controls, lags, neutral), lags)


def clip_state(carry: Array, state_bounds: Array | None) -> tuple[Array, np.ndarray]:
    """Return ``carry`` with its state clipped to ``state_bounds``, and a mask (B,) of the changed rows.

    nan becomes the upper bound, so that a diverged simulation remains visible.
    """
    if state_bounds is None:
        return carry, np.zeros(len(carry), dtype=bool)
    low, high = state_bounds
    inside = np.ones(len(carry), dtype=bool)
    for value, least, most in zip(carry.T, low, high, strict=False):
        inside &= (value >= least) & (value <= most)
    if inside.all():
        return carry, ~inside
    clipped = carry.copy()
    for value, least, most in zip(clipped.T, low, high, strict=False):
        np.maximum(np.fmin(value, most), least, out=value)
    return clipped, ~inside
