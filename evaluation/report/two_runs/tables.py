"""Tables of what differs between two runs."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Mapping
from typing import Any

from evaluation.prediction import Interval
from evaluation.report.predicting import horizon_name
from evaluation.report.sheets import Sheet, lines, number, three_digits
from evaluation.report.two_runs.differences import Change, Differences

WIDE = 28
"""Letters of a setting in one line, so that both runs fit a terminal."""
CHANCE = "no significant\ndifference"


def setting_sheet(found: Differences) -> Sheet | None:
    """The settings and parameters of models that differ; None where all are the same."""
    values = {**found.settings, **found.parameters}
    return _values("Settings that differ", found.names, values) if values else None


def version_sheet(found: Differences) -> Sheet | None:
    """The libraries whose versions differ; None where all are the same."""
    first, second = (report.versions for report in found.reports)
    names = dict.fromkeys((*first, *second))
    values = {name: (first.get(name), second.get(name)) for name in names if first.get(name) != second.get(name)}
    return _values("Versions that differ", found.names, values) if values else None


def error_sheet(found: Differences, horizon: int | None) -> Sheet:
    """N of every model in both runs at one horizon."""
    prediction = found.reports[0].prediction
    assert prediction is not None
    changes = found.errors[horizon]
    paired = "Both met the same windows in every draw." if found.same_test else "Other test data: draws are not paired."
    return Sheet(
        f"Error N, {horizon_name(prediction, horizon)}",
        ("model", *_heads(found), "difference", "which is"),
        tuple((name, *_row(change, three_digits, "lower", "higher")) for name, change in changes.items()),
        note=f"Difference: the second minus the first, with its 95 % interval. {paired}",
        details=horizon not in (found.main_horizon, None),
    )


def controller_sheet(found: Differences, figure: str, title: str) -> Sheet | None:
    """One figure of every controller in both runs; None where no controller has it in both."""
    known = [(c.name, change) for c in found.controllers if (change := getattr(c, figure)) is not None]
    if not known:
        return None
    paired = "the same trials" if all(change.paired for _, change in known) else "other trials, so not paired"
    return Sheet(
        f"{title} ({found.unit or 'fitness'})",
        ("controller", *_heads(found), "difference", "which is"),
        tuple((name, *_row(change, number, "less", "more")) for name, change in known),
        note=f"Difference: the second minus the first, with its 95 % interval over trials ({paired}). How far "
        "champions differ from evolution seed to evolution seed is not in it.",
    )


def _values(title: str, names: tuple[str, str], values: Mapping[str, tuple[Any, Any]]) -> Sheet:
    rows = [(name, *(_shown(value) for value in pair)) for name, pair in values.items()]
    return Sheet(title, ("name", *(_folded(name) for name in names)), tuple(rows), prose=True)


def _heads(found: Differences) -> tuple[str, str]:
    first, second = (_folded(name, 14) for name in found.names)
    return first, second


def _row(change: Change, shown: Callable[[float], str], fewer: str, more: str) -> tuple[str, ...]:
    if change.same:
        return shown(change.first), shown(change.second), "none", "the same"
    difference = _signed(change.difference, shown)
    between = "" if change.interval is None else _span(change.interval, shown)
    word = "not known" if change.interval is None else CHANCE
    if change.significant:
        word = fewer if change.difference < 0 else more
    return shown(change.first), shown(change.second), lines(difference, between), word


def _span(interval: Interval, shown: Callable[[float], str]) -> str:
    return f"{_signed(interval.low, shown)} to {_signed(interval.high, shown)}"


def _signed(value: float, shown: Callable[[float], str]) -> str:
    return f"{'-' if value < 0.0 else '+'}{shown(abs(value))}"


def _shown(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, (list, tuple)):
        return "\n".join(_shown(item) for item in value) or "none"
    return _folded(value if isinstance(value, str) else json.dumps(value, default=str))


def _folded(text: str, width: int = WIDE) -> str:
    return "\n".join(textwrap.wrap(text, width)) or "–"
