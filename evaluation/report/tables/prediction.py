"""Tables of prediction errors."""

from __future__ import annotations

from collections.abc import Mapping

from evaluation.labels import percent
from evaluation.prediction import Coverage, ErrorScore, ModelPrediction, Prediction
from evaluation.prediction.conditions import ConditionErrors
from evaluation.report.predicting import N_IN_WORDS, horizon_name
from evaluation.report.sheets import Sheet, lines, number, three_digits


def prediction_sheet(prediction: Prediction) -> Sheet:
    """N of every model at every horizon and in free run, with intervals."""
    horizons = prediction.horizons
    leaders: dict[int | None, set[str]] = {}
    for horizon in horizons:
        ranking = prediction.ranking(horizon)
        equal = {d.first for d in prediction.differences(horizon) if not d.significant}
        leaders[horizon] = equal | ({ranking[0].name} if ranking else set())
    rows = [
        (
            lines(model.name, _divergence(model)),
            *(_n_cell(model, model.score(horizon), model.name in leaders[horizon]) for horizon in horizons),
        )
        for model in prediction.models
    ]
    protocol = prediction.cases.protocol
    return Sheet(
        title=f"Prediction error N, {N_IN_WORDS} (0 is perfect)",
        columns=("model", *(horizon_name(prediction, h).replace(" (", "\n(") for h in horizons)),
        rows=tuple(rows),
        note=(
            "N: RMSE / standard deviation of the truth, mean over channels. "
            f"{protocol.describe(prediction.cases.system.dt)} {len(prediction.cases.windows)} windows; "
            f"free run: each whole episode from sample {protocol.first}. "
            "* best, or no significant difference from the best (paired bootstrap, single comparisons). "
            "clip: windows in which the simulation reached its clip, and the median time until then."
        ),
    )


def coverage_sheet(prediction: Prediction) -> Sheet | None:
    """How much the intervals of every model with a spread hold; None if there is no such model."""
    horizons, models = prediction.cases.horizons, [model for model in prediction.models if model.coverage]
    if not models:
        return None
    rows = []
    for model in models:
        found = {held.horizon: held for held in model.coverage}
        cells = [found.get(horizon) for horizon in horizons]
        rows.append((model.name, *("–" if held is None else _coverage_cell(held) for held in cells)))
    aim = percent(models[0].coverage[0].share)
    return Sheet(
        title=f"What {aim} intervals hold",
        columns=("model", *(horizon_name(prediction, h).replace(" (", "\n(") for h in horizons)),
        rows=tuple(rows),
        note=(
            f"Share of measured states inside the central {aim} of 100 simulations with noise, mean over channels; "
            f"below it each of {', '.join(prediction.cases.system.state_names)}. ! more than 5 points off: too narrow "
            "if lower, wider than need be if higher."
        ),
    )


def channel_sheet(prediction: Prediction, horizon: int | None) -> Sheet:
    """RMSE (standard deviation) [relative error] of every channel, as in Table 1 of the paper, and fit."""
    system = prediction.cases.system
    heads = [lines(channel.name, f"({channel.unit})" if channel.unit else "") for channel in system.states]
    rows = []
    for model in prediction.models:
        score = model.score(horizon)
        cells = ["failed" if model.failed else "–"] * system.nx if score is None else _channel_cells(score)
        rows.append((model.name, *cells))
    start = "from sample" if horizon is None else "from measured states,"
    protocol = prediction.cases.protocol
    begin = f"{protocol.first} of each episode" if horizon is None else protocol.history_in_words
    return Sheet(
        title=f"Error per channel, {horizon_name(prediction, horizon)}",
        columns=("model", *heads),
        rows=tuple(rows),
        note=(
            f"RMSE (standard deviation of the error) [RMSE / RMS of the signal], then fit = 100 (1 - RMSE / std of the "
            f"truth). Simulated {start} {begin}; moving samples only."
        ),
        details=horizon is not None,
    )


def condition_sheet(conditions: Mapping[str, tuple[ConditionErrors, ...]]) -> Sheet | None:
    """N within and across conditions, side by side; None if none was left out."""
    found = next(iter(conditions.values()), ())
    if not found:
        return None
    return Sheet(
        title="Error N within and across conditions",
        columns=("model", *(errors.condition or "no name" for errors in found)),
        rows=tuple(
            (label, *(f"{_known(errors.within)} → {_known(errors.across)}" for errors in of_model))
            for label, of_model in conditions.items()
        ),
        note=(
            f"After {found[0].horizon} steps, in the test part of each condition. Left: learned from the training "
            "parts of all conditions; right: of all but this one."
        ),
    )


def _known(value: float | None) -> str:
    return "–" if value is None else three_digits(value)


def _n_cell(model: ModelPrediction, score: ErrorScore | None, leads: bool) -> str:
    if model.failed:
        return "failed"
    if score is None:
        return "–"
    low, high = score.interval
    return lines(f"{'* ' if leads else ''}{three_digits(score.n)}", f"{three_digits(low)}-{three_digits(high)}")


def _coverage_cell(held: Coverage) -> str:
    each = ", ".join(f"{100 * share:.0f}" for share in held.inside)
    return lines(f"{'' if held.honest else '! '}{percent(held.mean)}", each)


def _divergence(model: ModelPrediction) -> str:
    found = model.divergence
    if found is None or found.share == 0:
        return ""
    return f"clip {percent(found.share)}, {number(found.median_time, 2)} s"


def _channel_cells(score: ErrorScore) -> list[str]:
    cells = zip(score.rmse, score.error_std, score.relative_percent, score.fit_percent, strict=True)
    return [
        lines(f"{size:.4f} ({std:.4f})", f"[{number(rel)} %]", f"fit {number(fit)} %") for size, std, rel, fit in cells
    ]
