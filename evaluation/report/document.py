"""The report as strict JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.resources import files
from typing import Any

import numpy as np

from evaluation.advice import advice_to_json
from evaluation.behaviour import Manner, described, manners
from evaluation.behaviour.manner import unit_of
from evaluation.exploitability import ModelExploitability
from evaluation.forecast import RULE, summary_of
from evaluation.prediction import Coverage, Difference, EpisodeError, ErrorScore, ModelPrediction, Prediction, Residuals
from evaluation.prediction.residuals import AHEAD, LAGS
from evaluation.report.contents import Report
from evaluation.report.headlines import headlines
from evaluation.report.verdict import verdict
from evaluation.transfer import Cell, ControllerSummary, Figures, TransferMatrix, TransferSummary
from evaluation.transfer.standing import judges_of
from evaluation.transfer.uncertainty import SHARE
from sysid_evo.evolution import Champion
from sysid_evo.system import System

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


def _behaviour(found: Sequence[Manner], matrix: TransferMatrix) -> list[dict[str, Any]]:
    """Return the numbers of every controller on every system where it was recorded, and the sentences on it."""
    sentences = described(found, matrix.robot)
    rows = []
    for manner in found:
        measures = {name: {**asdict(one), "unit": unit_of(name)} for name, one in manner.measures.items()}
        rows.append({**asdict(manner), "measures": measures, "sentence": sentences.get(manner.controller, "")})
    return rows


def _prediction(prediction: Prediction) -> dict[str, Any]:
    cases = prediction.cases
    return {
        "protocol": asdict(cases.protocol),
        "description": cases.protocol.describe(cases.system.dt),
        "windows": len(cases.windows),
        "std": dict(zip(cases.system.state_names, cases.std, strict=True)),
        "rms": dict(zip(cases.system.state_names, cases.rms, strict=True)),
        "models": [_model(model, cases.horizons, cases.system) for model in prediction.models],
        "differences": [
            _difference(difference) for horizon in prediction.horizons for difference in prediction.differences(horizon)
        ],
    }


def _model(model: ModelPrediction, horizons: Sequence[int], system: System) -> dict[str, Any]:
    return {
        "name": model.name,
        "family": model.family,
        "reason": model.reason or None,
        "horizons": [_score(score, system) for score in model.at],
        "free_run": None if model.free_run is None else _score(model.free_run, system),
        "curve": model.curve,
        "curve_interval": model.curve_interval,
        "residuals": None if model.residuals is None else _residuals(model.residuals, system),
        "regions": [{"words": region.words, **asdict(region)} for region in model.regions],
        "episodes": [_episode(episode, horizons, system) for episode in model.episodes],
        "divergence": None if model.divergence is None else asdict(model.divergence),
        "coverage": [_coverage(held, system) for held in model.coverage],
        "notes": model.notes,
    }


def _residuals(found: Residuals, system: System) -> dict[str, Any]:
    channels = {
        name: {
            "white": found.white[i],
            "white_p": found.white_p[i],
            "autocorrelation": found.autocorrelation[:, i],
            "band": found.band[:, i],
            "controls": {
                control: {
                    "p": found.cross_p[j, i],
                    "correlation": found.cross[:, j, i],
                    "band": found.cross_band[:, j, i],
                }
                for j, control in enumerate(system.control_names)
            },
        }
        for i, name in enumerate(system.state_names)
    }
    return {"samples": found.samples, "control_lags": list(range(-AHEAD, LAGS + 1)), "channels": channels}


def _episode(episode: EpisodeError, horizons: Sequence[int], system: System) -> dict[str, Any]:
    return {
        "name": episode.name,
        "n": {str(horizon): n for horizon, n in zip(horizons, episode.n, strict=True)},
        "fit_percent": dict(zip(system.state_names, episode.fit, strict=True)),
    }


def _score(score: ErrorScore, system: System) -> dict[str, Any]:
    channels = {
        channel.name: {
            "unit": channel.unit,
            "rmse": score.rmse[i],
            "error_std": score.error_std[i],
            "relative_percent": score.relative_percent[i],
            "nrmse": score.nrmse[i],
            "fit_percent": score.fit_percent[i],
        }
        for i, channel in enumerate(system.states)
    }
    return {
        "steps": score.horizon,
        "seconds": None if score.horizon is None else score.horizon * system.dt,
        "initialisation": "measured states and controls",
        "samples": score.samples,
        "n": score.n,
        "interval": list(score.interval),
        "channels": channels,
    }


def _coverage(held: Coverage, system: System) -> dict[str, Any]:
    return {
        "steps": held.horizon,
        "seconds": held.horizon * system.dt,
        "samples": held.samples,
        "aim": held.share,
        "mean": held.mean,
        "honest": held.honest,
        "channels": dict(zip(system.state_names, held.inside, strict=True)),
    }


def _difference(difference: Difference) -> dict[str, Any]:
    return {
        "first": difference.first,
        "second": difference.second,
        "steps": difference.horizon,
        "difference": difference.difference,
        "interval": list(difference.interval),
        "verdict": difference.verdict,
    }


def _champion(champion: Champion) -> dict[str, Any]:
    known = {name: value for name, value in champion.to_dict().items() if name != "system"}
    return {**known, "parameters": champion.parameters, "history": champion.history}


def _matrix(matrix: TransferMatrix) -> dict[str, Any]:
    figures = Figures(matrix)
    return {
        "unit": matrix.unit,
        "trials": matrix.trials,
        "rows": matrix.rows,
        "columns": matrix.columns,
        "robot": matrix.robot,
        "other_robots": matrix.other_robots,
        "families": matrix.families,
        "interval": SHARE,
        "cells": [_cell(matrix.cell(row, column), figures) for row in matrix.rows for column in matrix.columns],
        "consensus": [_consensus(champion, figures) for champion in matrix.champions],
    }


def _consensus(champion: Champion, figures: Figures) -> dict[str, Any]:
    median = figures.consensus(champion)
    return {
        "champion": champion.name,
        "models": judges_of(champion, figures.matrix),
        "median": None if median is None else median.value,
        "interval": None if median is None else median.interval(),
    }


def _cell(cell: Cell, figures: Figures) -> dict[str, Any]:
    figure = figures.singles.get((cell.champion, cell.column))
    return {
        "champion": cell.champion,
        "column": cell.column,
        "trials": cell.trials,
        "mean": cell.mean,
        "std": cell.std,
        "standard_error": cell.standard_error,
        "interval": None if figure is None else figure.interval(),
        "clipped_share": cell.clipped_share,
        "diverged_share": cell.diverged_share,
        "engine": cell.engine,
        "fitness": cell.fitness,
        "reason": cell.reason or None,
        "missing": cell.missing,
    }


def _summary(summary: TransferSummary) -> dict[str, Any]:
    return {
        "controllers": [_controller(controller) for controller in summary.controllers],
        "pick": summary.pick,
        "best_on": summary.best_on,
        "correlations": [asdict(correlation) for correlation in summary.correlations],
    }


def _controller(controller: ControllerSummary) -> dict[str, Any]:
    return {**asdict(controller), "kept": controller.kept, "exploited": controller.exploited}


def _forecast(report: Report) -> dict[str, Any]:
    achieved = {one.name: one.achieved for one in (report.transfer.controllers if report.transfer else ())}
    return {
        "rule": asdict(RULE),
        "controllers": [
            {
                **asdict(one),
                "achieved": None if (real := achieved.get(one.controller)) is None else real.value,
                "held": None if real is None else one.holds(real),
            }
            for one in report.forecasts.values()
        ],
        "models": [{**asdict(one), "kept": one.kept} for one in report.model_forecasts.values()],
    }


def _exploitability(model: ModelExploitability) -> dict[str, Any]:
    found = {**asdict(model), "on_each": dict(model.on_each)}
    return {**found, "exploited": model.exploited, "sentence": model.sentence}


def plain(value: Any) -> Any:
    """Return ``value`` made of dicts, lists, strings, finite numbers, booleans and None alone."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    return str(value)
