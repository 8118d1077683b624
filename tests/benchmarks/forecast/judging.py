"""How good forecasts are, on cars that had no part in their calibration."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from evaluation.transfer import summary
from evaluation.transfer.forecast import ForecastRule, forecast_of
from sysid_evo.types import Array
from sysid_evo.validation.estimates import across
from tests.benchmarks.forecast.looking import Record

TENS = 200
RIDGE = 0.1
"""Weight of the ridge penalty relative to the controllers, for terms in units of their standard deviation."""


@dataclass(frozen=True)
class Seen:
    """One controller: achieved fitness, forecast without a calibrated interval, and further terms.

    ``unit`` is that of the interval, see `ForecastRule`. ``terms`` are in units of the fitness, none where they were
    not looked at.
    """

    car: int
    run: str
    achieved: float
    forecast: float
    unit: float
    claimed: float
    others: float
    error: float
    terms: Mapping[str, float] = field(default_factory=dict)
    name: str = ""


def asked_only(records: Sequence[Record], labels: Collection[str]) -> list[Record]:
    """Return the controllers that were evolved in models called ``labels`` alone, as seen by these models."""
    return [
        {**record, "columns": {label: column for label, column in record["columns"].items() if label in labels}}
        for record in records
        if set(record["against"]) <= set(labels)
    ]


def seen(record: Record, car: int, run: str, rule: ForecastRule) -> Seen:
    """Return the case of a record; a controller evolved against several models claims their lowest fitness."""
    columns = record["columns"]
    fitness = {label: np.array(column["fitness"]) for label, column in columns.items()}
    against = [label for label in record["against"] if label in columns]
    families = {columns[label]["family"] for label in against}
    own = [column["family"] in families for column in columns.values()]
    errors = [column["error"] for column in columns.values()]
    outside = [column.get("outside") for column in columns.values()]
    rule = replace(rule, low=0.0, high=1.0)
    value, _, high = forecast_of(list(fitness.values()), errors, own, outside=outside, rule=rule)
    elsewhere = [fitness[label].mean() for label, mine in zip(columns, own, strict=True) if not mine]
    claimed = min((float(fitness[label].mean()) for label in against), default=value)
    others = float(np.median(elsewhere)) if elsewhere else value
    apart = float(np.mean([one.std() for one in fitness.values()]))
    return Seen(
        car=car,
        run=run,
        achieved=record["achieved"],
        forecast=value,
        unit=high - value,
        claimed=claimed,
        others=others,
        error=float(np.mean([columns[label]["error"] for label in against])) if against else np.nan,
        name=record.get("name", ""),
        terms={}
        if not all("outside" in column for column in columns.values())
        else {
            "nothing else": 0.0,
            "claimed less forecast": claimed - value,
            "other families less forecast": others - value,
            "outside the data": apart * float(np.mean([column["outside"] for column in columns.values()])),
            "probes": apart * float(np.mean([columns[label]["probed"] for label in against])) if against else 0.0,
        },
    )


def rank_correlation(found: Sequence[Seen], figure: Callable[[Seen], float]) -> float:
    """Return Spearman's correlation of a figure with the achieved fitness."""
    correlation = summary.rank_correlation([(figure(one), one.achieved) for one in found if np.isfinite(figure(one))])
    return np.nan if correlation is None else correlation


def best_of_ten(found: Sequence[Seen], figure: Callable[[Seen], float], *, seed: int = 0) -> float:
    """Return the loss from choosing the best of ten by a figure, as a share of the best, averaged over many draws."""
    achieved, ranked = np.array([one.achieved for one in found]), np.array([figure(one) for one in found])
    rng, losses = np.random.default_rng(seed), []
    for _ in range(TENS):
        ten = rng.choice(len(found), size=min(10, len(found)), replace=False)
        losses.append(1.0 - achieved[ten][ranked[ten].argmax()] / achieved[ten].max())
    return float(np.mean(losses))


def over_cars(by_run: Mapping[tuple[int, str], float]) -> tuple[float, float, float]:
    """Return the mean over cars of the mean over the runs of each, and its 95 % interval."""
    found = across(list(by_run.values()), [car for car, _ in by_run])
    return found.value, found.low, found.high


def calibrated(found: Sequence[Seen], share: float) -> tuple[float, float]:
    """Return between which multiples of their units the misses of ``share`` of the controllers lie."""
    missed = [(one.achieved - one.forecast) / one.unit for one in found]
    low, high = np.quantile(missed, [0.5 - share / 2, 0.5 + share / 2])
    return float(low), float(high)


def held(found: Sequence[Seen], share: float) -> list[bool]:
    """Return which controllers achieve what lies in the interval that the *other* cars calibrate."""
    ends = {car: calibrated([one for one in found if one.car != car], share) for car in {one.car for one in found}}
    return [
        one.forecast + ends[one.car][0] * one.unit <= one.achieved <= one.forecast + ends[one.car][1] * one.unit
        for one in found
    ]


def with_term(found: Sequence[Seen], name: str) -> Array:
    """Return forecasts (N,) plus a constant and one further term, fitted by ridge to the errors on the other cars."""
    terms = np.array([one.terms[name] for one in found])
    inputs = np.stack([np.ones(len(terms)), terms / max(float(terms.std()), 1e-12)], axis=1)
    missed = np.array([one.achieved - one.forecast for one in found])
    cars = np.array([one.car for one in found])
    forecast = np.array([one.forecast for one in found])
    for car in np.unique(cars):
        rest = cars != car
        penalty = np.diag([0.0, RIDGE * rest.sum()])
        weights = np.linalg.solve(inputs[rest].T @ inputs[rest] + penalty, inputs[rest].T @ missed[rest])
        forecast[~rest] += inputs[~rest] @ weights
    return forecast
