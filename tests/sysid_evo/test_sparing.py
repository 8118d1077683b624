"""Candidates that cannot become good enough are spared dear models, and nothing that counts changes by it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from sysid_evo.arrays import Array, IntArray, Seeds
from sysid_evo.controllers import Controller
from sysid_evo.data import Dataset
from sysid_evo.engine import DynamicsRunner, Rollouts
from sysid_evo.evolution import (
    ControllerEvolution,
    EnsembleObjective,
    Generation,
    Schedule,
    Stage,
    evolve,
    evolve_controller,
)
from sysid_evo.evolution.sparing import TOGETHER, run_leading
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, make_model, make_strategy
from sysid_evo.tasks import Task

from .made_up import Constant, Ladder

N, TRIALS = 3, 6
LOOSE = "credible", "median"
"""Rules of which a part says so little that here hardly anybody is spared anything."""


@dataclass
class Hill:
    """A runner whose fitness falls off around ``peak``, in whole tenths, with luck that depends on trial and place."""

    peak: float
    engine: str = "compiled made-up"
    run_of: list[int] = field(default_factory=list)

    def run(
        self, controller: Controller, parameters: Array, task: Task, seeds: Seeds, *, record: bool = False
    ) -> Rollouts:
        self.run_of.append(len(parameters))
        luck = np.sin((seeds % 1000).astype(np.float64) + 40.0 * parameters.sum(axis=1, keepdims=True))
        fitness = np.round(5.0 - np.abs(parameters - self.peak).sum(axis=1, keepdims=True) + luck, 1)
        count = np.zeros(fitness.shape, dtype=np.int64)
        return Rollouts(fitness, count, count, task.begin(seeds), self.engine)


def hills(engine: str = "compiled made-up") -> tuple[Hill, ...]:
    return Hill(-1.0, engine), Hill(0.5, engine), Hill(1.0, engine)


def searched(strategy: str, aggregate: str, *, spare: bool) -> tuple[list[Generation], Array, int]:
    """Return 30 generations of a search, the elite it ends with, and how many candidates were run on all models."""
    models = hills()
    objective = EnsembleObjective(models, Constant(), Ladder(), 5, TRIALS, aggregate)
    search = make_strategy(strategy, n_parameters=N, seed=2)
    loop = evolve(search, objective if spare else lambda population, index: objective(population, index), 30)
    return list(loop), search.elite, sum(sum(model.run_of) for model in models)


@pytest.mark.parametrize("aggregate", ["min", "lower_confidence", "credible", "median", "random_subset(size=2)"])
def test_a_search_takes_the_same_way_and_runs_fewer_candidates(aggregate: str) -> None:
    strategy = "mu_plus_lambda(parents=10, children=30)"
    spared, elite, run = searched(strategy, aggregate, spare=True)
    everyone, expected, all_run = searched(strategy, aggregate, spare=False)
    for one, other in zip(spared, everyone, strict=True):
        np.testing.assert_array_equal(one.population, other.population)
        assert one.summary == other.summary
    np.testing.assert_array_equal(elite, expected)
    assert run < 0.95 * all_run or (aggregate in LOOSE and run <= all_run)


@pytest.mark.parametrize("strategy", ["cma_es(population=20)", "mu_plus_lambda(parents=5, reevaluate=false)"])
def test_a_strategy_that_needs_everyone_is_told_of_everyone(strategy: str) -> None:
    assert searched(strategy, "min", spare=True)[2] == searched(strategy, "min", spare=False)[2]


@pytest.mark.parametrize("aggregate", ["mean", "cvar", "rank_mean"])
def test_a_rule_of_which_a_part_says_nothing_is_told_of_every_model(aggregate: str) -> None:
    strategy = "mu_plus_lambda(parents=10, children=30)"
    assert searched(strategy, aggregate, spare=True)[2] == searched(strategy, aggregate, spare=False)[2]


def test_where_candidates_may_feel_each_other_everyone_is_run() -> None:
    models = Hill(-1.0, "reference"), Hill(0.5), Hill(1.0, "reference")
    objective = EnsembleObjective(models, Constant(), Ladder(), 5, TRIALS)
    population = np.random.default_rng(1).standard_normal((80, N))
    for generation in range(4):
        objective.leading(population, generation, 5)
    first, compiled, last = (model.run_of for model in models)
    assert first == last == [80] * 4
    assert compiled[0] == 80
    assert sum(compiled) < 4 * 80


def test_who_is_not_among_the_best_has_a_fitness_below_theirs_and_none_where_it_was_not_run() -> None:
    objective = EnsembleObjective(hills(), Constant(), Ladder(), 5, TRIALS)
    population = np.random.default_rng(1).standard_normal((80, N))
    exact = objective(population, 0)
    spared = objective.leading(population, 0, 7)
    assert exact.by_model is not None
    assert spared.by_model is not None
    known = np.isfinite(spared.by_model).all(axis=0)
    level = np.sort(exact.fitness)[-7]
    assert known[exact.fitness >= level].all()
    assert not known.all()
    np.testing.assert_array_equal(spared.fitness[known], exact.fitness[known])
    assert (spared.fitness[~known] < level).all()
    assert (spared.fitness >= exact.fitness).all()
    run = np.isfinite(spared.by_model)
    np.testing.assert_array_equal(spared.by_model[run], exact.by_model[run])


def test_of_equals_the_first_is_the_winner_on_trials_as_if_all_were_known() -> None:
    objective = EnsembleObjective(hills(), Constant(), Ladder(), 5, TRIALS)
    some = np.random.default_rng(3).standard_normal((20, N))
    candidates, seeds = np.repeat(some, 4, axis=0), trial_seeds(9, TRIALS)
    exact = objective.on_trials(candidates, seeds).fitness
    spared = objective.on_trials(candidates, seeds, needed=1).fitness
    assert np.argmax(spared) == np.argmax(exact)
    assert spared.max() == exact.max()
    assert not np.array_equal(spared, exact)


def test_the_first_models_decide_who_is_run_on_the_next() -> None:
    """With full blocks, whoever is run on a model could have become one of the best by the models before it."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        models, candidates, needed = rng.integers(1, 4), rng.integers(1, 40), rng.integers(1, 10)
        needed = min(needed, candidates)
        scores = rng.integers(0, 8, (models, candidates)).astype(np.float64)
        run_on = np.zeros((models, candidates), dtype=np.int64)

        def run(model: int, who: IntArray, scores: Array = scores, run_on: IntArray = run_on) -> Array:
            run_on[model, who] += 1
            return scores[: model + 1, who].min(axis=0)

        bounds = run_leading(run, candidates=candidates, models=models, needed=needed, trials=TOGETHER)
        lowest = scores.min(axis=0)
        level = np.sort(lowest)[-needed]
        for model in range(models):
            hope = scores[:model].min(axis=0, initial=np.inf)
            np.testing.assert_array_equal(run_on[model], hope >= level)
        np.testing.assert_array_equal(bounds[lowest >= level], lowest[lowest >= level])


def test_a_stage_that_ends_by_the_better_half_knows_it() -> None:
    objective = EnsembleObjective(hills(), Constant(), Ladder(), 5, TRIALS)
    population = np.random.default_rng(1).standard_normal((80, N))
    exact = np.sort(objective(population, 0).fitness)
    staged = Schedule([(Stage(at_most=1), objective)], objective)
    in_stage = np.sort(staged.leading(population, 0, 2).fitness)  # type: ignore[union-attr]  # an ensemble gives scores
    np.testing.assert_array_equal(in_stage[40:], exact[40:])
    staged.tell(Generation(0, population, exact))
    asked = np.sort(staged.leading(population, 0, 2).fitness)  # type: ignore[union-attr]
    np.testing.assert_array_equal(asked[-2:], exact[-2:])
    assert not np.array_equal(asked[40:], exact[40:])


def test_compiled_models_give_the_champion_that_they_give_without(
    recording: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    runners = {
        name: DynamicsRunner(make_model(name).fit(recording, rng=np.random.default_rng(0)))
        for name in ("linear", "nearest_neighbour")
    }
    settings = ControllerEvolution(
        generations=15,
        trials=5,
        selection_trials=10,
        controller=Spec.parse("recurrent(hidden=3)"),
        task=Spec.parse("point_to_point(horizon=120, waypoint_radius=0.4)"),
        strategy=Spec.parse("mu_plus_lambda(parents=15, children=35, sigma=0.3)"),
    )
    spared = [evolve_controller("c", runners, recording.system, settings, seed=seed) for seed in (3, 4)]
    monkeypatch.setattr(EnsembleObjective, "_stages", lambda _, models: [tuple(range(len(models)))])
    for seed, champion in zip((3, 4), spared, strict=True):
        expected = evolve_controller("c", runners, recording.system, settings, seed=seed)
        np.testing.assert_array_equal(champion.parameters, expected.parameters)
        np.testing.assert_array_equal(champion.history, expected.history)
        np.testing.assert_array_equal(champion.population, expected.population)
        assert champion.finalists[0].fitness == expected.finalists[0].fitness
