"""In what two reports differ: settings, data, models, errors, claims and what is achieved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from evaluation.prediction import Interval, MeasuredCases, Prediction
from evaluation.report.contents import Report
from evaluation.transfer import TransferMatrix, fitness_on
from sysid_evo.arrays import Array
from sysid_evo.system import System

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Change:
    """A figure in both runs, and the interval of the second minus the first.

    Without ``paired`` draws the two met different data, so that the interval is wider. The interval is None where a
    single trial, or none, leaves it unknown.
    """

    first: float
    second: float
    interval: Interval | None
    paired: bool

    @property
    def difference(self) -> float:
        return self.second - self.first

    @property
    def same(self) -> bool:
        """Whether the second run found just what the first did, in every draw."""
        return self.paired and self.interval == Interval(0.0, 0.0) and self.difference == 0.0

    @property
    def significant(self) -> bool:
        """Whether the interval excludes zero."""
        return self.interval is not None and not self.interval.spans(0.0)


@dataclass(frozen=True)
class ControllerChange:
    """What one controller claims and achieves in both runs; None where one of them does not know."""

    name: str
    claimed: Change | None
    others: Change | None
    achieved: Change | None


@dataclass(frozen=True)
class Differences:
    """Two reports by the ``names`` of their runs, and what differs.

    ``settings`` are those that differ, by dotted name, None where a run does not have one; ``parameters`` those of
    models of the same name. ``errors`` are by horizon and model. ``same_training`` and ``same_test`` tell whether the
    data are equal, ``same_trials`` whether controllers met the same trials.
    """

    names: tuple[str, str]
    reports: tuple[Report, Report]
    settings: Mapping[str, tuple[Any, Any]]
    parameters: Mapping[str, tuple[Any, Any]]
    errors: Mapping[int | None, Mapping[str, Change]]
    controllers: tuple[ControllerChange, ...]
    same_training: bool
    same_test: bool
    same_trials: bool

    def models_only_in(self, run: int) -> tuple[str, ...]:
        """Return the models that one run has and the other has not."""
        here, there = self.reports[run].models, {model.name for model in self.reports[1 - run].models}
        return tuple(model.name for model in here if model.name not in there)

    @property
    def incomparable(self) -> str | None:
        """Why nothing but settings can be compared: the systems differ; None where they are the same."""
        first, second = (report.data.system for report in self.reports)
        if _channels(first) == _channels(second):
            return None
        here, there = (", ".join((*one.state_names, *one.control_names)) for one in (first, second))
        if here == there:
            here, there = (f"{one.dt:g} s a step, or other units" for one in (first, second))
        return (
            f"The runs are of different systems, so neither errors nor fitness are compared: {self.names[0]} has "
            f"{here}; {self.names[1]} has {there}."
        )

    @property
    def other_tasks(self) -> str | None:
        """Why fitness is not compared: the tasks differ; None where it is the same one, whatever its parameters."""
        if _same_task(*self.reports):
            return None
        first, second = (report.settings.get("task") for report in self.reports)
        return f"The tasks differ, {first} and {second}, so fitness is not compared."

    @property
    def unit(self) -> str:
        """The unit of fitness."""
        return next((report.matrix.unit for report in self.reports if report.matrix is not None), "")

    @property
    def picks(self) -> tuple[str | None, str | None]:
        """The controllers to take."""
        first, second = (None if report.transfer is None else report.transfer.pick for report in self.reports)
        return first, second

    @property
    def main_horizon(self) -> int | None:
        """The horizon that the answers speak of, of the first run."""
        prediction = self.reports[0].prediction
        return None if prediction is None else prediction.cases.main_horizon


def differences(first: Report, second: Report, names: tuple[str, str] = ("first", "second")) -> Differences:
    """Compare two reports; a figure is paired where both runs met the same test data, or the same trials."""
    settings = _changed(_flat(first.settings), _flat(second.settings))
    same_system = _channels(first.data.system) == _channels(second.data.system)
    same_test = _same_cases(first.prediction, second.prediction)
    same_trials = not {"seed", "task", "transfer_trials"} & {name.partition(".")[0] for name in settings}
    return Differences(
        names=names,
        reports=(first, second),
        settings=settings,
        parameters=_parameters(first, second),
        errors=_errors(first.prediction, second.prediction, same_test) if same_system else {},
        controllers=(
            _controllers(first.matrix, second.matrix, same_trials) if same_system and _same_task(first, second) else ()
        ),
        same_training=first.data.fingerprint == second.data.fingerprint,
        same_test=same_test,
        same_trials=same_trials,
    )


def _channels(system: System) -> tuple[Any, ...]:
    """Return what makes errors and fitness of a system comparable: names and units of its channels, and its step."""
    named = ((channel.name, channel.unit) for channel in (*system.states, *system.controls))
    return (*named, system.dt)


def _same_task(first: Report, second: Report) -> bool:
    here, there = (str(report.settings.get("task", "")).partition("(")[0] for report in (first, second))
    return here == there


def _parameters(first: Report, second: Report) -> dict[str, tuple[Any, Any]]:
    """Return family and parameters that differ, of the models that both runs have."""
    here, there = ({model.name: model for model in report.models} for report in (first, second))
    sides: tuple[dict[str, Any], dict[str, Any]] = ({}, {})
    for name in (name for name in here if name in there):
        for side, model in zip(sides, (here[name], there[name]), strict=True):
            side |= {f"{name}.family": model.family, **{f"{name}.{key}": v for key, v in model.parameters.items()}}
    return _changed(*sides)


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = value
    return found


def _changed(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    names = dict.fromkeys((*first, *second))
    return {name: (first.get(name), second.get(name)) for name in names if first.get(name) != second.get(name)}


def _same_cases(first: Prediction | None, second: Prediction | None) -> bool:
    """Whether models were asked the same, so that draws of the bootstrap are the same ones."""
    if first is None or second is None:
        return False
    a, b = first.cases, second.cases
    return a.protocol == b.protocol and a.horizons == b.horizons and _fingerprint(a) == _fingerprint(b)


def _fingerprint(cases: MeasuredCases) -> str:
    return cases.test.fingerprint


def _errors(first: Prediction | None, second: Prediction | None, paired: bool) -> dict[int | None, dict[str, Change]]:
    """Return N of every model that both runs have, at every horizon that both have."""
    found: dict[int | None, dict[str, Change]] = {}
    if first is None or second is None or first.cases.system.dt != second.cases.system.dt:
        return found
    for horizon in (horizon for horizon in first.horizons if horizon in second.horizons):
        changes = {}
        for name in (name for name in first.names if name in second.names):
            a, b = first.model(name).score(horizon), second.model(name).score(horizon)
            if a is not None and b is not None:
                draws = _between(a.resampled_n, b.resampled_n, paired)
                changes[name] = Change(a.n, b.n, draws, paired)
        if changes:
            found[horizon] = changes
    return found


def _controllers(
    first: TransferMatrix | None, second: TransferMatrix | None, paired: bool
) -> tuple[ControllerChange, ...]:
    if first is None or second is None:
        return ()
    both = [name for name in first.rows if name in second.rows]
    same_robot = first.robot is not None and first.robot == second.robot
    same_models = set(first.models) == set(second.models)
    return tuple(
        ControllerChange(
            name,
            claimed=_fitness(name, (first, second), "claimed", paired),
            others=_fitness(name, (first, second), "others", paired) if same_models else None,
            achieved=_fitness(name, (first, second), "robot", paired) if same_robot else None,
        )
        for name in both
    )


def _fitness(name: str, matrices: tuple[TransferMatrix, TransferMatrix], where: str, paired: bool) -> Change | None:
    draws = [_draws(name, matrix, where) for matrix in matrices]
    first, second = draws
    if first is None or second is None:
        return None
    paired = paired and matrices[0].trials == matrices[1].trials
    return Change(float(first[0]), float(second[0]), _between(first[1:], second[1:], paired), paired)


def _draws(name: str, matrix: TransferMatrix, where: str) -> Array | None:
    """Return a controller's fitness and that of every draw of trials: claimed, on others, or on the robot."""
    champion = next(champion for champion in matrix.champions if champion.name == name)
    if where == "claimed":
        return fitness_on(champion, champion.against, matrix) if champion.against else None
    if where == "robot":
        return None if matrix.robot is None else fitness_on(champion, [matrix.robot], matrix)
    found = [fitness_on(champion, [model], matrix) for model in matrix.models if model not in champion.against]
    known = [draws for draws in found if draws is not None]
    return np.mean(known, axis=0) if known else None


def _between(first: Array, second: Array, paired: bool) -> Interval | None:
    """Return the interval of the second minus the first; draws that are not paired are put in another order."""
    if len(first) != len(second) or not len(first):
        return None
    if not paired:
        second = np.random.default_rng(0).permutation(second)
    between = second - first
    if not np.isfinite(between).any():
        return None
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.nanpercentile(between, [tail, 100.0 - tail])
    return Interval(float(low), float(high))
