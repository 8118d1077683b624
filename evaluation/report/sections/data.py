"""The data that models were fitted to and tested on."""

from __future__ import annotations

from evaluation.report.contents import Report
from evaluation.report.sections.section import Section
from evaluation.report.tables import channel_list, episode_sheet


def section(report: Report) -> Section:
    """Return episodes, channels and notes."""
    return Section(
        "Data", [episode_sheet(report), channel_list(report)], [_sentence(report), *report.notes], background=True
    )


def _sentence(report: Report) -> str:
    data = report.data
    seconds = [sum(episode.duration for episode in part) for part in (data.training, data.test)]
    name = f"{data.name}: " if data.name else ""
    return (
        f"{name}{len(data.training)} training episodes of {seconds[0]:.0f} s, {len(data.test)} test episodes of "
        f"{seconds[1]:.0f} s, sampled every {data.system.dt:g} s. Training set SHA-256: {data.fingerprint}"
    )
