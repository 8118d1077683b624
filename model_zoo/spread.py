"""How far a prediction may be off: the noise of every step, scaled on measured free runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields

import numpy as np
from sklearn.base import clone

from model_zoo.validation import time_blocks, validation_windows
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset, Windows
from sysid_evo.dynamics import DynamicsModel

SAMPLES = 40
SHARE = 0.9
MOST_WINDOWS = 200
MOST_GROUPS = 4
BLOCK_FOLDS = 2


def calibrated_scale(
    model: DynamicsModel, windows: Windows, rng: np.random.Generator, *, share: float = SHARE, rounds: int = 6
) -> Array:
    """Return the ``noise_scale_`` (nx,) with which ``share`` of the last states of ``windows`` lie inside.

    ``model`` is fitted, has the hyper-parameter ``stochastic`` and multiplies its noise with
    ``noise_scale_``. Every channel is found by bisection in the logarithm, between 0.1 and 30; the
    same noise is drawn each time.
    """
    few = windows[:: max(1, len(windows) // MOST_WINDOWS)]
    noisy = clone(model).set_params(stochastic=True)
    noisy.__dict__.update({name: value for name, value in vars(model).items() if name.endswith("_")})
    seed = int(rng.integers(2**32))
    nx = windows.states.shape[2]
    low, high = np.full(nx, np.log(0.1)), np.full(nx, np.log(30.0))
    for _ in range(rounds):
        middle = 0.5 * (low + high)
        noisy.noise_scale_ = np.exp(middle)
        drawn = noisy.simulate(
            few.past_states, few.past_controls, few.controls, samples=SAMPLES, rng=np.random.default_rng(seed)
        )
        wide = coverage(drawn[:, :, -1], few.states[:, -1], share=share) >= share
        low, high = np.where(wide, low, middle), np.where(wide, middle, high)
    return np.exp(0.5 * (low + high))


def unseen_recordings(dataset: Dataset) -> list[list[str]]:
    """Return up to 4 groups of recordings to hold out in turn, pieces of one together; none if it is alone."""
    recordings = list(dict.fromkeys(name.split("[")[0] for name in dataset.names))
    if len(recordings) < 2:
        return []
    groups = np.array_split(np.array(recordings, dtype=object), min(MOST_GROUPS, len(recordings)))
    return [list(group) for group in groups]


def rough_fits(dataset: Dataset) -> int:
    """Number of times that `growth_on_unseen_recordings` fits."""
    groups = len(unseen_recordings(dataset))
    return groups + BLOCK_FOLDS if groups else 0


def growth_on_unseen_recordings(
    fit: Callable[[Dataset], DynamicsModel], dataset: Dataset, *, share: float = SHARE
) -> Array:
    """Return by what factor (nx,) errors on a recording never seen exceed those on held-out blocks of time.

    Both are the ``share`` quantile of the error after one second of what ``fit`` learns from the rest:
    a recording differs from others by the battery, the tyres or the floor, which blocks of the same
    recording share. The factor is the median over the recordings held out in turn, each weighing as
    many samples as it has, at least 1.
    """
    groups = unseen_recordings(dataset)
    if not groups:
        return np.ones(dataset.system.nx)
    blocks = [_last_errors(fit(seen), held) for seen, held in (time_blocks(dataset, k) for k in range(BLOCK_FOLDS))]
    within = np.quantile(np.concatenate(blocks), share, axis=0)
    across, weights = [], []
    for group in groups:
        seen, held = dataset.split(group)
        across.append(np.quantile(_last_errors(fit(seen), held), share, axis=0))
        weights.append(held.n_steps)
    middle = weighted_median(np.array(across), np.array(weights, dtype=float))
    return np.maximum(middle / np.where(within > 0, within, np.inf), 1.0)


def weighted_median(values: Array, weights: Array) -> Array:
    """Return for each column of ``values`` (N, n) the lowest that reaches half of the ``weights`` (N,)."""
    order = np.argsort(values, axis=0)
    reached = np.cumsum(weights[order], axis=0) >= 0.5 * weights.sum()
    return np.take_along_axis(np.take_along_axis(values, order, axis=0), reached.argmax(axis=0)[None], axis=0)[0]


def _last_errors(model: DynamicsModel, held: Dataset) -> Array:
    """Return the absolute errors (N, nx) after one second."""
    windows = validation_windows(held, model.n_lags)
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    return np.abs(simulated[:, -1] - windows.states[:, -1])


def coverage(samples: Array, truth: Array, *, share: float = SHARE) -> Array:
    """Return how much of ``truth`` (N, nx) lies in the central ``share`` of ``samples`` (S, N, nx), (nx,)."""
    low, high = np.quantile(samples, [0.5 - share / 2, 0.5 + share / 2], axis=0)
    return ((truth >= low) & (truth <= high)).mean(axis=0)


def joined(parts: Sequence[Windows]) -> Windows:
    """Return windows of equal length from several sources, those of the shortest horizon deciding."""
    horizon = min(part.controls.shape[1] for part in parts)
    cut = {"controls", "states"}
    columns = {
        field.name: np.concatenate(
            [
                getattr(part, field.name)[:, :horizon] if field.name in cut else getattr(part, field.name)
                for part in parts
            ]
        )
        for field in fields(Windows)
    }
    return Windows(**columns)
