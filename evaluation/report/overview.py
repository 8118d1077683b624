"""The short table of a report: how well each model predicts, and what its controllers are worth."""

from __future__ import annotations

import shlex
from pathlib import Path

from evaluation.prediction import Prediction
from evaluation.report.contents import Report
from evaluation.report.predicting import N_IN_WORDS, horizon_name, main_horizon
from evaluation.report.sheets import Sheet, lines, number, of_each_run, plus_minus, three_digits
from evaluation.transfer import ControllerSummary

EXPLOITED = {True: "yes", False: "no", None: "–"}


def overview_sheet(report: Report) -> Sheet | None:
    """One row for each model and each controller; None if there is neither.

    A controller shares the row of the one model that it was evolved against, if both have the same name.
    """
    prediction, controllers = report.prediction, _controllers(report)
    names = [] if prediction is None else list(prediction.names)
    names += [name for name in controllers if name not in names]
    if not names:
        return None
    with_robot = report.matrix is not None and report.matrix.robot is not None
    heads: list[str] = ["model" if not controllers else "model or\ncontroller"]
    if prediction is not None:
        heads.append(f"N, {_where(prediction)}")
    if controllers:
        heads += ["claimed", "on the\nrobot" if with_robot else "on other\nmodels", "exploited"]
    rows = []
    for name in names:
        row = [name]
        if prediction is not None:
            row.append(_n(prediction, name))
        if controllers:
            row += _controller_cells(controllers.get(name))
        rows.append(tuple(row))
    notes = []
    if prediction is not None:
        notes.append(f"N: {N_IN_WORDS} (0 is perfect).")
    if controllers:
        notes += _claims_note(report, list(controllers.values()))
    return Sheet("In short", tuple(heads), tuple(rows), note=" ".join(notes))


def drive_command(report: Report, controller: str, *, folder: str | Path = "") -> str | None:
    """Return the command that runs a controller on the robot, None where its file is not known.

    Nor is there one for the recordings of a system without a motion: only an emulated robot or an environment can be
    driven without a tracker. ``folder`` is the run folder as seen from where the command is typed.
    """
    path, robot = report.controllers.get(controller), report.settings.get("robot")
    if path is None or (report.data.system.motion is None and not robot):
        return None
    plugins = [word for plugin in report.settings.get("plugins", ()) for word in ("--plugin", str(plugin))]
    command = ["sysid-evo", "drive", "--controller", (Path(folder) / path).as_posix(), "--robot", str(robot or "ROBOT")]
    return shlex.join([*command, *plugins])


def command_sheet(report: Report) -> Sheet | None:
    """The command that runs each controller on the robot; None if no file is known."""
    rows = [(name, command) for name in report.controllers if (command := drive_command(report, name)) is not None]
    if not rows:
        return None
    note = "" if report.settings.get("robot") else "ROBOT: the name of a robot, NAME:SEED, or the TOML file of one."
    return Sheet(
        "Run a controller, in the folder of this report", ("controller", "command"), tuple(rows), note, code=True
    )


def _controllers(report: Report) -> dict[str, ControllerSummary]:
    """Return the controllers by the name of their row."""
    if report.transfer is None:
        return {}
    models = () if report.prediction is None else report.prediction.names
    named = {}
    for controller in report.transfer.controllers:
        shared = controller.name not in models or controller.against == (controller.name,)
        named[controller.name if shared else f"{controller.name} (controller)"] = controller
    return named


def _where(prediction: Prediction) -> str:
    name = horizon_name(prediction, main_horizon(prediction))
    return name.replace(" (", "\n(")


def _n(prediction: Prediction, name: str) -> str:
    if name not in prediction.names:
        return "–"
    model = prediction.model(name)
    score = model.score(main_horizon(prediction))
    if model.failed:
        return "failed"
    return "–" if score is None else three_digits(score.n)


def _controller_cells(controller: ControllerSummary | None) -> list[str]:
    if controller is None:
        return ["–"] * 3
    return [
        lines(plus_minus(controller.claimed), of_each_run(controller)),
        plus_minus(controller.elsewhere),
        EXPLOITED[controller.exploited],
    ]


def _claims_note(report: Report, controllers: list[ControllerSummary]) -> list[str]:
    assert report.matrix is not None
    unit = f", in {report.matrix.unit}" if report.matrix.unit else ""
    notes = [f"Claimed: fitness where it was evolved, ± standard error{unit}."]
    runs = {len(c.seed_fitness) for c in controllers if c.claimed is not None}
    if any(count > 1 for count in runs):
        notes.append(f"Below it: the champion of each of {number(max(runs), 0)} evolution runs.")
    return [*notes, "Exploited: the claim exceeds the fitness elsewhere by a tenth and two standard errors."]
