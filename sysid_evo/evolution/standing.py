"""How far an evolution is, so that one that was stopped goes on as if nothing had happened."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.evolution.champion import Finalist
from sysid_evo.evolution.schedule import Schedule
from sysid_evo.evolution.strategy import EvolutionStrategy, StrategyState

STRATEGY, SCHEDULE = "strategy.", "schedule."


@dataclass(frozen=True)
class EndedRun:
    """What one run ended with: finalists, history (G, 3), the last candidates (P, n)."""

    finalists: tuple[Finalist, ...]
    history: Array
    population: Array


@dataclass(frozen=True)
class Standing:
    """The runs that ended, and how far the next one is: history (G, 3) of G generations, strategy and schedule."""

    ended: tuple[EndedRun, ...] = ()
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
                f"ended.{i}.niches": json.dumps([finalist.niche for finalist in run.finalists]),
                f"ended.{i}.fitness": np.array([finalist.fitness for finalist in run.finalists]),
                f"ended.{i}.finalists": np.array([finalist.parameters for finalist in run.finalists]),
                f"ended.{i}.history": run.history,
                f"ended.{i}.population": run.population,
            }
        present = {f"{STRATEGY}{name}": value for name, value in self.strategy.items()}
        present |= {f"{SCHEDULE}{name}": value for name, value in self.schedule.items()}
        return {"runs": len(self.ended), "history": self.history, **ended, **present}

    @classmethod
    def of(cls, state: StrategyState) -> Standing:
        """Undo `state`. Raises `KeyError`, `TypeError` or `ValueError` for anything else."""
        return cls(
            ended=tuple(_ended(state, run) for run in range(_number(state["runs"]))),
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


def _ended(state: Mapping[str, Array | int | float | str], run: int) -> EndedRun:
    niches, fitness, finalists, history, population = (
        state[f"ended.{run}.{name}"] for name in ("niches", "fitness", "finalists", "history", "population")
    )
    names: list[str] = json.loads(str(niches))
    fitness = check_shape("fitness", fitness, (len(names),))
    finalists = check_shape("finalists", finalists, (len(names), None))
    return EndedRun(
        tuple(
            Finalist(name, run, float(value), row) for name, value, row in zip(names, fitness, finalists, strict=True)
        ),
        check_shape("history", history, (None, 3)),
        check_shape("population", population, (None, finalists.shape[1])),
    )


def _number(value: Array | int | float | str) -> int:
    if not isinstance(value, int) or value < 0:
        raise ValueError(f"expected a number of runs, got {value!r}")
    return value
