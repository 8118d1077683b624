"""Choice among candidates that have all the fitness there is: the one that stays inside the data and lasts."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine.rollout import DynamicsRunner, Runner
from sysid_evo.evolution.loop import Scores
from sysid_evo.models.disturbances import Disturbed, DomainRandomisation
from sysid_evo.models.penalty import UncertaintyPenalty
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import tasks
from sysid_evo.system import System
from sysid_evo.tasks.task import make_task
from sysid_evo.types import Array, BoolArray, IntArray, Seeds

EQUAL_SHARE = 0.01
"""Share of the highest fitness within which fitness counts as equal."""
MIN_TRIAL_SHARE = 0.9
"""Share of the trials that must have nearly the highest fitness."""
NOISE = DomainRandomisation(sensor=0.1, process=0.02)
HORIZON_MULTIPLE = 2
"""Multiple of the horizon over which margins are measured."""
MARGIN_TRIALS = 20


def has_all_fitness(by_trial: Array, worst: float) -> BoolArray:
    """Return which candidates (P,) have nearly the highest fitness of any trial in nearly all trials (P, E).

    Then fitness does not rank them: the task has no more to give. None has if all have the ``worst`` fitness.
    """
    top = float(by_trial.max())
    found: BoolArray = ((by_trial >= top - EQUAL_SHARE * abs(top)).mean(axis=1) >= MIN_TRIAL_SHARE) & (top > worst)
    return found


def best_candidate(scores: Scores, worst: float, margins: Callable[[IntArray, float], Array]) -> int:
    """Return the index of the fittest candidate; of those with all the fitness there is, of the largest margin.

    ``margins`` returns the margins of the candidates with these indices, in units of that fitness; it is called if
    there are two or more.
    """
    fitness = scores.fitness
    best = int(np.argmax(fitness))  # of equals the first
    if scores.by_trial is None:
        return best
    near = fitness >= fitness[best] - EQUAL_SHARE * abs(fitness[best])
    equal = np.flatnonzero(has_all_fitness(scores.by_trial, worst) & near)
    return int(equal[np.argmax(margins(equal, float(fitness[best])))]) if best in equal and len(equal) > 1 else best


def candidate_margins(
    population: Array,
    runners: Mapping[str, Runner],
    controller: Spec,
    task: Spec,
    system: System,
    seeds: Seeds,
    *,
    scale: float,
    delay: float = 0.0,
) -> Array:
    """Return the margin (P,) of each candidate: its fitness under noise, minus its time outside the data.

    Both are means over the trials ``seeds`` in those of ``runners`` that are models. Fitness is in units of ``scale``,
    the fitness that all candidates have; a trial outside the training data, see `UncertaintyPenalty`, loses 1.
    The horizon is `HORIZON_MULTIPLE` times that of the task, if the task has such a parameter. Zeros without a model.
    """
    horizon = make_task(task).bind(system).horizon
    lasting = task
    if "horizon" in tasks.parameters(task.name):
        lasting = Spec(task.name, {**task.parameters, "horizon": HORIZON_MULTIPLE * horizon}, task.label)
    goal, law = make_task(lasting).bind(system), make_controller(controller)
    fitness, outside = [], []
    for runner in runners.values():
        if isinstance(runner, DynamicsRunner) and getattr(runner.dynamics, "training_sample_", None) is not None:
            checked = UncertaintyPenalty(outside=1.0).around(runner.dynamics)
            bound = DynamicsRunner(Disturbed(checked, NOISE, delay=delay), runner.engine, runner.threads)
            run = bound.bind(law, goal)(population, seeds[:MARGIN_TRIALS])
            fitness.append(run.fitness)
            outside.append(np.minimum(run.penalty / np.maximum(run.survived, 1), 1.0))
    if not fitness:
        return np.zeros(len(population))
    return np.asarray(np.mean(fitness, axis=(0, 2)) / (abs(scale) or 1.0) - np.mean(outside, axis=(0, 2)))
