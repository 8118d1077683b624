"""Evolving a controller against one model or an ensemble, and choosing the champion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from sysid_evo.arrays import Array, Seeds
from sysid_evo.controllers.controller import Controller
from sysid_evo.engine import DynamicsRunner, Runner, behaviour_names
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.champion import Champion, Finalist
from sysid_evo.evolution.ensemble import EnsembleObjective
from sysid_evo.evolution.loop import evolve
from sysid_evo.evolution.strategy import EvolutionStrategy
from sysid_evo.progress import Progress
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import (
    Spec,
    aggregates,
    controllers,
    make_controller,
    make_strategy,
    make_task,
    strategies,
    tasks,
)
from sysid_evo.system import System
from sysid_evo.tasks.task import Task
from sysid_evo.wrappers import (
    DelayedEstimate,
    Discounted,
    Doubt,
    RadicalEnvelope,
    Switching,
    cautions,
    disturbed,
    noises,
    one_of_its_members,
)

SELECTION = 2**31
"""The generation number of the fresh trials on which champions are chosen: never reached by a run."""


@dataclass(frozen=True)
class ControllerEvolution:
    """How controllers are evolved: specs of registered things (or their text) and numbers, all of it storable.

    ``trials`` of every candidate in each generation (paper: 10); ``runs`` from different seeds (paper: 2).
    Every niche of every run gives a finalist, its best on ``selection_trials`` fresh trials, and the
    champion is one of them, see `Champion`. ``aggregate`` is a name or a spec, ``NAME(parameter=value)``. With
    ``estimator_delay`` (s) every model is observed that late, as on a robot whose state is estimated,
    see `DelayedEstimate`. ``noise`` is met in evolution and in the choice of the champion, not by its claims; a
    spec, see `RadicalEnvelope`; empty for none. With ``caution``, a spec too (`Doubt`), candidates lose fitness where
    the models that they are evolved in cannot be believed.
    """

    generations: int = 300
    trials: int = 10
    runs: int = 1
    aggregate: str = "min"
    selection_trials: int = 100
    estimator_delay: float = 0.0
    controller: Spec = field(default_factory=lambda: Spec("recurrent"))
    task: Spec = field(default_factory=lambda: Spec("point_to_point"))
    strategy: Spec = field(default_factory=lambda: Spec("mu_plus_lambda"))
    noise: str = ""
    caution: str = ""

    def __post_init__(self) -> None:
        for name, registry in (("controller", controllers), ("task", tasks), ("strategy", strategies)):
            object.__setattr__(self, name, registry.check(getattr(self, name)))
        for name in ("generations", "trials", "runs", "selection_trials"):
            if getattr(self, name) < 1:
                raise InvalidArgument(f"evolution: expected {name} >= 1, got {getattr(self, name)}")
        aggregates.check(self.aggregate)
        self.make_noise()
        self.make_caution()
        if not 0.0 <= self.estimator_delay < np.inf:
            raise InvalidArgument(f"evolution: expected estimator_delay >= 0 s, got {self.estimator_delay}")

    def make_task(self, system: System) -> Task:
        """Return the task, bound to ``system``."""
        return make_task(self.task).bind(system)

    def make_controller(self, task: Task) -> Controller:
        """Return the controller with the inputs of ``task`` and the outputs of its system."""
        return make_controller(self.controller).bind(len(task.observations), task.system.nu)

    def make_noise(self) -> RadicalEnvelope | None:
        """Return the noise, None without any."""
        return noises.make(self.noise) if self.noise else None

    def make_caution(self) -> Doubt | None:
        """Return what a trial loses where models are doubted, None for nothing."""
        return cautions.make(self.caution) if self.caution else None

    def make_strategy(self, n_parameters: int, seed: int) -> EvolutionStrategy:
        """Return the strategy, which searches ``n_parameters`` numbers."""
        return make_strategy(self.strategy, n_parameters=n_parameters, seed=seed)


def evolve_controller(
    name: str,
    runners: Mapping[str, Runner],
    system: System,
    settings: ControllerEvolution,
    *,
    seed: int,
    judges: Mapping[str, Runner] | None = None,
    progress: Progress | None = None,
) -> Champion:
    """Evolve a controller against all of ``runners`` at once and return the champion of all runs.

    ``judges`` are models of other families, on which nothing is evolved: among the finalists of all niches
    and runs the one with the highest median on them is chosen. Without judges the fittest is. ``progress``
    is called after every generation. The result depends on ``seed`` alone.
    """
    task = settings.make_task(system)
    controller = settings.make_controller(task)
    late, judging = met(in_turns(runners, settings), settings), met(judges or {}, replace(settings, caution=""))
    seeds = trial_seeds(seed, settings.selection_trials, generation=SELECTION)
    total = settings.runs * settings.generations
    ended: list[_Run] = []
    for run in range(settings.runs):
        run_seed = int(np.random.SeedSequence(seed, spawn_key=(run,)).generate_state(1, np.uint32)[0])
        strategy = settings.make_strategy(controller.n_parameters, run_seed)
        strategy.behaviour_names = behaviour_names(system)
        objective = EnsembleObjective(
            tuple(late.values()), controller, task, run_seed, settings.trials, settings.aggregate
        )
        history = []
        for generation in evolve(strategy, objective, settings.generations):
            history.append(generation.summary)
            if progress is not None:
                progress(run * settings.generations + generation.index + 1, total)
        ended.append(_Run(tuple(_finalists(strategy, objective, run, seeds)), np.array(history), strategy.elite))
    finalists = tuple(chain.from_iterable(run.finalists for run in ended))
    if judging:
        finalists = _judged(finalists, tuple(judging.values()), controller, task, seeds)
    best = max(
        finalists, key=lambda one: one.fitness if one.elsewhere is None else one.elsewhere
    )  # of equals the first
    return Champion(
        name=name,
        parameters=best.parameters,
        against=tuple(runners),
        aggregate=settings.aggregate,
        seed=seed,
        history=ended[best.run].history,
        controller=settings.controller,
        task=settings.task,
        estimator_delay=settings.estimator_delay,
        seed_fitness=tuple(max(one.fitness for one in run.finalists) for run in ended),
        system=system,
        judges=tuple(judging),
        finalists=finalists,
        population=ended[best.run].population,
    )


@dataclass(frozen=True)
class _Run:
    """What one run ended with: finalists, history (G, 3), the last candidates (P, n)."""

    finalists: tuple[Finalist, ...]
    history: Array
    population: Array


def _finalists(strategy: EvolutionStrategy, objective: EnsembleObjective, run: int, seeds: Seeds) -> Iterator[Finalist]:
    """Yield the best of every niche on the trials of ``seeds``."""
    for niche, candidates in strategy.finals.items():
        fitness = objective.on_trials(candidates, seeds).fitness
        winner = int(np.argmax(fitness))
        yield Finalist(niche, run, float(fitness[winner]), candidates[winner])


def _judged(
    finalists: tuple[Finalist, ...], judges: tuple[Runner, ...], controller: Controller, task: Task, seeds: Seeds
) -> tuple[Finalist, ...]:
    """Return the finalists with their median over the ``judges``."""
    everyone = np.stack([finalist.parameters for finalist in finalists])
    elsewhere = EnsembleObjective(judges, controller, task, seed=0, aggregate="median").on_trials(everyone, seeds)
    return tuple(
        replace(finalist, elsewhere=float(value)) for finalist, value in zip(finalists, elsewhere.fitness, strict=True)
    )


def met(runners: Mapping[str, Runner], settings: ControllerEvolution) -> dict[str, Runner]:
    """Return ``runners`` as candidates meet them: doubted, with noise, observed late. Raises `InvalidArgument`."""
    noise, caution, delay = settings.make_noise(), settings.make_caution(), settings.estimator_delay
    if noise is None and caution is None:
        return {label: observed_late(label, runner, delay) for label, runner in runners.items()}
    models = models_of(runners, "noise and caution")
    found: dict[str, Runner] = {}
    for label, runner in models.items():
        dynamics = runner.dynamics
        if noise is not None and noise.members:
            dynamics = one_of_its_members(dynamics)
        if caution is not None:
            dynamics = caution.about(dynamics, [other.dynamics for name, other in models.items() if name != label])
        if noise is not None:
            dynamics = disturbed(dynamics, noise, delay)
        elif delay:
            dynamics = DelayedEstimate(dynamics, delay)
        runner = replace(runner, dynamics=dynamics)
        found[label] = runner if caution is None else Discounted(runner, caution.most)
    return found


def models_of(runners: Mapping[str, Runner], asked_for: str) -> dict[str, DynamicsRunner]:
    """Return ``runners`` if all of them run a dynamics here. Raises `InvalidArgument`."""
    found = {label: runner for label, runner in runners.items() if isinstance(runner, DynamicsRunner)}
    others = [label for label in runners if label not in found]
    if others:
        raise InvalidArgument(f"evolution: {', '.join(others)} is not a model, so that {asked_for} cannot be added")
    return found


def in_turns(runners: Mapping[str, Runner], settings: ControllerEvolution) -> Mapping[str, Runner]:
    """Return one runner whose models take turns, if the noise lets them switch and there are several."""
    noise = settings.make_noise()
    if noise is None or not noise.switching or len(runners) < 2:
        return runners
    models = models_of(runners, "switching")
    together = Switching([runner.dynamics for runner in models.values()], every=noise.switching)
    return {"|".join(models): replace(next(iter(models.values())), dynamics=together)}


def observed_late(name: str, runner: Runner, delay: float) -> Runner:
    """Return ``runner`` with a state that is observed ``delay`` s late. Raises `InvalidArgument`."""
    if delay == 0.0:
        return runner
    if not isinstance(runner, DynamicsRunner):
        raise InvalidArgument(f"evolution: {name} is not a model, so that its state cannot be observed late")
    return replace(runner, dynamics=DelayedEstimate(runner.dynamics, delay))
