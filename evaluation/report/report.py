"""The report of a comparison: its document (fields are the sections), its page, printing, notebook form."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from evaluation.advice.evidence import advice_to_json
from evaluation.behaviour import manners
from evaluation.report.document import plain
from evaluation.report.elements import Section, Sheet, Story
from evaluation.report.render.html import page_of
from evaluation.report.render.markdown import story_to_markdown
from evaluation.report.render.terminal import _indented, findings_lines, to_rich
from evaluation.report.save import _end, _mark
from evaluation.report.sections import (
    advice,
    behaviour,
    controllers,
    data,
    exploitability,
    prediction,
    replay,
    run,
    transfer,
)
from evaluation.report.sections.advice import advice_lines
from evaluation.report.sections.behaviour import _behaviour
from evaluation.report.sections.controllers import _forecast, _summary, drive_command, overview_sheet
from evaluation.report.sections.evolution import _champion
from evaluation.report.sections.exploitability import _exploitability
from evaluation.report.sections.prediction import _prediction, condition_sheet
from evaluation.report.sections.summary import SAID, headlines, verdict
from evaluation.report.sections.transfer import _matrix
from evaluation.results import Report
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.summary import summary_of
from sysid_evo.files import write_atomically

SCHEMA = "sysid-evo/report/4"
"""What ``report.schema.json`` describes."""


def to_json(report: Report) -> dict[str, Any]:
    """Return the report as strict JSON: what is not a number is null, durations stand under ``timings`` alone."""
    document = {
        "schema": SCHEMA,
        "title": report.title,
        "headlines": [asdict(headline) for headline in headlines(report)],
        "verdict": [asdict(finding) for finding in verdict(report)],
        "data": {
            "name": report.data.name,
            "fingerprint": report.data.fingerprint,
            "system": report.data.system.to_dict(),
            "training": [asdict(episode) for episode in report.data.training],
            "test": [asdict(episode) for episode in report.data.test],
        },
        "notes": report.notes,
        "models": [asdict(model) for model in report.models],
        "prediction": None if report.prediction is None else _prediction(report.prediction),
        **(
            {"conditions": {label: [asdict(one) for one in errors] for label, errors in report.conditions.items()}}
            if report.conditions
            else {}
        ),
        "champions": [] if report.matrix is None else [_champion(champion) for champion in report.matrix.champions],
        "transfer": None if report.matrix is None else _matrix(report.matrix),
        "controllers": None if report.transfer is None else _summary(report.transfer),
        "forecast": None if report.matrix is None else _forecast(report),
        "behaviour": [] if report.matrix is None else _behaviour(report.manners, report.matrix),
        "controller_files": report.controllers,
        "exploitability": [_exploitability(model) for model in report.exploitability],
        "advice": None if report.advice is None else advice_to_json(report.advice),
        "failures": [asdict(failure) for failure in report.all_failures],
        "settings": report.settings,
        "versions": report.versions,
        "timings": report.timings,
    }
    strict: dict[str, Any] = plain(document)
    return strict


def transfer_to_json(matrix: TransferMatrix) -> dict[str, Any]:
    """Return a transfer matrix without a report as strict JSON: the parts that a report holds under the same names."""
    document = {
        "schema": SCHEMA,
        "champions": [_champion(champion) for champion in matrix.champions],
        "transfer": _matrix(matrix),
        "controllers": _summary(summary_of(matrix)),
        "behaviour": _behaviour(manners(matrix), matrix),
    }
    strict: dict[str, Any] = plain(document)
    return strict


def report_schema() -> dict[str, Any]:
    """Return the JSON schema of the document."""
    schema: dict[str, Any] = json.loads(files("evaluation.report").joinpath("report.schema.json").read_text("utf-8"))
    return schema


def to_markdown(report: Report, *, figures: str = "") -> str:
    """Return the report as Markdown; ``figures`` is the folder of the SVG files, empty to leave them out."""
    return story_to_markdown(Story.of(report), figures=figures)


def to_html(report: Report) -> str:
    """Return the page of a report as text; it holds no link and no source outside itself."""
    return page_of(Story.of(report))


DOCUMENT, PAGE = "report.json", "report.html"


def save_report(
    report: Report, folder: str | Path, *, of: str | None = None, afresh: bool = False
) -> tuple[Path, Path]:
    """Write ``report.json`` and ``report.html`` into ``folder`` and return their paths.

    ``of`` is a digest of all results that the report shows. With it a page is not drawn again that is there already,
    made of the same results by the same program, unless that is wanted ``afresh``.
    """
    folder = Path(folder)
    text = json.dumps(to_json(report), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    document = write_atomically(folder / DOCUMENT, lambda file: file.write_text(text, encoding="utf-8"))
    mark = "" if of is None else _mark(of, text)
    if afresh or not mark or _end(folder / PAGE, len(mark)) != mark:
        page = to_html(report) + mark
        write_atomically(folder / PAGE, lambda file: file.write_text(page, encoding="utf-8"))
    return document, folder / PAGE


SECTIONS: tuple[Callable[[Report], Section | None], ...] = (
    prediction.section,
    advice.section,
    transfer.section,
    controllers.section,
    behaviour.section,
    replay.section,
    exploitability.section,
    run.failures_section,
    data.section,
    run.section,
)


def sections(report: Report) -> list[Section]:
    """Return the parts of the report after the verdict, without those that have nothing to show."""
    return [section for make in SECTIONS if (section := make(report)) is not None]


SHOWN_FAILURES = 5


def brief(report: Report, *, folder: str | Path = "") -> list[RenderableType]:
    """Return the verdict and one short table: what fits on a screen.

    ``folder``, the run folder, is put before the file of the chosen controller. The path of the report is not
    in it: whoever saves the report prints it, last.
    """
    parts = _verdict(report)
    if report.all_failures:
        shown, count = report.all_failures[:SHOWN_FAILURES], len(report.all_failures)
        reasons = [_indented(f"{failure.what}: {failure.reason.splitlines()[0]}") for failure in shown]
        more = [_indented(f"and {count - len(shown)} more, in the report")] if count > len(shown) else []
        parts.append(Group(*reasons, *more))
    for sheet in (overview_sheet(report), condition_sheet(report.conditions)):
        parts += [] if sheet is None else to_rich(sheet)
    pick = None if report.transfer is None else report.transfer.pick
    if pick is not None and (command := drive_command(report, pick, folder=folder)) is not None:
        told = Text.assemble(("Drive with the chosen controller: ", "bold"), command)
        told.no_wrap, told.overflow = True, "ignore"  # a line of the terminal may break; one that is copied may not
        parts.append(Group(told))
    return parts


def tables(report: Report) -> list[RenderableType]:
    """Return the verdict and all main tables as rich renderables, each at most 80 columns wide."""
    parts = _verdict(report)
    if report.advice is not None and len(report.advice.remarks) > SAID:
        parts += advice_lines(report.advice)
    for sheet in _sheets(report):
        parts += to_rich(sheet)
    if report.exploitability:
        parts.append(Group(*(Text(model.sentence) for model in report.exploitability)))
    for title, notes in (("Notes", report.notes), ("Not shown", _absent(report))):
        if notes:
            parts.append(Group(Text(title, style="bold"), *(Text(f"- {note}") for note in notes)))
    return parts


def _sheets(report: Report) -> list[Sheet]:
    shown = [section for section in sections(report) if not section.background]
    return [sheet for section in shown for sheet in section.sheets if not sheet.code]


def _absent(report: Report) -> list[str]:
    return [sentence for section in sections(report) for sentence in section.absent]


def _verdict(report: Report) -> list[RenderableType]:
    return [Text(report.title, style="bold"), *findings_lines(verdict(report))]
