"""Calibration of prediction intervals on held-out simulations.

Intervals are calibrated if they contain a given share of the held-out truth. The noise of a step is therefore scaled,
with a scale for each time span between several horizons (`horizon_scales`), and where a model is wrong before the start
of a run, more (`RecentErrors`). Errors on an unseen recording are larger than on held-out blocks of a seen one, by the
factor `growth_on_unseen_recordings`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist
from typing import Protocol, TypeVar

import numpy as np

from sysid_evo.carry import clip_state, pad_history, recent
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.trajectory import Windows, evenly_spaced
from sysid_evo.types import Array, BoolArray, IntArray
from sysid_evo.validation.folds import recording_folds, time_fold
from sysid_evo.validation.simulation_error import STRIDE, Fitted, Simulator

HORIZONS = (1, 10, 20, 60)
"""Steps at which intervals are calibrated, and at which their coverage is measured."""
SHARE = 0.9
"""Share of the truth that an interval must contain."""

MAX_WINDOWS, FEWEST = 120, 20
"""Number of windows of all cases together, and the least number for a horizon, which is left out otherwise."""

SAMPLES, ROUNDS = 16, 2

POOLED_WEIGHT = 0.5
"""Weight of the spread of all windows in that of a single one, which is estimated from few samples."""
SMALLEST, LARGEST = 0.02, 20.0
"""Range of factors by which a round may change a scale."""
LAGS = range(2, 6)
"""Lags at which residuals are correlated by model errors but not by measurement noise."""

RECORDING_GAP = 10
"""Gap between the sample numbers of two recordings, larger than `LAGS`."""


class NoisySteps(Fitted, Protocol):
    """A fitted model whose steps can be disturbed."""

    def initial_carry(self, states: Array, controls: Array) -> Array:
        """Return the carry after a history."""
        ...

    def disturbed(self, carry: Array, control: Array, disturbance: Array) -> Array:
        """Return the next carry, with ``disturbance`` (B, nx), in deviations, added to the state."""
        ...


Steps = TypeVar("Steps", bound=NoisySteps)


@dataclass(frozen=True)
class Case:
    """A model, windows of its held-out data, and a mask of their targets (N, H) in motion.

    ``noisy`` is the model whose noise is calibrated on the errors of ``model``: the same one, or that of all data.
    """

    model: NoisySteps
    windows: Windows
    moving: BoolArray
    noisy: NoisySteps

    @classmethod
    def of(cls, model: NoisySteps, part: Dataset, horizon: int, most: int, *, noisy: NoisySteps | None = None) -> Case:
        """Return the case of at most ``most`` evenly spaced windows of ``horizon`` steps of ``part`` in motion."""
        noisy = noisy or model
        cut = part.windows(horizon, stride=1, history=max(model.n_lags, noisy.n_lags), moving=True)
        cut = cut[evenly_spaced(len(cut), most)]
        begins = np.cumsum([0, *(len(rows) for rows in part.moving)])[:-1]
        ahead = cut.start[:, None] + 1 + np.arange(cut.states.shape[1])
        moves = (
            np.concatenate(part.moving)[begins[cut.episode][:, None] + ahead] if len(cut) else np.empty((0, 0), bool)
        )
        return cls(model, cut, moves, noisy)


RECENT = 20
"""Number of measured steps before a start whose errors widen the intervals of the run."""
MEDIAN_SQUARE = 0.455
"""The median of the square of a standard normal number."""


@dataclass(frozen=True)
class RecentErrors:
    """Errors (N, 20, nx) of a simulation of the last 20 measured steps, and the steps (N, 20) since then.

    The steps are 0, and the error is not used, while the history only repeats its first state under neutral controls:
    then it was padded, or the robot is at rest.
    """

    errors: Array
    steps: IntArray

    @classmethod
    def of(cls, model: NoisySteps, states: Array, controls: Array) -> RecentErrors:
        """Simulate the end of a history (N, L + 1, nx), (N, L, nu) of 20 samples more than ``model`` needs."""
        system, lags = model.system, model.n_lags
        states, controls = recent(states, controls, lags + RECENT)
        repeated = (states == states[:, :1]).all(axis=2)[:, 1:] & (controls == system.neutral_control).all(axis=2)
        idle = np.logical_and.accumulate(repeated, axis=1)[:, lags:]
        errors, steps = np.zeros((len(states), RECENT, system.nx)), np.zeros((len(states), RECENT), dtype=np.int64)
        nothing, carry = np.zeros((len(states), system.nx)), np.empty(0)
        with np.errstate(all="ignore"):
            for k in range(RECENT):
                measured = model.initial_carry(states[:, k : k + lags + 1], controls[:, k : k + lags])
                carry = np.where(idle[:, k - 1, None], measured, carry) if k else measured
                carry = model.disturbed(carry, controls[:, lags + k], nothing)
                carry = clip_state(carry, model.state_bounds)[0]
                errors[:, k] = system.difference(states[:, lags + k + 1], carry[:, : system.nx])
                steps[:, k] = np.where(idle[:, k], 0, (steps[:, k - 1] if k else 0) + 1)
        return cls(errors, steps)

    @classmethod
    def before(cls, case: Case, part: Dataset) -> RecentErrors:
        """Return the errors before the windows of ``case``, which are those of ``part``."""
        count, idle = case.model.n_lags + RECENT, part.system.neutral_control
        histories = []
        for number, start in zip(case.windows.episode, case.windows.start, strict=True):
            episode, first = part.episodes[number], max(0, start - count)
            given = episode.states[first : start + 1], episode.controls[first:start]
            histories.append(pad_history(*given, count, idle))
        return cls.of(case.model, *(np.stack(arrays) for arrays in zip(*histories, strict=True)))

    @staticmethod
    def usual(parts: Sequence[RecentErrors]) -> Array:
        """Return the usual error (20, nx) after each number of steps; it never falls.

        It is the standard deviation of normal errors with the same median square, which a few divergent runs do not
        change.
        """
        errors, steps = (np.concatenate([getattr(part, name) for part in parts]) for name in ("errors", "steps"))
        found = [errors[steps == k + 1] for k in range(RECENT)]
        medians = [np.median(each**2, axis=0) if len(each) else np.zeros(errors.shape[2]) for each in found]
        return np.sqrt(np.maximum.accumulate(np.nan_to_num(medians)) / MEDIAN_SQUARE)

    def factor(self, usual: Array) -> Array:
        """Return the factor (N, 1) of the noise: the root mean square of error / ``usual`` error, at least 1.

        Steps that were not simulated count like usual ones; so do states without any usual error.
        """
        unit = usual[np.maximum(self.steps - 1, 0)]
        ratios = np.divide(self.errors, unit, out=np.ones_like(self.errors), where=unit > 0)
        squares = np.where(self.steps[:, :, None] > 0, ratios**2, 1.0).mean(axis=(1, 2))
        return np.sqrt(np.maximum(np.nan_to_num(squares, nan=1.0), 1.0))[:, None]


def usable_horizon(parts: Sequence[Dataset], history: int) -> int:
    """Return the longest of `HORIZONS` with enough windows in all ``parts`` together."""
    for horizon in reversed(HORIZONS):
        if sum(len(part.windows(horizon, stride=4, history=history, moving=True)) for part in parts) >= FEWEST:
            return horizon
    return HORIZONS[0]


def segments(horizon: int) -> list[tuple[int, int]]:
    """Return the first and last step of every time span with its own scale, up to ``horizon``."""
    edges = [0, *(step for step in HORIZONS if step <= horizon)]
    return list(pairwise(edges))


def step_spread(
    cases: Sequence[tuple[Steps, Dataset]], step: Callable[[Steps, Array, Array], Array]
) -> tuple[Array, Array]:
    """Return the error (nx,) of one ``step`` (model, carry, control), and its `persistent_share` (nx,).

    ``cases`` are models, each with its held-out data.
    """
    errors, numbers, begin = [], [], 0
    for model, part in cases:
        windows = part.windows(1, history=model.n_lags)
        carry = model.initial_carry(windows.past_states, windows.past_controls)
        after = step(model, carry, windows.controls[:, 0])
        errors.append(part.system.difference(windows.states[:, 0], after[:, : part.system.nx]))
        longest = max(len(episode) for episode in part) + RECORDING_GAP
        numbers.append(begin + windows.start + windows.episode * longest)
        begin += longest * len(part)
    pooled = np.concatenate(errors)
    return np.sqrt(np.mean(pooled**2, axis=0)), persistent_share(pooled, np.concatenate(numbers))


def persistent_share(residuals: Array, sample: Array) -> Array:
    """Return the share (nx,) of the variance of one-step errors that is constant from step to step.

    ``residuals`` (N, nx) are errors of single steps with the numbers ``sample`` (N,). The part that is still correlated
    after two to five steps is persistent; measurement noise is anticorrelated between neighbours, the rest is white.
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
    heartbeat: Callable[[], None] = lambda: None,
) -> Array:
    """Return the noise of every step in deviations (4, nx), for each time span between 0 and `HORIZONS`.

    The noise between two horizons is chosen so that at the later one 90 % of all windows lie inside (split
    conformal prediction: Lei et al. 2018), given the variance from earlier noise. The part ``persistent`` (nx,) of its
    variance is drawn once for a run. Time spans beyond the longest window have the last scale.
    """
    z = NormalDist().inv_cdf(0.5 + SHARE / 2)
    nx, seed = cases[0].windows.states.shape[2], int(rng.integers(2**32))
    runs = [_Run(case, persistent, (seed, i)) for i, case in enumerate(cases) if len(case.windows)]
    scales = np.ones((len(HORIZONS), nx))
    stretches = segments(max(run.horizon for run in runs))
    for number, (first, last) in enumerate(stretches):
        scale = scales[max(number - 1, 0)].copy()
        squares = [(run.error(last) / z) ** 2 for run in runs]
        before = [run.to(first, last, np.zeros(nx))[1] if first else np.zeros_like(run.error(last)) for run in runs]
        for _ in range(ROUNDS):
            heartbeat()
            wanted = []
            for run, square, earlier in zip(runs, squares, before, strict=True):
                variance = run.to(first, last, scale)[1]
                variance = (1.0 - POOLED_WEIGHT) * variance + POOLED_WEIGHT * variance.mean(axis=0)
                added = np.maximum(variance - earlier, 1e-6 * variance + np.finfo(float).tiny)
                wanted.append(((square - earlier) / added)[run.counts(last)])
            scale = scale * _factor(np.concatenate(wanted))
        for run in runs:
            run.go(first, last, scale)
        scales[number] = scale
    scales[len(stretches) :] = scales[len(stretches) - 1]
    return scales


def _factor(wanted: Array) -> Array:
    """Return the factor (nx,) of new noise with which 90 % of the targets lie inside.

    ``wanted`` (N, nx) is the requirement of each target: its square, minus the earlier variance, over the added one.
    """
    level = min(1.0, SHARE * (len(wanted) + 1) / len(wanted))
    return np.clip(np.sqrt(np.maximum(np.quantile(wanted, level, axis=0, method="higher"), 0.0)), SMALLEST, LARGEST)


def _started(model: NoisySteps, windows: Windows) -> Array:
    return model.initial_carry(*recent(windows.past_states, windows.past_controls, model.n_lags))


def _next(model: NoisySteps, carry: Array, control: Array, disturbance: Array) -> Array:
    return clip_state(model.disturbed(carry, control, disturbance), model.state_bounds)[0]


class _Run:
    """The samples of one case, simulated from horizon to horizon."""

    def __init__(self, case: Case, persistent: Array, seed: tuple[int, int]) -> None:
        windows = case.windows
        self.case, self.horizon, self.seed = case, windows.controls.shape[1], seed
        self.centre = self._alone()
        carry = _started(case.noisy, windows)
        self.carry, self.count = np.tile(carry, (SAMPLES, 1)), len(carry)
        self.white, self.lasting = np.sqrt(1.0 - persistent), np.sqrt(persistent)
        self.held = np.random.default_rng(seed).standard_normal((len(self.carry), windows.states.shape[2]))

    def _alone(self) -> Array:
        """Return the states (N, H, nx) of the run without noise."""
        windows, found = self.case.windows, np.empty_like(self.case.windows.states)
        carry, nothing = _started(self.case.model, windows), np.zeros((len(windows), windows.states.shape[2]))
        for k in range(self.horizon):
            carry = _next(self.case.model, carry, windows.controls[:, k], nothing)
            found[:, k] = carry[:, : found.shape[2]]
        return found

    def counts(self, last: int) -> BoolArray:
        """Return a mask (N,) of the targets to use at a horizon: those in motion, or all if there are none."""
        rows = self.case.moving[:, last - 1]
        return rows if rows.any() else np.ones(self.count, dtype=bool)

    def error(self, last: int) -> Array:
        """Return the errors (N, nx) at a horizon of the run without noise."""
        truth = self.case.windows.states[:, last - 1]
        return np.abs(self.case.model.system.difference(truth, self.centre[:, last - 1]))

    def to(self, first: int, last: int, scale: Array) -> tuple[Array, Array]:
        """Return the carries at a horizon, and the variance (N, nx) of their states; the noise is always the same."""
        controls, carry = self.case.windows.controls, self.carry
        rng = np.random.default_rng([*self.seed, last])
        for k in range(first, last):
            noise = self.white * rng.standard_normal(self.held.shape) + self.lasting * self.held
            carry = _next(self.case.noisy, carry, np.tile(controls[:, k], (SAMPLES, 1)), scale * noise)
        states = carry[:, : len(scale)].reshape(SAMPLES, self.count, -1)
        return carry, states.var(axis=0, ddof=1)

    def go(self, first: int, last: int, scale: Array) -> None:
        """Continue the simulation to a horizon."""
        self.carry = self.to(first, last, scale)[0]


BLOCK_FOLDS = 2
"""Number of folds of blocks of time of seen recordings."""


def rough_fits(dataset: Dataset) -> int:
    """Return the number of fits in `growth_on_unseen_recordings`."""
    groups = len(recording_folds(dataset))
    return groups + BLOCK_FOLDS if groups else 0


def growth_on_unseen_recordings(fit: Callable[[Dataset], Simulator], dataset: Dataset) -> Array:
    """Return the factor (4, nx) by which errors on an unseen recording exceed those on held-out blocks of time.

    Errors are the 90 % quantile after each of `HORIZONS` of the model that ``fit`` returns for the rest; horizons
    beyond the longest block get its factor. A recording differs from others by battery, tyres or floor, which are the
    same for blocks of one recording. The factor is the geometric mean over the recordings held out in turn, at least 1.
    """
    groups = recording_folds(dataset)
    if not groups:
        return np.ones((len(HORIZONS), dataset.system.nx))
    inside = [(fit(seen), held) for seen, held in (time_fold(dataset, k) for k in range(BLOCK_FOLDS))]
    outside = [(fit(seen), held) for seen, held in groups]
    factors: list[Array] = []
    for step in HORIZONS:
        within = [_last_errors(model, held, step) for model, held in inside]
        across = [_last_errors(model, held, step) for model, held in outside]
        if any(len(errors) == 0 for errors in (np.concatenate(within), *across)):
            factors.append(factors[-1] if factors else np.ones(dataset.system.nx))
            continue
        seen_errors = np.quantile(np.concatenate(within), SHARE, axis=0)
        unseen_errors = np.maximum([np.quantile(errors, SHARE, axis=0) for errors in across], np.finfo(float).tiny)
        factor = np.exp(np.mean(np.log(unseen_errors), axis=0)) / np.where(seen_errors > 0, seen_errors, np.inf)
        factors.append(np.maximum(factor, 1.0))
    return np.stack(factors)


def _last_errors(model: Simulator, held: Dataset, step: int) -> Array:
    """Return the absolute errors (N, nx) after ``step`` steps."""
    windows = held.windows(step, stride=STRIDE, history=model.n_lags, moving=True)
    if not len(windows):
        return np.empty((0, held.system.nx))
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    return np.abs(simulated[:, -1] - windows.states[:, -1])
