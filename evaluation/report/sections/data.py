"""Episodes and channels of the data, notes on them, and the reward that a task has learned from them."""

from __future__ import annotations

from typing import Any

from evaluation.formatting import number, percent
from evaluation.report.document import Number, Part
from evaluation.report.elements import Section, TableElement
from evaluation.results import ComparisonResults, EpisodeSummary


def section(report: ComparisonResults) -> Section:
    """Return episodes, channels and notes."""
    data = report.data
    seconds = [sum(episode.duration for episode in part) for part in (data.training, data.test)]
    name = f"{data.name}: " if data.name else ""
    sentence = (
        f"{name}{len(data.training)} training episodes of {seconds[0]:.0f} s, {len(data.test)} test episodes of "
        f"{seconds[1]:.0f} s, sampled every {data.system.dt:g} s. SHA-256 of the training data: {data.fingerprint}"
    )
    items = [episode_sheet(report), channel_list(report)]
    return Section("Data", items, [sentence, *report.notes], background=True)


def task_section(report: ComparisonResults) -> Section | None:
    """Return the task and what its learned reward is worth; None if it has learned nothing."""
    if not report.task_notes:
        return None
    return Section("Task", (), [f"Task: {report.settings.get('task')}.", *report.task_notes])


SHOWN_EPISODES = 40


def episode_sheet(report: ComparisonResults) -> TableElement:
    """The episodes of the data set."""
    rows = [
        (e.name, part, f"{e.duration:.1f}", str(e.steps), percent(e.moving))
        for part, episodes in (("training", report.data.training), ("test", report.data.test))
        for e in episodes[:SHOWN_EPISODES]
    ]
    return TableElement("Episodes", ("episode", "used for", "seconds", "steps", "moving"), tuple(rows), details=True)


def channel_list(report: ComparisonResults) -> TableElement:
    """The channels of the system."""
    system = report.data.system
    rows = [
        (
            channel.name,
            kind,
            channel.unit or "–",
            number(channel.low, 3),
            number(channel.high, 3),
            "–" if channel.levels is None else ", ".join(f"{level:g}" for level in channel.levels),
        )
        for kind, channels in (("state", system.states), ("control", system.controls))
        for channel in channels
    ]
    return TableElement(
        f"Channels, sampled every {system.dt:g} s",
        ("channel", "kind", "unit", "lowest", "highest", "levels"),
        tuple(rows),
        details=True,
    )


class ChannelPart(Part):
    """A channel of a system; ``low`` and ``high`` are null where there is no limit."""

    name: str
    unit: str
    low: Number
    high: Number
    levels: tuple[float, ...] | None
    neutral: float
    period: float | None = None
    description: str = ""


class SystemPart(Part):
    """Names, units and limits of the channels; ``dt`` in s."""

    name: str
    dt: float
    states: tuple[ChannelPart, ...]
    controls: tuple[ChannelPart, ...]
    motion: dict[str, Any] | None


class DataPart(Part):
    """The data that models were fitted to and tested on, and notes on data and tests.

    ``fingerprint`` is the SHA-256 of the training data, ``moving`` the share of the samples in motion.
    """

    name: str
    fingerprint: str
    system: SystemPart
    training: tuple[EpisodeSummary, ...]
    test: tuple[EpisodeSummary, ...]
    notes: tuple[str, ...]

    @classmethod
    def of(cls, report: ComparisonResults) -> DataPart:
        """Return the data of a report."""
        system = SystemPart.model_validate(report.data.system.to_dict())
        return cls.made_of(
            report.data, system=system, notes=(*report.notes, *filter(None, [report.task_warning]), *report.task_notes)
        )
