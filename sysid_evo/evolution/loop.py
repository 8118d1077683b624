"""The generation loop, as a generator that belongs to the caller; easier stages that come before the task.

In incremental evolution easier forms of the task come first, the next one as soon as the fitness is there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy, StrategyState
from sysid_evo.processors import one_blas_thread
from sysid_evo.registry.grammar import Spec, split_specs
from sysid_evo.registry.registry import tasks
from sysid_evo.types import Array, Converted, check_shape


@dataclass(frozen=True)
class Scores:
    """What P candidates scored: their fitness (P,), and what is known beside it.

    ``behaviour`` (P, d) holds descriptors, ``by_model`` (M, P) the fitness on each of several models.
    """

    fitness: Array
    behaviour: Array | None = None
    by_model: Array | None = None


Objective: TypeAlias = Callable[[Array, int], Scores | Array]
"""What candidates (P, n) score in a generation, or their fitness (P,) alone; maximised."""


@dataclass(frozen=True)
class Generation:
    """One ask-tell cycle: its number, candidates (P, n), their fitness (P,), and on each model (M, P)."""

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
    """Run ask-tell cycles up to ``generations`` in all, and yield each one.

    A strategy that was restored goes on from the generation ``start``, the number of those it has behind it.
    """
    for index in range(start, generations):
        with one_blas_thread():
            population = strategy.ask()
            scored = objective(population, index)
            scores = scored if isinstance(scored, Scores) else Scores(np.asarray(scored, dtype=np.float64))
            strategy.tell(population, scores.fitness, scores.behaviour)
        yield Generation(index, population, scores.fitness, scores.by_model)


MANY, LONG = 0.5, 20
"""Share of the candidates that must have all there is, and for how many generations, until a search is over."""


def _checked(task: Spec | str | None) -> Spec | None:
    return None if task is None else tasks.check(task)


def _labels(models: Sequence[str] | str) -> tuple[str, ...]:
    return tuple(model.strip() for model in (models.split("+") if isinstance(models, str) else models))


@dataclass(frozen=True)
class Stage:
    """What comes before that which is asked for, and until when.

    The ``task`` of the stage, a spec or its text, and the ``models`` that it is met on, a list of labels or
    ``a+b``; each is by default what is asked for. The stage ends when the median fitness of the better half has reached
    ``until``, the median over the last ``over`` generations, or after ``at_most`` generations.
    """

    task: Converted[Spec | str | None, Spec | None] = Converted(_checked, None)
    models: Converted[Sequence[str] | str, tuple[str, ...]] = Converted(_labels, ())
    until: float | None = None
    at_most: int | None = None
    over: int = 5

    def __post_init__(self) -> None:
        if self.until is None and self.at_most is None:
            raise InvalidArgument("stage: expected until=FITNESS, at_most=GENERATIONS or both, so that it ends")
        if self.over < 1 or (self.at_most is not None and self.at_most < 1):
            raise InvalidArgument(f"stage: expected over and at_most >= 1, got {self.over} and {self.at_most}")
        if self.until is not None and not np.isfinite(self.until):
            raise InvalidArgument(f"stage: expected a finite fitness, got until={self.until}")

    @classmethod
    def listed(cls, given: Sequence[Stage] | str) -> tuple[Stage, ...]:
        """Return stages, or read ``stage(task=..., until=...), stage(...)``. Raises `InvalidArgument`."""
        if not isinstance(given, str):
            return tuple(given)
        return tuple(cls._of(Spec.parse(piece)) for piece in split_specs(given))

    @classmethod
    def _of(cls, spec: Spec) -> Stage:
        unknown = [name for name in spec.parameters if name not in cls.__dataclass_fields__]
        if spec.name != "stage" or unknown:
            raise InvalidArgument(
                f"schedule: expected stage({', '.join(f'{name}=...' for name in cls.__dataclass_fields__)}), got {spec}"
            )
        try:
            return cls(**spec.parameters)
        except (TypeError, AttributeError) as error:
            raise InvalidArgument(f"schedule: {spec} cannot be read: {error}") from error

    def reached(self, levels: Sequence[float]) -> bool:
        """Whether the stage has ended, after generations of these levels."""
        enough = self.until is not None and len(levels) >= self.over and np.median(levels[-self.over :]) >= self.until
        return bool(enough) or (self.at_most is not None and len(levels) >= self.at_most)


class Schedule:
    """An objective that becomes harder: that of each stage in turn, at last what is ``asked`` for.

    Whoever evolves hands every generation to `tell`, and makes the strategy forget old fitness when that
    says that the next stage has begun::

        for generation in evolve(strategy, schedule, 300):
            if schedule.tell(generation):
                strategy.forget_fitness()

    ``most`` is the most that a candidate can score at what is asked for: where many reach that for long, the schedule
    is `converged`, for nothing is left to choose by.
    """

    def __init__(self, stages: Sequence[tuple[Stage, Objective]], asked: Objective, *, most: float = np.inf) -> None:
        self.stages = tuple(stage for stage, _ in stages)
        self.objectives = (*(objective for _, objective in stages), asked)
        self.stage, self.most = 0, most
        self._levels: list[float] = []
        self._full = 0

    def __call__(self, population: Array, generation: int) -> Scores | Array:
        """Return what ``population`` (P, n) scores in the present stage."""
        return self.objectives[self.stage](population, generation)

    def tell(self, generation: Generation) -> bool:
        """Take in a generation; return whether the next stage begins after it."""
        if self.stage == len(self.stages):
            reached = np.mean(generation.fitness >= self.most)
            self._full = self._full + 1 if reached >= MANY else 0
            return False
        self._levels.append(float(np.median(np.sort(generation.fitness)[len(generation.fitness) // 2 :])))
        if not self.stages[self.stage].reached(self._levels):
            return False
        self.stage += 1
        self._levels = []
        return True

    @property
    def converged(self) -> bool:
        """Whether half of the candidates have had all there is in each of the last 20 generations."""
        return self._full >= LONG

    @property
    def status(self) -> str:
        """Which stage of how many it is, the last being what is asked for; empty without stages."""
        return f"stage {self.stage + 1} of {len(self.objectives)}" if self.stages else ""

    @property
    def state(self) -> StrategyState:
        """All that `tell` has changed."""
        return {"stage": self.stage, "levels": np.array(self._levels), "full": self._full}

    def restore(self, state: StrategyState) -> None:
        """Go on from a ``state`` of a schedule of the same stages. Raises `InvalidArgument` or `ShapeError`."""
        stage = state["stage"]
        if not isinstance(stage, int) or not 0 <= stage <= len(self.stages):
            raise InvalidArgument(f"schedule: expected the number of a stage up to {len(self.stages)}, got {stage!r}")
        self.stage, self._levels = stage, check_shape("levels", state["levels"], (None,)).tolist()
        self._full = int(state["full"])
