"""How well each model predicts: errors, intervals, differences, curves; which models predict at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from evaluation.formatting import few, horizon_name, lines, number, percent, three_digits
from evaluation.plots import plot_free_run, plot_horizon_curve
from evaluation.prediction.cases import PredictionProtocol
from evaluation.prediction.scores import (
    PERSISTENCE,
    ConditionError,
    Difference,
    Divergence,
    ErrorScore,
    ModelPrediction,
    Prediction,
)
from evaluation.report.document import Interval, Number, Numbers, Part
from evaluation.report.elements import (
    Answer,
    DrawingPair,
    FigureElement,
    Fold,
    Section,
    TableElement,
    present,
    wide_and_narrow,
)
from evaluation.report.sections.error_analysis import (
    episode_error_sheet,
    region_sheet,
    residual_picture,
    residual_sheet,
)
from evaluation.results import ComparisonResults
from evaluation.sufficiency import (
    USELESS,
    beats_mean,
    leads,
    no_worse,
    predicts,
    tells_apart,
    too_little,
)
from sysid_evo.display import listed
from sysid_evo.validation.estimates import CONFIDENCE
from sysid_evo.validation.measures import mean_over_channels

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MEASURE = (
    "Each model is started from measured states and simulated with the recorded controls. N is the error (RMSE) "
    "divided by the standard deviation of the measured signal, averaged over the states: 0 is perfect, 1 is as bad as "
    "predicting the mean. The row persistence keeps the first state (no change)."
)
LOW_ERROR = "A low N does not show that controllers evolved in the model work: see Can the models be trusted?"


def section(report: ComparisonResults) -> Section:
    """Return errors, their curves, and their analysis; without any, why."""
    prediction = report.prediction
    if prediction is None:
        return Section("Prediction", absent=_absent(report))
    scored = [model for model in prediction.models if not model.failed]
    return Section(
        "Prediction",
        present(
            error_table(prediction),
            horizon_picture(prediction) if prediction.cases.horizons else None,
            free_run_picture(prediction) if prediction.cases.free_runs and scored else None,
            difference_table(prediction),
            coverage_table(prediction),
            condition_table(report.conditions),
            region_sheet(prediction),
            _residuals(prediction),
            episode_error_sheet(prediction),
            *(state_error_table(prediction, horizon) for horizon in reversed(prediction.horizons)),
        ),
        [f"{MEASURE} {LOW_ERROR}" if report.matrix is not None else MEASURE],
        absent=_absent(report),
    )


def _residuals(prediction: Prediction) -> Fold | None:
    """Return the table of residuals with their correlations; None without residuals."""
    sheet = residual_sheet(prediction)
    items = present(None if sheet is None else replace(sheet, details=False), residual_picture(prediction))
    return Fold("One-step residuals", items) if items else None


def _absent(report: ComparisonResults) -> list[str]:
    """Return what is not known of prediction errors, and why."""
    prediction = report.prediction
    if prediction is None:
        return ["No prediction error was computed, so it is not known which models predict."]
    found = []
    if not prediction.cases.horizons:
        found.append(
            "No horizon fits into the test data, so there is no error over the horizon. Record longer episodes."
        )
    if not prediction.cases.free_runs:
        found.append("No test episode is long enough to simulate it whole.")
    if not any(model.coverage for model in prediction.models):
        found.append("No model gives prediction intervals to check; some families do with stochastic=true.")
    return found


def error_table(prediction: Prediction) -> TableElement:
    """Return N of every model at every horizon and over whole episodes, with intervals."""
    horizons = prediction.horizons
    rows = [
        (lines(model.name, _divergence(model)), *(_n_cell(prediction, model, horizon) for horizon in horizons))
        for model in prediction.models
    ]
    protocol = prediction.cases.protocol
    blocks = prediction.cases.blocks(prediction.cases.main_horizon)
    notes = [
        f"{protocol.describe(prediction.cases.system.dt)} {len(prediction.cases.windows)} windows in {blocks} "
        f"independent blocks of test data; whole episodes from sample {protocol.first}. N is the error in standard "
        "deviations of the recording: 0 is perfect, 1 is no better than its mean."
    ]
    if any(cell.startswith("* ") for row in rows for cell in row[1:]):
        notes.append("* lowest, or not significantly different from it (paired bootstrap, single comparisons).")
    if any(map(_divergence, prediction.models)):
        notes.append("Limited: windows in which a state reached its bounds, and the median time until then.")
    notes.append(too_little(prediction, prediction.cases.main_horizon))
    return TableElement(
        title=f"Simulation error N ({percent(CONFIDENCE)} intervals)",
        columns=("model", *_heads(prediction, horizons)),
        rows=tuple(rows),
        note=" ".join(filter(None, notes)),
    )


def _heads(prediction: Prediction, horizons: Sequence[int | None]) -> list[str]:
    names = [horizon_name(horizon, prediction.cases.system.dt) for horizon in horizons]
    return [name.replace(" (", "\n(").replace("whole ", "whole\n") for name in names]


def _n_cell(prediction: Prediction, model: ModelPrediction, horizon: int | None) -> str:
    score = model.score(horizon)
    if model.failed:
        return "failed"
    if score is None:
        return "–"
    low, high = score.estimate.interval
    between = f"{three_digits(low)} to {three_digits(high)}" if tells_apart(prediction, horizon) else ""
    return lines(f"{'* ' if leads(prediction, model, horizon) else ''}{three_digits(score.n)}", between)


def _divergence(model: ModelPrediction) -> str:
    found = model.divergence
    if found is None or found.share == 0:
        return ""
    return f"limited {percent(found.share)}, {number(found.median_time, 2)} s"


def coverage_table(prediction: Prediction) -> TableElement | None:
    """Return the coverage of the prediction intervals of each model; None if no model gives any."""
    horizons, models = prediction.cases.horizons, [model for model in prediction.models if model.coverage]
    if not models:
        return None
    rows = []
    for model in models:
        found = {held.horizon: held for held in model.coverage}
        row = [model.name]
        for held in map(found.get, horizons):
            each = "" if held is None else ", ".join(f"{100 * share:.0f}" for share in held.inside)
            row.append("–" if held is None else lines(f"{'' if held.calibrated else '! '}{percent(held.mean)}", each))
        rows.append(tuple(row))
    aim = percent(models[0].coverage[0].share)
    return TableElement(
        title=f"Coverage of {aim} intervals",
        details=True,
        columns=("model", *_heads(prediction, horizons)),
        rows=tuple(rows),
        note=(
            f"Share of measured states inside the central {aim} of 100 simulations with noise, mean over the states; "
            f"below it each of {', '.join(prediction.cases.system.state_names)}. ! more than 5 points off: "
            "overconfident (too narrow) if lower, underconfident if higher; the others are calibrated."
        ),
    )


def condition_table(conditions: Mapping[str, tuple[ConditionError, ...]]) -> TableElement | None:
    """Return N within and across conditions; None if no condition was left out."""
    found = next(iter(conditions.values()), ())
    if not found:
        return None
    return TableElement(
        title="Error N across conditions",
        details=True,
        columns=("model", *(errors.condition or "no name" for errors in found)),
        rows=tuple((label, *map(_condition_cell, of_model)) for label, of_model in conditions.items()),
        note=(
            f"After {found[0].horizon} steps, on the test data of each condition. Left: fitted to the training data of "
            "all conditions; right: of all but this one, and the share inside its intervals, if it has any."
        ),
    )


def _condition_cell(errors: ConditionError) -> str:
    inside = "" if errors.covered is None else f"{percent(errors.covered)} inside"
    return lines(f"{three_digits(errors.within)} → {three_digits(errors.across)}", inside)


def difference_table(prediction: Prediction) -> TableElement | None:
    """Return the difference of each model from the best, with intervals; None with fewer than two models."""
    horizons = [horizon for horizon in prediction.horizons if tells_apart(prediction, horizon)]
    rankings = {horizon: prediction.ranking(horizon) for horizon in horizons}
    if not horizons or max(len(ranking) for ranking in rankings.values()) < 2:
        return None
    compared = {h: {d.first: d for d in prediction.differences(h)} for h in horizons}
    main = rankings.get(prediction.cases.main_horizon, next(iter(rankings.values())))
    names = [model.name for model in main] + [name for name in prediction.names if name not in {m.name for m in main}]
    rows = [
        (name, *(_against(compared[h].get(name), bool(rankings[h]) and rankings[h][0].name == name) for h in horizons))
        for name in names
    ]
    return TableElement(
        "Difference from the best model (N)",
        ("model", *_heads(prediction, horizons)),
        tuple(rows),
        note=f"N minus that of the best model at this horizon, with its {percent(CONFIDENCE)} interval by paired block "
        "bootstrap. An interval that contains 0 is no significant difference.",
        details=True,
    )


def _against(difference: Difference | None, best: bool) -> str:
    if difference is None:
        return "best" if best else "–"
    low, high = difference.difference.interval
    between = f"{_signed(low)} to {_signed(high)}"
    same = "" if difference.significant else "no significant\ndifference"
    return lines(_signed(difference.difference.value), between, same)


def _signed(value: float) -> str:
    return f"{'-' if value < 0.0 else '+'}{three_digits(abs(value))}"


def state_error_table(prediction: Prediction, horizon: int | None) -> TableElement:
    """Return RMSE (standard deviation) [relative error] of every state, as in Table 1 of the paper, and fit."""
    system = prediction.cases.system
    heads = [lines(channel.name, f"({channel.unit})" if channel.unit else "") for channel in system.states]
    rows = []
    for model in prediction.models:
        cells = ["failed" if model.failed else "–"] * system.nx
        if (score := model.score(horizon)) is not None:
            errors = zip(score.rmse, score.error_std, score.relative_percent, score.fit_percent, strict=True)
            cells = [
                lines(f"{size:.4f} ({std:.4f})", f"[{number(rel)} %]", f"fit {number(fit)} %")
                for size, std, rel, fit in errors
            ]
        rows.append((model.name, *cells))
    start = "from sample" if horizon is None else "from measured states,"
    protocol = prediction.cases.protocol
    begin = f"{protocol.first} of each episode" if horizon is None else protocol.history_in_words
    return TableElement(
        title=f"Error of each state, {horizon_name(horizon, system.dt)}",
        columns=("model", *heads),
        rows=tuple(rows),
        note=(
            f"RMSE (standard deviation of the error) [RMSE / RMS of the signal], then fit = 100 (1 - RMSE / std of the "
            f"measurement). Simulated {start} {begin}; moving samples only."
        ),
        details=True,
    )


def horizon_picture(prediction: Prediction) -> FigureElement:
    """N over the horizon."""

    def draw(figure: Figure) -> None:
        plot_horizon_curve(prediction, figure.add_subplot())

    return FigureElement(
        "Error over the horizon",
        "N after every step of a simulation with the recorded controls "
        f"({prediction.cases.protocol.history_in_words}). Bands: intervals. Vertical lines: the horizons of the table.",
        (wide_and_narrow("horizon", "N over the horizon, a line for each model", draw, 3.6, 2.9),),
    )


SHOWN_MODELS = 5
"""Models whose simulation is shown at first; a reader may show the others."""
SHOWN_EPISODES = 3
"""Test episodes from which a reader may choose."""


def free_run_picture(prediction: Prediction) -> FigureElement:
    """Return measured and simulated states, one drawing for each of the most varied test episodes."""
    ranked = [model.name for model in prediction.ranking(None) if model.name != PERSISTENCE]
    parts = ranked[:SHOWN_MODELS], ranked[SHOWN_MODELS:]
    best, rest = ([name for name in prediction.names if name in part] for part in parts)
    cases = prediction.cases
    variation = [-mean_over_channels(run.states.std(axis=0) / cases.scale) for run in cases.free_runs]
    runs = np.argsort(np.nan_to_num(variation), kind="stable")[:SHOWN_EPISODES].tolist()
    left_out = f"; the best {SHOWN_MODELS} of {len(ranked)} models are shown at first" if rest else ""
    several = (
        f"; the {len(runs)} most varied episodes" if len(runs) > 1 else f"; episode {cases.free_runs[runs[0]].episode}"
    )
    return FigureElement(
        "Simulated and measured",
        f"Simulation with the recorded controls from sample {cases.protocol.first} of an episode, at most 15 s "
        f"from the first movement{several}{left_out}.",
        tuple(_episode(prediction, run, best, rest, place) for place, run in enumerate(runs)),
        choose="Test episode" if len(runs) > 1 else "",
    )


def _episode(prediction: Prediction, run: int, best: Sequence[str], rest: Sequence[str], place: int) -> DrawingPair:
    nx, name = prediction.cases.system.nx, prediction.cases.free_runs[run].episode

    def draw(figure: Figure) -> None:
        plots = figure.subplots(nx, 1, sharex=True, squeeze=False)[:, 0]
        for channel, ax in enumerate(plots):
            plot_free_run(prediction, channel, ax, models=best, besides=rest, run=run)
            ax.label_outer()
        figure.align_ylabels(plots)

    key, label = "free-run" if place == 0 else f"free-run-{place + 1}", f"simulated and measured states of {name}"
    pair = wide_and_narrow(key, label, draw, 0.5 + 1.4 * nx, 0.5 + 1.5 * nx, off=frozenset(rest))
    return replace(pair, title=name)


def headline(report: ComparisonResults) -> Answer:
    """Return which models predict, in one answer."""
    question, prediction = "Which models predict?", report.prediction
    if prediction is None:
        return Answer(question, "Not known", ("No prediction was made.",))
    horizon = prediction.cases.main_horizon
    models = scored(prediction, horizon) if prediction.horizons else ()
    if not models:
        return Answer(question, "Not known", ("No model has a score; the notes and failures give the reasons.",))
    best = models[0]
    score = best.score(horizon)
    assert score is not None
    if few_data := too_little(prediction, horizon):
        lowest = f"The lowest error, N {three_digits(score.n)}, is that of {best.name}."
        return Answer(question, "Not known", (few_data, lowest))
    between = " to ".join(map(three_digits, score.estimate.interval))
    size = f"{three_digits(score.n)} ({between})"
    where = "Over whole episodes" if horizon is None else f"After {horizon_name(horizon, prediction.cases.system.dt)}"
    good = [model.name for model in models if predicts(prediction, model, horizon)]
    if not good:
        if score.n >= USELESS:
            why = "From 1 on, predicting the mean is as good"
        elif any(beats_mean(model.score(horizon)) for model in models):
            why = "No model is significantly better than no change (persistence)"
        else:
            why = "No model is significantly better than predicting the mean, which has 1"
        lowest = f"{where}, the lowest simulation error N is {size}, of {best.name}."
        return Answer(question, "None", tuple(filter(None, (lowest, f"{why}.", _tried(report)))), "bad")
    equal = [m.name for m in models[1:] if m.name in good and no_worse(prediction, m, best, horizon)]
    leaders = [best.name, *equal]
    beaten = [model.name for model in models if model.name not in good]
    count = f"{len(good)} of {len(models)} models predict" if len(models) > 1 else ""
    count += f", not {few(beaten)}." if count and beaten else "." if count else ""
    same = "; no significant difference between them" if len(leaders) > 1 else ""
    whose = "the lowest simulation error N" if len(leaders) > 1 else "its simulation error N"
    sentences = (f"{where}, {whose} is {size}{same}.", count, _tried(report))
    return Answer(question, few(leaders), tuple(filter(None, sentences)), "good")


def _tried(report: ComparisonResults) -> str:
    """Return a sentence on the families that were tried because no default family predicted, empty if none were."""
    tried = report.settings.get("tried_models", ())
    if not tried:
        return ""
    added = [name for name in tried if name in {model.name for model in report.models}]
    result = f"{added[0]} is, and was added" if added else "none is"
    return f"No default family is better than predicting the mean; of {listed(tried)}, tried in this order, {result}."


def scored(prediction: Prediction, horizon: int | None) -> tuple[ModelPrediction, ...]:
    """Return the models with a score at ``horizon``, lowest N first, without persistence."""
    return tuple(model for model in prediction.ranking(horizon) if model.name != PERSISTENCE)


class ChannelErrorPart(Part):
    """Errors of one state; ``rmse`` and ``error_std`` in its ``unit``."""

    unit: str
    rmse: Number
    error_std: Number
    relative_percent: Number
    nrmse: Number
    fit_percent: Number


class ScorePart(Part):
    """Errors after ``steps``, null over whole episodes; ``n`` is the mean of RMSE / standard deviation of the states.

    The interval is null where there is too little test data for one.
    """

    steps: int | None
    seconds: Number
    initialisation: str
    samples: int
    n: Number
    interval: Interval
    channels: dict[str, ChannelErrorPart]

    @classmethod
    def of(cls, score: ErrorScore, prediction: Prediction) -> ScorePart:
        """Return a score with the names of the states."""
        system = prediction.cases.system
        each = ("rmse", "error_std", "relative_percent", "nrmse", "fit_percent")
        return cls.made_of(
            score,
            steps=score.horizon,
            seconds=None if score.horizon is None else score.horizon * system.dt,
            initialisation="measured states and controls",
            interval=score.estimate.interval if tells_apart(prediction, score.horizon) else (None, None),
            channels={
                channel.name: ChannelErrorPart(unit=channel.unit, **{name: getattr(score, name)[i] for name in each})
                for i, channel in enumerate(system.states)
            },
        )


class CoveragePart(Part):
    """Share of the measured states inside the prediction intervals of a model; ``aim`` is the nominal one."""

    steps: int
    seconds: float
    samples: int
    aim: float
    mean: Number
    calibrated: bool
    channels: dict[str, Number]


class ModelPredictionPart(Part):
    """Prediction errors of one model; ``reason`` is why there are none. ``curve`` is N after every step.

    ``warning`` is a sentence if the model is worse than persistence and a linear model, else empty.
    """

    name: str
    family: str
    reason: str | None
    scores: tuple[ScorePart, ...]
    free_run: ScorePart | None
    curve: Numbers
    curve_interval: tuple[Numbers, Numbers]
    divergence: Divergence | None
    coverage: tuple[CoveragePart, ...]
    notes: tuple[str, ...]
    warning: str

    @classmethod
    def of(cls, model: ModelPrediction, prediction: Prediction) -> ModelPredictionPart:
        """Return the errors of a model, with intervals where the data suffice."""
        system, last = prediction.cases.system, max(prediction.cases.horizons, default=None)
        band = model.curve_interval if tells_apart(prediction, last) else np.full_like(model.curve_interval, np.nan)
        return cls.made_of(
            model,
            reason=model.reason or None,
            scores=[ScorePart.of(score, prediction) for score in model.scores],
            free_run=None if model.free_run is None else ScorePart.of(model.free_run, prediction),
            curve_interval=(band[0], band[1]),
            coverage=[
                CoveragePart.made_of(
                    held,
                    steps=held.horizon,
                    seconds=held.horizon * system.dt,
                    aim=held.share,
                    channels=dict(zip(system.state_names, held.inside, strict=True)),
                )
                for held in model.coverage
            ],
        )


class DifferencePart(Part):
    """N of the first minus N of the second model, paired; an interval that contains 0 is no significant difference."""

    first: str
    second: str
    steps: int | None
    difference: Number
    interval: Interval
    verdict: str


class PredictionPart(Part):
    """Prediction errors of all models; ``std`` and ``rms`` of each measured state, ``conditions`` by model."""

    protocol: PredictionProtocol
    description: str
    windows: int
    std: dict[str, Number]
    rms: dict[str, Number]
    models: tuple[ModelPredictionPart, ...]
    differences: tuple[DifferencePart, ...]
    conditions: dict[str, tuple[ConditionError, ...]]

    @classmethod
    def of(cls, prediction: Prediction, conditions: Mapping[str, tuple[ConditionError, ...]]) -> PredictionPart:
        """Return the errors of all models, and those within and across conditions."""
        cases = prediction.cases
        differences = [
            found
            for horizon in prediction.horizons
            if tells_apart(prediction, horizon)
            for found in prediction.differences(horizon)
        ]
        return cls(
            protocol=cases.protocol,
            description=cases.protocol.describe(cases.system.dt),
            windows=len(cases.windows),
            std=dict(zip(cases.system.state_names, cases.std, strict=True)),
            rms=dict(zip(cases.system.state_names, cases.rms, strict=True)),
            models=tuple(ModelPredictionPart.of(model, prediction) for model in prediction.models),
            differences=tuple(
                DifferencePart.made_of(
                    found,
                    steps=found.horizon,
                    difference=found.difference.value,
                    interval=found.difference.interval,
                )
                for found in differences
            ),
            conditions=dict(conditions),
        )
