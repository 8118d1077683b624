"""Several runs of a search that can be interrupted and resumed."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sysid_evo.controllers.controller import Controller
from sysid_evo.engine.rollout import DynamicsRunner, Runner
from sysid_evo.errors import CheckpointWarning, EvolutionWarning
from sysid_evo.evolution.champion import Finalist
from sysid_evo.evolution.loop import Generation, Schedule, evolve
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy, StrategyState
from sysid_evo.processors import engine_inputs
from sysid_evo.progress import Checkpoint, Progress
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks.task import Task
from sysid_evo.types import Array, check_shape


@dataclass(frozen=True)
class Runs:
    """``count`` runs of ``generations`` each, or until the schedule is exhausted.

    ``begun(run)`` makes strategy and objective anew, as they are before the first generation; ``finals`` chooses
    the finalists of a run that has ended. ``models`` are the labels of those that each stage is met on, the last
    for what is asked. The ``checkpoint`` is kept under ``evolution_digest``.
    """

    count: int
    generations: int
    begun: Callable[[int], tuple[EvolutionStrategy, Schedule]]
    finals: Callable[[int, EvolutionStrategy], tuple[Finalist, ...]]
    models: Sequence[tuple[str, ...]]
    checkpoint: Checkpoint | None = None
    identity: str = ""

    def finish(self, progress: Progress | None) -> tuple[FinishedRun, ...]:
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

    def _steps(self, standing: EvolutionState) -> Iterator[tuple[EvolutionState, _Search, str]]:
        """Yield how things stand after every generation, with a note, and after every run, without one."""
        for run in range(len(standing.ended), self.count):
            strategy, schedule = self.begun(run)
            standing.restore(strategy, schedule)
            begin = len(standing.history)
            for generation in evolve(
                strategy, schedule, begin if schedule.converged else self.generations, start=begin
            ):
                note = self._note(run, generation, strategy, schedule)
                if schedule.tell(generation):
                    strategy.forget_fitness()
                history = np.concatenate([standing.history, [generation.summary]])
                standing = EvolutionState(standing.ended, history)
                yield standing, _Search(strategy, schedule, strategy.updates), note
                if schedule.converged:
                    break
            if schedule.stage < len(schedule.stages):
                warnings.warn(
                    f"run {run + 1} ended in {schedule.status}: the task itself was never evolved. "
                    "Give more generations, a lower until, or at_most",
                    EvolutionWarning,
                    stacklevel=2,
                )
            ended = FinishedRun(self.finals(run, strategy), standing.history, strategy.elite)
            standing = EvolutionState((*standing.ended, ended))
            yield standing, _Search(strategy, schedule, strategy.updates), ""

    def _resumed(self) -> EvolutionState:
        """Return how far the checkpoint is, if it is a checkpoint of this very evolution."""
        found = None if self.checkpoint is None else self.checkpoint.load(self.identity)
        if found is None:
            return EvolutionState()
        try:
            standing = EvolutionState.of(found)
            standing.restore(*self.begun(0))
        except (LookupError, TypeError, ValueError) as error:
            warnings.warn(
                f"the checkpoint is ignored, and all is computed again: {error}", CheckpointWarning, stacklevel=2
            )
            return EvolutionState()
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
        return self.strategy.updates == self.told

    def added_to(self, standing: EvolutionState) -> EvolutionState:
        """Return ``standing`` with the states of both, as they are now; as it is between two runs."""
        if not len(standing.history):
            return standing
        return replace(standing, strategy=self.strategy.state, schedule=self.schedule.state)


def evolution_digest(
    told: Sequence[Any], runners: Mapping[str, Runner], controller: Controller, task: Task, seed: int
) -> str:
    """Return the digest of an evolution: what is ``told`` of it, strict JSON, and where controllers drive in models."""
    text = json.dumps([*told, list(runners), task.system.to_dict(), seed, *engine_inputs().items()], sort_keys=True)
    digest = hashlib.sha256(text.encode())
    some = np.random.default_rng(seed).standard_normal((2, controller.n_parameters))
    for runner in runners.values():
        if isinstance(runner, DynamicsRunner):  # a robot never drives the same way twice
            for trajectory in runner.bind(controller, task)(some, trial_seeds(seed, 2), record=True).trajectories:
                digest.update(np.ascontiguousarray(trajectory.states).tobytes())
    return digest.hexdigest()


STRATEGY, SCHEDULE = "strategy.", "schedule."


@dataclass(frozen=True)
class FinishedRun:
    """What one run ended with: finalists, history (G, 3), the last candidates (P, n)."""

    finalists: tuple[Finalist, ...]
    history: Array
    population: Array


@dataclass(frozen=True)
class EvolutionState:
    """The runs that ended, and how far the next one is: history (G, 3) of G generations, strategy and schedule."""

    ended: tuple[FinishedRun, ...] = ()
    history: Array = field(default_factory=lambda: np.empty((0, 3)))
    strategy: StrategyState = field(default_factory=dict)
    schedule: StrategyState = field(default_factory=dict)

    @property
    def generations(self) -> int:
        """How many generations are done, those of all runs."""
        return sum(len(run.history) for run in self.ended) + len(self.history)

    @property
    def state(self) -> StrategyState:
        """All of it as arrays, numbers and text, see `of`."""
        ended: dict[str, Array | str] = {}
        for i, run in enumerate(self.ended):
            ended |= {
                f"ended.{i}.niches": json.dumps([finalist.behaviour_class for finalist in run.finalists]),
                f"ended.{i}.fitness": np.array([finalist.fitness for finalist in run.finalists]),
                f"ended.{i}.finalists": np.array([finalist.parameters for finalist in run.finalists]),
                f"ended.{i}.history": run.history,
                f"ended.{i}.population": run.population,
            }
        present = {f"{STRATEGY}{name}": value for name, value in self.strategy.items()}
        present |= {f"{SCHEDULE}{name}": value for name, value in self.schedule.items()}
        return {"runs": len(self.ended), "history": self.history, **ended, **present}

    @classmethod
    def of(cls, state: StrategyState) -> EvolutionState:
        """Undo `state`. Raises `KeyError`, `TypeError` or `ValueError` for anything else."""
        runs = state["runs"]
        if not isinstance(runs, int) or runs < 0:
            raise ValueError(f"expected a number of runs, got {runs!r}")
        return cls(
            ended=tuple(_ended(state, run) for run in range(runs)),
            history=check_shape("history", state["history"], (None, 3)),
            strategy=_part(state, STRATEGY),
            schedule=_part(state, SCHEDULE),
        )

    def restore(self, strategy: EvolutionStrategy, schedule: Schedule) -> None:
        """Let ``strategy`` and ``schedule``, both new, go on from here. Raises what they say of a wrong state."""
        if len(self.history):
            strategy.restore(self.strategy)
            schedule.restore(self.schedule)


def _part(state: StrategyState, prefix: str) -> StrategyState:
    return {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}


def _ended(state: Mapping[str, Array | int | float | str], run: int) -> FinishedRun:
    niches, fitness, finalists, history, population = (
        state[f"ended.{run}.{name}"] for name in ("niches", "fitness", "finalists", "history", "population")
    )
    names: list[str] = json.loads(str(niches))
    fitness = check_shape("fitness", fitness, (len(names),))
    finalists = check_shape("finalists", finalists, (len(names), None))
    return FinishedRun(
        tuple(
            Finalist(name, run, float(value), row) for name, value, row in zip(names, fitness, finalists, strict=True)
        ),
        check_shape("history", history, (None, 3)),
        check_shape("population", population, (None, finalists.shape[1])),
    )
