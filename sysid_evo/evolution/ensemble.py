"""Fitness against several models at once (paper, section 4.5)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid_evo.arrays import Array, Seeds
from sysid_evo.controllers.controller import Controller
from sysid_evo.engine import Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks.task import Task

AGGREGATES: dict[str, Callable[[Array], Array]] = {
    "min": lambda fitness: np.min(fitness, axis=0),
    "mean": lambda fitness: np.mean(fitness, axis=0),
    "median": lambda fitness: np.median(fitness, axis=0),
}
"""How the fitnesses on several models, (models, ...), become one; the paper's rule is ``min``."""


def aggregate(name: str, fitness: npt.ArrayLike) -> Array:
    """Return one fitness (...) from those on several models (models, ...). Raises `InvalidArgument`."""
    if name not in AGGREGATES:
        raise InvalidArgument(f"aggregate: expected one of {', '.join(AGGREGATES)}, got {name!r}")
    return AGGREGATES[name](np.asarray(fitness, dtype=np.float64))


@dataclass(frozen=True)
class EnsembleObjective:
    """Mean fitness over ``trials`` on each of the runners, made one by ``aggregate``.

    Everyone in a generation meets the same trials, keyed by (seed, generation, trial), and the same
    trials on every model; the next generation meets new ones.
    """

    runners: Sequence[Runner]
    controller: Controller
    task: Task
    seed: int
    trials: int = 10
    aggregate: str = "min"

    def __post_init__(self) -> None:
        aggregate(self.aggregate, np.zeros((1, 1)))
        if not self.runners or self.trials < 1:
            raise InvalidArgument(
                f"ensemble: expected at least one model and one trial, got {len(self.runners)} and {self.trials}"
            )

    def __call__(self, population: Array, generation: int) -> Array:
        """Return the fitness (P,) of ``population`` (P, n) in ``generation``."""
        return self.on_trials(population, trial_seeds(self.seed, self.trials, generation=generation))

    def on_trials(self, population: Array, seeds: Seeds) -> Array:
        """Return the fitness (P,) on the trials of these seeds."""
        means = [
            runner.run(self.controller, population, self.task, seeds).fitness.mean(axis=1) for runner in self.runners
        ]
        return aggregate(self.aggregate, np.stack(means))
