"""Fitness on several models together (paper, section 4.5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid_evo.controllers.controller import Controller
from sysid_evo.engine.rollout import BoundRunner, Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.aggregates import make_aggregate
from sysid_evo.evolution.loop import Scores
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry.registry import aggregates
from sysid_evo.tasks.task import Task
from sysid_evo.types import Array, Seeds, check_shape


@dataclass(frozen=True)
class EnsembleObjective:
    """Fitness on all runners in ``trials`` trials, combined by ``aggregate`` (a spec).

    All candidates of a generation have the same trials on all models, keyed by (seed, generation, trial). The next
    generation has new trials.
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

    @cached_property
    def bound(self) -> list[BoundRunner]:
        """Controller and task on each runner."""
        return [runner.bind(self.controller, self.task) for runner in self.runners]

    def __call__(self, population: Array, generation: int) -> Scores:
        """Return the scores of ``population`` (P, n) in ``generation``."""
        return self.on_trials(population, trial_seeds(self.seed, self.trials, generation=generation))

    def on_trials(self, population: Array, seeds: Seeds) -> Scores:
        """Return the scores of ``population`` (P, n) in these trials. Raises `ShapeError` if a runner skips trials."""
        shape = len(population), len(seeds)
        runs = [run(population, seeds) for run in self.bound]
        fitness = np.stack([check_shape("fitness in every trial", run.fitness, shape) for run in runs])
        described = [run.behaviour.mean(axis=1) for run in runs if run.behaviour.shape[:2] == shape]
        behaviour = np.mean(described, axis=0) if described else None
        return Scores(
            make_aggregate(self.aggregate)(fitness), behaviour, fitness.mean(axis=2), np.median(fitness, axis=0)
        )
