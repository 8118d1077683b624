"""Corrections of accelerations: regressors, and a fit by simulation.

Coefficients minimise the simulation error over windows of a recording by damped least squares (`corrections`), with
derivatives that are computed along with the simulations (`sensitivities`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
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

COEFFICIENT_TIME = 1.0
"""Time in s within which a coefficient of 1 moves a state by its standard deviation."""
PRODUCT_RIDGE_FACTOR = 10.0
"""Factor of the ridge penalty for products."""


@dataclass(frozen=True)
class CorrectionTerms:
    """The regressors of an acceleration that is added to that of a model: 1, z, optionally z_i z_k (i <= k) and a.

    - z: state and control (sine and cosine of a periodic state), clipped to ``low`` and ``high`` (n,), minus their
      ``centre``, divided by their ``scale``.
    - Products are clipped to ``least`` and ``most`` (n (n + 1) / 2,), which are empty without products.
    - a (*gains*): the acceleration that the model itself predicts, divided by its ``strength`` and clipped to
      ``weakest`` and ``strongest`` (nx,), which are empty without gains. A weak battery or a worn tyre reduces
      everything that the model predicts.

    Because of the clipping a correction never exceeds its values within the recording. ``unit`` (nx,) is the
    acceleration for a coefficient of 1.
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
        """Return the terms scaled to ``dataset`` in motion (all of it, if it never moves); gains are for ``model``."""
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
        unit = state_scale(system, states) / COEFFICIENT_TIME
        return cls(system, low, high, centre, scale, unit, least, most, weakest, strongest, strength)

    @property
    def arrays(self) -> dict[str, Array]:
        """All fields but the system, by name."""
        return {name: value for name, value in vars(self).items() if name != "system"}

    @property
    def lengths(self) -> dict[str, tuple[int, ...]]:
        """The required shapes of `arrays`, by name."""
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
        """Whether there are gains."""
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
        """Ridge weight of each coefficient, (size, nx); that of a gain is relative to the predicted acceleration."""
        plain = np.repeat([1.0, PRODUCT_RIDGE_FACTOR], [1 + self.n_inputs, len(self.least)])
        of_gains = np.ones((len(self.strength), 1)) * (self.unit / self.strength if self.gains else self.unit) ** 2
        return np.concatenate([plain[:, None] * np.ones(self.system.nx), of_gains])

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the coefficients, (size, nx)."""
        return self.size, self.system.nx

    @property
    def names(self) -> list[str]:
        """The names of z, of their products and of gains."""
        inputs = [*self.system.regressor_names, *self.system.control_names]
        pairs = [f"{one} {other}" for i, one in enumerate(inputs) for other in inputs[i:]] if self.products else []
        own = [f"predicted d {channel.name}/dt" for channel in self.system.states] if self.gains else []
        return inputs + pairs + own

    def __call__(self, state: Array, control: Array, after: Array) -> Array:
        """Return the regressors (..., size) of states (..., nx), controls (..., nu) and a model's next states."""
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
        """Return the change of the next state ``after`` (..., nx) for ``coefficients`` (..., size, nx).

        The acceleration c of all regressors but the gains adds integrate(x, c) - integrate(x, 0), independent of the
        model, because the integration from a given state is affine in the acceleration. Gains act in the frame of the
        next state, in which the model's acceleration is measured.
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
        """Return the next carry ``after`` (B, n_carry) of a model, with its state corrected."""
        nx = self.system.nx
        moved = self.corrected(carry[:, :nx], control, after[:, :nx], coefficients)
        return np.concatenate([moved, after[:, nx:]], axis=1)


def _products(z: Array) -> Array:
    """Return all products z_i z_k (i <= k), (..., n (n + 1) / 2)."""
    return np.concatenate([z[..., i : i + 1] * z[..., i:] for i in range(z.shape[-1])], axis=-1)


def acceleration_from_coasting(system: System, before: Array, after: Array) -> Array:
    """Return the acceleration (..., nx) that leads from ``before`` to ``after`` instead of to coasting."""
    return system.difference(after, system.integrate(before, np.zeros_like(before))) / system.dt


def predicted_acceleration(model: Dynamics, states: Array, past_controls: Array, control: Array) -> Array:
    """Return the acceleration from coasting (N, nx) that ``model`` predicts, without noise.

    ``states`` (N, L + 1, nx), ``past_controls`` (N, L, nu) before ``control`` (N, nu).
    """
    carry = model.start(states, past_controls, np.zeros((len(states), model.n_draws)))
    noise = np.zeros((len(states), model.n_noise)) if model.n_noise else None
    after = model.step(carry, control, noise)[:, : model.system.nx]
    return acceleration_from_coasting(model.system, carry[:, : model.system.nx], after)


def state_scale(system: System, states: Array) -> Array:
    """Return the standard deviation (nx,) of ``states`` (N, nx), 1 for a constant state."""
    spread = system.spread(states)
    return np.where(spread > 1e-9 * np.abs(states).max(axis=0), spread, 1.0)


SECOND, FEWEST_STEPS, MOST_STEPS = 1.0, 10, 20
STRIDE = 3
MAX_ERROR = 10.0
"""Upper bound of an error, in standard deviations."""
ROWS = 2**14
"""Number of simulations in one batch."""


@dataclass(frozen=True)
class AdaptationWindows:
    """B windows of H steps for simulation and comparison with the recording.

    ``carry`` (B, n_carry) at the start, after ``past_states`` (B, L + 1, nx) and the last L of ``past_controls``
    (B, L + 1, nu), the first of which repeats where the recording begins,
    ``controls`` (B, H, nu), ``truth`` (B, H, nx), ``first`` (B,) the start sample, counted over all episodes; ``scale``
    (nx,) is the standard deviation of the states, ``state_bounds`` (2, nx) those of the model.
    """

    system: System
    past_states: Array
    past_controls: Array
    carry: Array
    controls: Array
    truth: Array
    first: IntArray
    scale: Array
    state_bounds: Array | None

    @classmethod
    def of(cls, model: Dynamics, dataset: Dataset, *, stride: int = STRIDE) -> Self:
        """Return windows of one second, 10 to 20 steps, that start in motion. Raises `InvalidData` if there is none."""
        system, lags = dataset.system, model.n_lags
        horizon = int(np.clip(round(SECOND / system.dt), FEWEST_STEPS, MOST_STEPS))
        windows = dataset.windows(horizon, stride=stride, history=lags, moving=True)
        if not len(windows):
            windows = dataset.windows(horizon, stride=stride, history=lags)
        if not len(windows):
            raise InvalidData(
                f"adaptation: expected an episode of more than {horizon + lags} steps, {lags} of history and {horizon} "
                f"to simulate; the longest has {max(len(episode) for episode in dataset)}"
            )
        begins = np.cumsum([0, *(len(episode) for episode in dataset)])[:-1]
        past_states, past = windows.past_states, windows.past_controls
        carry = model.start(past_states, past, np.zeros((len(windows), model.n_draws)))
        before = np.maximum(windows.start - lags - 1, 0)
        earlier = [dataset.episodes[e].controls[k] for e, k in zip(windows.episode, before, strict=True)]
        past = np.concatenate([np.stack(earlier)[:, None], past], axis=1)
        states = np.concatenate([e.states[rows] for e, rows in zip(dataset, dataset.moving, strict=True)])
        states = states if len(states) else np.concatenate([episode.states for episode in dataset])
        scale = state_scale(system, states)
        first = windows.start + begins[windows.episode]
        return cls(system, past_states, past, carry, windows.controls, windows.states, first, scale, model.state_bounds)

    def __len__(self) -> int:
        return len(self.first)

    def __getitem__(self, rows: BoolArray | IntArray | slice) -> AdaptationWindows:
        names = ("past_states", "past_controls", "carry", "controls", "truth", "first")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    @property
    def horizon(self) -> int:
        """Steps of each window."""
        return int(self.controls.shape[1])

    def errors(self, runs: Array) -> Array:
        """Return the errors (..., B, H, nx) of ``runs`` in standard deviations, clipped to `MAX_ERROR`."""
        wrong = self.system.difference(runs, np.broadcast_to(self.truth, runs.shape)) / self.scale
        return np.where(np.isfinite(wrong), np.clip(wrong, -MAX_ERROR, MAX_ERROR), MAX_ERROR)


def simulate_corrections(
    model: Dynamics, terms: CorrectionTerms, candidates: Array, windows: AdaptationWindows
) -> Array:
    """Return the states (P, B, H, nx) simulated by ``model`` with each correction in ``candidates`` (P, size, nx)."""
    size = max(1, ROWS // max(1, len(windows)))
    parts = [_simulate_batch(model, terms, candidates[i : i + size], windows) for i in range(0, len(candidates), size)]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _simulate_batch(model: Dynamics, terms: CorrectionTerms, candidates: Array, windows: AdaptationWindows) -> Array:
    """Return the simulations with all ``candidates`` in one batch."""
    count, (batch, horizon, nu), nx = len(candidates), windows.controls.shape, terms.system.nx
    carry = np.tile(windows.carry, (count, 1))
    noise = np.zeros((len(carry), model.n_noise)) if model.n_noise else None
    out = np.empty((count, batch, horizon, nx))
    with np.errstate(all="ignore"):
        for k in range(horizon):
            control = np.tile(windows.controls[:, k], (count, 1))
            after = model.step(carry, control, noise)
            before, reached = (x[:, :nx].reshape(count, batch, nx) for x in (carry, after))
            moved = terms.corrected(before, control.reshape(count, batch, nu), reached, candidates[:, None])
            carry, _ = clip_state(np.concatenate([moved.reshape(-1, nx), after[:, nx:]], axis=1), windows.state_bounds)
            out[:, :, k] = carry[:, :nx].reshape(count, batch, nx)
    return out


ROUNDS = 2
"""Linearisations for each ridge; the first starts from the coefficients of the stronger one."""
SHORTENINGS = (1.0, 0.3, 0.1)
HUBER_ERROR = 1.5
"""Error, in standard deviations, beyond which the loss is linear instead of quadratic (Huber)."""


def corrections(
    model: Dynamics, terms: CorrectionTerms, windows: AdaptationWindows, ridges: Sequence[float], seconds: float
) -> Iterator[Array]:
    """Yield the coefficients (size, nx) for each of ``ridges``, which begin with the strongest.

    They minimise seconds * mean(error^2) + ridge * sum(weight * coefficients^2), where errors are in standard
    deviations and averaged over windows, steps and states: a ridge of 3 has the weight of three seconds of data.
    Huber's weights reduce large errors, because a simulation that diverges contains little information.
    """
    found = np.zeros(terms.shape)
    for ridge in ridges:
        for _ in range(ROUNDS):
            found, moved = _improved(model, terms, windows, found, ridge * terms.weight, seconds)
            if not moved:
                break
        yield found


def _improved(
    model: Dynamics, terms: CorrectionTerms, windows: AdaptationWindows, start: Array, ridge: Array, seconds: float
) -> tuple[Array, bool]:
    """Return better coefficients from one linearisation, and whether they differ from ``start``."""
    runs, derivatives = sensitivities(model, terms, start, windows)
    slopes = (derivatives / windows.scale).reshape(start.size, -1)

    def errors_of(candidates: Array) -> Array:
        return windows.errors(simulate_corrections(model, terms, candidates, windows))

    return damped_step(start, windows.errors(runs[None]).ravel(), slopes, errors_of, ridge, seconds)


def damped_step(
    start: Array,
    here: Array,
    slopes: Array,
    errors_of: Callable[[Array], Array],
    ridge: Array,
    seconds: float,
) -> tuple[Array, bool]:
    """Return better coefficients than ``start`` from one linearisation, and whether they differ from it.

    ``here`` (E,) are the errors at ``start`` (...) and ``slopes`` (k, E) their derivatives by its k numbers;
    ``errors_of`` returns the errors (P, ...) of candidates (P, ...). ``ridge`` has the shape of ``start``.
    """
    slopes = np.where(np.abs(here) < MAX_ERROR, slopes, 0.0)
    weights = np.minimum(1.0, HUBER_ERROR / np.maximum(np.abs(here), 1e-12))
    share = seconds / here.size
    normal = share * (slopes * weights) @ slopes.T + np.diag(ridge.ravel())
    step = np.linalg.solve(normal, -share * slopes @ (weights * here) - (ridge * start).ravel()).reshape(start.shape)
    if not np.isfinite(step).all():
        return start, False
    candidates = np.stack([start, *(start + length * step for length in SHORTENINGS)])
    costs = [_cost(one, found, ridge, seconds) for one, found in zip(errors_of(candidates), candidates, strict=True)]
    best = int(np.argmin(costs))
    return candidates[best], costs[best] < (1.0 - 1e-3) * costs[0]


def _cost(errors: Array, coefficients: Array, ridge: Array, seconds: float) -> float:
    size = np.abs(errors)
    huber = np.where(size <= HUBER_ERROR, size**2, HUBER_ERROR * (2.0 * size - HUBER_ERROR))
    return float(seconds * huber.mean() + np.sum(ridge * coefficients**2))


STEP = 1e-4
"""Step of a difference quotient, in standard deviations of the carry."""
STEEPEST = 1e6
"""Upper bound of derivatives; those of simulations that diverge are larger."""


def sensitivities(
    model: Dynamics, terms: CorrectionTerms, coefficients: Array, windows: AdaptationWindows
) -> tuple[Array, Array]:
    """Return simulations (B, H, nx), and their derivatives by ``coefficients``, (size * nx, B, H, nx).

    The derivatives S_k of the carry follow S_k+1 = (dg/dcarry) S_k + dg/dC, where g is one step of ``model`` with the
    correction. dg/dcarry is computed by finite differences in those parts of the carry that depend on the coefficients,
    which are fewer than the coefficients; dg/dC is exact, because a step is affine in C.
    """
    (batch, horizon, _), nx, count = windows.controls.shape, terms.system.nx, coefficients.size
    spread = windows.carry.std(axis=0)
    steps = STEP * np.where(spread > 0.0, spread, 1.0)
    carry, gradient = windows.carry, np.zeros((batch, windows.carry.shape[1], count))
    runs, derivatives = np.empty((batch, horizon, nx)), np.empty((count, batch, horizon, nx))
    with np.errstate(all="ignore"):
        for k in range(horizon):
            moved = np.flatnonzero(gradient.any(axis=(0, 2)))
            perturbed = np.repeat(carry[None], 1 + len(moved), axis=0)
            perturbed[np.arange(len(moved)) + 1, :, moved] += steps[moved, None]
            control = np.tile(windows.controls[:, k], (len(perturbed), 1))
            flat = perturbed.reshape(-1, perturbed.shape[2])
            reached = model.step(flat, control, np.zeros((len(flat), model.n_noise)) if model.n_noise else None)
            corrected = terms.corrected(flat[:, :nx], control, reached[:, :nx], coefficients)
            after, _ = clip_state(np.concatenate([corrected, reached[:, nx:]], axis=1), windows.state_bounds)
            after = after.reshape(perturbed.shape)
            changes = ((after[1:] - after[0]) / steps[moved, None, None]).transpose(1, 2, 0)
            direct = _by_coefficients(terms, carry[:, :nx], control[:batch], reached[:batch, :nx])
            unbounded = reached[:batch, :nx] + direct @ coefficients.ravel()
            direct[np.abs(unbounded - after[0, :, :nx]) > 1e-9 * (1.0 + np.abs(unbounded))] = 0.0
            gradient = changes @ gradient[:, moved]
            gradient[:, :nx] += direct
            gradient = np.clip(np.nan_to_num(gradient), -STEEPEST, STEEPEST)
            carry = after[0]
            runs[:, k], derivatives[:, :, k] = carry[:, :nx], gradient[:, :nx].transpose(2, 0, 1)
    return runs, derivatives


def _by_coefficients(terms: CorrectionTerms, state: Array, control: Array, after: Array) -> Array:
    """Return the derivatives (B, nx, size * nx) of the next state by the coefficients."""
    pushes = np.diag(terms.unit)[:, None]
    coasting = terms.system.integrate(state, np.zeros_like(state))
    of_terms = terms.system.integrate(np.repeat(state[None], len(pushes), axis=0), pushes + 0.0 * state) - coasting
    of_gains = np.broadcast_to(terms.system.dt * pushes, of_terms.shape)
    own = terms.size - len(terms.strength)
    moves = np.stack([of_terms] * own + [of_gains] * (terms.size - own))
    regressors = terms(state, control, after)
    return np.einsum("bs,sjbi->bisj", regressors, moves).reshape(len(state), terms.system.nx, -1)
