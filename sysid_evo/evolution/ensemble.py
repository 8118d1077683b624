"""Fitness against several models at once (paper, section 4.5)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from sysid_evo.arrays import Array, IntArray, Seeds, check_shape
from sysid_evo.controllers.controller import Controller
from sysid_evo.engine import Rollouts, Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.aggregates import Aggregate
from sysid_evo.evolution.loop import Scores
from sysid_evo.evolution.sparing import run_leading
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import aggregates, make_aggregate
from sysid_evo.tasks.task import Task

COMPILED = "compiled"
"""How the names of the engines begin in which a rollout does not depend on those beside it."""


@dataclass(frozen=True)
class EnsembleObjective:
    """Fitness on each of the runners in ``trials`` trials, made one by ``aggregate``, a spec.

    Everyone in a generation meets the same trials, keyed by (seed, generation, trial), and the same
    trials on every model; the next generation meets new ones. Which models are the dear ones is measured; what
    comes out does not depend on it.
    """

    runners: Sequence[Runner]
    controller: Controller
    task: Task
    seed: int
    trials: int = 10
    aggregate: str = "min"
    _costs: dict[int, float] = field(default_factory=dict, init=False, repr=False, compare=False)
    """Seconds that one candidate took on each model; 0 on one on which nobody is left out."""

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
        return self.leading(population, generation, len(population))

    def leading(self, population: Array, generation: int, needed: int) -> Scores:
        """Return what ``population`` (P, n) scores in ``generation``, exactly for the ``needed`` best.

        Who cannot be one of them, by what the aggregate says of the fitness on the cheap models (`Aggregate.at_most`),
        is not run on the dear ones: its fitness is the most that it could have been, on those models it is nan.
        """
        seeds = trial_seeds(self.seed, self.trials, generation=generation)
        chosen = self._rule.models(len(self.runners), generation)
        return self._score(chosen, population, seeds, needed, self._rule.in_population)

    def on_trials(self, population: Array, seeds: Seeds, *, needed: int | None = None) -> Scores:
        """Return what ``population`` scores on all models in the trials of these seeds: what each candidate claims.

        Exactly so for the ``needed`` best, by default for all, see `leading`. The behaviour is the mean over all.
        Raises `ShapeError` if a runner leaves trials out.
        """
        everywhere = np.arange(len(self.runners))
        return self._score(everywhere, population, seeds, needed or len(population), self._rule)

    def _score(
        self, models: IntArray, population: Array, seeds: Seeds, needed: int, rule: Callable[[Array], Array]
    ) -> Scores:
        """Return what ``population`` scores by ``rule`` on some of the models, exactly for the ``needed`` best."""
        stages = self._stages(models) if needed < len(population) else [tuple(range(len(models)))]
        scored = _Scored(len(models), len(population), len(seeds))

        def run(stage: int, who: IntArray) -> Array:
            for place in stages[stage]:
                scored.write(place, who, self._run(int(models[place]), population[who], seeds))
            so_far = scored.fitness[np.ix_(scored.run_on(who), who)]
            return rule(so_far) if stage == len(stages) - 1 else self._rule.at_most(so_far, len(models))

        fitness = run_leading(
            run, candidates=len(population), models=len(stages), needed=min(needed, len(population)), trials=len(seeds)
        )
        by_model = np.full((len(self.runners), len(population)), np.nan)
        by_model[models] = np.where(scored.there, scored.fitness.mean(axis=2), np.nan)
        return Scores(fitness, scored.behaviour, by_model)

    def _run(self, model: int, population: Array, seeds: Seeds) -> Rollouts:
        """Run ``population`` on a model, and remember what one candidate cost."""
        begun = time.perf_counter()
        run = self.runners[model].run(self.controller, population, self.task, seeds)
        seconds = (time.perf_counter() - begun) / len(population)
        alone = run.engine.startswith(COMPILED)
        self._costs[model] = min(seconds, self._costs.get(model, np.inf)) if alone else 0.0
        return run

    def _stages(self, models: IntArray) -> list[tuple[int, ...]]:
        """Return which places of ``models`` are run one after the other, the dearest last.

        All are one stage until their cost is known. So are those on which the fitness of a candidate may
        depend, in the last digit, on who is run beside it: everyone is run on these.
        """
        costs = [self._costs.get(model) for model in models.tolist()]
        if None in costs:
            return [tuple(range(len(models)))]
        dear = sorted((cost, place) for place, cost in enumerate(costs) if cost)
        together = tuple(place for place, cost in enumerate(costs) if not cost)
        return [*([together] if together else []), *((place,) for _, place in dear)]

    @cached_property
    def _rule(self) -> Aggregate:
        return make_aggregate(self.aggregate)


class _Scored:
    """What was run so far: fitness (M, P, trials), and on which models each candidate is ``there`` (M, P)."""

    def __init__(self, models: int, candidates: int, trials: int) -> None:
        self.fitness = np.zeros((models, candidates, trials))
        self.there = np.zeros((models, candidates), dtype=bool)
        self._described: dict[int, Array] = {}

    def write(self, place: int, who: IntArray, run: Rollouts) -> None:
        """Take in what the candidates ``who`` did on one model. Raises `ShapeError` if trials were left out."""
        shape = len(who), self.fitness.shape[2]
        self.fitness[place, who] = check_shape("fitness in every trial", run.fitness, shape)
        self.there[place, who] = True
        if run.behaviour.shape[:2] == shape:
            behaviour = run.behaviour.mean(axis=1)
            self._described.setdefault(place, np.zeros((self.there.shape[1], behaviour.shape[1])))[who] = behaviour

    def run_on(self, who: IntArray) -> IntArray:
        """Return on which models the candidates ``who``, all of them on the same, have been run."""
        return np.flatnonzero(self.there[:, who[0]])

    @property
    def behaviour(self) -> Array:
        """The mean (P, d) over the models that each candidate was run on."""
        if not self._described:
            return np.empty((self.there.shape[1], 0))
        places = sorted(self._described)
        times = np.maximum(1, self.there[places].sum(axis=0))
        return np.asarray(np.sum([self._described[place] for place in places], axis=0) / times[:, None])
