"""Tables of what stands behind a comparison: failures, data, models, settings."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from evaluation.advice import ModelAdvice
from evaluation.labels import percent
from evaluation.report.contents import Report
from evaluation.report.sheets import Sheet, listed, number

SHOWN_EPISODES = 40


def advice_sheet(advice: ModelAdvice) -> Sheet:
    """What limits the best model, and what to record next."""
    rows = tuple((remark.topic, remark.sentence) for remark in advice.remarks)
    return Sheet(
        f"What limits {advice.model}",
        ("topic", "what was found, and what to do"),
        rows,
        note=f"The most important first. Judged on {advice.judged_on}.",
        prose=True,
    )


def failure_sheet(report: Report) -> Sheet:
    """What could not be computed, and why."""
    rows = tuple((failure.what, failure.reason) for failure in report.all_failures)
    return Sheet("Failed", ("what", "reason"), rows, prose=True)


def episode_sheet(report: Report) -> Sheet:
    """The episodes of the data set."""
    rows = [
        (e.name, part, f"{e.duration:.1f}", str(e.steps), percent(e.moving))
        for part, episodes in (("training", report.data.training), ("test", report.data.test))
        for e in episodes[:SHOWN_EPISODES]
    ]
    return Sheet("Episodes", ("episode", "used for", "seconds", "steps", "moving"), tuple(rows), details=True)


def channel_list(report: Report) -> Sheet:
    """The channels of the system."""
    system = report.data.system
    rows = [
        (
            channel.name,
            kind,
            channel.unit or "–",
            number(channel.low, 3),
            number(channel.high, 3),
            "–" if channel.levels is None else listed([f"{level:g}" for level in channel.levels]),
        )
        for kind, channels in (("state", system.states), ("control", system.controls))
        for channel in channels
    ]
    return Sheet(
        f"Channels, sampled every {system.dt:g} s",
        ("channel", "kind", "unit", "lowest", "highest", "levels"),
        tuple(rows),
        details=True,
    )


def model_sheet(report: Report) -> Sheet:
    """The models and their hyper-parameters."""
    rows = [
        (model.name, model.family, model.knowledge, listed([f"{k} = {v}" for k, v in model.parameters.items()]))
        for model in report.models
    ]
    heads = ("model", "family", "knowledge", "hyper-parameters")
    return Sheet("Models", heads, tuple(rows), details=True, prose=True)


def key_sheet(title: str, values: Mapping[str, Any]) -> Sheet:
    """Keys and values; what is nested gets a dotted key."""
    return Sheet(title, ("name", "value"), tuple(_flat(values)), details=True, prose=True)


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows += _flat(value, f"{prefix}{key}.")
        else:
            text = value if isinstance(value, str) else json.dumps(value, default=str)
            rows.append((f"{prefix}{key}", text))
    return rows
