"""Controllers' forecasts: their fitness on the robot, by what all models say, weighted by how well these predict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.forecast.credibility import credibilities, weighted_median
from evaluation.forecast.rule import RULE, Rule
from evaluation.transfer import Estimate, TransferMatrix
from sysid_evo.arrays import Array
from sysid_evo.evolution import Champion
from sysid_evo.registry import make_aggregate


@dataclass(frozen=True)
class Forecast:
    """What ``controller`` is expected to achieve on the robot, and a 90 % interval, in units of fitness.

    ``weights`` says how much each model counts; they add up to 1. Nothing that was measured on the robot is in it,
    but for the recordings that the models were fitted to and tested on.
    """

    controller: str
    value: float
    low: float
    high: float
    weights: Mapping[str, float]

    def holds(self, achieved: Estimate) -> bool:
        """Whether what was measured on the robot is in the interval, made wider by the error of the measurement."""
        error = achieved.standard_error if np.isfinite(achieved.standard_error) else 0.0
        below, above = np.hypot(self.value - self.low, 2.0 * error), np.hypot(self.high - self.value, 2.0 * error)
        return bool(self.value - below <= achieved.value <= self.value + above)


def forecasts(matrix: TransferMatrix, errors: Mapping[str, float | None], *, rule: Rule = RULE) -> dict[str, Forecast]:
    """Return the forecast of every controller that ran in two models or more, by its name.

    ``errors`` are the prediction errors of the models by their columns, see `error_of`. What was evolved on a robot
    itself has none, nor has somebody who drives by hand: neither comes from models.
    """
    found = (_of_champion(champion, matrix, errors, rule) for champion in matrix.champions)
    return {one.controller: one for one in found if one is not None}


def forecast_of(
    fitness: Sequence[Array], errors: Sequence[float | None], own: Sequence[bool], *, rule: Rule = RULE
) -> tuple[float, float, float]:
    """Return value, low and high of a controller from its fitness in the trials (E,) of each model, two or more.

    ``own`` says which models are of a family that it was evolved in. The interval has no width where all models and
    all trials say the same.
    """
    weights = credibilities(errors, np.array(own), rule=rule)
    return _joined(np.array([one.mean() for one in fitness]), fitness, weights, rule)


def _joined(means: Array, fitness: Sequence[Array], weights: Array, rule: Rule) -> tuple[float, float, float]:
    value = float(weighted_median(means, weights))
    apart = float(weights @ np.abs(means - value)) * float((weights**2).sum()) ** rule.apart
    error = float(weights @ np.array([one.std() / np.sqrt(len(one)) for one in fitness]))
    unit = float(np.hypot(apart, error))
    return value, value + rule.low * unit, value + rule.high * unit


def _of_champion(
    champion: Champion, matrix: TransferMatrix, errors: Mapping[str, float | None], rule: Rule
) -> Forecast | None:
    robots = {matrix.robot, *matrix.other_robots}
    cells = [matrix.cell(champion.name, model) for model in matrix.models]
    cells = [cell for cell in cells if not cell.failed]
    if len(cells) < 2 or robots & set(champion.against) or champion.system is None:
        return None
    families = {matrix.families.get(model, model) for model in champion.against}
    own = np.array([matrix.families[cell.column] in families for cell in cells])
    weights = credibilities([errors.get(cell.column) for cell in cells], own, rule=rule)
    one_number = make_aggregate(champion.aggregate)
    means = np.array([float(one_number(cell.fitness[None, None])[0]) for cell in cells])
    value, low, high = _joined(means, [cell.fitness for cell in cells], weights, rule)
    columns = (cell.column for cell in cells)
    return Forecast(champion.name, value, low, high, dict(zip(columns, weights.tolist(), strict=True)))
