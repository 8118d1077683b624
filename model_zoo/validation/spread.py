"""How far a prediction may be off: the noise of every step, scaled on measured free runs (conformal calibration)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.cross_validation import EpisodeFold, recording, time_blocks
from sysid_evo.data import Dataset, Windows
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.free_run import STRIDE, judging_windows

SAMPLES = 30
SHARE = 0.9
MOST_WINDOWS = 150
MOST_GROUPS = 4
BLOCK_FOLDS = 2
LONE_FOLDS = 3
ROUNDS = 3
PIECE = 40
SMALLEST, LARGEST = 0.1, 10.0


def conformal_scale(
    cases: Sequence[tuple[DynamicsModel, Windows]],
    rng: np.random.Generator,
    *,
    share: float = SHARE,
    rounds: int = ROUNDS,
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
    few = [(with_noise(model), _evenly(windows, MOST_WINDOWS // len(cases))) for model, windows in cases]
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
                samples=SAMPLES,
                rng=np.random.default_rng([seed, number]),
            )
            parts.append(normalised_errors(drawn[:, :, -1], windows.states[:, -1], share=share))
        errors = np.concatenate(parts)
        level = min(1.0, share * (len(errors) + 1) / len(errors))
        scale = np.clip(scale * np.quantile(errors, level, axis=0, method="higher"), SMALLEST, LARGEST)
    return scale


def _evenly(windows: Windows, most: int) -> Windows:
    """Return up to ``most`` windows, evenly spread."""
    if len(windows) <= most:
        return windows
    return windows[np.linspace(0, len(windows) - 1, most).astype(np.int64)]


def with_noise(model: DynamicsModel) -> DynamicsModel:
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


def unseen_recordings(dataset: Dataset) -> list[tuple[Dataset, Dataset]]:
    """Return (seen, held out) for up to 4 groups of recordings in turn, pieces of one together; none if it is alone."""
    recordings = len({recording(name) for name in dataset.names})
    if recordings < 2:
        return []
    folds = EpisodeFold(min(MOST_GROUPS, recordings)).split(dataset)
    return [(dataset[list(seen)], dataset[list(held)]) for seen, held in folds]


def unseen_parts(dataset: Dataset) -> list[tuple[Dataset, Dataset]]:
    """Return what `unseen_recordings` does, or for one recording alone its held-out blocks of time in turn."""
    return unseen_recordings(dataset) or [time_blocks(dataset, fold) for fold in range(LONE_FOLDS)]


def rough_fits(dataset: Dataset) -> int:
    """Number of times that `growth_on_unseen_recordings` fits."""
    groups = len(unseen_recordings(dataset))
    return groups + BLOCK_FOLDS if groups else 0


def growth_on_unseen_recordings(
    fit: Callable[[Dataset], DynamicsModel],
    dataset: Dataset,
    *,
    share: float = SHARE,
    steps: Sequence[int] | None = None,
) -> Array:
    """Return by what factor (nx,) errors on a recording never seen exceed those on held-out blocks of time.

    With ``steps``, the factors after so many of them, (len(steps), nx); those that no block is long enough for have
    that of the longest. Both are the ``share`` quantile of the error after one second of what ``fit`` learns from
    the rest:
    a recording differs from others by the battery, the tyres or the floor, which blocks of the same
    recording share. The factor is the geometric mean over the recordings held out in turn, at least 1.
    """
    groups = unseen_recordings(dataset)
    if not groups:
        return np.ones(dataset.system.nx) if steps is None else np.ones((len(steps), dataset.system.nx))
    inside = [(fit(seen), held) for seen, held in (time_blocks(dataset, k) for k in range(BLOCK_FOLDS))]
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


def _last_errors(model: DynamicsModel, held: Dataset, step: int | None) -> Array:
    """Return the absolute errors (N, nx) after so many steps; None is one second."""
    if step is None:
        windows = judging_windows(held, model.n_lags)
    else:
        windows = held.windows(step, stride=STRIDE, history=model.n_lags, moving=True)
        if not len(windows):
            return np.empty((0, held.system.nx))
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    return np.abs(simulated[:, -1] - windows.states[:, -1])
