"""The answers that a report begins with, in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.prediction import PERSISTENCE, ModelPrediction, Prediction
from evaluation.report.contents import Report
from evaluation.report.sheets import percent
from evaluation.transfer import ControllerSummary, TransferMatrix, TransferSummary

SECOND = 1.0


@dataclass(frozen=True)
class Finding:
    """One question and its answers."""

    question: str
    answers: tuple[str, ...]


def verdict(report: Report) -> tuple[Finding, ...]:
    """Answer which models predict, which controllers transfer, and what to use."""
    findings = []
    if report.prediction is not None:
        findings.append(Finding("Which models predict?", _predicting(report.prediction)))
    if report.matrix is not None and report.transfer is not None:
        findings.append(Finding("Which controllers transfer?", _transferring(report.matrix, report.transfer)))
        findings.append(Finding("What to use?", _recommended(report.matrix, report.transfer)))
    if report.all_failures:
        count = len(report.all_failures)
        findings.append(
            Finding("What failed?", (f"{count} {'part' if count == 1 else 'parts'}; the reasons are listed below.",))
        )
    return tuple(findings)


def main_horizon(prediction: Prediction) -> int | None:
    """Return the longest scored horizon of at most one second, in steps; None (free run) without any."""
    horizons = prediction.cases.horizons
    near = [h for h in horizons if h * prediction.cases.system.dt <= SECOND + 1e-9]
    return max(near) if near else min(horizons, default=None)


def horizon_name(prediction: Prediction, horizon: int | None) -> str:
    """Return ``20 steps (1 s)``, or ``free run`` over whole episodes."""
    if horizon is None:
        return "free run"
    seconds = horizon * prediction.cases.system.dt
    return f"{horizon} {'step' if horizon == 1 else 'steps'} ({seconds:g} s)"


def _predicting(prediction: Prediction) -> tuple[str, ...]:
    horizon = main_horizon(prediction)
    where = horizon_name(prediction, horizon)
    ranking = prediction.ranking(horizon)
    still = prediction.model(PERSISTENCE).score(horizon)
    models = [model for model in ranking if model.name != PERSISTENCE]
    if not models:
        return ("No model could be scored.",)
    best = models[0]
    score = best.score(horizon)
    assert score is not None
    answers = [
        f"At {where}, {best.name} is best: N {score.n:.3f} "
        f"({score.interval.low:.3f} to {score.interval.high:.3f})" + (f"; persistence {still.n:.3f}." if still else ".")
    ]
    equal = [m.name for m in models[1:] if _no_worse(prediction, m, best, horizon)]
    if equal:
        answers.append(f"No significant difference from it: {_listed(equal)}.")
    beaten = [m.name for m in models if not _beats_persistence(prediction, m, horizon)]
    if beaten:
        answers.append(f"Not significantly better than persistence: {_listed(beaten)}.")
    free = [model for model in prediction.ranking(None) if model.name != PERSISTENCE]
    if free and horizon is not None:
        best_free = free[0].score(None)
        assert best_free is not None
        answers.append(f"In free run over whole episodes, {free[0].name} is best: N {best_free.n:.3f}.")
    diverging = [
        f"{m.name} ({percent(m.divergence.share)} of windows)"
        for m in models
        if m.divergence is not None and m.divergence.share > 0
    ]
    if diverging:
        answers.append(f"Simulations reach their clip: {_listed(diverging)}.")
    return tuple(answers)


def _transferring(matrix: TransferMatrix, summary: TransferSummary) -> tuple[str, ...]:
    unit = f" {matrix.unit}" if matrix.unit else ""
    if matrix.robot is not None:
        tested = sorted(
            (c for c in summary.controllers if c.achieved is not None),
            key=lambda c: -(c.achieved.value if c.achieved else 0.0),
        )
        if not tested:
            return ("No controller could be run on the robot.",)
        answers = [f"Most on the robot: {_on_robot(tested[0])}{unit}."]
        holding = [c.name for c in tested if not c.on_robot and c.kept is not None and c.kept >= 0.9]
        failing = [
            f"{c.name} ({percent(c.kept)})" for c in tested if not c.on_robot and c.kept is not None and c.kept < 0.5
        ]
        answers.append(
            f"At least nine tenths of their claim is kept on the robot by {_listed(holding)}."
            if holding
            else "No controller keeps nine tenths of its claim on the robot."
        )
        if failing:
            answers.append(f"Less than half of it: {_listed(failing)}.")
        return tuple(answers)
    pairs = [(c, c.claimed.value, c.others.value) for c in summary.controllers if c.claimed and c.others]
    if not pairs:
        return ("There is no robot and no other model to transfer to.",)
    holding = [c.name for c, claimed, others in pairs if others >= 0.9 * claimed]
    falling = [f"{c.name} ({claimed:.1f} to {others:.1f})" for c, claimed, others in pairs if others < 0.5 * claimed]
    keeping = f"{_listed(holding)} keep" if holding else "no controller keeps"
    answers = [
        "Nothing was run on the robot. On the other models (mean fitness), "
        f"{keeping} at least nine tenths of the claim."
    ]
    if falling:
        answers.append(f"Less than half of it, in mean fitness{unit and f' ({matrix.unit})'}: {_listed(falling)}.")
    return tuple(answers)


def _recommended(matrix: TransferMatrix, summary: TransferSummary) -> tuple[str, ...]:
    answers = []
    if summary.pick is None:
        answers.append("No controller can be judged by models of other families; add a family to choose by.")
    else:
        pick = summary.controller(summary.pick)
        assert pick.other_families is not None
        judges = f"{len(pick.judges)} {'model' if len(pick.judges) == 1 else 'models'}"
        answers.append(
            f"Chosen without the robot: {pick.name}, the highest median on models of other families "
            f"({pick.other_families.value:.1f} on {judges})"
            + (f"; it achieves {pick.achieved.value:.1f} on the robot." if pick.achieved is not None else ".")
        )
    if matrix.robot is not None:
        best = summary.best_on.get(matrix.robot)
        if best is not None and best != summary.pick:
            answers.append(f"Chosen with the robot: {best}, {matrix.cell(best, matrix.robot).mean:.1f} on it.")
        answers += [
            f"Rank correlation of {correlation.figure} with achieved: {correlation.value:+.2f} "
            f"({correlation.controllers} controllers)."
            for correlation in summary.correlations
            if correlation.value is not None
        ]
    return tuple(answers)


def _no_worse(prediction: Prediction, model: ModelPrediction, best: ModelPrediction, horizon: int | None) -> bool:
    difference = prediction.compare(model.name, best.name, horizon)
    return difference is not None and not difference.significant


def _beats_persistence(prediction: Prediction, model: ModelPrediction, horizon: int | None) -> bool:
    difference = prediction.compare(model.name, PERSISTENCE, horizon)
    return difference is not None and difference.significant and difference.difference < 0


def _on_robot(controller: ControllerSummary) -> str:
    assert controller.achieved is not None
    error = controller.achieved.standard_error
    spread = f" ± {2 * error:.1f} (two standard errors)" if np.isfinite(error) and error > 0 else ""
    return f"{controller.name}, {controller.achieved.value:.1f}{spread}"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)
