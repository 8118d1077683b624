"""Evolving a controller against one model or an ensemble, and choosing the champion."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from sysid_evo.arrays import Seeds
from sysid_evo.controllers.controller import Controller
from sysid_evo.engine import DynamicsRunner, Runner, behaviour_names
from sysid_evo.errors import CheckpointWarning, EvolutionWarning, InvalidArgument
from sysid_evo.evolution.champion import Champion, Finalist
from sysid_evo.evolution.ensemble import EnsembleObjective
from sysid_evo.evolution.loop import Generation, evolve
from sysid_evo.evolution.schedule import Schedule, Stage
from sysid_evo.evolution.standing import Checkpoint, EndedRun, Standing
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
from sysid_evo.wrappers import DelayedEstimate

SELECTION = 2**31
"""The generation number of the fresh trials on which champions are chosen: never reached by a run."""


@dataclass(frozen=True)
class ControllerEvolution:
    """How controllers are evolved: specs of registered things (or their text) and numbers, all of it storable.

    ``trials`` of every candidate in each generation (paper: 10); ``runs`` from different seeds (paper: 2).
    Every niche of every run gives a finalist, its best on ``selection_trials`` fresh trials, and the
    champion is one of them, see `Champion`. ``aggregate`` is a name or a spec, ``NAME(parameter=value)``. With
    ``estimator_delay`` (s) every model is observed that late, as on a robot whose state is estimated,
    see `DelayedEstimate`. The ``schedule`` holds easier stages, or their text, which come before the task in every run.
    """

    generations: int = 300
    trials: int = 10
    runs: int = 1
    aggregate: str = "min"
    selection_trials: int = 100
    estimator_delay: float = 0.0
    schedule: tuple[Stage, ...] = ()
    controller: Spec = field(default_factory=lambda: Spec("recurrent"))
    task: Spec = field(default_factory=lambda: Spec("point_to_point"))
    strategy: Spec = field(default_factory=lambda: Spec("mu_plus_lambda"))

    def __post_init__(self) -> None:
        for name, registry in (("controller", controllers), ("task", tasks), ("strategy", strategies)):
            object.__setattr__(self, name, registry.check(getattr(self, name)))
        for name in ("generations", "trials", "runs", "selection_trials"):
            if getattr(self, name) < 1:
                raise InvalidArgument(f"evolution: expected {name} >= 1, got {getattr(self, name)}")
        aggregates.check(self.aggregate)
        schedule: object = self.schedule
        if isinstance(schedule, str):
            object.__setattr__(self, "schedule", Stage.parse_many(schedule))
        if not 0.0 <= self.estimator_delay < np.inf:
            raise InvalidArgument(f"evolution: expected estimator_delay >= 0 s, got {self.estimator_delay}")

    def make_task(self, system: System) -> Task:
        """Return the task, bound to ``system``."""
        return make_task(self.task).bind(system)

    def stages(self, task: Task, models: tuple[str, ...]) -> tuple[tuple[Stage, Task, tuple[str, ...]], ...]:
        """Return every stage before ``task``, which is bound: with its own task, and on which of ``models`` it is met.

        Raises `InvalidArgument` if a stage wants another controller, or models that are not there.
        """
        found = []
        for stage in self.schedule:
            of_stage = task if stage.task is None else make_task(stage.task).bind(task.system)
            if of_stage.observations != task.observations:
                raise InvalidArgument(
                    f"schedule: {stage.task} shows other things than {self.task}, so that no controller can do both"
                )
            missing = [model for model in stage.models if model not in models]
            if missing:
                raise InvalidArgument(f"schedule: {missing[0]!r} is not among the models: {', '.join(models)}")
            found.append((stage, of_stage, stage.models or models))
        return tuple(found)

    def make_controller(self, task: Task) -> Controller:
        """Return the controller with the inputs of ``task`` and the outputs of its system."""
        return make_controller(self.controller).bind(len(task.observations), task.system.nu)

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
    checkpoint: Checkpoint | None = None,
    progress: Progress | None = None,
) -> Champion:
    """Evolve a controller against all of ``runners`` at once and return the champion of all runs.

    ``judges`` are models of other families, on which nothing is evolved: among the finalists of all niches
    and runs the one with the highest median on them is chosen. Without judges the fittest is. ``progress``
    is called after every generation, with a note of what it reached. The result depends on ``seed`` alone.

    With a ``checkpoint``, `CheckpointFile` for example, an evolution that was stopped or killed goes on where
    it was, to the champion that it would have had.
    """
    task = settings.make_task(system)
    controller = settings.make_controller(task)
    late = {label: observed_late(label, runner, settings.estimator_delay) for label, runner in runners.items()}
    judging = {
        label: observed_late(label, runner, settings.estimator_delay) for label, runner in (judges or {}).items()
    }
    seeds = trial_seeds(seed, settings.selection_trials, generation=SELECTION)

    easier = settings.stages(task, tuple(runners))

    def begun(run: int) -> tuple[EvolutionStrategy, Schedule, EnsembleObjective]:
        """Return strategy and objectives of a run as they are before its first generation, and the last objective."""
        run_seed = int(np.random.SeedSequence(seed, spawn_key=(run,)).generate_state(1, np.uint32)[0])
        strategy = settings.make_strategy(controller.n_parameters, run_seed)
        strategy.behaviour_names = behaviour_names(system)

        def objective(of_stage: Task, models: tuple[str, ...]) -> EnsembleObjective:
            met = tuple(late[model] for model in models)
            return EnsembleObjective(met, controller, of_stage, run_seed, settings.trials, settings.aggregate)

        stages = [(stage, objective(of_stage, models)) for stage, of_stage, models in easier]
        asked = objective(task, tuple(runners))
        return strategy, Schedule(stages, asked), asked

    identity = "" if checkpoint is None else _identity(settings, late, controller, task, seed)
    met = (*(models for _, _, models in easier), tuple(runners))
    runs = _Runs(settings, begun, seeds, met, checkpoint, identity)
    ended = runs.to_the_end(progress)
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
class _Runs:
    """The runs of an evolution, one after the other. ``begun(run)`` makes strategy and objectives anew.

    ``models`` are the labels of those that each stage is met on.
    """

    settings: ControllerEvolution
    begun: Callable[[int], tuple[EvolutionStrategy, Schedule, EnsembleObjective]]
    seeds: Seeds
    models: tuple[tuple[str, ...], ...]
    checkpoint: Checkpoint | None
    identity: str

    def to_the_end(self, progress: Progress | None) -> tuple[EndedRun, ...]:
        """Return all runs when they have ended. Whatever stops them, the generations done are kept."""
        standing = saved = self._resumed()
        if progress is not None and standing.generations:
            progress(standing.generations, self._total)
        try:
            for reached, note in self._steps(standing):
                standing = reached
                if self.checkpoint is not None and (not note or self.checkpoint.due()):
                    self.checkpoint.save(self.identity, standing.state)
                    saved = standing
                if progress is not None and note:
                    progress(standing.generations, self._total, note)
        except BaseException:  # Ctrl-C, too
            if self.checkpoint is not None and standing is not saved:
                self.checkpoint.save(self.identity, standing.state)
            raise
        return standing.ended

    def _steps(self, standing: Standing) -> Iterator[tuple[Standing, str]]:
        """Yield how things stand after every generation, with a note, and after every run, without one."""
        settings = self.settings
        for run in range(len(standing.ended), settings.runs):
            strategy, schedule, asked = self.begun(run)
            standing.restore(strategy, schedule)
            for generation in evolve(strategy, schedule, settings.generations, start=len(standing.history)):
                note = self._note(run, generation, strategy, schedule)
                if schedule.tell(generation):
                    strategy.forget_fitness()
                history = np.concatenate([standing.history, [generation.summary]])
                states = ({}, {}) if self.checkpoint is None else (strategy.state, schedule.state)
                standing = Standing(standing.ended, history, *states)
                yield standing, note
            if schedule.stage < len(settings.schedule):
                warnings.warn(
                    f"run {run + 1} ended in {schedule.status}: the task itself was never evolved. "
                    "Give more generations, a lower until, or at_most",
                    EvolutionWarning,
                    stacklevel=2,
                )
            finalists = tuple(_finalists(strategy, asked, run, self.seeds))
            standing = Standing((*standing.ended, EndedRun(finalists, standing.history, strategy.elite)))
            yield standing, ""

    def _resumed(self) -> Standing:
        """Return how far the checkpoint is, if it is a checkpoint of this very evolution."""
        found = None if self.checkpoint is None else self.checkpoint.load(self.identity)
        if found is None:
            return Standing()
        try:
            standing = Standing.of(found)
            strategy, schedule, _ = self.begun(0)
            standing.restore(strategy, schedule)
        except (LookupError, TypeError, ValueError) as error:
            warnings.warn(
                f"the checkpoint is ignored, and all is computed again: {error}", CheckpointWarning, stacklevel=2
            )
            return Standing()
        return standing

    def _note(self, run: int, generation: Generation, strategy: EvolutionStrategy, schedule: Schedule) -> str:
        """Return what a generation reached: best and mean, the best on every model, what the strategy says."""
        models = self.models[schedule.stage]
        best, mean, _ = generation.summary
        parts = [f"best {best:.1f}, mean {mean:.1f}"]
        if generation.by_model is not None and len(generation.by_model) > 1:
            of_best = generation.by_model[:, int(np.argmax(generation.fitness))]
            parts.append(", ".join(f"{name} {value:.1f}" for name, value in zip(models, of_best, strict=True)))
        if self.settings.runs > 1:
            parts.append(f"run {run + 1} of {self.settings.runs}")
        return "; ".join(filter(None, (*parts, schedule.status, strategy.status)))

    @property
    def _total(self) -> int:
        return self.settings.runs * self.settings.generations


def _identity(
    settings: ControllerEvolution, runners: Mapping[str, Runner], controller: Controller, task: Task, seed: int
) -> str:
    """Return the digest of an evolution: what was asked for, and where a few controllers drive in the models."""
    told = [repr(settings), seed, list(runners), task.system.to_dict()]
    digest = hashlib.sha256(json.dumps(told, sort_keys=True).encode())
    some = np.random.default_rng(seed).standard_normal((2, controller.n_parameters))
    for runner in runners.values():
        if isinstance(runner, DynamicsRunner):  # a robot never drives the same way twice
            driven = runner.run(controller, some, task, trial_seeds(seed, 2, generation=SELECTION), record=True)
            for trajectory in driven.trajectories:
                digest.update(np.ascontiguousarray(trajectory.states).tobytes())
    return digest.hexdigest()


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


def observed_late(name: str, runner: Runner, delay: float) -> Runner:
    """Return ``runner`` with a state that is observed ``delay`` s late. Raises `InvalidArgument`."""
    if delay == 0.0:
        return runner
    if not isinstance(runner, DynamicsRunner):
        raise InvalidArgument(f"evolution: {name} is not a model, so that its state cannot be observed late")
    return replace(runner, dynamics=DelayedEstimate(runner.dynamics, delay))
