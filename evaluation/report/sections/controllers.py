"""Forecast, claimed and achieved fitness of controllers in one table; which controller to use."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from evaluation.formatting import (
    by_error,
    few,
    folded,
    lines,
    percent,
    plus_minus,
    three_digits,
    value_of,
    with_interval,
    within,
)
from evaluation.plots import plot_claimed_measured
from evaluation.prediction.scores import Prediction
from evaluation.report.document import EstimatePart, Number, Part
from evaluation.report.elements import (
    HALF,
    NARROW,
    Answer,
    Drawing,
    DrawingPair,
    FigureElement,
    Fold,
    Section,
    TableElement,
    Tone,
    present,
)
from evaluation.report.sections.evolution import behaviour_class_table, fewer_generations, fitness_picture
from evaluation.report.sections.transfer import further_measures_table, paper_sheet, transfer_sheet
from evaluation.results import ComparisonResults
from evaluation.rounds import SHORT_EPISODE
from evaluation.sufficiency import beats_rest, gain_over_rest, guess_warning, guessed_share, none_beats_rest
from evaluation.transfer.forecast import FORECAST_RULE, Forecast, ForecastRule, ModelForecast
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.summary import ControllerSummary, RankCorrelation, TransferSummary
from sysid_evo.validation.estimates import CONFIDENCE, Estimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def section(report: ComparisonResults) -> Section:
    """Return the table of all controllers, claims, the transfer matrix and details; without controllers, why."""
    matrix, summary = report.matrix, report.transfer
    if matrix is None or summary is None:
        return Section("Controllers", absent=_absent(report))
    search = present(fitness_picture(matrix), behaviour_class_table(matrix))
    return Section(
        "Controllers",
        present(
            fitness_table(report),
            transfer_sheet(matrix),
            further_figures_table(matrix, summary),
            model_weight_table(report),
            Fold("Search: fitness over generations, best of each behaviour class", search) if search else None,
            further_measures_table(matrix),
            paper_sheet(matrix) if report.settings.get("preset") == "paper" else None,
        ),
        absent=[*_absent(report), *fewer_generations(matrix, report.settings)],
    )


def _absent(report: ComparisonResults) -> list[str]:
    """Return what is not known of controllers, and why."""
    matrix = report.matrix
    if matrix is None or report.transfer is None:
        stage = report.settings.get("stop_after")
        why = f"this run stops after {stage}" if stage else "none was asked for"
        why = why if report.finished else "the run is not finished"
        return [f"No controller was evolved, because {why}."]
    if matrix.robot is None:
        return [
            "Nothing was run on a robot, so measured fitness is not known; the other models are used in its place. "
            "Name a robot with --robot, or drive one and run sysid-evo report again."
        ]
    if all(matrix.cell(row, matrix.robot).failed for row in matrix.rows):
        return [f"No controller could be run on {matrix.robot}, so measured fitness is not known."]
    return []


def fitness_table(report: ComparisonResults, *, short: bool = False) -> TableElement | None:
    """Return forecast, claimed and achieved fitness of every controller, the highest forecast first.

    None without controllers. The ``short`` table fits a terminal of 80 columns.
    """
    matrix, summary = report.matrix, report.transfer
    if matrix is None or summary is None or not summary.controllers:
        return None
    known = sorted(summary.controllers, key=lambda one: _rank(one, report))
    robot = matrix.robot
    columns: dict[str, list[str]] = {"controller": [_named(one, summary) for one in known]}
    if robot is not None:
        columns["on the\nrobot" if short else f"on {robot}"] = [plus_minus(one.achieved) for one in known]
    else:
        columns["other\nmodels"] = [plus_minus(one.other_models) for one in known]
    if report.forecasts:
        found = [report.forecasts.get(one.name) for one in known]
        columns["forecast\n(90 %)"] = [
            "–" if one is None else sized(one).replace(" (", "\n(") if short else sized(one) for one in found
        ]
    columns["claimed"] = [plus_minus(one.claimed) for one in known]
    if not short:
        columns["achieved\n/ claimed" if robot else "others\n/ claimed"] = [_share(one.kept) for one in known]
        if robot is not None:
            columns["other\nmodels"] = [plus_minus(one.other_models) for one in known]
        columns["lowest on"] = ["–" if one.worst is None else f"{value_of(one.worst)}, {one.worst_on}" for one in known]
        if report.prediction is not None:
            columns["N of its\nmodels"] = [_errors(one, report.prediction) for one in known]
    columns["exploited"] = [EXPLOITED[one.exploited] for one in known]
    last = len(columns) - 2
    return TableElement(
        title=f"Controllers: forecast, claimed and achieved{f' ({matrix.unit})' if matrix.unit else ''}",
        columns=tuple(columns),
        rows=tuple(zip(*columns.values(), strict=True)),
        note=_fitness_note(report, known, short=short),
        marked=frozenset((row, last) for row, one in enumerate(known) if one.exploited),
        sticky=2,
        commands=() if short else tuple(use_command(report, one.name) or "" for one in known),
    )


def _rank(one: ControllerSummary, report: ComparisonResults) -> tuple[int, float]:
    """Return the place of a controller: evolved in models by forecast, then on the robot, then baselines."""
    group = 3 if not one.against else 2 if one.evolved_on_robot else 0 if one.name in report.forecasts else 1
    value = report.forecasts[one.name].value if one.name in report.forecasts else None
    fitness = value if value is not None else one.elsewhere.value if one.elsewhere is not None else -np.inf
    return group, -fitness


def _named(one: ControllerSummary, summary: TransferSummary) -> str:
    kind = "baseline" if not one.against else "reference" if one.evolved_on_robot else ""
    return f"{one.name} (chosen)" if one.name == summary.pick else f"{one.name} ({kind})" if kind else one.name


def _errors(one: ControllerSummary, prediction: Prediction) -> str:
    """Return N of the models that a controller was evolved in, from the lowest to the highest."""
    scores = [prediction.model(name).score(prediction.cases.main_horizon) for name in one.against
              if name in prediction.names]  # fmt: skip
    found = dict.fromkeys(three_digits(n) for n in sorted(score.n for score in scores if score is not None))
    ends = list(found)
    return "–" if not ends else ends[0] if len(ends) == 1 else f"{ends[0]} to {ends[-1]}"


EXPLOITED = {True: "yes", False: "no", None: "–"}


def _fitness_note(report: ComparisonResults, known: Sequence[ControllerSummary], *, short: bool) -> str:
    assert report.matrix is not None
    assert report.transfer is not None
    notes = ["Mean ± standard error over fresh trials."]
    if report.forecasts:
        alone = "" if report.rounds is not None else ", the only figure by which a controller is chosen"
        notes.append(f"Rows are in the order of the forecast{alone}.")
    notes.append("Claimed: fitness in the models where the controller was evolved.")
    notes.append("Exploited: the claim is too high by more than a tenth and two standard errors.")
    if short:
        return " ".join(notes)
    judged = [
        report.forecasts[one.name].covers(one.achieved)
        for one in known
        if one.achieved is not None and one.name in report.forecasts
    ]
    if judged:
        notes.append(f"{sum(judged)} of {len(judged)} measured values are inside their forecast interval.")
    guesses = [
        f"{one.name} ({percent(share)})"
        for one in known
        if (share := guessed_share(report.exploitability, one.name)) is not None
    ]
    if guesses:
        notes.append(f"Forecasts that extrapolate, by time spent outside the data: {few(guesses)}.")
    if any(one.evolved_on_robot for one in known):
        notes.append("Reference: evolved on the robot itself (one search, not the best possible).")
    return " ".join([*notes, *open_questions(report.transfer)])


def model_weight_table(report: ComparisonResults) -> TableElement | None:
    """Return the forecast of claims made in each model, and its weight; None if no model has controllers."""
    if not report.model_forecasts:
        return None
    rows = []
    for name, found in report.model_forecasts.items():
        kept = found.kept
        share = "–" if kept is None else f"{percent(kept[0])} ({percent(kept[1])} to {percent(kept[2])})"
        weight = report.forecasts[found.controllers[0]].weights.get(name)
        rows.append(
            (
                lines(name, "" if found.controllers == (name,) else f"({', '.join(found.controllers)})"),
                three_digits(found.claimed),
                sized(found),
                share,
                "–" if weight is None else percent(weight),
            )
        )
    return TableElement(
        title="How the forecast weights the models",
        columns=("model", "claimed", "forecast", "forecast /\nclaimed", "own\nweight"),
        rows=tuple(rows),
        note=(
            "The forecast is the median of all models. A model counts as the inverse square of its prediction error, "
            "half as much if the controller was evolved in its family. Nothing measured on the robot is used but the "
            "recordings. Means over the controllers evolved in each model alone; own weight: of that model in it. "
            + " ".join(_correlations(report))
        ).strip(),
        details=True,
    )


def _correlations(report: ComparisonResults) -> list[str]:
    """Return how well each figure ranks the controllers, where enough of them were run on the robot."""
    summary = report.transfer
    return [
        f"Rank correlation of {correlation.figure} with achieved: {correlation.value:+z.2f} "
        f"({correlation.controllers} controllers)."
        for correlation in (() if summary is None else summary.correlations)
        if correlation.value is not None
    ]


def overview_picture(report: ComparisonResults) -> FigureElement | None:
    """Return claimed against measured fitness, a dot for each controller; None if no controller has both."""
    matrix, summary = report.matrix, report.transfer
    if matrix is None or summary is None:
        return None
    shown = [one for one in summary.controllers if one.claimed and one.elsewhere and not one.evolved_on_robot]
    if not shown:
        return None
    where = f"measured on {matrix.robot}" if matrix.robot else "mean on the other models"
    unit = f" {matrix.unit}" if matrix.unit else ""
    links = tuple(
        (one.name, f"{one.name}: claims {sized(one.claimed)}{unit}, {where} {sized(one.elsewhere)}{unit}")
        for one in shown
        if one.claimed is not None and one.elsewhere is not None
    )

    def drawing(key: str, width: float, height: float, letters: int) -> Drawing:
        def draw(figure: Figure) -> None:
            label = f"{where if width == HALF else where.split()[0]}{f' ({matrix.unit})' if matrix.unit else ''}"
            ax = figure.add_subplot()
            plot_claimed_measured(shown, ax, unit=matrix.unit, label=label, pick=summary.pick, letters=letters)

        label = "claimed against measured fitness, a dot for each controller"
        return Drawing(key, label, draw, width, height, links=links)

    pair = DrawingPair(drawing("claimed-measured", HALF, 4.0, 22), drawing("claimed-measured-narrow", NARROW, 2.9, 12))
    played = any(cell.traces for cell in matrix.cells.values())
    return FigureElement(
        "Claimed against measured" if matrix.robot else "Claimed against the other models",
        f"On the line a claim holds; below it the claim is too high (orange: exploited). Bars: {percent(CONFIDENCE)} "
        f"intervals.{' A click on a dot plays its trial.' if played else ''}",
        (pair,),
    )


def _share(kept: Estimate | None) -> str:
    """Return the achieved share of a claim, with its standard error if that is known."""
    if kept is None:
        return "–"
    error = f" ±{100 * kept.standard_error:.0f}" if kept.standard_error >= 0.005 else ""
    return f"{100 * kept.value:.0f}{error} %"


def further_figures_table(matrix: TransferMatrix, summary: TransferSummary) -> TableElement:
    """Return the gaps, and the lowest fitness of each controller, with intervals."""
    robot = matrix.robot is not None
    rows = [
        (
            _named(one, summary),
            lines(within(one.claimed), of_each_run(one)),
            *((within(one.achieved),) if robot else ()),
            within(one.other_models),
            within(one.other_families),
            within(one.exploitation_gap),
            *((within(one.reality_gap),) if robot else ()),
            lines(within(one.worst), folded(one.worst_on, 12)),
        )
        for one in summary.controllers
    ]
    runs = [len(one.seed_fitness) for one in summary.controllers if one.claimed is not None]
    each = (
        f"Last line of a claim: the champion of each of {max(runs)} evolution runs. "
        if max(runs, default=0) > 1
        else ""
    )
    return TableElement(
        title=f"All figures of each controller ({matrix.unit or 'fitness'}, {percent(CONFIDENCE)} intervals)",
        columns=(
            "controller",
            "claimed",
            *(("achieved",) if robot else ()),
            "other\nmodels",
            "other\nfamilies",
            "claimed -\nother models",
            *(("claimed -\nrobot",) if robot else ()),
            "lowest on",
        ),
        rows=tuple(rows),
        note=(
            f"{each}Other models: mean of those that it was not evolved in; other families: median of the models of "
            "families that it was not evolved in. Lowest on: of the systems that it was not evolved in. "
            "Intervals are over fresh trials of this one controller, not over evolution runs."
        ),
        details=True,
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


QUESTION = "Which controller to use?"


def headline(report: ComparisonResults) -> Answer:
    """Return which controller to use, in one answer."""
    question, summary = QUESTION, report.transfer
    if summary is None:
        return Answer(question, "Not known", (_absent(report)[0],))
    assert report.matrix is not None
    if none_beats_rest(report.matrix):
        return Answer(question, "None", tuple(filter(None, (LOOK_AT_THE_REWARD, _to_record(report)))), "warn")
    if summary.pick in (*report.matrix.at_rest, *report.matrix.at_random):
        why = (NO_BETTER.format(summary.pick), _better(summary.controller(summary.pick), report), _to_record(report))
        return Answer(question, "None", tuple(filter(None, why)), "warn")
    if summary.pick is None:
        return _best_measured(report) or Answer(question, "Not known", (NO_OTHER_FAMILY,))
    pick = summary.controller(summary.pick)
    unit = f" {report.matrix.unit}" if report.matrix.unit else ""
    found = report.forecasts.get(pick.name)
    parts = [] if found is None else [f"forecast {sized(found)}{unit}"]
    if pick.achieved is not None:
        inside = "" if found is None else ": as forecast" if found.covers(pick.achieved) else ": outside the forecast"
        parts.append(f"measured {sized(pick.achieved)} on {report.matrix.robot}{inside}")
    elif pick.other_models is not None:
        parts.append(f"{sized(pick.other_models)} on the other models")
    wording = ", ".join(parts)
    sentences = [_idle(report.matrix, pick.name), NO_BETTER.format(pick.name) if not pick.against else ""]
    sentences += [f"{wording[:1].upper()}{wording[1:]}." if wording else "", _claim(pick)]
    sentences += (
        ["Nothing was run on a robot."] if pick.achieved is None else [_better(pick, report), _share_of(pick, summary)]
    )
    guess = guess_warning(report.exploitability, pick.name)
    kept = pick.achieved is not None and found is not None and found.covers(pick.achieved)
    useless = beats_rest(report.matrix, pick.name) is False
    tone: Tone = "bad" if pick.exploited or useless else "warn" if guess and not kept else "good"
    command = use_command(report, pick.name) or ""
    return Answer(question, pick.name, tuple(filter(None, (*sentences, guess))), tone, command)


def _best_measured(report: ComparisonResults) -> Answer | None:
    """Return the controller that achieves the most on the robot, without forecasts; None if none was run there."""
    matrix, summary = report.matrix, report.transfer
    assert matrix is not None
    assert summary is not None
    trivial = (*matrix.at_rest, *matrix.at_random)
    tried = [c for c in summary.controllers if c.achieved is not None and c.name not in trivial]
    tried = [c for c in tried if not c.evolved_on_robot]
    best = max(tried, key=lambda one: -np.inf if one.achieved is None else one.achieved.value, default=None)
    if best is None or best.achieved is None:
        return None
    count = f", the most of {len(tried)} controllers" if len(tried) > 1 else ""
    unit = f" {matrix.unit}" if matrix.unit else ""
    measured = f"Measured {sized(best.achieved)}{unit} on {matrix.robot}{count}."
    sentences = (_idle(matrix, best.name), measured, _claim(best), NO_OTHER_FAMILY)
    tone: Tone = "bad" if best.exploited or beats_rest(matrix, best.name) is False else "warn"
    return Answer(QUESTION, best.name, tuple(filter(None, sentences)), tone, use_command(report, best.name) or "")


def _share_of(pick: ControllerSummary, summary: TransferSummary) -> str:
    """Return how much of the fitness of a search on the robot itself a controller achieves; empty without one."""
    reference = next((c for c in summary.controllers if c.evolved_on_robot and c.achieved is not None), None)
    share = None if reference is None or reference.achieved is None else pick.share_of(reference.achieved.value)
    if reference is None or reference.achieved is None or share is None:
        return ""
    compared = f"{percent(share)} of" if share <= 1.0 else "more than"  # one search is no upper limit: no 107 %
    return f"That is {compared} the {value_of(reference.achieved)} that one search on the robot itself reached."


def _claim(pick: ControllerSummary) -> str:
    """Return whether the claim of a controller holds."""
    if pick.claimed is None:
        return ""
    held = {True: "is exploited", False: "holds", None: "cannot be checked"}[pick.exploited]
    return f"Its claim of {value_of(pick.claimed)} {held}."


NO_OTHER_FAMILY = "No forecast: no controller can be scored by models of other families. Add one with --models."
LOOK_AT_THE_REWARD = (
    "No controller does better than controls at rest. Look at the reward, which may not ask for motion, or evolve "
    "longer."
)


NO_BETTER = "No evolved controller has a higher forecast than the baseline {}."


def _to_record(report: ComparisonResults) -> str:
    """Return what to record if no controller does better than a trivial one; empty if that is not known."""
    steps = [episode.steps for episode in report.data.training]
    if steps and (middle := int(np.median(steps))) < SHORT_EPISODE:
        return f"Half of the recorded episodes end within {middle} steps: record under controllers, with --rounds 6."
    remarks = () if report.advice is None else report.advice.remarks
    return next((one.sentence for one in remarks if one.topic in TO_RECORD), "")


TO_RECORD = ("outside the data", "excitation", "rare commands", "length")
"""Topics of the remarks on where to record more."""


def _idle(matrix: TransferMatrix, name: str) -> str:
    """Return a warning if a controller is no better than controls at rest, else an empty text."""
    gain = gain_over_rest(matrix, name)
    if gain is None or beats_rest(matrix, name) is not False:
        return ""
    worse = "worse" if gain.high < 0.0 else "no better"
    return f"{name} is {worse} than controls at rest (difference {plus_minus(gain)}): do not use it."


def _better(pick: ControllerSummary, report: ComparisonResults) -> str:
    """Return which other controller from models does clearly better on the robot than the chosen one."""
    assert report.transfer is not None
    others = [c for c in report.transfer.controllers if c.against and not c.evolved_on_robot and c.name != pick.name]
    reached = [(c.achieved, c.name) for c in others if c.achieved is not None]
    best = max(reached, key=lambda one: one[0].value, default=None)
    if best is None or pick.achieved is None or not best[0].low > pick.achieved.high:
        return ""
    return f"{best[1]} does better on the robot, {sized(best[0])}, which was not known before the run."


def sized(estimate: Estimate | Forecast | ModelForecast) -> str:
    """Return a value with its interval, alone where it has none."""
    return with_interval(estimate.value, estimate.low, estimate.high)


ONE_SEED = "Each controller was evolved once; repeat with --repeats 3 to see how much claims vary."
POLISHED = "{} was polished once, from the best of all searches, so the variation of its claim is not known."


def open_questions(summary: TransferSummary) -> tuple[str, ...]:
    """Return what the claims leave open, in sentences."""
    claiming = [c for c in summary.controllers if c.claimed is not None]
    once = [c for c in claiming if len(c.seed_fitness) < 2]
    answers = [POLISHED.format(", ".join(c.name for c in once))] if once else []
    if any(not c.polished for c in once):
        answers = [ONE_SEED]
    single = [c.name for c in claiming if c.achieved is not None and not np.isfinite(c.achieved.standard_error)]
    if single:
        answers.append(f"A single trial on the robot has no error and cannot test a claim: {', '.join(single)}.")
    return tuple(answers)


class ControllerForecastPart(Part):
    """Expected fitness on the robot, and a 90 % interval; the weights of the models add up to 1.

    ``covers_achieved``: whether the interval contains what was achieved; null without a measurement.
    """

    value: Number
    low: Number
    high: Number
    weights: dict[str, Number]
    covers_achieved: bool | None


class ControllerPart(Part):
    """One controller: fitness where it was evolved, elsewhere, and on the robot; its file and the command to use it.

    ``worst_on`` is the system where it is lowest. File and command are relative to the run folder, empty if not known.
    """

    name: str
    against: tuple[str, ...]
    aggregate: str
    forecast: ControllerForecastPart | None
    claimed: EstimatePart | None
    other_models: EstimatePart | None
    other_families: EstimatePart | None
    achieved: EstimatePart | None
    exploitation_gap: EstimatePart | None
    reality_gap: EstimatePart | None
    kept: EstimatePart | None
    worst: EstimatePart | None
    worst_on: str
    other_family_models: tuple[str, ...]
    evolved_on_robot: bool
    seed_fitness: tuple[Number, ...]
    polished: bool
    rest_fitness: Number
    exploited: bool | None
    file: str
    command: str


class ModelForecastPart(Part):
    """Means over the controllers evolved in the model alone; ``kept`` is value, low and high as shares of the claim."""

    model: str
    controllers: tuple[str, ...]
    claimed: Number
    value: Number
    low: Number
    high: Number
    kept: tuple[Number, Number, Number] | None


class ControllersPart(Part):
    """All controllers, the one chosen without the robot (``pick``), and the rule of the forecast."""

    controllers: tuple[ControllerPart, ...]
    pick: str | None
    correlations: tuple[RankCorrelation, ...]
    forecast_rule: ForecastRule
    model_forecasts: tuple[ModelForecastPart, ...]

    @classmethod
    def of(
        cls, summary: TransferSummary, found: Mapping[str, Forecast], report: ComparisonResults | None = None
    ) -> ControllersPart:
        """Return the controllers with their forecasts; files, commands and models are known with a report."""
        controllers = []
        for one in summary.controllers:
            expected = found.get(one.name)
            covers = None if expected is None or one.achieved is None else expected.covers(one.achieved)
            forecast = expected and ControllerForecastPart.made_of(expected, covers_achieved=covers)
            file = "" if report is None else report.controllers.get(one.name, "")
            command = "" if report is None else use_command(report, one.name) or ""
            controllers.append(ControllerPart.made_of(one, forecast=forecast, file=file, command=command))
        models = () if report is None else report.model_forecasts.values()
        return cls(
            controllers=tuple(controllers),
            pick=summary.pick,
            correlations=summary.correlations,
            forecast_rule=FORECAST_RULE,
            model_forecasts=tuple(map(ModelForecastPart.model_validate, models)),
        )
