"""Choice of a champion without the robot, by its fitness on other models; refinement on an ensemble (polishing)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import TypeAlias

import numpy as np

from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine.rollout import Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.champion import Champion, Finalist
from sysid_evo.evolution.controller_evolution import (
    ControllerEvolution,
    EnsembleObjective,
    delayed_runner,
    disturbed_runners,
    selection_seeds,
)
from sysid_evo.evolution.loop import Objective, Scores
from sysid_evo.evolution.margins import EQUAL_SHARE, best_candidate, lasting_fitness, margins_of
from sysid_evo.evolution.runs import FinishedRun, Runs, evolution_digest
from sysid_evo.evolution.strategies.cma_es import CmaEs
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy
from sysid_evo.progress import Checkpoint, Progress, reporting
from sysid_evo.randomness import derived_seed
from sysid_evo.tasks.task import make_task
from sysid_evo.types import Array, IntArray, Seeds
from sysid_evo.validation.acceptance import within_margin

FinalistScore: TypeAlias = Callable[[Champion, tuple[str, ...], Array], Array]
"""Returns the scores (P,) of a champion's finalists from their fitness (M, P) on the models of these labels."""


def median(_champion: Champion, _models: tuple[str, ...], by_model: Array) -> Array:
    """Return the median over the models, (P,)."""
    result: Array = np.median(by_model, axis=0)
    return result


def choose(
    searched: Sequence[tuple[Champion, Mapping[str, Runner]]],
    *,
    seed: int,
    trials: int = 100,
    judgement: FinalistScore = median,
) -> Champion:
    """Return the champion whose finalist scores best on its scoring models, in ``trials`` fresh trials.

    ``searched`` are champions with their scoring models. For the default ``judgement``, the median over the models,
    these should be of *other* families than the models of its evolution: fitness in its own model hardly predicts
    fitness on the robot, and fitness in other families ranks controllers as the robot does. A champion without
    scoring models keeps its fittest finalist; if only some champions have scoring models, only those are compared.
    Of finalists that have all the fitness there is, the one with the largest margin wins, see `lasting_fitness`.
    The result holds the finalists with its kind of controller of all champions, with their scores. Raises
    `InvalidArgument` without a champion.
    """
    if not searched:
        raise InvalidArgument("choose: expected at least one champion, got none")
    champions = [
        score_finalists(champion, models, seed=seed, trials=trials, judgement=judgement)
        for champion, models in searched
    ]
    ranked = [
        (finalist, champion, models)
        for champion, (_, models) in zip(champions, searched, strict=True)
        for finalist in champion.finalists
    ]
    scored = [one for one in ranked if one[0].forecast is not None]
    top = max(ranking_value(one[0]) for one in scored or ranked)
    near = [one for one in scored or ranked if ranking_value(one[0]) >= top - EQUAL_SHARE * abs(top)]
    best, own, _ = near[_largest_margin(near, selection_seeds(seed, trials))]
    # searches from several starts may have found controllers of another kind, with other parameters
    same_kind = tuple(finalist for finalist, champion, _ in ranked if champion.controller == own.controller)
    return replace(own, parameters=best.parameters, finalists=same_kind)


def _largest_margin(near: Sequence[tuple[Finalist, Champion, Mapping[str, Runner]]], seeds: Seeds) -> int:
    """Return the best of these finalists: by ranking value, of those with all the fitness there is by margin."""
    values = np.array([ranking_value(finalist) for finalist, _, _ in near])
    if len(near) < 2 or not all(models for _, _, models in near):
        return int(np.argmax(values))

    def by_trial(finalist: Finalist, champion: Champion, models: Mapping[str, Runner]) -> Array:
        found = _scores(champion, models, finalist.parameters[None], seeds).by_trial
        assert found is not None
        return found[0]

    def margins(rows: IntArray) -> Array:
        found = []
        for finalist, champion, models in (near[row] for row in rows):
            assert champion.system is not None
            found.append(
                lasting_fitness(
                    finalist.parameters[None], models, champion.controller, champion.task, champion.system, seeds,
                    delay=champion.estimator_delay,
                )[0]
            )  # fmt: skip
        return margins_of(np.array(found))

    first = near[0][1]
    assert first.system is not None
    worst = make_task(first.task).bind(first.system).worst
    return best_candidate(Scores(values, by_trial=np.stack([by_trial(*one) for one in near])), worst, margins)


def _scores(champion: Champion, models: Mapping[str, Runner], population: Array, seeds: Seeds) -> Scores:
    """Return the scores of ``population`` (P, n), with the controller, task and delay of ``champion``."""
    assert champion.system is not None
    task = make_task(champion.task).bind(champion.system)
    law = make_controller(champion.controller).bind_to(task)
    delayed = tuple(delayed_runner(label, one, champion.estimator_delay) for label, one in models.items())
    return EnsembleObjective(delayed, law, task, 0).on_trials(population, seeds)


def score_finalists(
    champion: Champion, models: Mapping[str, Runner], *, seed: int, trials: int = 100, judgement: FinalistScore = median
) -> Champion:
    """Return ``champion`` with the score of each finalist on ``models``; unchanged without models."""
    if not models or not champion.finalists:
        return champion
    population = np.stack([finalist.parameters for finalist in champion.finalists])
    by_model = _scores(champion, models, population, selection_seeds(seed, trials)).by_model
    assert by_model is not None
    scores = judgement(champion, tuple(models), by_model)
    finalists = tuple(
        replace(one, forecast=float(value)) for one, value in zip(champion.finalists, scores, strict=True)
    )
    return replace(champion, finalists=finalists, scoring_models=tuple(models))


def ranking_value(finalist: Finalist) -> float:
    """Return the value that ranks finalists: the forecast, or the fitness where there is no forecast."""
    return finalist.fitness if finalist.forecast is None else finalist.forecast


POLISHED = "polished"
MAX_SHORTFALL = 0.3
"""Polishing omits a model if the controller's fitness on it is below its median over all models by more than this
share."""


def polish(
    name: str,
    champion: Champion,
    runners: Mapping[str, Runner],
    settings: ControllerEvolution,
    *,
    seed: int,
    starts: int = 2,
    generations: int = 120,
    sigma: float = 0.3,
    checkpoint: Checkpoint | None = None,
    progress: Progress | bool | None = None,
) -> Champion:
    """Return ``champion`` refined by CMA-ES on all ``runners``, starting from its ``starts`` best finalists.

    Aggregate, trials and task are those of ``settings``. The step size ``sigma`` is small because the
    finalists are good already; the refinement removes dependence on faults of single models. A finalist without an
    improvement stays unchanged. Models that underrate the best finalist (by more than `MAX_SHORTFALL`) are omitted, so
    that one bad model does not exclude good controllers; ``against`` names the models that were used. ``checkpoint``
    and ``progress`` are as in `evolve_controller`.
    """
    if not champion.finalists or champion.system is None:
        raise InvalidArgument(f"polish: controller {champion.name!r} has no finalists to start from")
    task = settings.make_task(champion.system)
    controller = make_controller(champion.controller).bind_to(task)
    delayed = {label: delayed_runner(label, runner, settings.estimator_delay) for label, runner in runners.items()}
    seeds = selection_seeds(seed, settings.selection_trials)
    chosen = sorted(champion.finalists, key=lambda one: -ranking_value(one))[:starts]
    everything = EnsembleObjective(tuple(delayed.values()), controller, task, seed, aggregate=settings.aggregate)
    by_model = everything.on_trials(chosen[0].parameters[None], seeds).by_model
    assert by_model is not None
    accepted = within_margin(-by_model[:, 0], -float(np.median(by_model[:, 0])), MAX_SHORTFALL)
    used = tuple(label for label, kept in zip(delayed, accepted, strict=True) if kept)
    used_runners = tuple(disturbed_runners({label: runners[label] for label in used}, settings).values())

    @cache
    def objective(run: int) -> EnsembleObjective:
        return EnsembleObjective(
            used_runners, controller, task, derived_seed(seed, run), settings.trials, settings.aggregate
        )

    def start_run(run: int, _ended: Sequence[FinishedRun]) -> tuple[EvolutionStrategy, Objective]:
        strategy = CmaEs(
            n_parameters=controller.n_parameters,
            seed=derived_seed(seed, run),
            sigma=sigma,
            initial=chosen[run].parameters,
            first_steps=controller.first_steps(task.observation_sizes()),
        )
        return strategy, objective(run)

    def margins(candidates: Array) -> Array:
        kept, delay = {label: runners[label] for label in used}, settings.estimator_delay
        law, goal = champion.controller, settings.task
        return margins_of(lasting_fitness(candidates, kept, law, goal, task.system, seeds, delay=delay))

    def finalists_of(run: int, strategy: EvolutionStrategy) -> tuple[Finalist, ...]:
        candidates = np.concatenate([chosen[run].parameters[None], strategy.elite])
        scores = objective(run).on_trials(candidates, seeds)
        winner = best_candidate(scores, task.worst, lambda rows: margins(candidates[rows]))
        label = f"{POLISHED} {chosen[run].behaviour_class}".strip()
        return (Finalist(label, run, float(scores.fitness[winner]), candidates[winner]),)

    inputs = [repr(settings), generations, sigma, *(start.parameters.tolist() for start in chosen)]
    runs = Runs(
        (generations,) * len(chosen),
        start_run,
        finalists_of,
        models=used,
        checkpoint=checkpoint,
        identity="" if checkpoint is None else evolution_digest(inputs, runners, controller, task, seed),
    )
    with reporting(progress, f"polish {name}") as report:
        ended = runs.finish(report)
    best = max((run.finalists[0] for run in ended), key=lambda one: one.fitness)  # of equals the first
    return replace(
        champion,
        name=name,
        parameters=best.parameters,
        against=used,
        aggregate=settings.aggregate,
        seed=seed,
        history=ended[best.repeat].history,
        seed_fitness=(),
        scoring_models=(),
        polished=True,
        finalists=tuple(run.finalists[0] for run in ended),
        population=ended[best.repeat].population,
    )
