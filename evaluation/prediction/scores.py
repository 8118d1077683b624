"""The scores of a model, of several, and of two compared."""

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
    them; ``free_states`` are the predicted states (T, nx) of each free run. ``regions`` are those of
    the near horizon, the worst first. ``coverage`` is that of the intervals at every horizon, of a model that gives a
    spread. Errors are those of the run without noise.
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
    reason: str = ""

    @property
    def failed(self) -> bool:
        return bool(self.reason)

    def score(self, horizon: int | None) -> ErrorScore | None:
        """Return the score at ``horizon`` steps, or of the free run (None); None where there is none."""
        if horizon is None:
            return self.free_run
        return next((score for score in self.scores if score.horizon == horizon), None)


@dataclass(frozen=True)
class ErrorScore:
    """Errors ``horizon`` steps after a measured start, or over a free run (``horizon`` None).

    Per channel (nx,): ``rmse`` and ``error_std`` in the channel's unit, ``relative_percent`` (RMSE
    of the signal's RMS), ``nrmse`` (RMSE of the truth's standard deviation). ``samples`` were scored.
    ``draws`` are those of N over blocks, the same for every model that is scored on the same windows.
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
        """N: the mean NRMSE over channels; channels that are constant in the truth are left out."""
        return float(mean_over_channels(self.nrmse))

    @property
    def fit_percent(self) -> Array:
        """100 (1 - NRMSE), per channel (nx,)."""
        return 100.0 * (1.0 - self.nrmse)


HONEST = 0.05
"""By how much a coverage may miss its aim."""


@dataclass(frozen=True)
class Coverage:
    """How many measured states lay in a model's intervals ``horizon`` steps after a measured start.

    ``inside`` (nx,) is the share for each channel, of ``samples`` targets; the intervals are to hold ``share``.
    """

    horizon: int
    samples: int
    share: float
    inside: Array

    @property
    def mean(self) -> float:
        """The mean share over channels."""
        return float(np.mean(self.inside))

    @property
    def calibrated(self) -> bool:
        """Whether that share is within five hundredths of what the intervals are to hold."""
        return abs(self.mean - self.share) <= HONEST


@dataclass(frozen=True)
class Divergence:
    """How often and when simulations reached the model's state_bounds or the guard.

    ``share`` of the windows; ``median_time`` in s of the first touch among those;
    ``free_run_times`` in s, one for each free run, None for never.
    """

    share: float
    median_time: float | None
    free_run_times: tuple[float | None, ...]


@dataclass(frozen=True)
class EpisodeError:
    """N of one episode at each scored horizon (H,), in the scale of the whole test set; nan without a window there.

    ``fit`` (nx,) is 100 (1 - norm(y - yhat) / norm(y - mean(y))) of each channel over the free run from the episode's
    first samples to its end, every sample of it; nan where there is no free run.
    """

    name: str
    n: Array
    fit: Array


@dataclass(frozen=True)
class ConditionError:
    """N of one family in the test part of one ``condition``, ``horizon`` steps after measured starts.

    ``within``: it also learned from recordings of that condition; ``across``: it learned from the others alone. None
    where there is nothing to test on or to learn from.
    """

    condition: str
    horizon: int
    within: float | None
    across: float | None


@dataclass(frozen=True, repr=False)
class Prediction(Displayed):
    """The prediction errors of several models on the same cases; persistence comes first."""

    cases: MeasuredCases
    models: tuple[ModelPrediction, ...]

    def facts(self) -> Mapping[str, str]:
        horizons = ("free run" if horizon is None else f"{horizon} steps" for horizon in self.horizons)
        return {"models": listed(self.names), "scored over": listed(horizons)}

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(model.name for model in self.models)

    @property
    def horizons(self) -> tuple[int | None, ...]:
        """The horizons that were scored, in steps; None, the free run, is last."""
        free: tuple[int | None, ...] = (None,) if self.cases.free_runs else ()
        return (*self.cases.horizons, *free)

    def model(self, name: str) -> ModelPrediction:
        """Return the scores of the model called ``name``. Raises `InvalidArgument`."""
        for model in self.models:
            if model.name == name:
                return model
        raise InvalidArgument(f"prediction: no model is called {name!r}; there are {', '.join(self.names)}")

    def compare(self, first: str, second: str, horizon: int | None) -> Difference | None:
        """Compare two models by a paired block bootstrap; None where one of them has no score."""
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
"""Steps after which the prediction error counts, where it was measured there."""


def error_of(found: ModelPrediction | None) -> float | None:
    """Return N of a model on held-out data, None where it is not known."""
    if found is None or not found.scores:
        return None
    return (found.score(HORIZON) or found.scores[-1]).n
