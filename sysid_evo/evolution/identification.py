"""Fitting a model's parameters by evolution on its multi-step error (paper, section 4.2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data import Dataset, Windows
from sysid_evo.errors import InvalidData
from sysid_evo.evolution.loop import evolve
from sysid_evo.evolution.mu_plus_lambda import MuPlusLambda
from sysid_evo.progress import Progress

PopulationStep: TypeAlias = Callable[[Array, Array, Array], Array]
"""(P, n) parameters, (P, W, nx) states, (W, nu) controls -> (P, W, nx) next states."""

CHOICE_WINDOWS = 500


@dataclass(frozen=True)
class ModelEvolution:
    """A 50+50 strategy on the error after ``horizon`` steps from ``windows`` random starts.

    The fitness of a candidate is minus the mean square difference between the simulated and the
    recorded state ``horizon`` steps after the start. All candidates of a generation meet the same
    windows, the next generation new ones, and parents are evaluated again. The winner is the best
    of the last parents on up to 500 windows spread evenly over the data.
    """

    generations: int = 1000
    windows: int = 100
    horizon: int = 10
    parents: int = 50
    children: int = 50
    sigma: float = 0.1

    def run(
        self,
        step: PopulationStep,
        dataset: Dataset,
        *,
        initial: Array,
        spread: float,
        rng: np.random.Generator,
        progress: Progress | None = None,
    ) -> Array:
        """Return the best parameters found, (n,), starting around ``initial`` (n,)."""
        every = dataset.windows(self.horizon)
        if not len(every):
            raise InvalidData(f"data set: no episode is longer than {self.horizon} steps, the horizon of the fit")
        seed = int(rng.integers(2**32))
        strategy = MuPlusLambda(
            n_parameters=len(initial),
            seed=seed,
            parents=self.parents,
            children=self.children,
            sigma=self.sigma,
            spread=spread,
            initial=initial,
        )

        def objective(population: Array, generation: int) -> Array:
            draw = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(generation,)))
            return -final_error(step, population, every[draw.integers(len(every), size=self.windows)])

        for generation in evolve(strategy, objective, self.generations):
            if progress is not None:
                progress(generation.index + 1, self.generations)
        evenly = np.unique(np.linspace(0, len(every) - 1, CHOICE_WINDOWS).astype(np.int64))
        return strategy.elite[int(np.argmin(final_error(step, strategy.elite, every[evenly])))]


def final_error(step: PopulationStep, population: Array, windows: Windows) -> Array:
    """Return the mean square difference (P,) of the last state of ``windows``; the largest number where it diverges."""
    state = np.repeat(windows.start_states[None], len(population), axis=0)
    with np.errstate(all="ignore"):
        for k in range(windows.controls.shape[1]):
            state = step(population, state, windows.controls[:, k])
        error = np.mean((state - windows.states[:, -1]) ** 2, axis=(1, 2))
    return np.where(np.isfinite(error), error, np.finfo(float).max)
