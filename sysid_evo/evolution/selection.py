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
    delayed_runner,
    disturbed_runners,
    selection_seeds,
)
from sysid_evo.evolution.ensemble import EnsembleObjective
from sysid_evo.evolution.loop import Schedule
from sysid_evo.evolution.runs import Runs, evolution_digest
from sysid_evo.evolution.strategies.cma_es import CmaEs
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy
from sysid_evo.progress import Checkpoint, Progress, reporting
from sysid_evo.randomness import derived_seed
from sysid_evo.tasks.task import make_task
from sysid_evo.types import Array
from sysid_evo.validation.acceptance import within_margin

FinalistScore: TypeAlias = Callable[[Champion, tuple[str, ...], Array], Array]
"""Returns the scores (P,) of a champion's finalists from their fitness (M, P) on the models of these labels."""


def median(_champion: Champion, _models: tuple[str, ...], by_model: Array) -> Array:
    """Return the median over the models, (P,)."""
    result: Array = np.median(by_model, axis=0)
    return result


def choose(
    contenders: Sequence[tuple[Champion, Mapping[str, Runner]]],
    *,
    seed: int,
    trials: int = 100,
    judgement: FinalistScore = median,
) -> Champion:
    """Return the champion whose finalist scores best on its scoring models, in ``trials`` fresh trials.

    ``contenders`` are champions with their scoring models. For the default ``judgement``, the median over the models,
    these should be of *other* families than the models of its evolution: fitness in its own model hardly predicts
    fitness on the robot, and fitness in other families ranks controllers as the robot does. A champion without
    scoring models keeps its fittest finalist; if only some champions have scoring models, only those are compared.
    The result holds the finalists of all contenders with their scores. Raises `InvalidArgument` without a contender.
    """
    if not contenders:
        raise InvalidArgument("choose: expected at least one champion, got none")
    champions = [
        score_finalists(champion, models, seed=seed, trials=trials, judgement=judgement)
        for champion, models in contenders
    ]
    ranked = [(finalist, champion) for champion in champions for finalist in champion.finalists]
    scored = [pair for pair in ranked if pair[0].forecast is not None]
    best, own = max(scored or ranked, key=lambda pair: ranking_value(pair[0]))  # of equals the first
    return replace(own, parameters=best.parameters, finalists=tuple(finalist for finalist, _ in ranked))


def score_finalists(
    champion: Champion, models: Mapping[str, Runner], *, seed: int, trials: int = 100, judgement: FinalistScore = median
) -> Champion:
    """Return ``champion`` with the score of each finalist on ``models``; unchanged without models."""
    if not models or not champion.finalists:
        return champion
    assert champion.system is not None
    task = make_task(champion.task).bind(champion.system)
    controller = make_controller(champion.controller).bind_to(task)
    delayed = tuple(delayed_runner(label, runner, champion.estimator_delay) for label, runner in models.items())
    population = np.stack([finalist.parameters for finalist in champion.finalists])
    by_model = (
        EnsembleObjective(delayed, controller, task, seed).on_trials(population, selection_seeds(seed, trials)).by_model
    )
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

    Aggregate, trials, task and controller are those of ``settings``. The step size ``sigma`` is small because the
    finalists are good already; the refinement removes dependence on faults of single models. A finalist without an
    improvement stays unchanged. Models that underrate the best finalist (by more than `MAX_SHORTFALL`) are omitted, so
    that one bad model does not exclude good controllers; ``against`` names the models that were used. ``checkpoint``
    and ``progress`` are as in `evolve_controller`.
    """
    if not champion.finalists or champion.system is None:
        raise InvalidArgument(f"polish: controller {champion.name!r} has no finalists to start from")
    task = settings.make_task(champion.system)
    controller = settings.make_controller(task)
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

    def start_run(run: int) -> tuple[EvolutionStrategy, Schedule]:
        strategy = CmaEs(
            n_parameters=controller.n_parameters,
            seed=derived_seed(seed, run),
            sigma=sigma,
            initial=chosen[run].parameters,
        )
        return strategy, Schedule((), objective(run), max_fitness=task.max_fitness)

    def finalists_of(run: int, strategy: EvolutionStrategy) -> tuple[Finalist, ...]:
        candidates = np.concatenate([chosen[run].parameters[None], strategy.elite])
        fitness = objective(run).on_trials(candidates, seeds).fitness
        winner = int(np.argmax(fitness))
        label = f"{POLISHED} {chosen[run].behaviour_class}".strip()
        return (Finalist(label, run, float(fitness[winner]), candidates[winner]),)

    inputs = [repr(settings), generations, sigma, *(start.parameters.tolist() for start in chosen)]
    runs = Runs(
        len(chosen),
        generations,
        start_run,
        finalists_of,
        models=(used,),
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
