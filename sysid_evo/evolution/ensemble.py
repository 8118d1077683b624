"""Fitness against several models at once (paper, section 4.5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid_evo.arrays import Array, Seeds, check_shape
from sysid_evo.controllers.controller import Controller
from sysid_evo.engine import Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.aggregates import Aggregate
from sysid_evo.evolution.loop import Scores
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import aggregates, make_aggregate
from sysid_evo.tasks.task import Task


@dataclass(frozen=True)
class EnsembleObjective:
    """Fitness on each of the runners in ``trials`` trials, made one by ``aggregate``, a spec.

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
        aggregates.check(self.aggregate)
        if not self.runners or self.trials < 1:
            raise InvalidArgument(
                f"ensemble: expected at least one model and one trial, got {len(self.runners)} and {self.trials}"
            )

    def __call__(self, population: Array, generation: int) -> Scores:
        """Return what ``population`` (P, n) scores in ``generation``: what the aggregate has evolution climb.

        On a model that the aggregate does not run in this generation the fitness is nan.
        """
        seeds = trial_seeds(self.seed, self.trials, generation=generation)
        chosen = self._rule.models(len(self.runners), generation)
        fitness, behaviour = self._run([self.runners[i] for i in chosen], population, seeds)
        by_model = np.full((len(self.runners), len(population)), np.nan)
        by_model[chosen] = fitness.mean(axis=2)
        return Scores(self._rule.in_population(fitness), behaviour, by_model)

    def on_trials(self, population: Array, seeds: Seeds) -> Scores:
        """Return what ``population`` scores on all models in the trials of these seeds: what each candidate claims.

        The behaviour is the mean over all. Raises `ShapeError` if a runner leaves trials out.
        """
        fitness, behaviour = self._run(self.runners, population, seeds)
        return Scores(self._rule(fitness), behaviour, fitness.mean(axis=2))

    def _run(self, runners: Sequence[Runner], population: Array, seeds: Seeds) -> tuple[Array, Array]:
        """Return fitness (M, P, trials) and behaviour (P, d) of ``population`` on ``runners``."""
        shape = (len(population), len(seeds))
        runs = [runner.run(self.controller, population, self.task, seeds) for runner in runners]
        fitness = np.stack([check_shape("fitness in every trial", run.fitness, shape) for run in runs])
        described = [run.behaviour.mean(axis=1) for run in runs if run.behaviour.shape[:2] == shape]
        return fitness, np.mean(described, axis=0) if described else np.empty((len(population), 0))

    @cached_property
    def _rule(self) -> Aggregate:
        return make_aggregate(self.aggregate)
