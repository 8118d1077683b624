"""Choice among candidates that have all the fitness there is: the one that stays inside the data and lasts."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine.rollout import DynamicsRunner, Runner
from sysid_evo.evolution.loop import Scores
from sysid_evo.models.disturbances import Disturbed, DomainRandomisation
from sysid_evo.models.outside import OutsideCounter
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


def best_candidate(scores: Scores, worst: float, margins: Callable[[IntArray], Array]) -> int:
    """Return the index of the fittest candidate; of those with all the fitness there is, of the largest margin.

    ``margins`` returns the margins of the candidates with these indices; it is called if there are two or more.
    """
    fitness = scores.fitness
    best = int(np.argmax(fitness))  # of equals the first
    if scores.by_trial is None:
        return best
    near = fitness >= fitness[best] - EQUAL_SHARE * abs(fitness[best])
    equal = np.flatnonzero(has_all_fitness(scores.by_trial, worst) & near)
    return int(equal[np.argmax(margins(equal))]) if best in equal and len(equal) > 1 else best


def margins_of(lasting: Array) -> Array:
    """Return the margin (P,) of each candidate: its share of the highest fitness, minus its share of time outside.

    ``lasting`` (P, 2) is that of `lasting_fitness`.
    """
    size = float(np.abs(lasting[:, 0]).max()) or 1.0
    return np.asarray(lasting[:, 0] / size - lasting[:, 1])


def lasting_fitness(
    population: Array,
    runners: Mapping[str, Runner],
    controller: Spec,
    task: Spec,
    system: System,
    seeds: Seeds,
    *,
    delay: float = 0.0,
) -> Array:
    """Return the fitness of each candidate under noise, and its share of time outside the data, (P, 2).

    Both are means over the trials ``seeds`` in those of ``runners`` that are models. A step is outside as for
    `OutsideCounter`. The horizon is `HORIZON_MULTIPLE` times that of the task, if the task has such a parameter.
    Zeros without a model.
    """
    horizon = make_task(task).bind(system).horizon
    goal, law = make_task(with_horizon(task, HORIZON_MULTIPLE * horizon)), make_controller(controller)
    found = []
    for runner in runners.values():
        if isinstance(runner, DynamicsRunner) and getattr(runner.dynamics, "training_sample_", None) is not None:
            noisy = Disturbed(OutsideCounter(runner.dynamics), NOISE, delay=delay)
            bound = DynamicsRunner(noisy, runner.engine, runner.threads)
            run = bound.bind(law, goal)(population, seeds[:MARGIN_TRIALS])
            outside = np.minimum(run.outside / np.maximum(run.survived, 1), 1.0)
            found.append(np.stack([run.fitness.mean(axis=1), outside.mean(axis=1)], axis=1))
    return np.mean(found, axis=0) if found else np.zeros((len(population), 2))


def with_horizon(task: Spec, horizon: int) -> Spec:
    """Return ``task`` with another horizon, unchanged if it has no such parameter."""
    if "horizon" not in tasks.parameters(task.name):
        return task
    return Spec(task.name, {**task.parameters, "horizon": horizon}, task.label)
