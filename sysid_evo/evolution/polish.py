"""A short local search, from controllers that were found in single models, against an ensemble of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sysid_evo.arrays import Array, BoolArray
from sysid_evo.engine import Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.champion import Champion, Finalist
from sysid_evo.evolution.choice import worth
from sysid_evo.evolution.cma_es import CmaEs
from sysid_evo.evolution.controllers import ControllerEvolution, observed_late, selection_seeds
from sysid_evo.evolution.ensemble import EnsembleObjective
from sysid_evo.evolution.loop import evolve
from sysid_evo.evolution.meeting import met
from sysid_evo.progress import Progress

POLISHED = "polished"
CREDIBLE = 0.7
"""Share of its median fitness over all models that a controller must have on one for that one to be believed."""


def polish(
    name: str,
    champion: Champion,
    runners: Mapping[str, Runner],
    settings: ControllerEvolution,
    *,
    seed: int,
    starts: int = 2,
    generations: int = 120,
    sigma: float = 0.1,
    progress: Progress | None = None,
) -> Champion:
    """Return the fittest of what CMA-ES finds near the ``starts`` best finalists of ``champion`` on all of ``runners``.

    How the fitnesses on the models become one is the aggregate of ``settings``, and so are trials, task and
    controller. The step is short, ``sigma`` at the start, since the starts are good drivers already: what
    changes is what they owe to the faults of single models. A start that nothing beats stays as it is. Models
    that deny the best start, on which it has less than `CREDIBLE` of its median over all, are left out, so that
    one bad model does not forbid good driving; ``against`` names those that were used.
    """
    if not champion.finalists or champion.system is None:
        raise InvalidArgument(f"polish: controller {champion.name!r} has no finalists to start from")
    task = settings.make_task(champion.system)
    controller = settings.make_controller(task)
    late = {label: observed_late(label, runner, settings.estimator_delay) for label, runner in runners.items()}
    seeds = selection_seeds(seed, settings.selection_trials)
    chosen = sorted(champion.finalists, key=lambda one: -worth(one))[:starts]
    everyone = EnsembleObjective(tuple(late.values()), controller, task, seed, aggregate=settings.aggregate)
    by_model = everyone.on_trials(chosen[0].parameters[None], seeds).by_model
    assert by_model is not None
    used = [label for label, kept in zip(late, credible(by_model[:, 0]), strict=True) if kept]
    believed = tuple(met({label: runners[label] for label in used}, settings).values())
    histories: list[Array] = []
    found: list[tuple[Finalist, Array]] = []
    for number, start in enumerate(chosen):
        run_seed = int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1, np.uint32)[0])
        objective = EnsembleObjective(believed, controller, task, run_seed, settings.trials, settings.aggregate)
        strategy = CmaEs(n_parameters=controller.n_parameters, seed=run_seed, sigma=sigma, initial=start.parameters)
        history = []
        for generation in evolve(strategy, objective, generations):
            history.append(generation.summary)
            if progress is not None:
                progress(number * generations + generation.index + 1, len(chosen) * generations)
        candidates = np.concatenate([start.parameters[None], strategy.elite])
        fitness = objective.on_trials(candidates, seeds).fitness
        winner = int(np.argmax(fitness))
        histories.append(np.array(history).reshape(-1, 3))
        label = f"{POLISHED} {start.niche}".strip()
        found.append((Finalist(label, number, float(fitness[winner]), candidates[winner]), strategy.elite))
    best, population = max(found, key=lambda pair: pair[0].fitness)  # of equals the first
    return replace(
        champion,
        name=name,
        parameters=best.parameters,
        against=tuple(used),
        aggregate=settings.aggregate,
        seed=seed,
        history=histories[best.run],
        seed_fitness=(),
        judges=(),
        finalists=tuple(finalist for finalist, _ in found),
        population=population,
    )


def credible(fitness: Array) -> BoolArray:
    """Return which models (M,) are believed about a controller that has this fitness on them."""
    median = np.median(fitness)
    kept: BoolArray = fitness >= median - (1.0 - CREDIBLE) * abs(median)
    return kept
