"""The report of a comparison: the list of its sections, its document, its page, and what a terminal prints of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from evaluation.behaviour import driving_summaries
from evaluation.report.elements import Page, Section, Tone
from evaluation.report.render.html import page_of
from evaluation.report.render.markdown import story_to_markdown
from evaluation.report.render.terminal import findings_lines, indented, plain_text, table_lines
from evaluation.report.save import json_text, write_page, write_text
from evaluation.report.sections import (
    advice,
    behaviour,
    controllers,
    data,
    exploitability,
    models,
    prediction,
    replay,
    run,
    transfer,
)
from evaluation.report.sections.advice import advice_lines
from evaluation.report.sections.behaviour import behaviour_to_json
from evaluation.report.sections.controllers import (
    fitness_table,
    forecast_to_json,
    overview_picture,
    summary_to_json,
    use_command,
)
from evaluation.report.sections.evolution import champion_to_json
from evaluation.report.sections.exploitability import exploitability_to_json
from evaluation.report.sections.prediction import condition_table, error_table, prediction_to_json
from evaluation.report.sections.summary import SAID, facts, headlines, is_empty, page_title, verdict, warnings
from evaluation.report.sections.transfer import matrix_to_json
from evaluation.results import ComparisonResults
from evaluation.storage import plain
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.summary import summary_of

DOCUMENT, PAGE = "report.json", "report.html"

SECTIONS: tuple[Callable[[ComparisonResults], Section | None], ...] = (
    controllers.section,
    replay.section,
    exploitability.section,
    prediction.section,
    models.section,
    advice.section,
    behaviour.section,
    data.task_section,
    data.section,
    run.section,
)
"""Functions that make the sections, in the order of the page."""


def sections(report: ComparisonResults) -> list[Section]:
    """Return the sections of a report that have something to show; without controllers prediction comes first."""
    order = list(SECTIONS)
    if report.matrix is None:
        order.sort(key=lambda make: make is not prediction.section)
    return [section for make in order if (section := make(report)) is not None]


def story_of(report: ComparisonResults) -> Page:
    """Return the content of a report in its order; page and Markdown are made of it."""
    return Page(
        page_title(report),
        headlines(report),
        verdict(report) if is_empty(report) else (),
        None,
        sections(report),
        facts=facts(report),
        warnings=warnings(report),
        figure=overview_picture(report),
    )


def to_html(report: ComparisonResults) -> str:
    """Return the page of a report as text, with no link or source outside itself."""
    return page_of(story_of(report))


def to_markdown(report: ComparisonResults, *, figures: str = "") -> str:
    """Return the report as Markdown; ``figures`` is the folder of the SVG files, empty to leave them out."""
    return story_to_markdown(story_of(report), figures=figures)


def save_report(
    report: ComparisonResults, folder: str | Path, *, of: str | None = None, afresh: bool = False
) -> tuple[Path, Path]:
    """Write ``report.json`` and ``report.html`` into ``folder`` and return their paths.

    ``of`` is a digest of all results in the report. If it is given, a page of the same results by the same program is
    left as it is, unless ``afresh``.
    """
    text = json_text(to_json(report))
    document = write_text(Path(folder) / DOCUMENT, text)
    made_of = () if of is None else (of, text, str(report.day))
    return document, write_page(Path(folder) / PAGE, lambda: story_of(report), made_of=made_of, afresh=afresh)


SCHEMA = "sysid-evo/report/6"
"""Version of the document that ``report.schema.json`` describes."""


def report_schema() -> dict[str, Any]:
    """Return the JSON schema of the document."""
    schema: dict[str, Any] = json.loads(files("evaluation.report").joinpath("report.schema.json").read_text("utf-8"))
    return schema


def to_json(report: ComparisonResults) -> dict[str, Any]:
    """Return the report as strict JSON: nan and infinity are null, durations are only in ``timings``."""
    document = {
        "schema": SCHEMA,
        "title": report.title,
        "headlines": headlines(report),
        "verdict": verdict(report),
        "data": {
            "name": report.data.name,
            "fingerprint": report.data.fingerprint,
            "system": report.data.system.to_dict(),
            "training": report.data.training,
            "test": report.data.test,
        },
        "notes": (*report.notes, *report.task_notes),
        "models": report.models,
        "prediction": None if report.prediction is None else prediction_to_json(report.prediction),
        **({"conditions": report.conditions} if report.conditions else {}),
        "champions": []
        if report.matrix is None
        else [champion_to_json(champion) for champion in report.matrix.champions],
        "transfer": None if report.matrix is None else matrix_to_json(report.matrix),
        "controllers": None if report.transfer is None else summary_to_json(report.transfer),
        "forecast": None if report.matrix is None else forecast_to_json(report),
        "behaviour": [] if report.matrix is None else behaviour_to_json(report.driving_summaries, report.matrix),
        "controller_files": report.controllers,
        "exploitability": [exploitability_to_json(model) for model in report.exploitability],
        "advice": report.advice,
        "failures": report.all_failures,
        "settings": report.settings,
        "versions": report.versions,
        "timings": report.timings,
    }
    strict: dict[str, Any] = plain(document)
    return strict


def transfer_to_json(matrix: TransferMatrix) -> dict[str, Any]:
    """Return a transfer matrix without a report as strict JSON, with the keys of a report."""
    document = {
        "schema": SCHEMA,
        "champions": [champion_to_json(champion) for champion in matrix.champions],
        "transfer": matrix_to_json(matrix),
        "controllers": summary_to_json(summary_of(matrix)),
        "behaviour": behaviour_to_json(driving_summaries(matrix), matrix),
    }
    strict: dict[str, Any] = plain(document)
    return strict


def transfer_tables(matrix: TransferMatrix) -> list[RenderableType]:
    """Return a transfer matrix without a report as tables."""
    manner = behaviour.driving_table(driving_summaries(matrix), matrix.robot)
    sheets = (transfer.transfer_sheet(matrix), controllers.further_figures_table(matrix, summary_of(matrix)), manner)
    return [part for sheet in sheets if sheet is not None for part in table_lines(sheet)]


SHOWN_FAILURES = 5
"""Failures that the terminal lists."""


def brief(report: ComparisonResults, *, folder: str | Path = "") -> list[RenderableType]:
    """Return the verdict and one short table, about a screen of text.

    ``folder``, the run folder, is put before the file of the chosen controller. The caller prints the path of the
    report, last.
    """
    parts = _verdict(report)
    if report.all_failures:
        shown, count = report.all_failures[:SHOWN_FAILURES], len(report.all_failures)
        reasons = [indented(f"{failure.what}: {failure.reason.splitlines()[0]}") for failure in shown]
        more = [indented(f"and {count - len(shown)} more, in the report")] if count > len(shown) else []
        parts.append(Group(*reasons, *more))
    short = fitness_table(report, short=True)
    if short is None and report.prediction is not None and report.prediction.horizons:
        short = error_table(report.prediction)
    for sheet in (short, condition_table(report.conditions)):
        parts += [] if sheet is None else table_lines(sheet)
    pick = None if report.transfer is None else report.transfer.pick
    if pick is not None and (command := use_command(report, pick, folder=folder)) is not None:
        line = Text.assemble(("Use the chosen controller: ", "bold"), command)
        line.no_wrap, line.overflow = True, "ignore"  # a line of the terminal may break; one that is copied may not
        parts.append(Group(line))
    return parts


def tables(report: ComparisonResults) -> list[RenderableType]:
    """Return the verdict and all main tables as rich renderables, each at most 80 columns wide."""
    parts, found = _verdict(report), sections(report)
    if report.advice is not None and len(report.advice.remarks) > SAID:
        parts += advice_lines(report.advice)
    for section in found:
        for sheet in () if section.background else section.sheets:
            parts += table_lines(sheet)
    if (failed := run.failure_table(report)) is not None:
        parts += table_lines(failed)
    if report.exploitability:
        parts.append(Group(*(Text(model.sentence) for model in report.exploitability)))
    absent = [sentence for section in found for sentence in section.absent]
    for title, notes in (("Notes", report.notes), ("Not shown", absent)):
        if notes:
            parts.append(Group(Text(title, style="bold"), *(Text(f"- {note}") for note in notes)))
    return parts


TONES: dict[Tone, str] = {"good": "#009e73", "warn": "#e69f00", "bad": "#d55e00", "open": "#888888"}


@dataclass(frozen=True, repr=False)
class PrintedReport(ComparisonResults):
    """A report that prints like in the terminal, and shows its answers as cards in a notebook."""

    def __str__(self) -> str:
        return plain_text(brief(self))

    def _repr_html_(self) -> str:
        cards = "".join(
            f'<div style="flex: 1 1 14em; padding: 0 1em; border-top: 3px solid {TONES[one.tone]}">'
            f"<p>{escape(one.question)}</p><p><strong>{escape(one.answer)}</strong></p><p>{escape(one.sentence)}</p></div>"
            for one in headlines(self)
        )
        return f'<p><strong>{escape(self.title)}</strong></p><div style="display: flex; flex-wrap: wrap">{cards}</div>'


def _verdict(report: ComparisonResults) -> list[RenderableType]:
    return [Text(page_title(report), style="bold"), *findings_lines(verdict(report))]
