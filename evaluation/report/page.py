"""The report as one HTML page that needs nothing else: styles and pictures are inside."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from evaluation.plots.theme import style_sheet
from evaluation.report import pictures as draw
from evaluation.report.contents import Report
from evaluation.report.forecasting import forecast_sheet, model_forecast_sheet
from evaluation.report.overview import command_sheet, overview_sheet
from evaluation.report.pictures import Picture
from evaluation.report.replay import Replay, replay
from evaluation.report.sheets import Sheet
from evaluation.report.tables import (
    advice_sheet,
    channel_list,
    channel_sheet,
    condition_sheet,
    controller_sheet,
    coverage_sheet,
    difference_sheet,
    episode_error_sheet,
    episode_sheet,
    exploitability_sheet,
    failure_sheet,
    finalist_sheet,
    fit_sheet,
    key_sheet,
    measure_sheet,
    model_sheet,
    prediction_sheet,
    probe_sheet,
    region_sheet,
    residual_sheet,
    transfer_sheet,
)
from evaluation.report.transferring import unknown
from evaluation.report.verdict import verdict
from evaluation.transfer import TransferMatrix, TransferSummary

TEMPLATE = "page.html.j2"
JOINT = re.compile(r"(?<=\w)([_+/@])(?=\w)")
"""Where a long name may break."""
SHORTEST = 0.05
"""Seconds below which the time of a cell is left out."""


@dataclass(frozen=True)
class Section:
    """A part of the page: paragraphs, then pictures and tables in order."""

    title: str
    items: Sequence[Picture | Sheet | Replay]
    paragraphs: Sequence[str] = ()

    @property
    def anchor(self) -> str:
        return "".join(letter if letter.isalnum() else "-" for letter in self.title.lower())


def to_html(report: Report) -> str:
    """Return the page as text; it holds no link and no source outside itself."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup, escape

    environment = Environment(
        loader=PackageLoader("evaluation.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["joints"] = lambda text: Markup(JOINT.sub(r"\1<wbr>", str(escape(text))))
    environment.filters["raw"] = Markup
    environment.tests["picture"] = lambda item: isinstance(item, Picture)
    environment.tests["replay"] = lambda item: isinstance(item, Replay)
    page: str = environment.get_template(TEMPLATE).render(
        report=report,
        verdict=verdict(report),
        overview=overview_sheet(report),
        sections=list(sections(report)),
        colours=Markup(style_sheet()),
    )
    return page


def sections(report: Report) -> Iterable[Section]:
    """Yield the parts of the page after the verdict, leaving out those that have nothing to show."""
    if report.advice is not None and report.advice.remarks:
        yield Section("Advice", [advice_sheet(report.advice)])
    if report.prediction is not None:
        yield _prediction(report)
    if report.matrix is not None and report.transfer is not None:
        yield _transfer(report, report.matrix, report.transfer)
        if forecasting := _present(forecast_sheet(report), model_forecast_sheet(report)):
            yield Section("Forecast", forecasting)
        if (shown := replay(report.matrix, first=report.transfer.pick)) is not None:
            yield Section("Replay", [shown])
    if report.exploitability:
        yield Section(
            "Exploitability",
            [
                exploitability_sheet(report.exploitability),
                *([probe_sheet(report.exploitability)] if report.exploitability[0].probes else []),
            ],
            [model.sentence for model in report.exploitability],
        )
    if report.all_failures:
        yield Section("Failures", [failure_sheet(report)])
    yield Section(
        "Data",
        _present(episode_sheet(report), channel_list(report)),
        [_data_sentence(report), *report.notes],
    )
    settings = [
        key_sheet(title, values)
        for title, values in (
            ("Settings", report.settings),
            ("Versions", report.versions),
            (f"Timings (s) from {SHORTEST:g} s", _timings(report)),
        )
        if values
    ]
    models = [model_sheet(report)] if report.models else []
    if settings or models:
        yield Section("Settings", [*models, *settings])


def _transfer(report: Report, matrix: TransferMatrix, summary: TransferSummary) -> Section:
    return Section(
        "Transfer",
        _present(
            transfer_sheet(matrix),
            draw.claims_picture(matrix, summary),
            controller_sheet(matrix, summary),
            measure_sheet(matrix),
            finalist_sheet(matrix),
            command_sheet(report),
            draw.fitness_picture(matrix),
            draw.traces_picture(matrix),
        ),
        [
            "Claimed: fitness on the models a controller was evolved against. Achieved: fitness elsewhere.",
            *unknown(summary),
        ],
    )


def _prediction(report: Report) -> Section:
    prediction = report.prediction
    assert prediction is not None
    scored = [model for model in prediction.models if not model.failed]
    pictures = _present(
        draw.horizon_picture(prediction) if prediction.cases.horizons else None,
        draw.free_run_picture(prediction) if prediction.cases.free_runs and scored else None,
    )
    compared = _present(difference_sheet(prediction))
    where = _present(
        region_sheet(prediction), residual_sheet(prediction), episode_error_sheet(prediction), fit_sheet(prediction)
    )
    channels = [channel_sheet(prediction, horizon) for horizon in reversed(prediction.horizons)]
    return Section(
        "Prediction",
        [
            prediction_sheet(prediction),
            *_present(coverage_sheet(prediction), condition_sheet(report.conditions)),
            *compared,
            *pictures,
            *where,
            *channels,
        ],
        ["A low prediction error does not show that a controller evolved in the model works elsewhere: see Transfer."]
        if report.matrix is not None
        else [],
    )


def _data_sentence(report: Report) -> str:
    data = report.data
    seconds = [sum(episode.duration for episode in part) for part in (data.training, data.test)]
    name = f"{data.name}: " if data.name else ""
    return (
        f"{name}{len(data.training)} training episodes of {seconds[0]:.0f} s, {len(data.test)} test episodes of "
        f"{seconds[1]:.0f} s, sampled every {data.system.dt:g} s. Training set SHA-256: {data.fingerprint}"
    )


def _timings(report: Report) -> dict[str, float]:
    return {cell: round(seconds, 2) for cell, seconds in report.timings.items() if seconds >= SHORTEST}


def _present(*items: Picture | Sheet | None) -> list[Picture | Sheet]:
    return [item for item in items if item is not None]
