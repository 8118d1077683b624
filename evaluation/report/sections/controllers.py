"""What is expected of controllers, what they claim and what they achieve; which one to use."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.formatting import (
    by_error,
    few,
    folded,
    horizon_name,
    lines,
    listed,
    number,
    percent,
    plus_minus,
    three_digits,
    value_of,
    with_interval,
    within,
)
from evaluation.plots import plot_claims
from evaluation.prediction.scores import Prediction
from evaluation.report.elements import (
    NARROW,
    WIDE,
    Drawing,
    DrawingPair,
    FigureElement,
    Headline,
    Section,
    TableElement,
    Tone,
    present,
)
from evaluation.report.sections.prediction import N_IN_WORDS
from evaluation.results import ComparisonResults
from evaluation.sufficiency import beats_rest, gain_over_rest, guess_warning, guessed_share, none_beats_rest
from evaluation.transfer.forecast import FORECAST_RULE, Forecast, ModelForecast
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.summary import ControllerSummary, TransferSummary
from sysid_evo.validation.estimates import CONFIDENCE, Estimate


def section(report: ComparisonResults) -> Section | None:
    """Return the forecasts of controllers and models; None where no controller has one."""
    items = present(forecast_sheet(report), model_weight_table(report))
    return Section("Forecast", items) if items else None


EXPLAINED = (
    "forecast: expected on the robot, the median of all models; a model weighs as the inverse square of its prediction "
    "error, half as much in a family that the controller was evolved in. Nothing measured on the robot is in it but "
    "the recordings. In brackets: the 90 % interval, calibrated on emulated cars."
)


def forecast_sheet(report: ComparisonResults) -> TableElement | None:
    """What is expected of every controller on the robot, beside what was claimed and achieved; None for nobody."""
    if report.transfer is None or report.matrix is None or not report.forecasts:
        return None
    with_robot = report.matrix.robot is not None
    known = [one for one in report.transfer.controllers if one.name in report.forecasts]
    known.sort(key=lambda one: -report.forecasts[one.name].value)
    rows = []
    for one in known:
        found = report.forecasts[one.name]
        name = lines(one.name, "(chosen)" if one.name == report.transfer.pick else "")
        row = [name, plus_minus(one.claimed), forecast_text(found)]
        if with_robot:
            inside = "–" if one.achieved is None else ("yes" if found.covers(one.achieved) else "no")
            row += [plus_minus(one.achieved), inside]
        rows.append(tuple(row))
    heads = ("controller", "claimed", "forecast", *(("on the\nrobot", "in the\ninterval") if with_robot else ()))
    judged = [report.forecasts[one.name].covers(one.achieved) for one in known if one.achieved is not None]
    held = f" {sum(judged)} of {len(judged)} were inside." if judged else ""
    guesses = [
        f"{one.name} ({percent(share)})"
        for one in known
        if (share := guessed_share(report.exploitability, one.name)) is not None
    ]
    held += f" Guesses, as so much of its time lies outside the data: {few(guesses)}." if guesses else ""
    return TableElement(
        title=f"Forecast for the robot ({report.matrix.unit or 'fitness'})",
        columns=heads,
        rows=tuple(rows),
        note=f"{EXPLAINED}{held}",
    )


def forecast_text(found: Forecast | ModelForecast) -> str:
    """Return a forecast with its interval."""
    return with_interval(found.value, found.low, found.high)


def model_weight_table(report: ComparisonResults) -> TableElement | None:
    """What is expected of the controllers evolved in each model; None where no model has any."""
    if not report.model_forecasts:
        return None
    rows = []
    for name, found in report.model_forecasts.items():
        kept = found.kept
        share = "–" if kept is None else f"{percent(kept[0])} ({percent(kept[1])} to {percent(kept[2])})"
        weight = report.forecasts[found.controllers[0]].weights.get(name)
        rows.append(
            (
                lines(name, "" if found.controllers == (name,) else f"({listed(found.controllers)})"),
                three_digits(found.claimed),
                forecast_text(found),
                share,
                "–" if weight is None else percent(weight),
            )
        )
    return TableElement(
        title="Forecast for models: what becomes of a claim made in them",
        columns=("model", "claimed", "forecast", "share of\nthe claim", "own\nweight"),
        rows=tuple(rows),
        note="Means over the controllers evolved in each model alone. own weight: how much it counts in that.",
    )


def overview_sheet(report: ComparisonResults) -> TableElement | None:
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
        main = horizon_name(prediction.cases.main_horizon, prediction.cases.system.dt)
        heads.append("N, " + main.replace(" (", "\n("))
    if controllers:
        heads += ["claimed", "on the\nrobot" if with_robot else "on other\nmodels", "exploited"]
    rows = []
    for name in names:
        row = [name]
        if prediction is not None:
            row.append(_n(prediction, name))
        if controllers:
            found = controllers.get(name)
            row += (
                ["–"] * 3
                if found is None
                else [
                    lines(plus_minus(found.claimed), of_each_run(found)),
                    plus_minus(found.elsewhere),
                    EXPLOITED[found.exploited],
                ]
            )
        rows.append(tuple(row))
    notes = []
    if prediction is not None:
        notes.append(f"N: {N_IN_WORDS} (0 is perfect).")
    if controllers:
        notes += _claims_note(report, list(controllers.values()))
    return TableElement("In short", tuple(heads), tuple(rows), note=" ".join(notes))


def _controllers(report: ComparisonResults) -> dict[str, ControllerSummary]:
    """Return the controllers by the name of their row."""
    if report.transfer is None:
        return {}
    models = () if report.prediction is None else report.prediction.names
    named = {}
    for controller in report.transfer.controllers:
        shared = controller.name not in models or controller.against == (controller.name,)
        named[controller.name if shared else f"{controller.name} (controller)"] = controller
    return named


def _n(prediction: Prediction, name: str) -> str:
    if name not in prediction.names:
        return "–"
    model = prediction.model(name)
    score = model.score(prediction.cases.main_horizon)
    return "failed" if model.failed else three_digits(None if score is None else score.n)


EXPLOITED = {True: "yes", False: "no", None: "–"}


def _claims_note(report: ComparisonResults, controllers: list[ControllerSummary]) -> list[str]:
    assert report.matrix is not None
    unit = f", in {report.matrix.unit}" if report.matrix.unit else ""
    notes = [f"Claimed: fitness where it was evolved, ± standard error{unit}."]
    runs = {len(c.seed_fitness) for c in controllers if c.claimed is not None}
    if any(count > 1 for count in runs):
        notes.append(f"Below it: the champion of each of {number(max(runs), 0)} evolution runs.")
    return [*notes, "Exploited: the claim exceeds the fitness elsewhere by a tenth, and surely."]


def claims_picture(matrix: TransferMatrix, summary: TransferSummary) -> FigureElement:
    """Claimed and achieved fitness of each controller."""

    def drawing(key: str, width: float, name_width: int) -> Drawing:
        rows = max(folded(controller.name, name_width).count("\n") + 1 for controller in summary.controllers)
        return Drawing(
            key,
            "claimed and achieved fitness of each controller",
            lambda figure: plot_claims(summary, figure.add_subplot(), unit=matrix.unit, name_width=name_width),
            width,
            1.4 + (0.2 + 0.1 * rows) * len(summary.controllers),
            keyed=True,
        )

    several = any(len(controller.seed_fitness) > 1 for controller in summary.controllers)
    ticks = " Ticks: the champion of each evolution run." if several else ""
    return FigureElement(
        "Claimed and achieved",
        f"Bars are {percent(CONFIDENCE)} intervals over trials, those of the table below.{ticks}",
        (DrawingPair(drawing("claims", WIDE, 26), drawing("claims-narrow", NARROW, 13)),),
    )


def standing_sheet(matrix: TransferMatrix, summary: TransferSummary) -> TableElement:
    """Claimed, achieved, worst case and regret of each controller, with intervals."""
    robot = matrix.robot is not None
    return TableElement(
        title=f"Claimed, achieved, worst case, regret ({matrix.unit or 'fitness'}, {percent(CONFIDENCE)} intervals)",
        columns=(
            "controller",
            "claimed",
            "achieved" if robot else "on other\nmodels",
            "kept\n%",
            "worst\ncase",
            "regret",
        ),
        rows=tuple(
            (
                lines(one.name, "(chosen)" if one.name == summary.pick else ""),
                within(one.claimed),
                within(one.achieved if robot else one.other_models),
                _share(one.kept),
                lines(within(one.worst), folded(one.worst_on, 12)),
                within(one.regret),
            )
            for one in summary.controllers
        ),
        note=(
            f"kept: share of the claim that is achieved{'' if robot else ' on the other models'}, ± standard error. "
            "worst case: the system where it is lowest, of those that it was not evolved against. "
            "regret: what the best other controller "
            + ("achieves more on the robot. " if robot else "has more, on the other model where that is most. ")
            + "Intervals are over fresh trials of this one controller, not over evolution seeds."
        ),
    )


def _share(kept: Estimate | None) -> str:
    """Return ``75 ±3``, a share in per cent and its standard error; the first alone without the second."""
    if kept is None:
        return "–"
    error = f" ±{100 * kept.standard_error:.0f}" if np.isfinite(kept.standard_error) else ""
    return f"{100 * kept.value:.0f}{error}"


def controller_sheet(matrix: TransferMatrix, summary: TransferSummary) -> TableElement:
    """Claimed and achieved fitness, and the gaps between them."""
    robot: tuple[str, ...] = ("on the\nrobot", "reality\ngap") if matrix.robot is not None else ()
    rows = [
        (
            lines(controller.name, "(chosen)" if controller.name == summary.pick else ""),
            lines(plus_minus(controller.claimed), of_each_run(controller)),
            plus_minus(controller.other_models),
            plus_minus(controller.exploitation_gap),
            plus_minus(controller.other_families),
            *((plus_minus(controller.achieved), plus_minus(controller.reality_gap)) if robot else ()),
        )
        for controller in summary.controllers
    ]
    runs = [len(controller.seed_fitness) for controller in summary.controllers if controller.claimed is not None]
    each = f"below a claim: the champion of each of {max(runs)} evolution runs. " if max(runs, default=0) > 1 else ""
    unknown = f" {said}" if (said := seeds_unknown(summary)) else ""
    return TableElement(
        title=f"Claimed and achieved ({matrix.unit or 'fitness'}, ± standard error)",
        columns=("controller", "claimed", "other\nmodels", "exploit.\ngap", "other\nfamilies", *robot),
        rows=tuple(rows),
        note=(
            f"claimed: on the models it was evolved against, joined as in its evolution, in fresh trials. {each}"
            "other families: median over the models of families it was not evolved against. "
            "Gap: claimed minus achieved; exploitation on the other models, reality on the robot. "
            f"chosen: without the robot, by its forecast.{unknown}"
        ),
    )


def of_each_run(controller: ControllerSummary) -> str:
    """Return the fitness of the champion of each evolution run, three a line; empty for fewer than two runs."""
    error = np.nan if controller.claimed is None else controller.claimed.standard_error
    found = [by_error(fitness, error) for fitness in controller.seed_fitness]
    return "\n".join(", ".join(found[i : i + 3]) for i in range(0, len(found), 3)) if len(found) > 1 else ""


def drive_command(report: ComparisonResults, controller: str, *, folder: str | Path = "") -> str | None:
    """Return the command that runs a controller on the robot, None where its file is not known.

    Nor is there one for the recordings of a system without a motion: only an emulated robot or an environment can be
    driven without a tracker. ``folder`` is the run folder as seen from where the command is typed.
    """
    path, robot = report.controllers.get(controller), report.settings.get("robot")
    if path is None or (report.data.system.motion is None and not robot):
        return None
    return _command(report, "drive", "--controller", (Path(folder) / path).as_posix(), "--robot", str(robot or "ROBOT"))


def export_command(report: ComparisonResults, controller: str, *, folder: str | Path = "") -> str | None:
    """Return the command that makes C of a controller, None where its file is not known; ``folder`` as above."""
    path = report.controllers.get(controller)
    return None if path is None else _command(report, "export", (Path(folder) / path).as_posix(), "--to", "c")


def use_command(report: ComparisonResults, controller: str, *, folder: str | Path = "") -> str | None:
    """Return what to do with a controller first: drive the robot, export it where there is none.

    With one that is no better than controls at rest there is nothing to do.
    """
    if report.matrix is not None and beats_rest(report.matrix, controller) is False:
        return None
    use = drive_command if report.settings.get("robot") else export_command
    return use(report, controller, folder=folder)


def _command(report: ComparisonResults, *words: str) -> str:
    plugins = [word for plugin in report.settings.get("plugins", ()) for word in ("--plugin", str(plugin))]
    return shlex.join(["sysid-evo", *words, *plugins])


def command_sheet(report: ComparisonResults) -> TableElement | None:
    """The command that runs each controller on the robot, after the exports without one; None if no file is known."""
    robot, names = report.settings.get("robot"), report.controllers
    commands = [] if robot else [(name, export_command(report, name)) for name in names]
    commands += [(name, drive_command(report, name)) for name in names]
    rows = tuple((name, command) for name, command in commands if command is not None)
    if not rows:
        return None
    driven = any("ROBOT" in command for _, command in rows)
    note = "ROBOT: the name of a robot, NAME:SEED, or the TOML file of one." if driven else ""
    return TableElement(
        "Use a controller, in the folder of this report", ("controller", "command"), rows, note, code=True
    )


def headline(report: ComparisonResults) -> Headline:
    """Say at first sight which controller to take."""
    question, summary = "Which controller to take?", report.transfer
    if summary is None:
        return Headline(question, "None", "No controller was evolved.", "open")
    assert report.matrix is not None
    if none_beats_rest(report.matrix):
        return Headline(question, "None", LOOK_AT_THE_REWARD, "bad")
    if summary.pick is None:
        return Headline(question, "Not known", "No controller can be judged by models of other families.", "open")
    pick = summary.controller(summary.pick)
    command = use_command(report, pick.name) or ""
    unit = f" {report.matrix.unit}" if report.matrix.unit else ""
    claim = "" if pick.claimed is None else f"Claims {sized(pick.claimed)}{unit}"
    found = report.forecasts.get(pick.name)
    claim += "" if found is None else f", forecast {forecast_text(found)}"
    if pick.achieved is not None:
        worth = f"{claim}, achieves {sized(pick.achieved)} on the robot.{_better(pick, report)}"
    elif pick.other_models is not None:
        worth = f"{claim}, reaches {sized(pick.other_models)} on the other models. Nothing was run on the robot."
    else:
        worth = f"{claim}. Nothing was run on the robot."
    idle, guess = _idle(report.matrix, pick.name), guess_warning(report.exploitability, pick.name)
    said = " ".join(filter(None, (idle, worth, guess)))
    kept = pick.achieved is not None and found is not None and found.covers(pick.achieved)
    tone: Tone = "bad" if pick.exploited or idle else "open" if guess and not kept else "good"
    return Headline(question, pick.name, said, tone, command)


LOOK_AT_THE_REWARD = "No controller does better than controls at rest: look at the reward, or evolve longer."


def _idle(matrix: TransferMatrix, name: str) -> str:
    """Say that a controller is no better than controls at rest; empty where it is, or that is not known."""
    gain = gain_over_rest(matrix, name)
    if gain is None or beats_rest(matrix, name) is not False:
        return ""
    worse = "worse" if gain.high < 0.0 else "no better"
    return f"{name} is {worse} than controls at rest (difference {plus_minus(gain)}): do not use it."


def _better(pick: ControllerSummary, report: ComparisonResults) -> str:
    """Say which controller from models does clearly better on the robot than the one that was chosen without it."""
    assert report.transfer is not None
    others = [c for c in report.transfer.controllers if c.against and not c.evolved_on_robot and c.name != pick.name]
    reached = [(c.achieved, c.name) for c in others if c.achieved is not None]
    best = max(reached, key=lambda one: one[0].value, default=None)
    if best is None or pick.achieved is None or not best[0].low > pick.achieved.high:
        return ""
    return f" {best[1]} does better there: {sized(best[0])}."


KEPT = 0.9
"""A claim is kept from this share of it on."""
LOST = 0.5
"""A claim is lost below this share of it."""


def transfer_sentences(matrix: TransferMatrix, summary: TransferSummary | None) -> tuple[str, ...]:
    """Answer which controllers transfer."""
    if summary is None:
        return ("No controller was evolved.",)
    if all(cell.failed for cell in matrix.cells.values()):
        return ("No controller could be run anywhere.",)
    unit = f" {matrix.unit}" if matrix.unit else ""
    return _on_models(summary, unit) if matrix.robot is None else _on_robot(summary, unit)


def _on_robot(summary: TransferSummary, unit: str) -> tuple[str, ...]:
    tested = sorted(
        (c for c in summary.controllers if c.achieved is not None),
        key=lambda c: -(c.achieved.value if c.achieved else 0.0),
    )
    if not tested:
        return ("No controller could be run on the robot.",)
    moved = [c for c in tested if not c.evolved_on_robot]
    answers = [f"Most on the robot: {_achieved(moved[0], unit)}."] if moved else []
    reference = next((c for c in tested if c.evolved_on_robot), None)
    if reference is not None:
        answers.append(
            f"One search on the robot itself, no longer than one in a model, reaches {_achieved(reference, unit)}."
        )
        pick = next((c for c in tested if c.name == summary.pick), None)
        assert reference.achieved is not None
        share = None if pick is None else pick.share_of(reference.achieved.value)
        if pick is not None and share is not None:  # one search is no upper limit: 107 % would mislead
            told = f"{percent(share)} of that" if share <= 1.0 else "more than that search, which is no upper limit"
            answers.append(f"{pick.name} achieves {told}.")
    shares = [(c.name, c.kept.value) for c in tested if not c.evolved_on_robot and c.kept is not None]
    if shares:
        holding = [name for name, kept in shares if kept >= KEPT]
        answers.append(
            f"At least nine tenths of their claim is kept on the robot by {few(holding, 8)}."
            if holding
            else "No controller keeps nine tenths of its claim on the robot."
        )
        failing = [f"{name} ({percent(kept)})" for name, kept in shares if kept < LOST]
        if failing:
            answers.append(f"Less than half of it: {', '.join(failing)}.")
    floor = tested[0].rest_fitness
    if floor is not None:
        answers.append(f"Shares are measured from controls at rest: {three_digits(floor)}{unit}.")
    return tuple(answers)


def _on_models(summary: TransferSummary, unit: str) -> tuple[str, ...]:
    pairs = [(c.name, c.claimed, c.other_models) for c in summary.controllers if c.claimed and c.other_models]
    if not pairs:
        return ("There is no robot and no other model to transfer to.",)
    holding = [name for name, claimed, others in pairs if others.value >= KEPT * claimed.value]
    falling = [
        f"{name} ({value_of(claimed)} to {value_of(others)})"
        for name, claimed, others in pairs
        if others.value < LOST * claimed.value
    ]
    keeping = f"{', '.join(holding)} keep" if holding else "no controller keeps"
    answers = [
        "Nothing was run on the robot. On the other models (mean fitness), "
        f"{keeping} at least nine tenths of the claim."
    ]
    if falling:
        answers.append(f"Less than half of it, in mean fitness{unit and f' ({unit.strip()})'}: {', '.join(falling)}.")
    return tuple(answers)


def _achieved(controller: ControllerSummary, unit: str) -> str:
    assert controller.achieved is not None
    return f"{controller.name}, {sized(controller.achieved)}{unit}"


def sized(estimate: Estimate) -> str:
    """Return a value with its interval, alone where it has none."""
    return with_interval(estimate.value, estimate.low, estimate.high)


def choice_sentences(report: ComparisonResults) -> tuple[str, ...]:
    """Answer what to use: first that it is of no use where it is not, then by what it was chosen."""
    matrix, summary = report.matrix, report.transfer
    assert matrix is not None
    assert summary is not None
    why = choice_reason(report) or "No controller can be judged by models of other families; add a family to choose by."
    pick = summary.pick
    warnings = [] if pick is None else [_idle(matrix, pick), guess_warning(report.exploitability, pick)]
    answers = list(filter(None, (*warnings[:1], why, *warnings[1:])))
    if matrix.robot is not None:
        tested = [c for c in summary.controllers if c.achieved is not None and c.against and not c.evolved_on_robot]
        best = max(tested, key=lambda c: c.achieved.value if c.achieved else -np.inf, default=None)
        if best is not None and best.achieved is not None and best.name != summary.pick:
            answers.append(f"Chosen with the robot: {best.name}, {value_of(best.achieved)} on it.")
        answers += [
            f"Rank correlation of {correlation.figure} with achieved: {correlation.value:+z.2f} "
            f"({correlation.controllers} controllers)."
            for correlation in summary.correlations
            if correlation.value is not None
        ]
    return tuple(answers)


def choice_reason(report: ComparisonResults) -> str | None:
    """Say by what the controller to drive was chosen, and what was achieved; None where no forecast chose it."""
    summary = report.transfer
    found = None if summary is None or summary.pick is None else report.forecasts.get(summary.pick)
    if summary is None or found is None:
        return None
    unit = f" {report.matrix.unit}" if report.matrix is not None and report.matrix.unit else ""
    picked = summary.controller(found.controller)
    count = sum(one.name in report.forecasts and bool(one.against) for one in summary.controllers)
    rivals = f"the highest of {count} forecasts" if count > 1 else "the only one with a forecast"
    said = f"Chosen without the robot: {found.controller}, {rivals}: {forecast_text(found)}{unit} are expected of it"
    if picked.achieved is None:
        return f"{said}."
    inside = "as forecast" if found.covers(picked.achieved) else "outside the interval"
    return f"{said}; it achieves {value_of(picked.achieved)} on the robot, {inside}."


ONE_SEED = "One evolution seed: how far a claim varies from seed to seed is unknown."
POLISHED = (
    "{} was polished once, from the best of all searches and seeds together: how far another polish would end from it "
    "is unknown."
)


def open_questions(summary: TransferSummary) -> tuple[str, ...]:
    """Say what the claims leave open."""
    claiming = [c for c in summary.controllers if c.claimed is not None]
    answers = [said] if (said := seeds_unknown(summary)) else []
    single = [c.name for c in claiming if c.achieved is not None and not np.isfinite(c.achieved.standard_error)]
    if single:
        answers.append(f"A single trial on the robot has no error and judges no claim: {', '.join(single)}.")
    return tuple(answers)


def seeds_unknown(summary: TransferSummary) -> str:
    """Say of which controllers it is not known how far evolution seeds differ, and why; empty if it is of all."""
    single = [c for c in summary.controllers if c.claimed is not None and len(c.seed_fitness) < 2]
    if any(not c.polished for c in single):
        return ONE_SEED
    return POLISHED.format(", ".join(c.name for c in single)) if single else ""


def summary_to_json(summary: TransferSummary) -> dict[str, Any]:
    """Return what the document holds under ``controllers``."""
    return {
        "controllers": [{**asdict(c), "exploited": c.exploited} for c in summary.controllers],
        "pick": summary.pick,
        "best_on": summary.best_on,
        "correlations": [asdict(correlation) for correlation in summary.correlations],
    }


def forecast_to_json(report: ComparisonResults) -> dict[str, Any]:
    """Return what the document holds under ``forecast``."""
    achieved = {one.name: one.achieved for one in (report.transfer.controllers if report.transfer else ())}
    return {
        "rule": asdict(FORECAST_RULE),
        "controllers": [
            {
                **asdict(one),
                "achieved": None if (real := achieved.get(one.controller)) is None else real.value,
                "held": None if real is None else one.covers(real),
            }
            for one in report.forecasts.values()
        ],
        "models": [{**asdict(one), "kept": one.kept} for one in report.model_forecasts.values()],
    }
