"""Held-out blocks of time of every episode, and the choice of hyper-parameters by simulations of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self, TypeVar

import numpy as np

from sysid_evo.data.dataset import Dataset
from sysid_evo.types import Array
from sysid_evo.validation.folds import FOLDS, time_fold
from sysid_evo.validation.simulation_error import STRIDE, Simulator, error_windows, relative_error

DIVERGED = 1e6
"""Error added for a fold in which a simulation diverges."""

EQUAL_SHARE = 0.05
"""A smaller model may be worse than the best by this share of its error."""
NEGLIGIBLE_ERROR = 0.02
"""Smaller simulation errors, in standard deviations, count as this."""
Choice = TypeVar("Choice")


class ClippedSimulator(Simulator, Protocol):
    """A fitted model whose simulations are clipped to bounds from its training data."""

    state_bounds_: Array


@dataclass(frozen=True)
class HeldOutError:
    """Simulation error of settings on held-out data: pairs of training and held-out data."""

    dataset: Dataset
    folds: tuple[tuple[Dataset, Dataset], ...]

    @classmethod
    def of(cls, dataset: Dataset, folds: int = FOLDS) -> Self:
        """Return the first ``folds`` of three folds of blocks of time."""
        return cls(dataset, tuple(time_fold(dataset, fold) for fold in range(folds)))

    @cached_property
    def far(self) -> Array:
        """Twice the largest value of each state, (nx,); a simulation that reaches it counts as diverged."""
        return 2.0 * np.abs(np.concatenate([episode.states for episode in self.dataset.episodes])).max(axis=0)

    def error(
        self,
        learn: Callable[[Dataset], ClippedSimulator],
        *,
        stride: int = STRIDE,
        report: Callable[[], None] = lambda: None,
    ) -> float:
        """Return the sum over folds of the simulation error on held-out data of the model that ``learn`` returns.

        Each error is at least `NEGLIGIBLE_ERROR`: without noise, a model with lags can have an even smaller error but
        fail at the start of a trial or at a limit, where its history differs from the recordings. A fold in which a
        simulation diverges adds 1e6, so that such a setting is chosen only if all diverge. ``report`` is called after
        each fold.
        """
        total = 0.0
        for learned, held in self.folds:
            model = learn(learned)
            windows = error_windows(held, model.n_lags, stride=stride)
            simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
            total += max(NEGLIGIBLE_ERROR, relative_error(model.system, simulated, windows))
            total += DIVERGED if self.diverges(model, simulated) else 0.0
            report()
        return total

    def diverges(self, model: ClippedSimulator, simulated: Array) -> bool:
        """Whether a simulation reaches twice the largest training value of a state, or the bounds of the model."""
        low, high = model.state_bounds_
        far = np.where(np.isfinite(high), self.far, np.inf)  # a periodic state cannot diverge
        return bool(((np.abs(simulated) >= far) | (simulated <= low) | (simulated >= high)).any())


def best_candidate(
    candidates: Sequence[Choice], error: Callable[[Choice], float], *, size: Callable[[Choice], float] | None = None
) -> Choice:
    """Return the candidate with the lowest error, the first of equal ones; a single candidate is not tested.

    With ``size``, which is called after ``error``, the smallest of those whose error is within 5 % of the lowest.
    """
    if len(candidates) == 1:
        return candidates[0]
    errors = np.array([error(candidate) for candidate in candidates])
    if size is None:
        return candidates[int(np.argmin(errors))]
    sizes = np.array([size(candidate) for candidate in candidates])
    return candidates[int(np.argmin(np.where(errors <= (1.0 + EQUAL_SHARE) * errors.min(), sizes, np.inf)))]


def count_fits(candidates: Sequence[Choice]) -> int:
    """Return the number of candidates that `best_candidate` tests."""
    return len(candidates) if len(candidates) > 1 else 0


def lag_candidates(
    state_lags: int | None,
    control_lags: int | None,
    options: Sequence[tuple[int, int]] = ((0, 0), (0, 3), (1, 3), (2, 4)),
) -> list[tuple[int, int]]:
    """Return the pairs of state and control lags to try: ``options``, with given lags fixed."""
    pairs = [
        (states if state_lags is None else state_lags, controls if control_lags is None else control_lags)
        for states, controls in options
    ]
    return list(dict.fromkeys(pairs))
