"""What a correction is linear in: state and control as a recording covers them, products, what the model predicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.data.support import regressors
from sysid_evo.dynamics.stepping import Dynamics
from sysid_evo.system import System

FAR = 1.0
"""Time in s within which a coefficient of 1 moves a state by its standard deviation."""
OF_PRODUCTS = 10.0
"""How much stronger a ridge is for products."""


@dataclass(frozen=True)
class Terms:
    """The regressors 1, z, perhaps z_i z_k (i <= k), and perhaps a, of an acceleration that is added to a model's.

    z are state and control (sine and cosine of a periodic state), kept within ``low`` and ``high`` (n,), less their
    ``centre`` and divided by their ``scale``; products are kept within ``least`` and ``most`` (n (n + 1) / 2,), which
    are empty without products. a is what the model itself predicts, the way per s from coasting to its next state,
    divided by its ``strength`` and kept within ``weakest`` and ``strongest`` (nx,), which are empty without: a battery
    or a tyre that gives less makes less of all that a model foresees, however it foresees it. So a correction is
    nowhere larger than what the recording covers. ``unit`` (nx,) is the acceleration that a coefficient of 1 stands
    for.
    """

    system: System
    low: Array
    high: Array
    centre: Array
    scale: Array
    unit: Array
    least: Array
    most: Array
    weakest: Array
    strongest: Array
    strength: Array

    @classmethod
    def of(cls, dataset: Dataset, *, products: bool = False, model: Dynamics | None = None) -> Self:
        """Measure ``dataset`` where it moves (everywhere, if it never does), and what ``model`` predicts there."""
        system = dataset.system
        masks = [rows[:-1] for rows in dataset.moving]
        if not any(rows.any() for rows in masks):
            masks = [np.ones_like(rows) for rows in masks]
        pairs = list(zip(dataset.episodes, masks, strict=True))
        states = np.concatenate([episode.states[:-1][rows] for episode, rows in pairs])
        controls = np.concatenate([episode.controls[rows] for episode, rows in pairs])
        pushes = None
        if model is not None:
            windows = dataset.windows(1, history=model.n_lags, moving=True)
            windows = windows if len(windows) else dataset.windows(1, history=model.n_lags)
            pushes = foreseen(model, windows.past_states, windows.past_controls, windows.controls[:, 0])
        seen = regressors(system, states, controls)
        low, high, centre, spread = seen.min(axis=0), seen.max(axis=0), seen.mean(axis=0), seen.std(axis=0)
        scale = np.where(spread > 1e-9 * np.abs(seen).max(axis=0), spread, 1.0)
        least = most = np.empty(0)
        if products:
            found = _products((seen - centre) / scale)
            least, most = found.min(axis=0), found.max(axis=0)
        weakest = strongest = strength = np.empty(0)
        if pushes is not None:
            weakest, strongest, spread = pushes.min(axis=0), pushes.max(axis=0), pushes.std(axis=0)
            strength = np.where(spread > 1e-9 * np.abs(pushes).max(axis=0), spread, 1.0)
        unit = state_scale(system, states) / FAR
        return cls(system, low, high, centre, scale, unit, least, most, weakest, strongest, strength)

    @property
    def products(self) -> bool:
        """Whether there are products."""
        return len(self.least) > 0

    @property
    def gains(self) -> bool:
        """Whether what the model predicts is among them."""
        return len(self.strength) > 0

    @property
    def n_inputs(self) -> int:
        """Number of z."""
        return len(self.centre)

    @property
    def size(self) -> int:
        """Number of regressors."""
        return 1 + self.n_inputs + len(self.least) + len(self.strength)

    @property
    def weight(self) -> Array:
        """How strong a ridge is for each coefficient, (size, nx); a gain counts as a share of what is foreseen."""
        plain = np.repeat([1.0, OF_PRODUCTS], [1 + self.n_inputs, len(self.least)])
        of_gains = np.ones((len(self.strength), 1)) * (self.unit / self.strength if self.gains else self.unit) ** 2
        return np.concatenate([plain[:, None] * np.ones(self.system.nx), of_gains])

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the coefficients, (size, nx)."""
        return self.size, self.system.nx

    @property
    def names(self) -> list[str]:
        """The names of z, of their products and of what the model predicts."""
        inputs = [*self.system.regressor_names, *self.system.control_names]
        pairs = [f"{one} {other}" for i, one in enumerate(inputs) for other in inputs[i:]] if self.products else []
        own = [f"foreseen d {channel.name}/dt" for channel in self.system.states] if self.gains else []
        return inputs + pairs + own

    def __call__(self, state: Array, control: Array, after: Array) -> Array:
        """Return the regressors (..., size) of states (..., nx), controls (..., nu) and what a model makes of them."""
        seen = np.concatenate([self.system.regressors(state), control], axis=-1)
        z = (np.clip(seen, self.low, self.high) - self.centre) / self.scale
        parts = [np.ones((*z.shape[:-1], 1)), z]
        if self.products:
            parts.append(np.clip(_products(z), self.least, self.most))
        if self.gains:
            parts.append(np.clip(pushed(self.system, state, after), self.weakest, self.strongest) / self.strength)
        return np.concatenate(parts, axis=-1)

    def shift(self, state: Array, control: Array, after: Array, coefficients: Array) -> Array:
        """Return what is added to the next state ``after`` (..., nx), with ``coefficients`` (..., size, nx).

        The acceleration c of all regressors but the gains moves it by integrate(x, c) - integrate(x, 0), whatever a
        model itself predicts, as the integration of a given state is affine in the acceleration. Gains move it in the
        frame of the next state, in which what the model predicts is measured.
        """
        regressors = self(state, control, after)
        own = self.size - len(self.strength)
        added, gained = (
            np.matmul(regressors[..., None, rows], coefficients[..., rows, :])[..., 0, :] * self.unit
            for rows in (slice(own), slice(own, None))
        )
        coasting = self.system.integrate(state, np.zeros_like(added))
        return self.system.integrate(state, added) - coasting + self.system.dt * gained

    def corrected(self, state: Array, control: Array, after: Array, coefficients: Array) -> Array:
        """Return the next state ``after`` (..., nx) of a model with the correction, within the limits of its channels.

        A body that the model leaves exactly at rest stays there.
        """
        system = self.system
        resting = (after == system.neutral_state).all(axis=-1, keepdims=True)
        moved = np.where(resting, after, after + self.shift(state, control, after, coefficients))
        return np.clip(moved, *system.limits) if system.limited else moved


def _products(z: Array) -> Array:
    """Return z_i z_k (i <= k) side by side, (..., n (n + 1) / 2)."""
    return np.concatenate([z[..., i : i + 1] * z[..., i:] for i in range(z.shape[-1])], axis=-1)


def pushed(system: System, before: Array, after: Array) -> Array:
    """Return the way per s (..., nx) to ``after`` from where a body is that coasts from ``before``."""
    return system.difference(after, system.integrate(before, np.zeros_like(before))) / system.dt


def foreseen(model: Dynamics, states: Array, past_controls: Array, control: Array) -> Array:
    """Return by how much ``model`` moves a body that coasts, (N, nx) per s, without noise.

    ``states`` (N, L + 1, nx), ``past_controls`` (N, L, nu) before ``control`` (N, nu).
    """
    carry = model.start(states, past_controls, np.zeros((len(states), model.n_draws)))
    noise = np.zeros((len(states), model.n_noise)) if model.n_noise else None
    after = model.step(carry, control, noise)[:, : model.system.nx]
    return pushed(model.system, carry[:, : model.system.nx], after)


def state_scale(system: System, states: Array) -> Array:
    """Return the spread (nx,) of ``states`` (N, nx), 1 for a state that never changes."""
    spread = system.spread(states)
    return np.where(spread > 1e-9 * np.abs(states).max(axis=0), spread, 1.0)
