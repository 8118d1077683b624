"""Expected fitness on the robot, from all models weighted by their prediction error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from evaluation.transfer.matrix import TransferMatrix
from sysid_evo.evolution import Champion, FinalistScore
from sysid_evo.evolution.aggregates import make_aggregate
from sysid_evo.evolution.margins import EQUAL_SHARE, has_all_fitness
from sysid_evo.types import Array, BoolArray
from sysid_evo.validation.estimates import Estimate


@dataclass(frozen=True)
class Forecast:
    """Expected fitness of ``controller`` on the robot, with a 90 % interval.

    ``weights`` are the weights of the models; they add up to 1. ``outside`` is the share of the time outside the data,
    a mean over the models by their weights; None if it is not known. No measurement on the robot is used, except for
    the recordings that the models were fitted to and tested on, and for the last episodes of rounds.
    """

    controller: str
    value: float
    low: float
    high: float
    weights: Mapping[str, float]
    outside: float | None = None

    def covers(self, achieved: Estimate) -> bool:
        """Return whether a measurement on the robot is in the interval, widened by the error of the measurement."""
        error = achieved.standard_error if np.isfinite(achieved.standard_error) else 0.0
        below, above = np.hypot(self.value - self.low, 2.0 * error), np.hypot(self.high - self.value, 2.0 * error)
        return bool(self.value - below <= achieved.value <= self.value + above)


def measured_forecast(forecast: Forecast, fitness: Array, spread: float) -> Forecast:
    """Return the forecast of a controller from its ``fitness`` (K,) in trials on the robot, made before it was chosen.

    ``spread`` is a standard deviation of one trial that is known from elsewhere; the larger one counts.
    """
    from scipy.special import stdtrit

    count, deviation = len(fitness), max(spread, float(fitness.std(ddof=1)))
    half, value = float(stdtrit(count - 1, 0.95)) * deviation / np.sqrt(count), float(fitness.mean())
    return replace(forecast, value=value, low=value - half, high=value + half)


@dataclass(frozen=True)
class ForecastRule:
    """Rule that makes one number with an interval from the fitness of a controller on models; without units.

    The weight of a model falls with its prediction error to the ``power``; errors below ``least_error`` count as equal.
    A model of a family that the controller was evolved in gets ``own`` times that: its claim may be exploited. The gain
    of a controller is the difference to controls at rest. ``shift`` times the share of the time outside the data is
    taken off it. The unit of the interval is the root of the squares of four parts. The first is the spread of the
    models around the forecast, divided by the number of models that count to the power ``apart``: not a half, since
    models of the same data share some of their errors. The second is the standard error of the trials, which all
    models share. The others are ``error`` times the prediction error and ``outside`` times the share outside the data,
    of the gain: there models may agree and be wrong. The interval reaches from ``low`` to ``high`` such units.
    """

    power: float = 2.0
    least_error: float = 0.1
    own: float = 0.5
    shift: float = 0.2
    apart: float = 0.25
    error: float = 0.3
    outside: float = 0.25
    low: float = -3.5
    high: float = 1.5
    share: float = 0.9


FORECAST_RULE = ForecastRule()
"""Calibrated on robots of five kinds; ``python -m tests.benchmarks.forecast.abroad`` prints how well it holds on each.

``low`` and ``high`` are near the 5 and 95 % quantiles of the errors, every kind with the same weight. The others are
round numbers on a plateau, chosen with the same robots.
"""


def forecasts(
    matrix: TransferMatrix,
    errors: Mapping[str, float | None],
    outside: Mapping[str, Mapping[str, float]] | None = None,
) -> dict[str, Forecast]:
    """Return the forecast of every controller that ran in two models or more, by its name.

    ``errors`` are the prediction errors of the models by their columns, see `error_of`; ``outside`` the shares of the
    time outside the data of each controller in each model, by model and controller. Controllers evolved on a robot and
    people who drive have no forecast: they do not come from models.
    """
    found = (_of_champion(champion, matrix, errors, outside or {}) for champion in matrix.champions)
    return {one.controller: one for one in found if one is not None}


def _of_champion(
    champion: Champion,
    matrix: TransferMatrix,
    errors: Mapping[str, float | None],
    outside: Mapping[str, Mapping[str, float]],
) -> Forecast | None:
    robots = {matrix.robot, *matrix.other_robots}
    cells = [matrix.cell(champion.name, model) for model in matrix.models]
    cells = [cell for cell in cells if not cell.failed]
    if len(cells) < 2 or robots & set(champion.against) or champion.system is None:
        return None
    families = {matrix.families.get(model, model) for model in champion.against}
    own = np.array([matrix.families[cell.column] in families for cell in cells])
    one_number = make_aggregate(champion.aggregate)
    means = np.array([float(one_number(cell.fitness[None, None])[0]) for cell in cells])
    resting = [matrix.cell(name, cell.column) for name in matrix.at_rest[:1] for cell in cells]
    rest = [0.0 if cell.failed else cell.mean for cell in resting] or [0.0] * len(cells)
    shares = [outside.get(cell.column, {}).get(champion.name) for cell in cells]
    known = _two_left([errors.get(cell.column) for cell in cells])
    weights = model_weights(known, own)
    fitness = [cell.fitness for cell in cells]
    value, low, high = forecast_of(fitness, known, own, means=means, outside=shares, rest=rest)
    columns = (cell.column for cell in cells)
    share = None if all(one is None for one in shares) else _mean(shares, weights)
    return Forecast(champion.name, value, low, high, dict(zip(columns, weights.tolist(), strict=True)), share)


def forecast_of(
    fitness: Sequence[Array] | Array,
    errors: Sequence[float | None],
    own: Sequence[bool] | BoolArray,
    *,
    means: Array | None = None,
    outside: Sequence[float | None] = (),
    rest: Sequence[float] = (),
    rule: ForecastRule = FORECAST_RULE,
) -> tuple[float, float, float]:
    """Return value, low and high of a controller from its fitness in the trials (E,) of each model, two or more.

    ``own`` marks the models of a family that it was evolved in. ``means`` (M,) are its fitness in each model as one
    number, by default the mean over the trials. ``outside`` are the shares of the time outside the data
    and ``rest`` is the fitness of controls at rest in each model, by default 0. The interval has no width if all models
    and all trials agree, the models predict perfectly and nothing is outside the data.
    """
    weights = model_weights(errors, np.array(own), rule=rule)
    means = np.array([one.mean() for one in fitness]) if means is None else means
    middle, floor = (float(weighted_median(at, weights)) for at in (means, np.array(rest or [0.0] * len(errors))))
    gain, share = abs(middle - floor), _mean(outside, weights)
    value = middle - rule.shift * share * gain
    apart = float(weights @ np.abs(means - middle)) * float((weights**2).sum()) ** rule.apart
    trials = float(weights @ np.array([one.std() / np.sqrt(len(one)) for one in fitness]))
    # an error of 1 is that of the mean of the data
    error = _mean([None if one is None else min(one, 1.0) for one in errors], weights)
    unit = float(np.linalg.norm([apart, trials, rule.error * error * gain, rule.outside * share * gain]))
    return value, value + rule.low * unit, value + rule.high * unit


def _mean(values: Sequence[float | None], weights: Array) -> float:
    """Return the mean by ``weights`` of the values that are known, 0 without any."""
    pairs = zip(values or [None] * len(weights), weights.tolist(), strict=True)
    known = [(value, weight) for value, weight in pairs if value is not None]
    total = sum(weight for _, weight in known)
    return sum(value * weight for value, weight in known) / total if total > 0.0 else 0.0


def model_weights(errors: Sequence[float | None], own: BoolArray, *, rule: ForecastRule = FORECAST_RULE) -> Array:
    """Return the weight of each model, (M,), that add up to 1.

    ``errors`` are those of `error_of`; a model with an unknown error gets the weight of the best one. ``own`` (M,)
    marks models of a family that the controller was evolved in.
    """
    known = [max(error, rule.least_error) for error in errors if error is not None and np.isfinite(error)]
    best = min(known, default=1.0)
    sizes = [best if error is None else max(error, rule.least_error) for error in errors]
    relative = [float((best / size) ** rule.power) if np.isfinite(size) else 0.0 for size in sizes]
    weights = np.where(own, rule.own, 1.0) * np.array(relative)
    total = float(weights.sum())
    return weights / total if total > 0.0 else np.full(len(weights), 1.0 / max(1, len(weights)))


def _two_left(errors: Sequence[float | None]) -> list[float | None]:
    """Return ``errors``; an infinite one is 1, as of the mean of the data, unless two models with another remain."""
    left = sum(error is None or not np.isinf(error) for error in errors)
    return [1.0 if error is not None and np.isinf(error) and left < 2 else error for error in errors]


def weighted_median(values: Array, weights: Array) -> Array:
    """Return the weighted median (...) of ``values`` (M, ...) with weights (M,), interpolated between two values.

    Each value is at the middle of its weight, with linear interpolation between values: with equal weights this is the
    usual median. Values without weight do not count, unless none has any.
    """
    if weights.any():
        values, weights = values[weights > 0.0], weights[weights > 0.0]
    order = np.argsort(values, axis=0, kind="stable")
    ranked, weight = np.take_along_axis(values, order, axis=0), weights[order]
    middle = np.cumsum(weight, axis=0) - 0.5 * weight
    flat, at = ranked.reshape(len(values), -1), middle.reshape(len(values), -1)
    found = [np.interp(0.5 * weights.sum(), at[:, i], flat[:, i]) for i in range(flat.shape[1])]
    return np.array(found).reshape(values.shape[1:])


def best_choice(matrix: TransferMatrix, found: Mapping[str, Forecast]) -> str | None:
    """Return the controller to use: of those evolved in models and the baselines the one with the highest forecast.

    Of those that have all the fitness there is (see `has_all_fitness`) it is the one that spends the smallest share of
    its time outside the data; one without a known share counts as the last of these. Of equals it is the first. None if
    no controller that was evolved in models has a forecast.
    """
    names = [champion.name for champion in matrix.champions if champion.name in found]
    if not any(champion.against for champion in matrix.champions if champion.name in found):
        return None
    best = max(names, key=lambda name: (found[name].value, name not in matrix.baselines))
    near = [name for name in names if found[name].value >= found[best].value - EQUAL_SHARE * abs(found[best].value)]
    full = has_all_fitness(np.stack([_by_trial(matrix, found[name]) for name in near]), 0.0)
    equal = [name for name, all_of_it in zip(near, full, strict=True) if all_of_it]
    if best not in equal:
        return best

    def order(name: str) -> tuple[float, float]:
        share = found[name].outside
        return np.inf if share is None else share, -found[name].value

    return min(equal, key=order)


def _by_trial(matrix: TransferMatrix, forecast: Forecast) -> Array:
    """Return the weighted median over the models of the fitness of a controller in each trial, (E,)."""
    fitness = [matrix.cell(forecast.controller, model).fitness for model in forecast.weights]
    trials = min(map(len, fitness))
    weights = np.array(list(forecast.weights.values()))
    return weighted_median(np.stack([one[:trials] for one in fitness]), weights)


def forecast_judgement(errors: Mapping[str, float | None], families: Mapping[str, str]) -> FinalistScore:
    """Return the ranking of finalists by their forecasts, from the models' prediction errors and families."""

    def score(champion: Champion, models: tuple[str, ...], by_model: Array) -> Array:
        own_families = {families.get(model, model) for model in champion.against}
        own = np.array([families.get(model, model) in own_families for model in models])
        return weighted_median(by_model, model_weights(_two_left([errors.get(model) for model in models]), own))

    return score


@dataclass(frozen=True)
class ModelForecast:
    """Expected fitness on the robot of ``controllers`` evolved in ``model`` alone, with a 90 % interval.

    ``claimed`` is their claim; all are means over the controllers.
    """

    model: str
    controllers: tuple[str, ...]
    claimed: float
    value: float
    low: float
    high: float

    @property
    def kept(self) -> tuple[float, float, float] | None:
        """The expected share of the claim that is achieved, and its interval; None without a claim."""
        if self.claimed <= 0.0:
            return None
        return self.value / self.claimed, self.low / self.claimed, self.high / self.claimed


def model_forecasts(matrix: TransferMatrix, found: Mapping[str, Forecast]) -> dict[str, ModelForecast]:
    """Return the forecast of every model in which a controller with a forecast was evolved alone.

    The interval is the mean of theirs, not narrower: errors that models share affect all of them.
    """
    made = {}
    for model in matrix.models:
        alone = [champion for champion in matrix.champions if champion.against == (model,) and champion.name in found]
        alone = [champion for champion in alone if not matrix.cell(champion.name, model).failed]
        if not alone:
            continue
        own = [found[champion.name] for champion in alone]
        claims = [
            float(make_aggregate(champion.aggregate)(matrix.cell(champion.name, model).fitness[None, None])[0])
            for champion in alone
        ]
        value, low, high = (float(np.mean([getattr(one, name) for one in own])) for name in ("value", "low", "high"))
        names = tuple(champion.name for champion in alone)
        made[model] = ModelForecast(model, names, float(np.mean(claims)), value, low, high)
    return made
