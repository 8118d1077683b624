"""What a report cannot show, and why: a sentence for each."""

from __future__ import annotations

from evaluation.report.contents import Report
from evaluation.report.replay import Replay

NO_ROBOT = (
    "Nothing was run on a robot, so what is achieved there is not known: the other models stand for it. Name one with "
    "--robot, or drive and run the report again."
)


def without_controllers(report: Report) -> str:
    """Say why there is no controller."""
    only = report.settings.get("only")
    if only:
        return f"No controller was evolved, since only {only!r} was asked for: transfer is not known."
    return "No controller was evolved, so transfer is not known."


def of_prediction(report: Report) -> list[str]:
    """Say what is not known of prediction errors."""
    prediction = report.prediction
    if prediction is None:
        return ["No prediction error was computed, so it is not known which models predict."]
    found = []
    if not prediction.cases.horizons:
        found.append("No horizon fits into the test set: there is no error over the horizon. Record longer episodes.")
    if not prediction.cases.free_runs:
        found.append("No episode of the test set is long enough for a free run.")
    if not any(model.coverage for model in prediction.models):
        found.append("No model gives a spread, so no interval can be checked; some families do with stochastic=true.")
    return found


def of_transfer(report: Report) -> list[str]:
    """Say what is not known of controllers."""
    matrix = report.matrix
    if matrix is None or report.transfer is None:
        return [without_controllers(report)]
    if matrix.robot is None:
        return [NO_ROBOT]
    if all(matrix.cell(row, matrix.robot).failed for row in matrix.rows):
        return [f"No controller could be run on {matrix.robot}: what is achieved there is not known."]
    return []


def of_replay(report: Report, shown: Replay | None) -> list[str]:
    """Say what cannot be watched."""
    if shown is None:
        return ["Nothing can be replayed: no trial of any controller was kept (traces in experiment.toml)."]
    found = []
    if report.matrix is not None and report.matrix.robot is None:
        found.append("There is no robot beside the models, and so no moment where they part.")
    if not shown.paths:
        found.append("There is no path to watch, since nothing moves on a plane here: states are shown over time.")
    return found


def of_exploitability(report: Report) -> list[str]:
    """Say what is not known of exploits."""
    found = report.exploitability
    if not found:
        return ["No model was assessed: without controllers and their kept trials there is nothing that exploits one."]
    absent = []
    if report.data.system.motion is None:
        absent.append("Probes of driving (turning, sliding, coasting) need a body on a plane; others remain.")
    if not any(model.probes for model in found):
        absent.append("No probe found a limit in the training data.")
    if all(model.achieved is None for model in found):
        absent.append("The gap is taken to the other models, since nothing was run on a robot.")
    return absent
