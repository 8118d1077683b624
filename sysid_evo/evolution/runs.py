"""Runs of a search, one after the other, which can be stopped after any generation and gone on with."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid_evo.checkpoint import Checkpoint
from sysid_evo.controllers.controller import Controller
from sysid_evo.engine import DynamicsRunner, Runner
from sysid_evo.errors import CheckpointWarning, EvolutionWarning
from sysid_evo.evolution.champion import Finalist
from sysid_evo.evolution.loop import Generation, evolve
from sysid_evo.evolution.schedule import Schedule
from sysid_evo.evolution.standing import EndedRun, Standing
from sysid_evo.evolution.strategy import EvolutionStrategy
from sysid_evo.progress import Progress
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks.task import Task


@dataclass(frozen=True)
class Runs:
    """``count`` runs of ``generations`` each, or until the schedule is exhausted.

    ``begun(run)`` makes strategy and objective anew, as they are before the first generation; ``finals`` chooses
    the finalists of a run that has ended. ``models`` are the labels of those that each stage is met on, the last
    for what is asked. The ``checkpoint`` is kept under ``identity``.
    """

    count: int
    generations: int
    begun: Callable[[int], tuple[EvolutionStrategy, Schedule]]
    finals: Callable[[int, EvolutionStrategy], tuple[Finalist, ...]]
    models: Sequence[tuple[str, ...]]
    checkpoint: Checkpoint | None = None
    identity: str = ""

    def to_the_end(self, progress: Progress | None) -> tuple[EndedRun, ...]:
        """Return all runs when they have ended. Whatever stops them, the generations done are kept.

        The state of a strategy is taken only when it is to be kept: to copy it takes as long as to learn. A stop while
        it learns, when it has none, leaves what was kept last.
        """
        standing = saved = self._resumed()
        search: _Search | None = None
        total = self.count * self.generations
        if progress is not None and standing.generations:
            progress(standing.generations, total)
        try:
            for reached, search, note in self._steps(standing):
                standing = reached
                if self.checkpoint is not None and (not note or self.checkpoint.due()):
                    self.checkpoint.save(self.identity, search.added_to(standing).state)
                    saved = standing
                if progress is not None and note:
                    progress(standing.generations, total, note)
        except BaseException:  # Ctrl-C, too
            if self.checkpoint is not None and search is not None and standing is not saved and search.settled:
                self.checkpoint.save(self.identity, search.added_to(standing).state)
            raise
        return standing.ended

    def _steps(self, standing: Standing) -> Iterator[tuple[Standing, _Search, str]]:
        """Yield how things stand after every generation, with a note, and after every run, without one."""
        for run in range(len(standing.ended), self.count):
            strategy, schedule = self.begun(run)
            standing.restore(strategy, schedule)
            begin = len(standing.history)
            for generation in evolve(
                strategy, schedule, begin if schedule.exhausted else self.generations, start=begin
            ):
                note = self._note(run, generation, strategy, schedule)
                if schedule.tell(generation):
                    strategy.forget_fitness()
                history = np.concatenate([standing.history, [generation.summary]])
                standing = Standing(standing.ended, history)
                yield standing, _Search(strategy, schedule, strategy.told), note
                if schedule.exhausted:
                    break
            if schedule.stage < len(schedule.stages):
                warnings.warn(
                    f"run {run + 1} ended in {schedule.status}: the task itself was never evolved. "
                    "Give more generations, a lower until, or at_most",
                    EvolutionWarning,
                    stacklevel=2,
                )
            ended = EndedRun(self.finals(run, strategy), standing.history, strategy.elite)
            standing = Standing((*standing.ended, ended))
            yield standing, _Search(strategy, schedule, strategy.told), ""

    def _resumed(self) -> Standing:
        """Return how far the checkpoint is, if it is a checkpoint of this very evolution."""
        found = None if self.checkpoint is None else self.checkpoint.load(self.identity)
        if found is None:
            return Standing()
        try:
            standing = Standing.of(found)
            standing.restore(*self.begun(0))
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
        if self.count > 1:
            parts.append(f"run {run + 1} of {self.count}")
        return "; ".join(filter(None, (*parts, schedule.status, strategy.status)))


@dataclass(frozen=True)
class _Search:
    """What goes on in a run after a generation: the ``strategy`` was ``told`` of so many."""

    strategy: EvolutionStrategy
    schedule: Schedule
    told: int

    @property
    def settled(self) -> bool:
        """Whether nothing was learned since."""
        return self.strategy.told == self.told

    def added_to(self, standing: Standing) -> Standing:
        """Return ``standing`` with the states of both, as they are now; as it is between two runs."""
        if not len(standing.history):
            return standing
        return replace(standing, strategy=self.strategy.state, schedule=self.schedule.state)


def identity(told: Sequence[Any], runners: Mapping[str, Runner], controller: Controller, task: Task, seed: int) -> str:
    """Return the digest of an evolution: what is ``told`` of it, strict JSON, and where controllers drive in models."""
    text = json.dumps([*told, list(runners), task.system.to_dict(), seed], sort_keys=True)
    digest = hashlib.sha256(text.encode())
    some = np.random.default_rng(seed).standard_normal((2, controller.n_parameters))
    for runner in runners.values():
        if isinstance(runner, DynamicsRunner):  # a robot never drives the same way twice
            for trajectory in runner.run(controller, some, task, trial_seeds(seed, 2), record=True).trajectories:
                digest.update(np.ascontiguousarray(trajectory.states).tobytes())
    return digest.hexdigest()
