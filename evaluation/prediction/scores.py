"""Scores of a model, of several models, and of the difference of two."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from evaluation.prediction.cases import MeasuredCases
from evaluation.prediction.regions import RegionError
from evaluation.prediction.residuals import Residuals
from sysid_evo.display import Displayed, listed
from sysid_evo.errors import InvalidArgument
from sysid_evo.types import Array
from sysid_evo.validation.estimates import Draws, Estimate
from sysid_evo.validation.measures import mean_over_channels

PERSISTENCE = "persistence"


@dataclass(frozen=True)
class ModelPrediction:
    """All prediction scores of one model, or the ``reason`` why there are none.

    ``curve`` (H,) is N after each step up to the longest horizon, ``curve_interval`` (2, H) its interval at each of
    them; ``free_states`` are the predicted states (T, nx) of each simulated episode. ``regions`` are those of the near
    horizon, the largest error first. ``coverage`` is that of prediction intervals at every horizon, for a model that
    has them. Errors are those of the simulation without noise. ``warning`` is a sentence if the model fails the
    `SanityCheck`; the forecast leaves it out if two others remain.
    """

    name: str
    family: str
    scores: tuple[ErrorScore, ...] = ()
    free_run: ErrorScore | None = None
    curve: Array = field(default_factory=lambda: np.empty(0), repr=False)
    curve_interval: Array = field(default_factory=lambda: np.empty((2, 0)), repr=False)
    divergence: Divergence | None = None
    residuals: Residuals | None = field(default=None, repr=False)
    regions: tuple[RegionError, ...] = field(default=(), repr=False)
    episodes: tuple[EpisodeError, ...] = field(default=(), repr=False)
    coverage: tuple[Coverage, ...] = ()
    free_states: tuple[Array, ...] = field(default=(), repr=False)
    notes: tuple[str, ...] = ()
    warning: str = ""
    reason: str = ""

    @property
    def failed(self) -> bool:
        return bool(self.reason)

    def score(self, horizon: int | None) -> ErrorScore | None:
        """Return the score at ``horizon`` steps, or over whole episodes (None); None if there is none."""
        if horizon is None:
            return self.free_run
        return next((score for score in self.scores if score.horizon == horizon), None)


@dataclass(frozen=True)
class ErrorScore:
    """Errors ``horizon`` steps after a measured start, or over whole episodes (``horizon`` None).

    Per channel (nx,): ``rmse`` and ``error_std`` in the channel's unit, ``relative_percent`` (RMSE relative to the
    signal's RMS), ``nrmse`` (RMSE divided by the measured standard deviation). ``samples`` is the number of targets.
    ``draws`` are bootstrap draws of N over blocks, paired for all models that are scored on the same windows.
    """

    horizon: int | None
    samples: int
    rmse: Array
    error_std: Array
    relative_percent: Array
    nrmse: Array
    draws: Draws = field(repr=False)

    @cached_property
    def estimate(self) -> Estimate:
        """N with its interval."""
        return self.draws.estimate.clipped(low=0.0)

    @property
    def n(self) -> float:
        """N: the mean NRMSE over channels, without channels that are constant in the measurement."""
        return float(mean_over_channels(self.nrmse))

    @property
    def fit_percent(self) -> Array:
        """100 (1 - NRMSE), per channel (nx,)."""
        return 100.0 * (1.0 - self.nrmse)


COVERAGE_TOLERANCE = 0.05
"""Tolerance of the coverage of an interval."""


@dataclass(frozen=True)
class Coverage:
    """Share of measured states in a model's prediction intervals, ``horizon`` steps after a measured start.

    ``inside`` (nx,) is the share for each channel, over ``samples`` targets, and ``width`` (nx,) the mean width of the
    intervals, in standard deviations of the measurement; ``share`` is the nominal coverage.
    """

    horizon: int
    samples: int
    share: float
    inside: Array
    width: Array

    @property
    def mean(self) -> float:
        """The mean share over channels."""
        return float(np.mean(self.inside))

    @property
    def calibrated(self) -> bool:
        """Whether the mean share is within five hundredths of the nominal coverage."""
        return abs(self.mean - self.share) <= COVERAGE_TOLERANCE


@dataclass(frozen=True)
class Divergence:
    """Share and time of simulations that reached the model's state bounds or the guard.

    ``share`` is that of the windows, ``median_time`` (s) that of their first contact; ``free_run_times`` (s) has one
    value for each simulated episode, None for never.
    """

    share: float
    median_time: float | None
    free_run_times: tuple[float | None, ...]


@dataclass(frozen=True)
class EpisodeError:
    """N of one episode at each scored horizon (H,), in the scale of the whole test set; NaN without a window there.

    ``fit`` (nx,) is 100 (1 - norm(y - yhat) / norm(y - mean(y))) of each channel over every sample of the simulated
    episode; NaN if it was not simulated.
    """

    name: str
    n: Array
    fit: Array


@dataclass(frozen=True)
class ConditionError:
    """N of one family in the test part of one ``condition``, ``horizon`` steps after measured starts.

    ``within``: fitted to recordings of that condition, too; ``across``: fitted to the others alone. None without test
    or training data. ``covered`` is the mean coverage of the intervals of the latter, None without intervals.
    """

    condition: str
    horizon: int
    within: float | None
    across: float | None
    covered: float | None


@dataclass(frozen=True, repr=False)
class Prediction(Displayed):
    """Prediction errors of several models on the same cases; persistence comes first."""

    cases: MeasuredCases
    models: tuple[ModelPrediction, ...]

    def facts(self) -> Mapping[str, str]:
        horizons = ("whole episodes" if horizon is None else f"{horizon} steps" for horizon in self.horizons)
        return {"models": listed(self.names), "scored over": listed(horizons)}

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(model.name for model in self.models)

    @property
    def horizons(self) -> tuple[int | None, ...]:
        """The scored horizons in steps; None, whole episodes, is last."""
        free: tuple[int | None, ...] = (None,) if self.cases.free_runs else ()
        return (*self.cases.horizons, *free)

    def model(self, name: str) -> ModelPrediction:
        """Return the scores of the model called ``name``. Raises `InvalidArgument`."""
        for model in self.models:
            if model.name == name:
                return model
        raise InvalidArgument(f"prediction: no model is called {name!r}; there are {', '.join(self.names)}")

    def compare(self, first: str, second: str, horizon: int | None) -> Difference | None:
        """Compare two models by a paired block bootstrap; None if one of them has no score."""
        a, b = self.model(first).score(horizon), self.model(second).score(horizon)
        if a is None or b is None:
            return None
        return Difference(first, second, horizon, (a.draws - b.draws).estimate)

    def ranking(self, horizon: int | None) -> tuple[ModelPrediction, ...]:
        """Return the models that have a score at ``horizon``, lowest N first."""
        scored = [(score.n, model) for model in self.models if (score := model.score(horizon)) is not None]
        known = [(n, model) for n, model in scored if np.isfinite(n)]
        return tuple(model for _, model in sorted(known, key=lambda pair: pair[0]))

    def differences(self, horizon: int | None) -> tuple[Difference, ...]:
        """Compare every other model with the best one at ``horizon``, in order of N."""
        ranking = self.ranking(horizon)
        compared = [self.compare(model.name, ranking[0].name, horizon) for model in ranking[1:]]
        return tuple(difference for difference in compared if difference is not None)


@dataclass(frozen=True)
class Difference:
    """N of ``first`` minus N of ``second`` on the same windows."""

    first: str
    second: str
    horizon: int | None
    difference: Estimate

    @property
    def significant(self) -> bool:
        """Whether the interval excludes zero."""
        return self.difference.differs_from(0.0)

    @property
    def verdict(self) -> str:
        """The comparison in words."""
        if not self.significant:
            return "no significant difference"
        better, worse = (self.first, self.second) if self.difference.value < 0 else (self.second, self.first)
        return f"{better} better than {worse}"


HORIZON = 20
"""Horizon in steps at which prediction errors are compared, if it was measured."""


def error_of(found: ModelPrediction | None) -> float | None:
    """Return N of a model on held-out data, None if it is not known."""
    if found is None or not found.scores:
        return None
    return (found.score(HORIZON) or found.scores[-1]).n


def forecast_error(found: ModelPrediction | None) -> float | None:
    """Return `error_of` a model, infinite if it fails the `SanityCheck`: then forecasts leave it out."""
    return float("inf") if found is not None and found.warning else error_of(found)
