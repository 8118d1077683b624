"""The generation loop, as a generator that the caller drives; easier stages that precede the task.

Incremental evolution begins with easier forms of the task; the next stage begins when the required fitness is reached.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np

from sysid_evo.errors import InvalidArgument, did_you_mean
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy, StrategyState
from sysid_evo.processors import one_blas_thread
from sysid_evo.registry.grammar import Spec, split_specs
from sysid_evo.registry.registry import tasks
from sysid_evo.types import Array, Converted, check_shape


@dataclass(frozen=True)
class Scores:
    """Scores of P candidates: ``fitness`` (P,), ``behaviour`` descriptors (P, d), fitness ``by_model`` (M, P).

    ``by_trial`` (P, E) is the median over the models of the fitness in each trial.
    """

    fitness: Array
    behaviour: Array | None = None
    by_model: Array | None = None
    by_trial: Array | None = None


Objective: TypeAlias = Callable[[Array, int], Scores | Array]
"""Returns the scores of candidates (P, n) in a generation, or only their fitness (P,), which is maximised."""


@dataclass(frozen=True)
class Generation:
    """One cycle of `ask` and `tell`: its number, candidates (P, n), fitness (P,), fitness on each model (M, P)."""

    index: int
    population: Array
    fitness: Array
    by_model: Array | None = None

    @property
    def summary(self) -> tuple[float, float, float]:
        """Best, mean and worst fitness of the candidates."""
        return float(self.fitness.max()), float(self.fitness.mean()), float(self.fitness.min())


def evolve(
    strategy: EvolutionStrategy, objective: Objective, generations: int, *, start: int = 0
) -> Iterator[Generation]:
    """Run cycles of `ask` and `tell` up to a total of ``generations``, and yield each one.

    A restored strategy continues with generation ``start``, the number of generations that it has completed.
    """
    for index in range(start, generations):
        with one_blas_thread():
            population = strategy.ask()
            scored = objective(population, index)
            scores = scored if isinstance(scored, Scores) else Scores(np.asarray(scored, dtype=np.float64))
            strategy.tell(population, scores.fitness, scores.behaviour)
        yield Generation(index, population, scores.fitness, scores.by_model)


EQUAL_SHARE, EQUAL_GENERATIONS, SAME = 0.5, 20, 1e-4
"""A schedule has converged if this share of the candidates had nearly the highest fitness in this number of
generations: at most a share `SAME` less."""


def _checked(task: Spec | str | None) -> Spec | None:
    return None if task is None else tasks.check(task)


def _labels(models: Sequence[str] | str) -> tuple[str, ...]:
    return tuple(model.strip() for model in (models.split("+") if isinstance(models, str) else models))


Record = TypeVar("Record")


def records(kind: type[Record], given: Sequence[Record] | str, setting: str, value: str = "...") -> tuple[Record, ...]:
    """Return the records of the dataclass ``kind`` that a ``setting`` lists; text is parsed: ``kind(field=value)``."""
    if not isinstance(given, str):
        return tuple(given)
    name, names, found = kind.__name__.lower(), list(inspect.signature(kind).parameters), []
    for spec in map(Spec.parse, split_specs(given)):
        unknown = [one for one in spec.parameters if one not in names]
        if spec.name != name or unknown:
            expected = ", ".join(f"{one}={value}" for one in names)
            hint = did_you_mean(unknown[0], names) if unknown else ""
            raise InvalidArgument(f"{setting}: expected {name}({expected}), got {spec}.{hint}")
        try:
            found.append(kind(**spec.parameters))
        except (TypeError, AttributeError) as error:
            raise InvalidArgument(f"{setting}: {spec} cannot be read: {error}") from error
    return tuple(found)


@dataclass(frozen=True)
class Stage:
    """An easier stage of an evolution that precedes the final task.

    ``task`` is a spec or its text, by default the final task; ``models`` are labels, a list or ``a+b``, by default all.
    The stage ends when the median fitness of the better half, as the median over the last ``window`` generations,
    reaches ``until``, or after ``max_generations``.
    """

    task: Converted[Spec | str | None, Spec | None] = Converted(_checked, None)
    models: Converted[Sequence[str] | str, tuple[str, ...]] = Converted(_labels, ())
    until: float | None = None
    max_generations: int | None = None
    window: int = 5

    def __post_init__(self) -> None:
        if self.until is None and self.max_generations is None:
            raise InvalidArgument("stage: expected until=FITNESS, max_generations=NUMBER or both: a stage must end")
        if self.window < 1 or (self.max_generations is not None and self.max_generations < 1):
            given = f"{self.window} and {self.max_generations}"
            raise InvalidArgument(f"stage: expected window and max_generations >= 1, got {given}")
        if self.until is not None and not np.isfinite(self.until):
            raise InvalidArgument(f"stage: expected a finite fitness, got until={self.until}")

    @classmethod
    def listed(cls, given: Sequence[Stage] | str) -> tuple[Stage, ...]:
        """Return the stages; text is parsed: ``stage(task=..., until=...), stage(...)``. Raises `InvalidArgument`."""
        return records(cls, given, "schedule")

    def reached(self, levels: Sequence[float]) -> bool:
        """True if the stage ends after generations with these ``levels`` (median fitness of the better half)."""
        enough = (
            self.until is not None and len(levels) >= self.window and np.median(levels[-self.window :]) >= self.until
        )
        return bool(enough) or (self.max_generations is not None and len(levels) >= self.max_generations)


class Schedule:
    """An objective in stages: the objective of each stage in turn, then the ``final`` one.

    The caller passes every generation to `tell`, and makes the strategy forget old fitness when the next stage begins:
    ``if schedule.tell(generation): strategy.forget_fitness()``.

    When many candidates have nearly the highest fitness of the final objective for several generations, selection no
    longer distinguishes candidates, and the schedule is `converged`. It is not while all candidates so far are equal: a
    search may begin where nothing is gained.
    """

    def __init__(self, stages: Sequence[tuple[Stage, Objective]], final: Objective) -> None:
        self.stages = tuple(stage for stage, _ in stages)
        self.objectives = (*(objective for _, objective in stages), final)
        self.stage = 0
        self._levels: list[float] = []
        self._lowest, self._highest = np.inf, -np.inf
        self._saturated = 0

    def __call__(self, population: Array, generation: int) -> Scores | Array:
        """Return the scores of ``population`` (P, n) in the current stage."""
        return self.objectives[self.stage](population, generation)

    def tell(self, generation: Generation) -> bool:
        """Register a generation; return True if the next stage begins after it."""
        if self.stage == len(self.stages):
            self._lowest = min(self._lowest, float(generation.fitness.min()))
            self._highest = max(self._highest, float(generation.fitness.max()))
            nearly = self._highest - SAME * abs(self._highest)
            equal = self._lowest < nearly and np.mean(generation.fitness >= nearly) >= EQUAL_SHARE
            self._saturated = self._saturated + 1 if equal else 0
            return False
        self._levels.append(float(np.median(np.sort(generation.fitness)[len(generation.fitness) // 2 :])))
        if not self.stages[self.stage].reached(self._levels):
            return False
        self.stage += 1
        self._levels = []
        return True

    @property
    def converged(self) -> bool:
        """True if half of the candidates had nearly the highest fitness in each of the last 20 generations."""
        return self._saturated >= EQUAL_GENERATIONS

    @property
    def status(self) -> str:
        """The current stage, as "stage 1 of 2"; the last is the final task. Empty without stages."""
        return f"stage {self.stage + 1} of {len(self.objectives)}" if self.stages else ""

    @property
    def state(self) -> StrategyState:
        """The state that `tell` changes."""
        return {
            "stage": self.stage,
            "levels": np.array(self._levels),
            "range": np.array([self._lowest, self._highest]),
            "saturated": self._saturated,
        }

    def restore(self, state: StrategyState) -> None:
        """Continue from the ``state`` of a schedule of the same stages. Raises `InvalidArgument` or `ShapeError`."""
        stage = state["stage"]
        if not isinstance(stage, int) or not 0 <= stage <= len(self.stages):
            raise InvalidArgument(f"schedule: expected the number of a stage up to {len(self.stages)}, got {stage!r}")
        self.stage, self._levels = stage, check_shape("levels", state["levels"], (None,)).tolist()
        self._lowest, self._highest = check_shape("range", state["range"], (2,)).tolist()
        self._saturated = int(state["saturated"])
