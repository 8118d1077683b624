"""Calibrating prediction intervals on held-out simulations.

An interval is right if it holds a given share of the truths that a model did not learn from. So the noise of a step is
scaled until simulations with it do that (conformal calibration): either at several horizons, with a scale for each
stretch of time (`horizon_scales`), or after the last step alone, with one scale (`conformal_scale`). A recording that
was never seen lies farther off than blocks of time of one that was: by how much says `growth_on_unseen_recordings`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist
from typing import Any, Protocol, Self, TypeVar

import numpy as np

from sysid_evo.carry import clip_state, recent
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.trajectory import Windows, evenly_spaced
from sysid_evo.types import Array, BoolArray
from sysid_evo.validation.folds import recording_folds, time_fold
from sysid_evo.validation.simulation_error import STRIDE, Fitted, Simulator, error_windows

HORIZONS = (1, 10, 20, 60)
"""Steps at which intervals are calibrated, and at which their coverage is measured."""
SHARE = 0.9
"""Of the truths, to lie within an interval."""

MAX_WINDOWS, FEWEST = 120, 20
"""Windows of all cases together, and how many there must be of a horizon, or it is left out."""

SAMPLES, ROUNDS = 16, 2

POOLED = 0.5
"""How far the spread of a window is drawn to that of all windows: few samples tell its own roughly."""
SMALLEST, LARGEST = 0.02, 20.0
"""By how much a round may change a scale."""
LAGS = range(2, 6)
"""Steps after which measurement noise is forgotten and what is wrong with a model is not."""

APART = 10
"""Steps between two recordings when samples are numbered, more than those."""


class NoisySteps(Fitted, Protocol):
    """A fitted model whose steps can be disturbed."""

    def initial_carry(self, states: Array, controls: Array) -> Array:
        """Return the carry after a history."""
        ...

    def disturbed(self, carry: Array, control: Array, disturbance: Array) -> Array:
        """Return the next carry, its state moved by ``disturbance`` (B, nx) deviations."""
        ...


Steps = TypeVar("Steps", bound=NoisySteps)


@dataclass(frozen=True)
class Case:
    """A model, windows that it did not learn from, and which of their targets (N, H) move."""

    model: NoisySteps
    windows: Windows
    moving: BoolArray

    @classmethod
    def of(cls, model: NoisySteps, part: Dataset, horizon: int, most: int, *, windows: Windows | None = None) -> Case:
        """Cut up to ``most`` windows of ``horizon`` steps out of ``part``, evenly spread, wherever the body moves."""
        cut = part.windows(horizon, stride=1, history=model.n_lags, moving=True) if windows is None else windows
        cut = cut[evenly_spaced(len(cut), most)]
        begins = np.cumsum([0, *(len(rows) for rows in part.moving)])[:-1]
        ahead = cut.start[:, None] + 1 + np.arange(cut.states.shape[1])
        moves = (
            np.concatenate(part.moving)[begins[cut.episode][:, None] + ahead] if len(cut) else np.empty((0, 0), bool)
        )
        return cls(model, cut, moves)


def usable_horizon(parts: Sequence[Dataset], history: int) -> int:
    """Return the longest of `HORIZONS` of which there are enough windows, together in all ``parts``."""
    for horizon in reversed(HORIZONS):
        if sum(len(part.windows(horizon, stride=4, history=history, moving=True)) for part in parts) >= FEWEST:
            return horizon
    return HORIZONS[0]


def segments(horizon: int) -> list[tuple[int, int]]:
    """Return first and last step of every stretch of time that has a scale of its own, up to ``horizon``."""
    edges = [0, *(step for step in HORIZONS if step <= horizon)]
    return list(pairwise(edges))


def step_spread(
    cases: Sequence[tuple[Steps, Dataset]], step: Callable[[Steps, Array, Array], Array]
) -> tuple[Array, Array]:
    """Return the error (nx,) of one ``step`` (model, carry, control), and its `persistent_share` (nx,).

    ``cases`` are models, each with what it did not learn from.
    """
    errors, numbers, begin = [], [], 0
    for model, part in cases:
        windows = part.windows(1, history=model.n_lags)
        carry = model.initial_carry(windows.past_states, windows.past_controls)
        after = step(model, carry, windows.controls[:, 0])
        errors.append(part.system.difference(windows.states[:, 0], after[:, : part.system.nx]))
        longest = max(len(episode) for episode in part) + APART
        numbers.append(begin + windows.start + windows.episode * longest)
        begin += longest * len(part)
    pooled = np.concatenate(errors)
    return np.sqrt(np.mean(pooled**2, axis=0)), persistent_share(pooled, np.concatenate(numbers))


def persistent_share(residuals: Array, sample: Array) -> Array:
    """Return how much (nx,) of the variance of what drives a model off course stays the same from step to step.

    ``residuals`` (N, nx) are errors of single steps, of which ``sample`` (N,) are the numbers. What is still correlated
    after two to five steps is persistent; measurement noise makes neighbours differ, the rest is white.
    """
    centred = residuals - residuals.mean(axis=0)

    def covariance(lag: int) -> Array:
        together = sample[lag:] - sample[: len(sample) - lag] == lag
        products = centred[lag:][together] * centred[: len(centred) - lag][together]
        return products.mean(axis=0) if len(products) else np.zeros(residuals.shape[1])

    variance = covariance(0) + residuals.mean(axis=0) ** 2
    slow = np.clip(np.mean([covariance(lag) for lag in LAGS], axis=0), 0.0, None) + residuals.mean(axis=0) ** 2
    measured = np.maximum(slow - covariance(1) - residuals.mean(axis=0) ** 2, 0.0)
    white = np.maximum(variance - slow - 2.0 * measured, 0.0)
    total = slow + white
    return np.clip(np.divide(slow, total, out=np.full_like(total, 0.5), where=total > 0), 0.0, 1.0)


def horizon_scales(
    cases: Sequence[Case],
    persistent: Array,
    rng: np.random.Generator,
    *,
    share: float = SHARE,
    still: Callable[[], None] = lambda: None,
) -> Array:
    """Return the noise of every step in deviations (4, nx), for each stretch of time between 0 and `HORIZONS`.

    From one horizon to the next the noise is what makes ``share`` of all windows lie inside at the next (conformal,
    as in `conformal_scale`): the spread that earlier noise has grown to there is kept, and the new noise adds what
    is missing. Of its variance the part ``persistent`` (nx,) is drawn once for a run. Stretches beyond the
    longest window have the scale of the last.
    """
    z = NormalDist().inv_cdf(0.5 + share / 2)
    nx, seed = cases[0].windows.states.shape[2], int(rng.integers(2**32))
    runs = [_Run(case, persistent, (seed, i)) for i, case in enumerate(cases) if len(case.windows)]
    scales = np.ones((len(HORIZONS), nx))
    stretches = segments(max(run.horizon for run in runs))
    for number, (first, last) in enumerate(stretches):
        scale = scales[max(number - 1, 0)].copy()
        squares = [(run.error(last) / z) ** 2 for run in runs]
        before = [run.to(first, last, np.zeros(nx))[1] if first else np.zeros_like(run.error(last)) for run in runs]
        for _ in range(ROUNDS):
            still()
            wanted = []
            for run, square, earlier in zip(runs, squares, before, strict=True):
                variance = run.to(first, last, scale)[1]
                variance = (1.0 - POOLED) * variance + POOLED * variance.mean(axis=0)
                added = np.maximum(variance - earlier, 1e-6 * variance + np.finfo(float).tiny)
                wanted.append(((square - earlier) / added)[run.counts(last)])
            scale = scale * _factor(np.concatenate(wanted), share)
        for run in runs:
            run.go(first, last, scale)
        scales[number] = scale
    scales[len(stretches) :] = scales[len(stretches) - 1]
    return scales


def _factor(wanted: Array, share: float) -> Array:
    """Return by what (nx,) new noise must grow so that ``share`` of the targets lie within what it adds.

    ``wanted`` (N, nx) is what each target needs: its square, less the variance before, over the variance added.
    """
    level = min(1.0, share * (len(wanted) + 1) / len(wanted))
    return np.clip(np.sqrt(np.maximum(np.quantile(wanted, level, axis=0, method="higher"), 0.0)), SMALLEST, LARGEST)


class _Run:
    """The samples of one case on their way: from horizon to horizon, each from where the last one ended."""

    def __init__(self, case: Case, persistent: Array, seed: tuple[int, int]) -> None:
        windows = case.windows
        carry = case.model.initial_carry(*recent(windows.past_states, windows.past_controls, case.model.n_lags))
        self.case, self.horizon, self.seed = case, windows.controls.shape[1], seed
        self.centre = self._alone(carry)
        self.carry, self.count = np.tile(carry, (SAMPLES, 1)), len(carry)
        self.white, self.lasting = np.sqrt(1.0 - persistent), np.sqrt(persistent)
        self.held = np.random.default_rng(seed).standard_normal((len(self.carry), windows.states.shape[2]))

    def _next(self, carry: Array, control: Array, disturbance: Array) -> Array:
        return clip_state(self.case.model.disturbed(carry, control, disturbance), self.case.model.state_bounds)[0]

    def _alone(self, carry: Array) -> Array:
        """Return the states (N, H, nx) of the run without noise."""
        windows, found = self.case.windows, np.empty_like(self.case.windows.states)
        nothing = np.zeros((len(carry), windows.states.shape[2]))
        for k in range(self.horizon):
            carry = self._next(carry, windows.controls[:, k], nothing)
            found[:, k] = carry[:, : found.shape[2]]
        return found

    def counts(self, last: int) -> BoolArray:
        """Return which targets (N,) at a horizon count: those that move, or all if none does."""
        rows = self.case.moving[:, last - 1]
        return rows if rows.any() else np.ones(self.count, dtype=bool)

    def error(self, last: int) -> Array:
        """Return the errors (N, nx) at a horizon of the run without noise."""
        truth = self.case.windows.states[:, last - 1]
        return np.abs(self.case.model.system.difference(truth, self.centre[:, last - 1]))

    def to(self, first: int, last: int, scale: Array) -> tuple[Array, Array]:
        """Return the carries at a horizon, and the variance (N, nx) of their states; the same noise every time."""
        controls, carry = self.case.windows.controls, self.carry
        rng = np.random.default_rng([*self.seed, last])
        for k in range(first, last):
            noise = self.white * rng.standard_normal(self.held.shape) + self.lasting * self.held
            carry = self._next(carry, np.tile(controls[:, k], (SAMPLES, 1)), scale * noise)
        states = carry[:, : len(scale)].reshape(SAMPLES, self.count, -1)
        return carry, states.var(axis=0, ddof=1)

    def go(self, first: int, last: int, scale: Array) -> None:
        """Go on to a horizon."""
        self.carry = self.to(first, last, scale)[0]


ONE_SCALE_WINDOWS, ONE_SCALE_SAMPLES, ONE_SCALE_ROUNDS = 150, 30, 3

SMALLEST_SCALE, LARGEST_SCALE = 0.1, 10.0

PIECE = 40
"""Windows that are simulated at a time."""


class NoisySimulator(Protocol):
    """A fitted model that can draw noise, which it multiplies with ``noise_scale_``."""

    def variant(self, **parameters: Any) -> Self: ...
    def simulate(self, *windows: Any, **options: Any) -> Array: ...
    def __setattr__(self, name: str, value: Any) -> None: ...


Noisy = TypeVar("Noisy", bound=NoisySimulator)


def conformal_scale(
    cases: Sequence[tuple[NoisySimulator, Windows]],
    rng: np.random.Generator,
    *,
    share: float = SHARE,
    rounds: int = ONE_SCALE_ROUNDS,
    still: Callable[[], None] = lambda: None,
) -> Array:
    """Return the ``noise_scale_`` (nx,) with which ``share`` of the last states of all windows lie inside.

    Every case is a fitted model and windows that it did not learn from; the model has the
    hyper-parameter ``stochastic`` and multiplies its noise with ``noise_scale_``. The normalised error
    of a window is by how much its interval would have to grow about its median to hold the truth; the
    scale grows by the ``share`` quantile of these over all windows, every case weighing alike, (n + 1) / n
    times ``share`` for n windows (split conformal prediction: Lei et al. 2018, Romano et al. 2019), all
    channels at once, ``rounds`` times, since the width is not quite proportional to the scale and the
    channels are coupled. The same noise is drawn each time; ``still`` is called every second or so.
    """
    most = ONE_SCALE_WINDOWS // len(cases)
    few = [(with_noise(model), windows[evenly_spaced(len(windows), most)]) for model, windows in cases]
    noisy = [(model, part[at : at + PIECE]) for model, part in few for at in range(0, len(part), PIECE)]
    nx = cases[0][1].states.shape[2]
    seed, scale = int(rng.integers(2**32)), np.ones(nx)
    for _ in range(rounds):
        parts = []
        for number, (model, windows) in enumerate(noisy):
            still()
            model.noise_scale_ = scale
            drawn = model.simulate(
                windows.past_states,
                windows.past_controls,
                windows.controls,
                samples=ONE_SCALE_SAMPLES,
                rng=np.random.default_rng([seed, number]),
            )
            parts.append(normalised_errors(drawn[:, :, -1], windows.states[:, -1], share=share))
        errors = np.concatenate(parts)
        level = min(1.0, share * (len(errors) + 1) / len(errors))
        scale = np.clip(scale * np.quantile(errors, level, axis=0, method="higher"), SMALLEST_SCALE, LARGEST_SCALE)
    return scale


def with_noise(model: Noisy) -> Noisy:
    """Return a copy of the fitted ``model`` with ``stochastic`` on."""
    return model.variant(stochastic=True)


def normalised_errors(samples: Array, truth: Array, *, share: float = SHARE) -> Array:
    """Return by how much (N, nx) the central ``share`` of ``samples`` (S, N, nx) must grow to hold ``truth`` (N, nx).

    It grows about the median, each side in proportion to its own length: 1 is a truth on its edge.
    """
    low, middle, high = np.quantile(samples, [0.5 - share / 2, 0.5, 0.5 + share / 2], axis=0, method="weibull")
    off = truth - middle
    side = np.where(off > 0, high - middle, middle - low)
    return np.divide(np.abs(off), side, out=np.where(off == 0, 0.0, np.inf), where=side > 0)


BLOCK_FOLDS = 2
"""Folds of blocks of time of recordings that were seen."""


def rough_fits(dataset: Dataset) -> int:
    """Number of times that `growth_on_unseen_recordings` fits."""
    groups = len(recording_folds(dataset))
    return groups + BLOCK_FOLDS if groups else 0


def growth_on_unseen_recordings(
    fit: Callable[[Dataset], Simulator], dataset: Dataset, *, share: float = SHARE, steps: Sequence[int] | None = None
) -> Array:
    """Return by what factor (nx,) errors on a recording never seen exceed those on held-out blocks of time.

    With ``steps``, the factors after so many of them, (len(steps), nx); those that no block is long enough for have
    that of the longest. Both are the ``share`` quantile of the error after one second of what ``fit`` learns from
    the rest:
    a recording differs from others by the battery, the tyres or the floor, which blocks of the same
    recording share. The factor is the geometric mean over the recordings held out in turn, at least 1.
    """
    groups = recording_folds(dataset)
    if not groups:
        return np.ones(dataset.system.nx) if steps is None else np.ones((len(steps), dataset.system.nx))
    inside = [(fit(seen), held) for seen, held in (time_fold(dataset, k) for k in range(BLOCK_FOLDS))]
    outside = [(fit(seen), held) for seen, held in groups]
    factors: list[Array] = []
    for step in [None] if steps is None else steps:
        within = [_last_errors(model, held, step) for model, held in inside]
        across = [_last_errors(model, held, step) for model, held in outside]
        if any(len(errors) == 0 for errors in (np.concatenate(within), *across)):
            factors.append(factors[-1] if factors else np.ones(dataset.system.nx))
            continue
        seen_before = np.quantile(np.concatenate(within), share, axis=0)
        never_seen = np.maximum([np.quantile(errors, share, axis=0) for errors in across], np.finfo(float).tiny)
        factor = np.exp(np.mean(np.log(never_seen), axis=0)) / np.where(seen_before > 0, seen_before, np.inf)
        factors.append(np.maximum(factor, 1.0))
    return factors[0] if steps is None else np.stack(factors)


def _last_errors(model: Simulator, held: Dataset, step: int | None) -> Array:
    """Return the absolute errors (N, nx) after so many steps; None is one second."""
    if step is None:
        windows = error_windows(held, model.n_lags)
    else:
        windows = held.windows(step, stride=STRIDE, history=model.n_lags, moving=True)
        if not len(windows):
            return np.empty((0, held.system.nx))
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    return np.abs(simulated[:, -1] - windows.states[:, -1])
