"""A correction of accelerations: its terms, and how it is learned by simulations.

Coefficients minimise the errors of free runs over pieces of a recording: damped least squares (`corrections`) with
derivatives that are carried along beside the runs (`sensitivities`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sysid_evo.carry import clip_state
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.support import regressors
from sysid_evo.errors import InvalidData
from sysid_evo.models.dynamics import Dynamics
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray, IntArray

FAR = 1.0
"""Time in s within which a coefficient of 1 moves a state by its standard deviation."""
OF_PRODUCTS = 10.0
"""How much stronger a ridge is for products."""


@dataclass(frozen=True)
class CorrectionTerms:
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
            pushes = predicted_acceleration(model, windows.past_states, windows.past_controls, windows.controls[:, 0])
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
    def arrays(self) -> dict[str, Array]:
        """All but the system, by name."""
        return {name: value for name, value in vars(self).items() if name != "system"}

    @property
    def lengths(self) -> dict[str, tuple[int, ...]]:
        """The shapes that the `arrays` must have, by name: with products and gains if there are some."""
        n, nx = len(self.system.regressor_names) + self.system.nu, self.system.nx
        products, gains = n * (n + 1) // 2 if self.products else 0, nx if self.gains else 0
        lengths = {"low": n, "high": n, "centre": n, "scale": n, "unit": nx, "least": products, "most": products}
        return {
            name: (length,)
            for name, length in {**lengths, **dict.fromkeys(("weakest", "strongest", "strength"), gains)}.items()
        }

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
            parts.append(
                np.clip(acceleration_from_coasting(self.system, state, after), self.weakest, self.strongest)
                / self.strength
            )
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

    def next_carry(self, carry: Array, control: Array, after: Array, coefficients: Array) -> Array:
        """Return the next carry ``after`` (B, n_carry), the state at its head, of a model with the correction."""
        nx = self.system.nx
        moved = self.corrected(carry[:, :nx], control, after[:, :nx], coefficients)
        return np.concatenate([moved, after[:, nx:]], axis=1)


def _products(z: Array) -> Array:
    """Return z_i z_k (i <= k) side by side, (..., n (n + 1) / 2)."""
    return np.concatenate([z[..., i : i + 1] * z[..., i:] for i in range(z.shape[-1])], axis=-1)


def acceleration_from_coasting(system: System, before: Array, after: Array) -> Array:
    """Return the way per s (..., nx) to ``after`` from where a body is that coasts from ``before``."""
    return system.difference(after, system.integrate(before, np.zeros_like(before))) / system.dt


def predicted_acceleration(model: Dynamics, states: Array, past_controls: Array, control: Array) -> Array:
    """Return by how much ``model`` moves a body that coasts, (N, nx) per s, without noise.

    ``states`` (N, L + 1, nx), ``past_controls`` (N, L, nu) before ``control`` (N, nu).
    """
    carry = model.start(states, past_controls, np.zeros((len(states), model.n_draws)))
    noise = np.zeros((len(states), model.n_noise)) if model.n_noise else None
    after = model.step(carry, control, noise)[:, : model.system.nx]
    return acceleration_from_coasting(model.system, carry[:, : model.system.nx], after)


def state_scale(system: System, states: Array) -> Array:
    """Return the spread (nx,) of ``states`` (N, nx), 1 for a state that never changes."""
    spread = system.spread(states)
    return np.where(spread > 1e-9 * np.abs(states).max(axis=0), spread, 1.0)


SECOND, FEWEST_STEPS, MOST_STEPS = 1.0, 10, 20
STRIDE = 3
FARTHEST = 10.0
"""Standard deviations that an error counts at most."""
ROWS = 2**14
"""Free runs side by side."""


@dataclass(frozen=True)
class AdaptationWindows:
    """B windows of H steps as a model starts and is judged.

    ``carry`` (B, n_carry) at the start, ``controls`` (B, H, nu), ``truth`` (B, H, nx), ``first`` (B,) the sample at
    which each starts, counted over all episodes; ``scale`` (nx,) is the spread of the states, ``state_bounds`` (2, nx)
    what a free run is clipped to.
    """

    system: System
    carry: Array
    controls: Array
    truth: Array
    first: IntArray
    scale: Array
    state_bounds: Array | None

    @classmethod
    def of(cls, model: Dynamics, dataset: Dataset, *, stride: int = STRIDE) -> Self:
        """Cut windows of one second, 10 to 20 steps, that start in motion. Raises `InvalidData` if there is none."""
        system, lags = dataset.system, model.n_lags
        horizon = int(np.clip(round(SECOND / system.dt), FEWEST_STEPS, MOST_STEPS))
        windows = dataset.windows(horizon, stride=stride, history=lags, moving=True)
        if not len(windows):
            windows = dataset.windows(horizon, stride=stride, history=lags)
        if not len(windows):
            raise InvalidData(
                f"adaptation: expected an episode of more than {horizon + lags} steps, {lags} of history and {horizon} "
                f"to run freely; the longest has {max(len(episode) for episode in dataset)}"
            )
        begins = np.cumsum([0, *(len(episode) for episode in dataset)])[:-1]
        draws = np.zeros((len(windows), model.n_draws))
        carry = model.start(windows.past_states, windows.past_controls, draws)
        states = np.concatenate([e.states[rows] for e, rows in zip(dataset, dataset.moving, strict=True)])
        states = states if len(states) else np.concatenate([episode.states for episode in dataset])
        scale = state_scale(system, states)
        first = windows.start + begins[windows.episode]
        return cls(system, carry, windows.controls, windows.states, first, scale, model.state_bounds)

    def __len__(self) -> int:
        return len(self.first)

    def __getitem__(self, rows: BoolArray | IntArray | slice) -> AdaptationWindows:
        return replace(
            self, carry=self.carry[rows], controls=self.controls[rows], truth=self.truth[rows], first=self.first[rows]
        )

    @property
    def horizon(self) -> int:
        """Steps of each window."""
        return int(self.controls.shape[1])

    def errors(self, runs: Array) -> Array:
        """Return the errors (..., B, H, nx) of ``runs`` in standard deviations; what is not finite counts most."""
        wrong = self.system.difference(runs, np.broadcast_to(self.truth, runs.shape)) / self.scale
        return np.where(np.isfinite(wrong), np.clip(wrong, -FARTHEST, FARTHEST), FARTHEST)


def free_runs(model: Dynamics, terms: CorrectionTerms, candidates: Array, pieces: AdaptationWindows) -> Array:
    """Return where ``model`` with each correction (P, size, nx) goes, (P, B, H, nx)."""
    at_once = max(1, ROWS // max(1, len(pieces)))
    parts = [_beside(model, terms, candidates[i : i + at_once], pieces) for i in range(0, len(candidates), at_once)]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _beside(model: Dynamics, terms: CorrectionTerms, candidates: Array, pieces: AdaptationWindows) -> Array:
    """Return the free runs with all of the ``candidates`` at once."""
    count, (batch, horizon, nu), nx = len(candidates), pieces.controls.shape, terms.system.nx
    carry = np.tile(pieces.carry, (count, 1))
    noise = np.zeros((len(carry), model.n_noise)) if model.n_noise else None
    out = np.empty((count, batch, horizon, nx))
    with np.errstate(all="ignore"):
        for k in range(horizon):
            control = np.tile(pieces.controls[:, k], (count, 1))
            after = model.step(carry, control, noise)
            before, reached = (x[:, :nx].reshape(count, batch, nx) for x in (carry, after))
            moved = terms.corrected(before, control.reshape(count, batch, nu), reached, candidates[:, None])
            carry, _ = clip_state(np.concatenate([moved.reshape(-1, nx), after[:, nx:]], axis=1), pieces.state_bounds)
            out[:, :, k] = carry[:, :nx].reshape(count, batch, nx)
    return out


ROUNDS = 2
"""Linearisations for each ridge; the first starts where that of the stronger one ended."""
SHORTENINGS = (1.0, 0.3, 0.1)
TOLERATED = 1.5
"""Standard deviations beyond which an error counts in proportion and no longer in square (Huber)."""


def corrections(
    model: Dynamics, terms: CorrectionTerms, pieces: AdaptationWindows, ridges: Sequence[float], seconds: float
) -> Iterator[Array]:
    """Yield the coefficients (size, nx) for each of ``ridges``, which begin with the strongest.

    They minimise seconds * mean(error^2) + ridge * sum(weight * coefficients^2), with the weight of the terms, errors
    in standard deviations over windows, steps and states: a ridge of 3 counts as much as three seconds of such data.
    Large errors count less (Huber's weights), since a run that diverges says little of what would prevent it.
    """
    found = np.zeros(terms.shape)
    for ridge in ridges:
        for _ in range(ROUNDS):
            found, moved = _improved(model, terms, pieces, found, ridge * terms.weight, seconds)
            if not moved:
                break
        yield found


def _improved(
    model: Dynamics, terms: CorrectionTerms, pieces: AdaptationWindows, start: Array, ridge: Array, seconds: float
) -> tuple[Array, bool]:
    """Return better coefficients by one linearisation, and whether there are any."""
    size = start.size
    runs, derivatives = sensitivities(model, terms, start, pieces)
    here = pieces.errors(runs[None]).ravel()
    slopes = np.where(np.abs(here) < FARTHEST, (derivatives / pieces.scale).reshape(size, -1), 0.0)
    weights = np.minimum(1.0, TOLERATED / np.maximum(np.abs(here), 1e-12))
    share = seconds / here.size
    normal = share * (slopes * weights) @ slopes.T + np.diag(ridge.ravel())
    step = np.linalg.solve(normal, -share * slopes @ (weights * here) - (ridge * start).ravel()).reshape(start.shape)
    if not np.isfinite(step).all():
        return start, False
    candidates = np.stack([start, *(start + length * step for length in SHORTENINGS)])
    reached = pieces.errors(free_runs(model, terms, candidates, pieces))
    costs = [_cost(one, found, ridge, seconds) for one, found in zip(reached, candidates, strict=True)]
    best = int(np.argmin(costs))
    return candidates[best], costs[best] < (1.0 - 1e-3) * costs[0]


def _cost(errors: Array, coefficients: Array, ridge: Array, seconds: float) -> float:
    size = np.abs(errors)
    huber = np.where(size <= TOLERATED, size**2, TOLERATED * (2.0 * size - TOLERATED))
    return float(seconds * huber.mean() + np.sum(ridge * coefficients**2))


STEP = 1e-4
"""Of a difference, in spreads of what is changed."""
STEEPEST = 1e6
"""Largest derivative that is believed: a run that diverges has larger ones."""


def sensitivities(
    model: Dynamics, terms: CorrectionTerms, coefficients: Array, pieces: AdaptationWindows
) -> tuple[Array, Array]:
    """Return where free runs go, (B, H, nx), and their derivatives by ``coefficients``, (size * nx, B, H, nx).

    With S_k the derivatives of the carry, S_k+1 = (dg/dcarry) S_k + dg/dC, g being one step of ``model`` with the
    correction. The former is found by differences in those parts of the carry that depend on the coefficients, a few
    states instead of all coefficients; the latter exactly, as a step is affine in them.
    """
    (batch, horizon, _), nx, count = pieces.controls.shape, terms.system.nx, coefficients.size
    spread = pieces.carry.std(axis=0)
    steps = STEP * np.where(spread > 0.0, spread, 1.0)
    carry, along = pieces.carry, np.zeros((batch, pieces.carry.shape[1], count))
    runs, derivatives = np.empty((batch, horizon, nx)), np.empty((count, batch, horizon, nx))
    with np.errstate(all="ignore"):
        for k in range(horizon):
            moved = np.flatnonzero(along.any(axis=(0, 2)))
            beside = np.repeat(carry[None], 1 + len(moved), axis=0)
            beside[np.arange(len(moved)) + 1, :, moved] += steps[moved, None]
            control = np.tile(pieces.controls[:, k], (len(beside), 1))
            flat = beside.reshape(-1, beside.shape[2])
            reached = model.step(flat, control, np.zeros((len(flat), model.n_noise)) if model.n_noise else None)
            corrected = terms.corrected(flat[:, :nx], control, reached[:, :nx], coefficients)
            after, _ = clip_state(np.concatenate([corrected, reached[:, nx:]], axis=1), pieces.state_bounds)
            after = after.reshape(beside.shape)
            changes = ((after[1:] - after[0]) / steps[moved, None, None]).transpose(1, 2, 0)
            direct = _by_coefficients(terms, carry[:, :nx], control[:batch], reached[:batch, :nx])
            unbounded = reached[:batch, :nx] + direct @ coefficients.ravel()
            direct[np.abs(unbounded - after[0, :, :nx]) > 1e-9 * (1.0 + np.abs(unbounded))] = 0.0
            along = changes @ along[:, moved]
            along[:, :nx] += direct
            along = np.clip(np.nan_to_num(along), -STEEPEST, STEEPEST)
            carry = after[0]
            runs[:, k], derivatives[:, :, k] = carry[:, :nx], along[:, :nx].transpose(2, 0, 1)
    return runs, derivatives


def _by_coefficients(terms: CorrectionTerms, state: Array, control: Array, after: Array) -> Array:
    """Return the derivatives (B, nx, size * nx) of the next state by the coefficients, which are the same for all."""
    pushes = np.diag(terms.unit)[:, None]
    coasting = terms.system.integrate(state, np.zeros_like(state))
    of_terms = terms.system.integrate(np.repeat(state[None], len(pushes), axis=0), pushes + 0.0 * state) - coasting
    of_gains = np.broadcast_to(terms.system.dt * pushes, of_terms.shape)
    own = terms.size - len(terms.strength)
    moves = np.stack([of_terms] * own + [of_gains] * (terms.size - own))
    regressors = terms(state, control, after)
    return np.einsum("bs,sjbi->bisj", regressors, moves).reshape(len(state), terms.system.nx, -1)
