"""The numbers of all recorded trials of a controller on one system, with intervals over the trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.behaviour.measures import measured
from evaluation.transfer import Trace, TransferMatrix
from evaluation.transfer.uncertainty import PairedEstimate
from sysid_evo.arrays import Array
from sysid_evo.system import System

UNITS = (("per second", "1/s"), ("per minute", "1/min"), ("speed", "m/s"), ("settling time", "s"), ("miss in", "s"))
"""By the end of a measure's name; all others are shares."""
USUAL = 0.75
"""Share of the trials that are slower than what counts as fast: a single exploited model may be faster than all."""
LEAST = 2
"""Trials from which on a measure has an interval."""


@dataclass(frozen=True)
class Measure:
    """The mean over ``trials`` that have the number, and its 90 % interval (nan for a single trial)."""

    value: float
    low: float
    high: float
    trials: int

    def differs(self, other: Measure) -> bool:
        """Whether the intervals of both lie apart."""
        return self.low > other.high or self.high < other.low


@dataclass(frozen=True)
class Manner:
    """How ``controller`` went about its task on ``column`` in ``trials`` recorded trials, each number by its name."""

    controller: str
    column: str
    trials: int
    measures: Mapping[str, Measure]

    def value(self, name: str) -> float:
        """Return a measure's mean, nan if there is none."""
        found = self.measures.get(name)
        return float("nan") if found is None else found.value


def unit_of(name: str) -> str:
    """Return the unit of the measure ``name``, empty for a share."""
    return next((unit for end, unit in UNITS if name.endswith(end)), "")


def manner_of(controller: str, column: str, traces: Sequence[Trace], system: System, fastest: Array) -> Manner:
    """Return the manner of these trials; ``fastest`` (nx,) is the largest size that each state has anywhere."""
    found = [measured(trace, system, fastest) for trace in traces]
    names = dict.fromkeys(name for one in found for name in one)
    measures = {}
    for name in names:
        values = np.array([one[name] for one in found if np.isfinite(one.get(name, np.nan))])
        if len(values):
            enough = len(values) >= LEAST
            low, high = PairedEstimate.of(controller, values[None]).interval() if enough else (np.nan,) * 2
            measures[name] = Measure(float(values.mean()), *_within(name, low, high), len(values))
    return Manner(controller, column, len(traces), measures)


def _within(name: str, low: float, high: float) -> tuple[float, float]:
    """Return an interval without what no such number can be: below 0, or a share above 1."""
    return float(np.maximum(0.0, low)), high if unit_of(name) else float(np.minimum(1.0, high))


def manners(matrix: TransferMatrix) -> tuple[Manner, ...]:
    """Return the manner of every controller on the robots and on what it was evolved against, as far as recorded."""
    system = next((champion.system for champion in matrix.champions if champion.system is not None), None)
    kept = {key: cell.traces for key, cell in matrix.cells.items() if cell.traces}
    if system is None or not kept:
        return ()
    states = [trace.trajectory.states for traces in kept.values() for trace in traces]
    fastest = np.quantile([np.quantile(np.abs(one), 0.99, axis=0) for one in states], USUAL, axis=0)
    found = []
    for champion in matrix.champions:
        robots = [column for column in matrix.columns if column not in matrix.models]
        for column in dict.fromkeys((*champion.against, *robots) if champion.against else matrix.columns):
            traces = kept.get((champion.name, column), ())
            if traces:
                found.append(manner_of(champion.name, column, traces, system, fastest))
    return tuple(found)
