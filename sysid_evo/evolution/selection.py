"""Choosing a champion without the robot, by what it does in other models; polishing it on an ensemble."""

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
"""What a champion's finalists are worth, (P,), by their fitness (M, P) on the models of these labels."""


def median(_champion: Champion, _models: tuple[str, ...], by_model: Array) -> Array:
    """Return the median over the models, (P,)."""
    found: Array = np.median(by_model, axis=0)
    return found


def choose(
    contenders: Sequence[tuple[Champion, Mapping[str, Runner]]],
    *,
    seed: int,
    trials: int = 100,
    judgement: FinalistScore = median,
) -> Champion:
    """Return the champion of the finalist that is worth most on the models beside its champion.

    Each is run there in ``trials`` fresh trials. By the median those must be of *other* families than it was evolved
    in: what a controller claims in its own model says next to nothing about what it achieves elsewhere, while this
    ranks as the robot does. A champion without such models keeps its fittest finalist; where there are
    models for some and for others not, only those with models are compared. The champion returned holds
    the finalists of all, with what they are worth. Raises `InvalidArgument` without a contender.
    """
    if not contenders:
        raise InvalidArgument("choose: expected at least one champion, got none")
    judged = [
        score_finalists(champion, judges, seed=seed, trials=trials, judgement=judgement)
        for champion, judges in contenders
    ]
    ranked = [(finalist, champion) for champion in judged for finalist in champion.finalists]
    known = [pair for pair in ranked if pair[0].forecast is not None]
    best, own = max(known or ranked, key=lambda pair: ranking_value(pair[0]))  # of equals the first
    return replace(own, parameters=best.parameters, finalists=tuple(finalist for finalist, _ in ranked))


def score_finalists(
    champion: Champion, judges: Mapping[str, Runner], *, seed: int, trials: int = 100, judgement: FinalistScore = median
) -> Champion:
    """Return ``champion`` with what each finalist is worth to the ``judges``; as it is where there are none."""
    if not judges or not champion.finalists:
        return champion
    assert champion.system is not None
    task = make_task(champion.task).bind(champion.system)
    controller = make_controller(champion.controller).bind_to(task)
    late = tuple(delayed_runner(label, runner, champion.estimator_delay) for label, runner in judges.items())
    everyone = np.stack([finalist.parameters for finalist in champion.finalists])
    by_model = (
        EnsembleObjective(late, controller, task, seed).on_trials(everyone, selection_seeds(seed, trials)).by_model
    )
    assert by_model is not None
    worths = judgement(champion, tuple(judges), by_model)
    finalists = tuple(
        replace(one, forecast=float(value)) for one, value in zip(champion.finalists, worths, strict=True)
    )
    return replace(champion, finalists=finalists, scoring_models=tuple(judges))


def ranking_value(finalist: Finalist) -> float:
    """Return by what finalists are ranked: what the judges made of it, or what it claims where nobody judged."""
    return finalist.fitness if finalist.forecast is None else finalist.forecast


POLISHED = "polished"
DENIED = 0.3
"""A model on which a controller has less than its median over all models by more than this share is not believed."""


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
    """Return the fittest of what CMA-ES finds near the ``starts`` best finalists of ``champion`` on all of ``runners``.

    How the fitnesses on the models become one is the aggregate of ``settings``, and so are trials, task and
    controller. The step is short, ``sigma`` at the start, since the starts are good drivers already: what
    changes is what they owe to the faults of single models. A start that nothing beats stays as it is. Models
    that deny the best start, on which it has less than its median over all by more than `DENIED`, are left out, so that
    one bad model does not forbid good driving; ``against`` names those that were used. ``checkpoint`` and ``progress``
    as for `evolve_controller`.
    """
    if not champion.finalists or champion.system is None:
        raise InvalidArgument(f"polish: controller {champion.name!r} has no finalists to start from")
    task = settings.make_task(champion.system)
    controller = settings.make_controller(task)
    late = {label: delayed_runner(label, runner, settings.estimator_delay) for label, runner in runners.items()}
    seeds = selection_seeds(seed, settings.selection_trials)
    chosen = sorted(champion.finalists, key=lambda one: -ranking_value(one))[:starts]
    everyone = EnsembleObjective(tuple(late.values()), controller, task, seed, aggregate=settings.aggregate)
    by_model = everyone.on_trials(chosen[0].parameters[None], seeds).by_model
    assert by_model is not None
    credible = within_margin(-by_model[:, 0], -float(np.median(by_model[:, 0])), DENIED)
    used = tuple(label for label, kept in zip(late, credible, strict=True) if kept)
    believed = tuple(disturbed_runners({label: runners[label] for label in used}, settings).values())

    @cache
    def objective(run: int) -> EnsembleObjective:
        return EnsembleObjective(
            believed, controller, task, derived_seed(seed, run), settings.trials, settings.aggregate
        )

    def begun(run: int) -> tuple[EvolutionStrategy, Schedule]:
        strategy = CmaEs(
            n_parameters=controller.n_parameters,
            seed=derived_seed(seed, run),
            sigma=sigma,
            initial=chosen[run].parameters,
        )
        return strategy, Schedule((), objective(run), most=task.max_fitness)

    def finals(run: int, strategy: EvolutionStrategy) -> tuple[Finalist, ...]:
        candidates = np.concatenate([chosen[run].parameters[None], strategy.elite])
        fitness = objective(run).on_trials(candidates, seeds).fitness
        winner = int(np.argmax(fitness))
        label = f"{POLISHED} {chosen[run].behaviour_class}".strip()
        return (Finalist(label, run, float(fitness[winner]), candidates[winner]),)

    asked = [repr(settings), generations, sigma, *(start.parameters.tolist() for start in chosen)]
    runs = Runs(
        len(chosen),
        generations,
        begun,
        finals,
        models=(used,),
        checkpoint=checkpoint,
        identity="" if checkpoint is None else evolution_digest(asked, runners, controller, task, seed),
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
