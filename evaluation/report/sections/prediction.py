"""How well each model predicts: errors, intervals, differences, curves; which models predict at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.formatting import few, horizon_name, lines, number, percent, three_digits
from evaluation.plots import plot_free_run, plot_horizon_curve
from evaluation.prediction.scores import (
    PERSISTENCE,
    ConditionError,
    Difference,
    ErrorScore,
    ModelPrediction,
    Prediction,
)
from evaluation.report.elements import FigureElement, Headline, Section, TableElement, present, wide_and_narrow
from evaluation.report.sections.error_analysis import (
    episode_error_sheet,
    episode_to_json,
    fit_sheet,
    region_sheet,
    residual_sheet,
    residuals_to_json,
)
from evaluation.results import ComparisonResults
from evaluation.sufficiency import (
    USELESS,
    beats_mean,
    beats_persistence,
    leads,
    no_worse,
    predicts,
    tells_apart,
    too_little,
)
from sysid_evo.validation.estimates import CONFIDENCE
from sysid_evo.validation.measures import mean_over_channels

if TYPE_CHECKING:
    from matplotlib.figure import Figure


LOW_ERROR = "A low prediction error does not show that a controller evolved in the model works elsewhere: see Transfer."


def section(report: ComparisonResults) -> Section:
    """Return errors, their curves, and where they are; without any, why."""
    prediction = report.prediction
    if prediction is None:
        return Section("Prediction", absent=_absent(report))
    scored = [model for model in prediction.models if not model.failed]
    return Section(
        "Prediction",
        present(
            error_table(prediction),
            coverage_table(prediction),
            condition_table(report.conditions),
            difference_table(prediction),
            horizon_picture(prediction) if prediction.cases.horizons else None,
            free_run_picture(prediction) if prediction.cases.free_runs and scored else None,
            region_sheet(prediction),
            residual_sheet(prediction),
            episode_error_sheet(prediction),
            fit_sheet(prediction),
            *(state_error_table(prediction, horizon) for horizon in reversed(prediction.horizons)),
        ),
        [LOW_ERROR] if report.matrix is not None else [],
        absent=_absent(report),
    )


def _absent(report: ComparisonResults) -> list[str]:
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


N_IN_WORDS = "the mean error in standard deviations"


def error_table(prediction: Prediction) -> TableElement:
    """N of every model at every horizon and in free run, with intervals."""
    horizons = prediction.horizons
    rows = [
        (lines(model.name, _divergence(model)), *(_n_cell(prediction, model, horizon) for horizon in horizons))
        for model in prediction.models
    ]
    protocol = prediction.cases.protocol
    return TableElement(
        title=f"Prediction error N, {N_IN_WORDS} (0 is perfect)",
        columns=("model", *_heads(prediction, horizons)),
        rows=tuple(rows),
        note=(
            "N: RMSE / standard deviation of the truth, mean over channels. "
            f"{protocol.describe(prediction.cases.system.dt)} {len(prediction.cases.windows)} windows; "
            f"free run: each whole episode from sample {protocol.first}. "
            "* best, or no significant difference from the best (paired bootstrap, single comparisons). "
            "clip: windows in which the simulation reached its clip, and the median time until then."
            f"{_said(too_little(prediction, prediction.cases.main_horizon))}"
        ),
    )


def _heads(prediction: Prediction, horizons: Sequence[int | None]) -> list[str]:
    return [horizon_name(horizon, prediction.cases.system.dt).replace(" (", "\n(") for horizon in horizons]


def _said(sentence: str) -> str:
    return f" {sentence}" if sentence else ""


def _n_cell(prediction: Prediction, model: ModelPrediction, horizon: int | None) -> str:
    score = model.score(horizon)
    if model.failed:
        return "failed"
    if score is None:
        return "–"
    low, high = score.estimate.interval
    between = f"{three_digits(low)}-{three_digits(high)}" if tells_apart(prediction, horizon) else ""
    return lines(f"{'* ' if leads(prediction, model, horizon) else ''}{three_digits(score.n)}", between)


def _divergence(model: ModelPrediction) -> str:
    found = model.divergence
    if found is None or found.share == 0:
        return ""
    return f"clip {percent(found.share)}, {number(found.median_time, 2)} s"


def coverage_table(prediction: Prediction) -> TableElement | None:
    """How much the intervals of every model with a spread hold; None if there is no such model."""
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
        title=f"What {aim} intervals hold",
        columns=("model", *_heads(prediction, horizons)),
        rows=tuple(rows),
        note=(
            f"Share of measured states inside the central {aim} of 100 simulations with noise, mean over channels; "
            f"below it each of {', '.join(prediction.cases.system.state_names)}. ! more than 5 points off: too narrow "
            "if lower, wider than need be if higher."
        ),
    )


def condition_table(conditions: Mapping[str, tuple[ConditionError, ...]]) -> TableElement | None:
    """N within and across conditions, side by side; None if none was left out."""
    found = next(iter(conditions.values()), ())
    if not found:
        return None
    return TableElement(
        title="Error N within and across conditions",
        columns=("model", *(errors.condition or "no name" for errors in found)),
        rows=tuple(
            (label, *(f"{three_digits(errors.within)} → {three_digits(errors.across)}" for errors in of_model))
            for label, of_model in conditions.items()
        ),
        note=(
            f"After {found[0].horizon} steps, in the test part of each condition. Left: learned from the training "
            "parts of all conditions; right: of all but this one."
        ),
    )


def difference_table(prediction: Prediction) -> TableElement | None:
    """Each model against the best where models can be told apart, with intervals; None with fewer than two."""
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
        "N above the best",
        ("model", *_heads(prediction, horizons)),
        tuple(rows),
        note=f"N minus that of the best model there, with its {percent(CONFIDENCE)} interval by paired block "
        "bootstrap: both meet the same windows in every draw. An interval that holds 0 is no significant difference.",
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
    """RMSE (standard deviation) [relative error] of every channel, as in Table 1 of the paper, and fit."""
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
        title=f"Error per channel, {horizon_name(horizon, prediction.cases.system.dt)}",
        columns=("model", *heads),
        rows=tuple(rows),
        note=(
            f"RMSE (standard deviation of the error) [RMSE / RMS of the signal], then fit = 100 (1 - RMSE / std of the "
            f"truth). Simulated {start} {begin}; moving samples only."
        ),
        details=horizon is not None,
    )


def horizon_picture(prediction: Prediction) -> FigureElement:
    """N over the horizon."""

    def draw(figure: Figure) -> None:
        plot_horizon_curve(prediction, figure.add_subplot())

    return FigureElement(
        "Error over the horizon",
        "N at every step of a free run under recorded controls from measured states "
        f"({prediction.cases.protocol.history_in_words}). Bands: intervals of the block bootstrap. Vertical "
        "lines: the horizons of the table.",
        (wide_and_narrow("horizon", "N over the horizon, a line for each model", draw, 3.6, 2.9),),
    )


SHOWN_MODELS = 5
"""Models whose free run is shown at once; a reader may switch on the others."""


def free_run_picture(prediction: Prediction) -> FigureElement:
    """Measured and predicted states in free run, one plot for each channel."""
    ranked = [model.name for model in prediction.ranking(None) if model.name != PERSISTENCE]
    parts = ranked[:SHOWN_MODELS], ranked[SHOWN_MODELS:]
    best, rest = ([name for name in prediction.names if name in part] for part in parts)
    cases, nx = prediction.cases, prediction.cases.system.nx
    scale = np.where(cases.std > 0, cases.std, np.nan)
    # the run whose states vary most, in the scale of the test set
    run = int(np.argmax([mean_over_channels(run.states.std(axis=0) / scale) for run in cases.free_runs]))

    def draw(figure: Figure) -> None:
        plots = figure.subplots(nx, 1, sharex=True, squeeze=False)[:, 0]
        for channel, ax in enumerate(plots):
            plot_free_run(prediction, channel, models=best, besides=rest, run=run, ax=ax)
            ax.label_outer()
        figure.align_ylabels(plots)

    label = "states in free run, measured and predicted"
    left_out = f"; the {SHOWN_MODELS} best of {len(ranked)} models are switched on" if rest else ""
    return FigureElement(
        "Predicted and measured",
        f"Free run of {cases.free_runs[run].episode!r} from its sample {cases.protocol.first}, "
        f"under its recorded controls; at most 15 s from the first movement{left_out}.",
        (wide_and_narrow("free-run", label, draw, 0.5 + 1.5 * nx, 0.5 + 1.5 * nx, off=frozenset(rest)),),
    )


def headline(report: ComparisonResults) -> Headline:
    """Say at first sight which models predict."""
    question, prediction = "Which models predict?", report.prediction
    if prediction is None:
        return Headline(question, "Not known", "No prediction was made.", "open")
    horizon = prediction.cases.main_horizon
    models = scored(prediction, horizon) if prediction.horizons else ()
    if not models:
        return Headline(question, "Not known", "No model has a score; the notes and failures say why.", "open")
    best = models[0]
    score = _score(best, horizon)
    if few_data := too_little(prediction, horizon):
        lowest = f"The lowest error, N {three_digits(score.n)}, is that of {best.name}."
        return Headline(question, "Not known", f"{few_data} {lowest}", "open")
    between = " to ".join(map(three_digits, score.estimate.interval))
    size = f"N {three_digits(score.n)} ({between})"
    where = horizon_name(horizon, prediction.cases.system.dt)
    good = [model.name for model in models if predicts(prediction, model, horizon)]
    if not good:
        return Headline(question, "None", f"The lowest error, {size} at {where}, is that of {best.name}.", "bad")
    equal = [m.name for m in models[1:] if m.name in good and no_worse(prediction, m, best, horizon)]
    leaders = [best.name, *equal]
    more = f"; {len(good)} of {len(models)} predict" if len(models) > 1 else ""
    alike = ", no significant difference between them" if len(leaders) > 1 else ""
    return Headline(question, few(leaders), f"Best at {where}: {size}{alike}{more}.", "good")


def scored(prediction: Prediction, horizon: int | None) -> tuple[ModelPrediction, ...]:
    """Return the models with a score at ``horizon``, lowest N first, without persistence."""
    return tuple(model for model in prediction.ranking(horizon) if model.name != PERSISTENCE)


def prediction_sentences(prediction: Prediction) -> tuple[str, ...]:
    """Answer which models predict."""
    if not prediction.horizons:
        return ("The test set is too short to say: no horizon and no free run fits into it.",)
    horizon = prediction.cases.main_horizon
    models = scored(prediction, horizon)
    if not models:
        return ("No model could be scored.",)
    if few_data := too_little(prediction, horizon):
        lowest = three_digits(_score(models[0], horizon).n)
        where = _at(prediction, horizon).capitalize()
        return (few_data, f"{where} the lowest N, {N_IN_WORDS}, is {lowest}, of {models[0].name}.")
    answers = [_best(prediction, models, horizon)]
    if any(predicts(prediction, model, horizon) for model in models):
        equal = [model.name for model in models[1:] if no_worse(prediction, model, models[0], horizon)]
        if equal:
            answers.append(f"No significant difference from it: {', '.join(equal)}.")
        beaten = [model.name for model in models if not beats_persistence(prediction, model, horizon)]
        if beaten:
            answers.append(f"Not significantly better than persistence: {', '.join(beaten)}.")
    if horizon is not None and (free := scored(prediction, None)) and tells_apart(prediction, None):
        best, n = free[0].name, _score(free[0], None).n
        found = f"{best} is best: N {n:.3f}"
        if not any(predicts(prediction, model, None) for model in free):
            found = f"no model predicts: the lowest N is {n:.3f}, of {best}"
        answers.append(f"In free run over whole episodes, {found}.")
    clipped = [
        f"{model.name} ({percent(model.divergence.share)} of windows)"
        for model in models
        if model.divergence is not None and model.divergence.share > 0
    ]
    if clipped:
        answers.append(f"Simulations reach their clip: {', '.join(clipped)}.")
    answers += [sentence for model in models if (sentence := coverage_sentence(prediction, model))]
    return tuple(answers)


def coverage_sentence(prediction: Prediction, model: ModelPrediction) -> str:
    """Return in a sentence what a model's intervals hold; empty for a model without a spread."""
    if not model.coverage:
        return ""
    aim = percent(model.coverage[0].share)
    wrong = [held for held in model.coverage if not held.calibrated]
    if not wrong:
        shares = sorted(held.mean for held in model.coverage)
        horizons = ", ".join(str(held.horizon) for held in model.coverage)
        return (
            f"The {aim} intervals of {model.name} are honest: they hold {percent(shares[0])} to {percent(shares[-1])} "
            f"after {horizons} steps."
        )
    parts = []
    for held in wrong:
        narrow = held.mean < held.share
        amount = f"{'only ' if narrow else ''}{percent(held.mean)}"
        verdict = "too narrow" if narrow else "wider than they need be"
        parts.append(f"hold {amount} after {horizon_name(held.horizon, prediction.cases.system.dt)}: {verdict}")
    return f"The {aim} intervals of {model.name} {'; they '.join(parts)}."


def _best(prediction: Prediction, models: tuple[ModelPrediction, ...], horizon: int | None) -> str:
    best, score = models[0], _score(models[0], horizon)
    still = prediction.model(PERSISTENCE).score(horizon)
    where = _at(prediction, horizon)
    size = f"{score.n:.3f} ({score.estimate.low:.3f} to {score.estimate.high:.3f})"
    beside = f"; persistence has {still.n:.3f}" if still else ""
    if any(predicts(prediction, model, horizon) for model in models):
        return f"{where.capitalize()}, {best.name} is best: N, {N_IN_WORDS}, is {size}{beside}."
    if score.n >= USELESS:
        why = "from 1 on, a constant would do as well"
    elif not any(beats_mean(model.score(horizon)) for model in models):
        why = "no model is significantly better than a constant, which has 1"
    else:
        why = "no model is significantly better than that"
    return f"No model predicts here: {where} the lowest N, {N_IN_WORDS}, is {size}, of {best.name}{beside}; {why}."


def _at(prediction: Prediction, horizon: int | None) -> str:
    return "in free run" if horizon is None else f"at {horizon_name(horizon, prediction.cases.system.dt)}"


def _score(model: ModelPrediction, horizon: int | None) -> ErrorScore:
    score = model.score(horizon)
    assert score is not None
    return score


def prediction_to_json(prediction: Prediction) -> dict[str, Any]:
    """Return what the document holds under ``prediction``."""
    cases = prediction.cases
    return {
        "protocol": asdict(cases.protocol),
        "description": cases.protocol.describe(cases.system.dt),
        "windows": len(cases.windows),
        "std": dict(zip(cases.system.state_names, cases.std, strict=True)),
        "rms": dict(zip(cases.system.state_names, cases.rms, strict=True)),
        "models": [_model_to_json(model, prediction) for model in prediction.models],
        "differences": [
            {
                "first": difference.first,
                "second": difference.second,
                "steps": difference.horizon,
                "difference": difference.difference.value,
                "interval": list(difference.difference.interval),
                "verdict": difference.verdict,
            }
            for horizon in prediction.horizons
            if tells_apart(prediction, horizon)
            for difference in prediction.differences(horizon)
        ],
    }


def _model_to_json(model: ModelPrediction, prediction: Prediction) -> dict[str, Any]:
    horizons, system = prediction.cases.horizons, prediction.cases.system
    last = max(horizons, default=None)
    band = model.curve_interval if tells_apart(prediction, last) else np.full_like(model.curve_interval, np.nan)
    return {
        "name": model.name,
        "family": model.family,
        "reason": model.reason or None,
        "horizons": [_score_to_json(score, prediction) for score in model.scores],
        "free_run": None if model.free_run is None else _score_to_json(model.free_run, prediction),
        "curve": model.curve,
        "curve_interval": band,
        "residuals": None if model.residuals is None else residuals_to_json(model.residuals, system),
        "regions": [
            {"words": one.words, **asdict(one), "ratio": one.ratio.value, "interval": list(one.ratio.interval)}
            for one in model.regions
        ],
        "episodes": [episode_to_json(episode, horizons, system) for episode in model.episodes],
        "divergence": None if model.divergence is None else asdict(model.divergence),
        "coverage": [
            {
                "steps": held.horizon,
                "seconds": held.horizon * system.dt,
                "samples": held.samples,
                "aim": held.share,
                "mean": held.mean,
                "honest": held.calibrated,
                "channels": dict(zip(system.state_names, held.inside, strict=True)),
            }
            for held in model.coverage
        ],
        "notes": model.notes,
    }


def _score_to_json(score: ErrorScore, prediction: Prediction) -> dict[str, Any]:
    system = prediction.cases.system
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
        "interval": list(score.estimate.interval) if tells_apart(prediction, score.horizon) else [None, None],
        "channels": channels,
    }
