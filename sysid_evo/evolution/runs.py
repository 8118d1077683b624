"""Several runs of an evolution, which can be interrupted and resumed."""

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
from sysid_evo.errors import CheckpointWarning
from sysid_evo.evolution.champion import Finalist
from sysid_evo.evolution.loop import Convergence, Generation, Objective, evolve
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy, StrategyState
from sysid_evo.processors import engine_inputs
from sysid_evo.progress import Checkpoint, Progress
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks.task import Task
from sysid_evo.types import Array, check_shape


@dataclass(frozen=True)
class Runs:
    """Runs of at most ``generations`` each, one after the other; a run ends earlier when its search has converged.

    ``start_run(run, ended)`` makes the strategy and objective of a run, which may continue one of the ``ended`` runs;
    ``finalists_of`` selects the finalists of a finished run. ``models`` are the labels of the models of the objective.
    ``identity`` is the `evolution_digest` under which the ``checkpoint`` is saved.
    """

    generations: Sequence[int]
    start_run: Callable[[int, tuple[FinishedRun, ...]], tuple[EvolutionStrategy, Objective]]
    finalists_of: Callable[[int, EvolutionStrategy], tuple[Finalist, ...]]
    models: tuple[str, ...]
    checkpoint: Checkpoint | None = None
    identity: str = ""

    def finish(self, progress: Progress | None) -> tuple[FinishedRun, ...]:
        """Return all runs when they have ended. An interruption saves the completed generations.

        The state of a strategy is copied only to be saved, because a copy takes as long as an update. If the
        interruption falls into an update, the state saved last remains.
        """
        state = saved = self._resumed()
        search: _Search | None = None
        total = sum(self.generations)
        if progress is not None and state.generations:
            progress(state.generations, total)
        try:
            for reached, search, note in self._steps(state):
                state = reached
                if self.checkpoint is not None and (not note or self.checkpoint.due()):
                    self.checkpoint.save(self.identity, search.added_to(state).state)
                    saved = state
                if progress is not None and note:
                    progress(state.generations, total, note)
        except BaseException:  # Ctrl-C, too
            if self.checkpoint is not None and search is not None and state is not saved and search.is_consistent:
                self.checkpoint.save(self.identity, search.added_to(state).state)
            raise
        return state.ended

    def _steps(self, state: EvolutionState) -> Iterator[tuple[EvolutionState, _Search, str]]:
        """Yield the state after every generation, with a note, and after every run, with an empty note."""
        for run in range(len(state.ended), len(self.generations)):
            (strategy, objective), convergence = self.start_run(run, state.ended), Convergence()
            state.restore(strategy, convergence)
            done = len(state.history)
            last = done if convergence.reached else self.generations[run]
            for generation in evolve(strategy, objective, last, start=done):
                note = self._note(run, generation, strategy)
                convergence.tell(generation)
                history = np.concatenate([state.history, [generation.summary]])
                state = EvolutionState(state.ended, history)
                yield state, _Search(strategy, convergence, strategy.updates), note
                if convergence.reached:
                    break
            ended = FinishedRun(self.finalists_of(run, strategy), state.history, strategy.elite, strategy.state)
            state = EvolutionState((*state.ended, ended))
            yield state, _Search(strategy, convergence, strategy.updates), ""

    def _resumed(self) -> EvolutionState:
        """Return the state in the checkpoint, or an empty one if the checkpoint belongs to another evolution."""
        found = None if self.checkpoint is None else self.checkpoint.load(self.identity)
        if found is None:
            return EvolutionState()
        try:
            state = EvolutionState.of(found)
            if len(state.ended) < len(self.generations):
                strategy, _ = self.start_run(len(state.ended), state.ended)
                state.restore(strategy, Convergence())
        except (LookupError, TypeError, ValueError) as error:
            warnings.warn(
                f"the checkpoint is ignored and the evolution starts again: {error}", CheckpointWarning, stacklevel=2
            )
            return EvolutionState()
        return state

    def _note(self, run: int, generation: Generation, strategy: EvolutionStrategy) -> str:
        """Return the progress note of a generation: best and mean fitness, fitness by model, status of the strategy."""
        best, mean, _ = generation.summary
        parts = [f"best {best:.1f}, mean {mean:.1f}"]
        if generation.by_model is not None and len(generation.by_model) > 1:
            of_best = generation.by_model[:, int(np.argmax(generation.fitness))]
            parts.append(", ".join(f"{name} {value:.1f}" for name, value in zip(self.models, of_best, strict=True)))
        if len(self.generations) > 1:
            parts.append(f"run {run + 1} of {len(self.generations)}")
        return "; ".join(filter(None, (*parts, strategy.status)))


@dataclass(frozen=True)
class _Search:
    """Strategy and convergence of a run after a generation; ``updates`` is the strategy's count at that time."""

    strategy: EvolutionStrategy
    convergence: Convergence
    updates: int

    @property
    def is_consistent(self) -> bool:
        """True if no update has begun since."""
        return self.strategy.updates == self.updates

    def added_to(self, state: EvolutionState) -> EvolutionState:
        """Return ``state`` with the current states of strategy and convergence; unchanged between two runs."""
        if not len(state.history):
            return state
        return replace(state, strategy=self.strategy.state, convergence=self.convergence.state)


def evolution_digest(
    inputs: Sequence[Any], runners: Mapping[str, Runner], controller: Controller, task: Task, seed: int
) -> str:
    """Return the digest of an evolution: its ``inputs`` (strict JSON) and trajectories of sample controllers."""
    text = json.dumps([*inputs, list(runners), task.system.to_dict(), seed, *engine_inputs().items()], sort_keys=True)
    digest = hashlib.sha256(text.encode())
    samples = np.random.default_rng(seed).standard_normal((2, controller.n_parameters))
    for runner in runners.values():
        if isinstance(runner, DynamicsRunner):  # trials of a robot are not reproducible
            for trajectory in runner.bind(controller, task)(samples, trial_seeds(seed, 2), record=True).trajectories:
                digest.update(np.ascontiguousarray(trajectory.states).tobytes())
    return digest.hexdigest()


STRATEGY, CONVERGENCE = "strategy.", "convergence."


@dataclass(frozen=True)
class FinishedRun:
    """Result of one run: finalists, history (G, 3), last candidates (P, n), state of its strategy."""

    finalists: tuple[Finalist, ...]
    history: Array
    population: Array
    strategy: StrategyState

    @property
    def fitness(self) -> float:
        """Fitness of the best finalist."""
        return max(one.fitness for one in self.finalists)


@dataclass(frozen=True)
class EvolutionState:
    """The finished runs, and the current run: its history (G, 3), strategy and convergence."""

    ended: tuple[FinishedRun, ...] = ()
    history: Array = field(default_factory=lambda: np.empty((0, 3)))
    strategy: StrategyState = field(default_factory=dict)
    convergence: StrategyState = field(default_factory=dict)

    @property
    def generations(self) -> int:
        """Number of completed generations of all runs."""
        return sum(len(run.history) for run in self.ended) + len(self.history)

    @property
    def state(self) -> StrategyState:
        """All fields as arrays, numbers and text, see `of`."""
        ended: dict[str, Array | int | float | str] = {}
        for i, run in enumerate(self.ended):
            ended |= {
                f"ended.{i}.behaviour_classes": json.dumps([finalist.behaviour_class for finalist in run.finalists]),
                f"ended.{i}.fitness": np.array([finalist.fitness for finalist in run.finalists]),
                f"ended.{i}.finalists": np.array([finalist.parameters for finalist in run.finalists]),
                f"ended.{i}.history": run.history,
                f"ended.{i}.population": run.population,
                **{f"ended.{i}.{STRATEGY}{name}": value for name, value in run.strategy.items()},
            }
        current = {f"{STRATEGY}{name}": value for name, value in self.strategy.items()}
        current |= {f"{CONVERGENCE}{name}": value for name, value in self.convergence.items()}
        return {"runs": len(self.ended), "history": self.history, **ended, **current}

    @classmethod
    def of(cls, state: StrategyState) -> EvolutionState:
        """Return the evolution state of `state`. Raises `KeyError`, `TypeError` or `ValueError`."""
        runs = state["runs"]
        if not isinstance(runs, int) or runs < 0:
            raise ValueError(f"expected a number of runs, got {runs!r}")
        return cls(
            ended=tuple(_ended(state, run) for run in range(runs)),
            history=check_shape("history", state["history"], (None, 3)),
            strategy=_part(state, STRATEGY),
            convergence=_part(state, CONVERGENCE),
        )

    def restore(self, strategy: EvolutionStrategy, convergence: Convergence) -> None:
        """Restore a new ``strategy`` and ``convergence`` to this state. Raises their errors for an invalid state."""
        if len(self.history):
            strategy.restore(self.strategy)
            convergence.restore(self.convergence)


def _part(state: StrategyState, prefix: str) -> StrategyState:
    return {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}


def _ended(state: Mapping[str, Array | int | float | str], run: int) -> FinishedRun:
    classes, fitness, finalists, history, population = (
        state[f"ended.{run}.{name}"] for name in ("behaviour_classes", "fitness", "finalists", "history", "population")
    )
    names: list[str] = json.loads(str(classes))
    fitness = check_shape("fitness", fitness, (len(names),))
    finalists = check_shape("finalists", finalists, (len(names), None))
    return FinishedRun(
        tuple(
            Finalist(name, run, float(value), row) for name, value, row in zip(names, fitness, finalists, strict=True)
        ),
        check_shape("history", history, (None, 3)),
        check_shape("population", population, (None, finalists.shape[1])),
        _part(state, f"ended.{run}.{STRATEGY}"),
    )
