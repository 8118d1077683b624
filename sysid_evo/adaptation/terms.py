"""What a correction is linear in: state and control as a recording covers them, and their products."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.data.support import regressors
from sysid_evo.system import System

FAR = 1.0
"""Time in s within which a coefficient of 1 moves a state by its standard deviation."""


@dataclass(frozen=True)
class Terms:
    """The regressors 1, z and perhaps z_i z_k (i <= k) of an acceleration that is added to a model's.

    z are state and control (sine and cosine of a periodic state), kept within ``low`` and ``high`` (n,), less their
    ``centre`` and divided by their ``scale``; products are kept within ``least`` and ``most`` (n (n + 1) / 2,), which
    are empty without products. So a correction is nowhere larger than what the recording covers. ``unit`` (nx,) is the
    acceleration that a coefficient of 1 stands for.
    """

    system: System
    low: Array
    high: Array
    centre: Array
    scale: Array
    unit: Array
    least: Array
    most: Array

    @classmethod
    def of(cls, dataset: Dataset, *, products: bool = False) -> Self:
        """Measure ``dataset`` where it moves (everywhere, if it never does)."""
        system = dataset.system
        masks = [rows[:-1] for rows in dataset.moving]
        if not any(rows.any() for rows in masks):
            masks = [np.ones_like(rows) for rows in masks]
        pairs = list(zip(dataset.episodes, masks, strict=True))
        states = np.concatenate([episode.states[:-1][rows] for episode, rows in pairs])
        controls = np.concatenate([episode.controls[rows] for episode, rows in pairs])
        return cls.of_pairs(system, states, controls, products=products)

    @classmethod
    def of_pairs(cls, system: System, states: Array, controls: Array, *, products: bool = False) -> Self:
        """Measure states (N, nx) and controls (N, nu)."""
        seen = regressors(system, states, controls)
        low, high, centre, spread = seen.min(axis=0), seen.max(axis=0), seen.mean(axis=0), seen.std(axis=0)
        scale = np.where(spread > 1e-9 * np.abs(seen).max(axis=0), spread, 1.0)
        least = most = np.empty(0)
        if products:
            found = _products((seen - centre) / scale)
            least, most = found.min(axis=0), found.max(axis=0)
        return cls(system, low, high, centre, scale, state_scale(system, states) / FAR, least, most)

    @property
    def products(self) -> bool:
        """Whether there are products."""
        return len(self.least) > 0

    @property
    def n_inputs(self) -> int:
        """Number of z."""
        return len(self.centre)

    @property
    def size(self) -> int:
        """Number of regressors."""
        return 1 + self.n_inputs + len(self.least)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the coefficients, (size, nx)."""
        return self.size, self.system.nx

    @property
    def names(self) -> list[str]:
        """The names of z and of their products."""
        inputs = [*self.system.regressor_names, *self.system.control_names]
        pairs = [f"{one} {other}" for i, one in enumerate(inputs) for other in inputs[i:]] if self.products else []
        return inputs + pairs

    def __call__(self, state: Array, control: Array) -> Array:
        """Return the regressors (..., size) of states (..., nx) and controls (..., nu)."""
        seen = np.concatenate([self.system.regressors(state), control], axis=-1)
        z = (np.clip(seen, self.low, self.high) - self.centre) / self.scale
        parts = [np.ones((*z.shape[:-1], 1)), z]
        if self.products:
            parts.append(np.clip(_products(z), self.least, self.most))
        return np.concatenate(parts, axis=-1)

    def shift(self, state: Array, control: Array, coefficients: Array) -> Array:
        """Return what is added to the next state (..., nx), with ``coefficients`` (..., size, nx).

        The acceleration c moves it by integrate(x, c) - integrate(x, 0), whatever a model itself predicts, as the
        integration of a given state is affine in the acceleration.
        """
        added = np.matmul(self(state, control)[..., None, :], coefficients)[..., 0, :] * self.unit
        return self.system.integrate(state, added) - self.system.integrate(state, np.zeros_like(added))

    def corrected(self, state: Array, control: Array, after: Array, coefficients: Array) -> Array:
        """Return the next state ``after`` (..., nx) of a model with the correction, within the limits of its channels.

        A body that the model leaves exactly at rest stays there.
        """
        system = self.system
        resting = (after == system.neutral_state).all(axis=-1, keepdims=True)
        moved = np.where(resting, after, after + self.shift(state, control, coefficients))
        return np.clip(moved, *system.limits) if system.limited else moved


def _products(z: Array) -> Array:
    """Return z_i z_k (i <= k) side by side, (..., n (n + 1) / 2)."""
    return np.concatenate([z[..., i : i + 1] * z[..., i:] for i in range(z.shape[-1])], axis=-1)


def state_scale(system: System, states: Array) -> Array:
    """Return the spread (nx,) of ``states`` (N, nx), 1 for a state that never changes."""
    spread = system.spread(states)
    return np.where(spread > 1e-9 * np.abs(states).max(axis=0), spread, 1.0)
