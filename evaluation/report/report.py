"""The report of a comparison: the list of its sections, its document, its page, and what a terminal prints of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, Field, ValidationError
from rich.console import Group, RenderableType
from rich.text import Text

from evaluation.advice.evidence import ModelAdvice
from evaluation.behaviour import driving_summaries
from evaluation.report.document import Part
from evaluation.report.elements import Answer, Page, Section, Tone
from evaluation.report.render.terminal import answer_lines, indented, plain_text, table_lines
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
    rounds,
    run,
    transfer,
)
from evaluation.report.sections.advice import advice_lines
from evaluation.report.sections.behaviour import BehaviourPart, behaviour_parts
from evaluation.report.sections.controllers import (
    ControllersPart,
    fitness_table,
    overview_picture,
    use_command,
)
from evaluation.report.sections.data import DataPart
from evaluation.report.sections.error_analysis import ErrorAnalysisPart
from evaluation.report.sections.evolution import EvolutionPart
from evaluation.report.sections.exploitability import ExploitabilityPart
from evaluation.report.sections.models import ModelPart
from evaluation.report.sections.prediction import PredictionPart, condition_table, error_table
from evaluation.report.sections.rounds import RoundsPart
from evaluation.report.sections.run import RunPart, TimingsPart
from evaluation.report.sections.summary import SAID, facts, headlines, is_empty, page_title, verdict, warnings
from evaluation.report.sections.transfer import TransferPart
from evaluation.results import ComparisonResults
from evaluation.storage import plain
from evaluation.transfer.forecast import forecasts
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.summary import summary_of
from sysid_evo.errors import ArtefactError

DOCUMENT, PAGE = "report.json", "report.html"

SECTIONS: tuple[Callable[[ComparisonResults], Section | None], ...] = (
    controllers.section,
    rounds.section,
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


def save_report(
    report: ComparisonResults, folder: str | Path, *, of: str = "", afresh: bool = False
) -> tuple[Path, Path]:
    """Write ``report.json`` and ``report.html`` into ``folder`` and return their paths.

    ``of`` is a digest of all results in the report. If it is given, a page of the same results by the same program is
    left as it is, unless ``afresh``.
    """
    text = json_text(to_json(report))
    document = write_text(Path(folder) / DOCUMENT, text)
    made_of = of + text if of else ""
    return document, write_page(Path(folder) / PAGE, lambda: story_of(report), made_of=made_of, afresh=afresh)


SCHEMA: Literal["sysid-evo/report/8"] = "sysid-evo/report/8"


class ReportDocument(Part):
    """Results of a comparison. Readers ignore keys that they do not know.

    A key that goes or changes its meaning raises the number in ``schema``. What is not a number is null. ``timings`` is
    the only key that differs between two equal runs.
    """

    model_config = ConfigDict(title="report.json of sysid-evo")

    schema_: Literal["sysid-evo/report/8"] = Field(default=SCHEMA, alias="schema")
    title: str
    answers: tuple[Answer, ...]
    controllers: ControllersPart | None
    transfer: TransferPart | None
    evolution: EvolutionPart | None
    exploitability: tuple[ExploitabilityPart, ...]
    prediction: PredictionPart | None
    error_analysis: ErrorAnalysisPart | None
    rounds: RoundsPart | None
    models: tuple[ModelPart, ...]
    advice: ModelAdvice | None
    behaviour: tuple[BehaviourPart, ...]
    data: DataPart
    run: RunPart
    timings: TimingsPart

    @classmethod
    def of(cls, report: ComparisonResults) -> ReportDocument:
        """Return the document of a report."""
        prediction, matrix = report.prediction, report.matrix
        return cls(
            title=report.title,
            answers=verdict(report),
            controllers=None
            if report.transfer is None
            else ControllersPart.of(report.transfer, report.forecasts, report),
            transfer=None if matrix is None else TransferPart.of(matrix),
            evolution=None if matrix is None else EvolutionPart.of(matrix),
            exploitability=tuple(map(ExploitabilityPart.model_validate, report.exploitability)),
            prediction=None if prediction is None else PredictionPart.of(prediction, report.conditions),
            error_analysis=None if prediction is None else ErrorAnalysisPart.of(prediction),
            rounds=None if report.rounds is None else RoundsPart.model_validate(report.rounds),
            models=tuple(map(ModelPart.of, report.models)),
            advice=report.advice,
            behaviour=() if matrix is None else tuple(behaviour_parts(report.driving_summaries, matrix)),
            data=DataPart.of(report),
            run=RunPart.of(report),
            timings=TimingsPart(cells=dict(report.timings), finished_on=report.day),
        )


def report_schema() -> dict[str, Any]:
    """Return the JSON schema of ``report.json``."""
    described = ReportDocument.model_json_schema(mode="serialization")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:{SCHEMA.replace('/', ':')}",
        **described,
    }


def to_json(report: ComparisonResults) -> dict[str, Any]:
    """Return the report as strict JSON: nan and infinity are null, times are only in ``timings``."""
    strict: dict[str, Any] = plain(ReportDocument.of(report).model_dump(mode="json", by_alias=True))
    return strict


def load_report(path: str | Path) -> ReportDocument:
    """Read ``report.json`` in the run folder ``path``.

    Raises `ArtefactError` for a file that is missing, of another version, or no report, with the remedy.
    """
    file = Path(path) / DOCUMENT
    remedy = f"rebuild it with sysid-evo report {path}"
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ArtefactError(f"{file}: not a readable report ({error}); {remedy}") from error
    version = found.get("schema") if isinstance(found, dict) else None
    if version != SCHEMA:
        raise ArtefactError(f"{file}: expected a report of schema {SCHEMA}, got {version!r:.60}; {remedy}")
    try:
        return ReportDocument.model_validate(found)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise ArtefactError(f"{file}: {key}: {first['msg']}, got {first['input']!r:.60}; {remedy}") from error


def transfer_to_json(matrix: TransferMatrix) -> dict[str, Any]:
    """Return a transfer matrix without a report as strict JSON, with the keys of a report."""
    parts = {
        "controllers": ControllersPart.of(summary_of(matrix), forecasts(matrix, {})),
        "transfer": TransferPart.of(matrix),
        "evolution": EvolutionPart.of(matrix),
    }
    behaviour = behaviour_parts(driving_summaries(matrix), matrix)
    return {
        "schema": SCHEMA,
        **{key: part.model_dump(mode="json") for key, part in parts.items()},
        "behaviour": [part.model_dump(mode="json") for part in behaviour],
    }


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
        reasons = [indented(f"{failure.step}: {failure.reason.splitlines()[0]}") for failure in shown]
        more = [indented(f"and {count - len(shown)} more, in the report")] if count > len(shown) else []
        parts.append(Group(*reasons, *more))
    short = fitness_table(report, short=True)
    if short is None and report.prediction is not None and report.prediction.horizons:
        short = error_table(report.prediction)
    for sheet in (rounds.rounds_table(report), short, condition_table(report.conditions)):
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
    return [Text(page_title(report), style="bold"), *answer_lines(verdict(report))]
