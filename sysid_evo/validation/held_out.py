"""Blocks of time held out of every episode, and the choice of hyper-parameters by free runs on them."""

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
"""What a fold counts in which a free run diverges."""

AS_GOOD = 0.05
"""Share of the lowest error by which a smaller model may be worse."""
GOOD = 0.02
"""A simulation error, in standard deviations, that is as good as none."""
Choice = TypeVar("Choice")


class ClippedSimulator(Simulator, Protocol):
    """A fitted model whose simulations end at limits that its training data set."""

    state_bounds_: Array


@dataclass(frozen=True)
class HeldOutError:
    """Pairs of what is learned from and what is held out, by which settings are judged."""

    dataset: Dataset
    folds: tuple[tuple[Dataset, Dataset], ...]

    @classmethod
    def of(cls, dataset: Dataset, folds: int = FOLDS) -> Self:
        """Hold out the first ``folds`` of three folds of blocks of time."""
        return cls(dataset, tuple(time_fold(dataset, fold) for fold in range(folds)))

    @cached_property
    def far(self) -> Array:
        """Twice the largest value of each state, (nx,): a free run that gets there diverges."""
        return 2.0 * np.abs(np.concatenate([episode.states for episode in self.dataset.episodes])).max(axis=0)

    def error(
        self,
        learn: Callable[[Dataset], ClippedSimulator],
        *,
        stride: int = STRIDE,
        told: Callable[[], None] = lambda: None,
    ) -> float:
        """Return the simulation errors on what is held out of each fold of what ``learn`` makes of the rest, summed.

        Each is at least `GOOD`: in recordings without noise a model with lags can be a little better still, and fails
        where a trial begins or a state meets a limit, for there its past is no longer that of the recordings.
        A fold in which a free run diverges counts 1e6 more: such a setting is chosen only if all diverge. ``told``
        is called after each fold.
        """
        total = 0.0
        for learned, held in self.folds:
            model = learn(learned)
            windows = error_windows(held, model.n_lags, stride=stride)
            simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
            total += max(GOOD, relative_error(model.system, simulated, windows))
            total += DIVERGED if self.diverges(model, simulated) else 0.0
            told()
        return total

    def diverges(self, model: ClippedSimulator, simulated: Array) -> bool:
        """Whether a free run reaches twice the largest training value of a state, or the model's own clip."""
        low, high = model.state_bounds_
        far = np.where(np.isfinite(high), self.far, np.inf)  # a periodic state cannot get far
        return bool(((np.abs(simulated) >= far) | (simulated <= low) | (simulated >= high)).any())


def best_candidate(
    candidates: Sequence[Choice], error: Callable[[Choice], float], *, size: Callable[[Choice], float] | None = None
) -> Choice:
    """Return the candidate with the lowest error, the first among equals; one alone is taken untried.

    With ``size``, asked after the error, the smallest of those whose error is within 5 % of the lowest.
    """
    if len(candidates) == 1:
        return candidates[0]
    errors = np.array([error(candidate) for candidate in candidates])
    if size is None:
        return candidates[int(np.argmin(errors))]
    sizes = np.array([size(candidate) for candidate in candidates])
    return candidates[int(np.argmin(np.where(errors <= (1.0 + AS_GOOD) * errors.min(), sizes, np.inf)))]


def count_fits(candidates: Sequence[Choice]) -> int:
    """Return how many candidates `best_candidate` tries."""
    return len(candidates) if len(candidates) > 1 else 0


def lag_candidates(
    state_lags: int | None,
    control_lags: int | None,
    offered: Sequence[tuple[int, int]] = ((0, 0), (0, 3), (1, 3), (2, 4)),
) -> list[tuple[int, int]]:
    """Return the pairs of state and control lags to try: those ``offered``, with what is given kept fixed."""
    pairs = [
        (states if state_lags is None else state_lags, controls if control_lags is None else control_lags)
        for states, controls in offered
    ]
    return list(dict.fromkeys(pairs))
