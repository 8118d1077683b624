"""Advice: what limits the best model, and what to record next."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from evaluation.advice.evidence import ModelAdvice, Remark
from evaluation.report.elements import Section, TableElement
from evaluation.results import ComparisonResults


def section(report: ComparisonResults) -> Section | None:
    """Return the advice; None without any."""
    if report.advice is None or not report.advice.remarks:
        return None
    sheet = TableElement(
        "Findings, the most important first",
        ("topic", "finding and next step"),
        tuple((remark.topic, remark.sentence) for remark in report.advice.remarks),
        note=f"Evaluated on {report.advice.evaluated_on}.",
        prose=True,
    )
    return Section(limits_question(report.advice).rstrip("?"), [sheet], background=True, link="Next recording")


def advice_lines(advice: ModelAdvice) -> list[RenderableType]:
    """Return the remarks on a model as a list, the most important first; empty without a model."""
    if not advice.model:
        return []
    if not advice.remarks:
        return [Text(f"No clear limit of {advice.model} was found. Evaluated on {advice.evaluated_on}.")]
    judged = Padding(Text(f"Evaluated on {advice.evaluated_on}.", style="dim"), (0, 0, 0, 1))
    return [*remark_lines(limits_question(advice), advice.remarks), judged]


def remark_lines(question: str, remarks: Sequence[Remark]) -> list[RenderableType]:
    """Return the ``question`` that ``remarks`` answer, and their sentences as a list."""
    bullets = Table.grid(padding=(0, 1))
    for remark in remarks:
        bullets.add_row(Text(" -"), Text(remark.sentence))
    return [Text(question, style="bold cyan"), bullets]


def limits_question(advice: ModelAdvice) -> str:
    """Return the question that the advice answers."""
    return f"What limits {advice.model}, and what to record next?"
