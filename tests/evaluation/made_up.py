"""Reports whose numbers are chosen, so that what is said about them is known."""

from __future__ import annotations

import functools
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from evaluation.prediction import (
    PERSISTENCE,
    Divergence,
    ErrorScore,
    Interval,
    MeasuredCases,
    ModelPrediction,
    Prediction,
    PredictionProtocol,
    measured_cases,
)
from evaluation.report import DataSummary, Failure, Report
from evaluation.sufficiency import FEWEST_BLOCKS
from evaluation.transfer import Cell, TransferMatrix
from sysid_evo.evolution import Champion
from sysid_evo.registry import Spec
from tests.evaluation.known_models import recording
from tests.evaluation.test_transfer import champion

FREE = None
SECOND = 20
"""Steps in a second of the made-up system."""


@functools.cache
def cases(steps: int = 80, episodes: int = FEWEST_BLOCKS) -> MeasuredCases:
    """Return cases with a horizon of one second and a free run; with 20 steps the free run alone, with 5 neither.

    Each episode is one block of the bootstrap.
    """
    test = recording(episodes, steps=steps, seed=8)
    return measured_cases(recording(1, steps=80), test, PredictionProtocol(horizons=(SECOND,), resamples=50))


def prediction(
    at_a_second: Mapping[str, float] | None = None,
    free: Mapping[str, float] | None = None,
    *,
    clipped: Mapping[str, float] | None = None,
    failed: Sequence[str] = (),
    spread: float = 0.01,
    steps: int = 80,
    episodes: int = FEWEST_BLOCKS,
) -> Prediction:
    """Return a prediction with these N; the draws of the bootstrap spread around them by ``spread``."""
    at_a_second, free, clipped = at_a_second or {}, free or {}, clipped or {}
    names = dict.fromkeys((PERSISTENCE, *at_a_second, *free, *failed))
    rows = [
        ModelPrediction(
            name,
            name,
            at=(_score(name, SECOND, at_a_second[name], spread),) if name in at_a_second else (),
            free_run=_score(name, FREE, free[name], spread) if name in free else None,
            free_states=tuple(run.states for run in cases(steps, episodes).free_runs) if name in free else (),
            divergence=Divergence(clipped.get(name, 0.0), 0.5, ()),
            reason="it broke" if name in failed else "",
        )
        for name in names
    ]
    return Prediction(cases(steps, episodes), tuple(rows))


def _score(name: str, horizon: int | None, n: float, spread: float) -> ErrorScore:
    draws = n + spread * np.random.default_rng(zlib.crc32(name.encode())).normal(size=50)
    each = np.full(3, n)
    return ErrorScore(horizon, 100, each, each, each, each, Interval(n - 2 * spread, n + 2 * spread), draws)


def matrix(
    fitness: Mapping[str, Mapping[str, float]],
    *,
    against: Mapping[str, Sequence[str]] | None = None,
    robot: str | None = None,
    trials: int = 10,
    robot_trials: int | None = None,
    seeds: Sequence[float] = (),
) -> TransferMatrix:
    """Return a matrix with these mean fitnesses by row and column; a row was evolved against the column of its name."""
    cells = []
    for row, columns in fitness.items():
        for column, mean in columns.items():
            count = robot_trials if column == robot and robot_trials is not None else trials
            luck = np.resize([-0.1, 0.1], count) if count > 1 else np.zeros(1)
            cells.append(
                Cell(row, column, mean + luck, unit="waypoints")
                if np.isfinite(mean)
                else Cell(row, column, reason="it stopped")
            )
    champions = [evolved(row, tuple((against or {}).get(row, () if row == REST else (row,))), seeds) for row in fitness]
    columns = dict.fromkeys(column for row in fitness.values() for column in row)
    champions = [replace(one, controller=Spec("constant")) if one.name == REST else one for one in champions]
    return TransferMatrix.of(champions, tuple(columns), cells, robot=robot)


REST = "rest"
"""The row that is not evolved: controls at rest."""


def evolved(name: str, against: tuple[str, ...], seeds: Sequence[float] = ()) -> Champion:
    """Return a champion whose evolution runs, one for each of ``seeds``, ended with these fitnesses."""
    made = champion(name, against)
    object.__setattr__(made, "seed_fitness", tuple(seeds))
    return made


def report(predicted: Prediction | None = None, transfer: TransferMatrix | None = None, *, failures: int = 0) -> Report:
    """Return a report of these parts."""
    return Report(
        title="Made up",
        data=DataSummary.of(recording(1, steps=80), recording(1, steps=80, seed=8)),
        prediction=predicted,
        matrix=transfer,
        failures=tuple(Failure(f"part {i}", "no such package") for i in range(failures)),
    )
