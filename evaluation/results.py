"""Results of a comparison as plain data; `evaluation.report` shows them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from functools import cached_property
from typing import Any

import numpy as np

from evaluation.advice.evidence import ModelAdvice
from evaluation.behaviour import DrivingSummary, driving_summaries
from evaluation.exploitability.results import ModelExploitability, outside_shares
from evaluation.linearisation import LinearResponse, OperatingPoint, linearised
from evaluation.prediction.scores import ConditionError, Prediction, forecast_error
from evaluation.rounds import ROUNDS, RecordingRound, RoundsSummary
from evaluation.transfer.forecast import (
    Forecast,
    ModelForecast,
    best_choice,
    forecasts,
    measured_forecast,
    model_forecasts,
)
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.summary import TransferSummary, chosen_by, summarise
from sysid_evo.data import Dataset
from sysid_evo.display import Displayed, listed
from sysid_evo.models import DynamicsModel
from sysid_evo.plan.store import WAITING
from sysid_evo.system import System


@dataclass(frozen=True, repr=False)
class ComparisonResults(Displayed):
    """Results of a comparison. Parts that were not computed are None or empty.

    ``failures`` are those outside ``prediction`` and ``matrix``, which contain their own. ``timings`` are in seconds;
    they and ``day`` alone differ between two equal runs. ``controllers`` gives the file of each controller, relative
    to the folder of the run. ``conditions`` are the errors of each model within and across conditions, if these were
    left out. ``task_notes`` are the held-out errors of a reward that was learned, in words, ``task_warning`` a
    sentence if it is badly known. ``day`` is that of the last computed step, in UTC.
    """

    title: str
    data: DataSummary
    models: tuple[ModelSummary, ...] = ()
    prediction: Prediction | None = None
    matrix: TransferMatrix | None = None
    exploitability: tuple[ModelExploitability, ...] = ()
    advice: ModelAdvice | None = None
    failures: tuple[Failure, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    timings: Mapping[str, float] = field(default_factory=dict)
    controllers: Mapping[str, str] = field(default_factory=dict)
    conditions: Mapping[str, tuple[ConditionError, ...]] = field(default_factory=dict)
    task_notes: tuple[str, ...] = ()
    task_warning: str = ""
    rounds: RoundsSummary | None = None
    day: date | None = None

    def facts(self) -> Mapping[str, str]:
        matrix = self.matrix
        ran = {} if matrix is None else {"controllers": listed(matrix.rows), "on": listed(matrix.columns)}
        failed = {"failures": str(len(self.all_failures))} if self.all_failures else {}
        return {"title": self.title, "models": listed(model.name for model in self.models), **ran, **failed}

    @cached_property
    def transfer(self) -> TransferSummary | None:
        """Claimed and achieved fitness of every controller, and the recommended one, by its forecast.

        The controller of rounds is recommended instead of a baseline if it achieved more than controls at rest while
        it was recorded.
        """
        if self.matrix is None or not self.matrix.champions:
            return None
        pick = best_choice(self.matrix, self.forecasts)
        if pick in self.matrix.baselines and ROUNDS in self.forecasts and self.rounds is not None:
            # both were measured, whatever the models expect of them
            pick = ROUNDS if self.rounds.better_than_rest else pick
        return chosen_by(summarise(self.matrix), self.forecasts, pick)

    @cached_property
    def forecasts(self) -> Mapping[str, Forecast]:
        """Expected fitness of every controller on the robot, by its name.

        Those of rounds and of rest come from episodes on the robot, where these are as long as its trials.
        """
        if self.matrix is None:
            return {}
        models = () if self.prediction is None else self.prediction.models
        errors = {model.name: forecast_error(model) for model in models}
        found = forecasts(self.matrix, errors, outside_shares(self.exploitability))
        if self.rounds is None or not self.rounds.whole:
            return found
        measured = dict.fromkeys(self.matrix.at_rest, (self.rounds.rest, 0.0))
        if (chosen := self.chosen_round) is not None:
            measured[ROUNDS] = chosen.again, float(chosen.achieved.std(ddof=1))
        known = {name: (fitness, spread) for name, (fitness, spread) in measured.items() if fitness is not None}
        return {name: measured_forecast(one, *known[name]) if name in known else one for name, one in found.items()}

    @property
    def chosen_round(self) -> RecordingRound | None:
        """The round whose controller was chosen among all rounds."""
        parameters = {} if self.matrix is None else {one.name: one.parameters for one in self.matrix.champions}
        return None if self.rounds is None else self.rounds.round_of(parameters.get(ROUNDS, np.empty(0)))

    @cached_property
    def model_forecasts(self) -> Mapping[str, ModelForecast]:
        """Expected fitness of controllers evolved in each model, by the name of the model."""
        return {} if self.matrix is None else model_forecasts(self.matrix, self.forecasts)

    @cached_property
    def driving_summaries(self) -> tuple[DrivingSummary, ...]:
        """Behaviour of every controller, on robots and where it was evolved."""
        return () if self.matrix is None else driving_summaries(self.matrix)

    @property
    def all_failures(self) -> tuple[Failure, ...]:
        """All failures, in the order of computation."""
        found = list(self.failures)
        if self.prediction is not None:
            found += [Failure(f"prediction of {m.name}", m.reason) for m in self.prediction.models if m.failed]
        if self.matrix is not None:
            found += [Failure(f"{cell.champion} on {cell.column}", cell.reason) for cell in self.matrix.failures()]
        return tuple(found)

    @property
    def finished(self) -> bool:
        """Whether every step was computed or failed; False if the run was interrupted."""
        return all(failure.reason != WAITING for failure in self.all_failures)

    @property
    def model_warnings(self) -> tuple[str, ...]:
        """Sentences on models that fail the `SanityCheck`; forecasts leave them out."""
        models = () if self.prediction is None else self.prediction.models
        return tuple(
            f"{model.warning}. Forecasts leave it out if two others remain." for model in models if model.warning
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the data, the prediction test and its models."""
        found = list(self.data.notes)
        if self.prediction is not None:
            found += self.prediction.cases.notes
            found += [note for model in self.prediction.models for note in model.notes]
        return tuple(dict.fromkeys(found))


@dataclass(frozen=True)
class DataSummary:
    """The data set that models were fitted to and tested on, what its preparation noted, and its mean ``point``."""

    name: str
    system: System
    training: tuple[EpisodeSummary, ...]
    test: tuple[EpisodeSummary, ...]
    notes: tuple[str, ...]
    fingerprint: str
    point: OperatingPoint | None = None

    @classmethod
    def of(cls, training: Dataset, test: Dataset, *, name: str = "") -> DataSummary:
        """Summarise both parts of a data set; ``fingerprint`` is that of the training set."""
        notes = tuple(dict.fromkeys((*training.notes, *test.notes)))
        known = notes, training.fingerprint, OperatingPoint.of(training)
        return cls(name, training.system, _episodes(training), _episodes(test), *known)


def _episodes(dataset: Dataset) -> tuple[EpisodeSummary, ...]:
    return tuple(
        EpisodeSummary(episode.name, len(episode), episode.duration, float(moving.mean()))
        for episode, moving in zip(dataset.episodes, dataset.moving, strict=True)
    )


@dataclass(frozen=True)
class EpisodeSummary:
    """One episode: ``duration`` in s, and ``moving``, the share of its samples in motion."""

    name: str
    steps: int
    duration: float
    moving: float


@dataclass(frozen=True)
class ModelSummary:
    """One model: its family, how much prior ``knowledge`` it holds, hyper-parameters, and what it learned in words.

    ``equations``, ``parameters_table`` and ``candidates`` are empty for a family without them, see `DynamicsModel`.
    ``linear`` is the model linearised at the mean of the training data; ``not_linearised`` gives a reason against it.
    """

    name: str
    family: str
    knowledge: str
    parameters: Mapping[str, Any]
    equations: tuple[str, ...] = ()
    parameters_table: tuple[Mapping[str, Any], ...] = ()
    candidates: tuple[Mapping[str, str], ...] = ()
    linear: LinearResponse | None = None
    not_linearised: str = ""

    @classmethod
    def of(
        cls, name: str, model: DynamicsModel, *, family: str | None = None, point: OperatingPoint | None = None
    ) -> ModelSummary:
        """Summarise ``model``, linearised at ``point``; ``family`` is its registered name (default: its class)."""
        linear, not_linearised = None, ""
        try:
            linear = None if point is None else linearised(model, point)
        except Exception as error:  # a plugin may fail in any way; the rest of its card must be shown
            not_linearised = str(error)
        return cls(
            name,
            family or type(model).__name__,
            model.knowledge,
            model.get_params(deep=False),
            tuple(model.equations()),
            tuple(model.parameters_table()),
            tuple(model.candidate_ranking()),
            linear,
            not_linearised,
        )


@dataclass(frozen=True)
class Failure:
    """A step that failed, and why; the report is made without it."""

    step: str
    reason: str
