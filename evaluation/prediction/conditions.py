"""Errors within and across conditions: with recordings of a condition to learn from, and without."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from evaluation.prediction.assess import score_model
from evaluation.prediction.cases import measured_cases
from evaluation.prediction.protocol import PredictionProtocol
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.errors import InvalidData


@dataclass(frozen=True)
class ConditionErrors:
    """N of one family in the test part of one ``condition``, ``horizon`` steps after measured starts.

    ``within``: it also learned from recordings of that condition; ``across``: it learned from the others alone. None
    where there is nothing to test on or to learn from.
    """

    condition: str
    horizon: int
    within: float | None
    across: float | None


def within_and_across(
    model: DynamicsModel,
    learn: Callable[[Dataset], DynamicsModel],
    training: Dataset,
    test: Dataset,
    protocol: PredictionProtocol,
) -> tuple[ConditionErrors, ...]:
    """Return the errors in every condition of ``test``; ``learn`` fits the family of ``model`` to other data."""
    found = []
    horizon = _seconds(protocol, test.system.dt)
    for condition in test.conditions:
        here = test.of_condition(condition)
        others = [episode for episode in training if episode.condition != condition]
        within = _error(model, training, here, protocol, horizon)
        across = None
        if others and within is not None:
            rest = training.with_episodes(others)
            across = _error(learn(rest), rest, here, protocol, horizon)
        found.append(ConditionErrors(condition, horizon, within, across))
    return tuple(found)


def _seconds(protocol: PredictionProtocol, dt: float) -> int:
    """Return the horizon nearest to one second."""
    return min(protocol.horizons, key=lambda horizon: abs(horizon * dt - 1.0))


def _error(
    model: DynamicsModel, training: Dataset, test: Dataset, protocol: PredictionProtocol, horizon: int
) -> float | None:
    try:
        score = score_model("", model, measured_cases(training, test, protocol), family="").score(horizon)
    except InvalidData:
        return None
    return None if score is None else score.n
