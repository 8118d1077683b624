"""Tables of where prediction errors are and what is left in them: against the best, by region, episode and channel."""

from __future__ import annotations

import numpy as np

from evaluation.labels import percent
from evaluation.prediction import Difference, ModelPrediction, Prediction, worst_region
from evaluation.prediction.residuals import LEVEL
from evaluation.report.predicting import horizon_name, main_horizon
from evaluation.report.sheets import Sheet, lines, number, three_digits

SHOWN_EPISODES = 40


def difference_sheet(prediction: Prediction) -> Sheet | None:
    """Each model against the best at every horizon, with the interval of the difference; None with fewer than two."""
    horizons = prediction.horizons
    rankings = {horizon: prediction.ranking(horizon) for horizon in horizons}
    if not horizons or max(len(ranking) for ranking in rankings.values()) < 2:
        return None
    compared = {h: {d.first: d for d in prediction.differences(h)} for h in horizons}
    main = rankings[main_horizon(prediction)]
    names = [model.name for model in main] + [name for name in prediction.names if name not in {m.name for m in main}]
    rows = [
        (name, *(_against(compared[h].get(name), bool(rankings[h]) and rankings[h][0].name == name) for h in horizons))
        for name in names
    ]
    confidence = percent(prediction.cases.protocol.confidence)
    return Sheet(
        "N above the best",
        ("model", *(horizon_name(prediction, h).replace(" (", "\n(") for h in horizons)),
        tuple(rows),
        note=f"N minus that of the best model there, with its {confidence} interval by paired block bootstrap: both "
        "meet the same windows in every draw. An interval that holds 0 is no significant difference.",
    )


def residual_sheet(prediction: Prediction) -> Sheet | None:
    """What one-step errors still hold: whether they are white, and which earlier controls show; None without any."""
    system, models = prediction.cases.system, [m for m in prediction.models if m.residuals is not None]
    if not models:
        return None
    rows = [(m.name, *(_left(m, prediction, channel) for channel in range(system.nx))) for m in models]
    return Sheet(
        "What is left one step ahead",
        ("model", *system.state_names),
        tuple(rows),
        note="White: nothing in the one-step error foretells the next one. Not white: the correlation with an earlier "
        "error. A control and a time: what it was set to that long before the step still shows in the error, with the "
        f"correlation; both at {100 * LEVEL:g} %, all lags together.",
        details=True,
    )


def region_sheet(prediction: Prediction) -> Sheet | None:
    """Where each model's error is clearly largest; None without scores."""
    steps, models = prediction.cases.near_horizon, [m for m in prediction.models if m.regions]
    if steps is None or not models:
        return None
    rows = []
    for model in models:
        worst = worst_region(model.regions)
        if worst is None:
            rows.append((model.name, "nowhere clearly", "–", "–"))
            continue
        low, high = worst.interval
        times = lines(f"{worst.ratio:.1f}", f"{low:.1f}-{high:.1f}")
        rows.append((model.name, worst.region.words, times, percent(worst.share)))
    return Sheet(
        "Where the error is largest",
        ("model", "windows that start at", "times N\nof all", "share"),
        tuple(rows),
        note=f"N after {horizon_name(prediction, steps)} of the windows that start with this state or control, divided "
        "by that of all windows. Of every channel the lowest and highest fifth are looked at, and that farthest from "
        "neutral; intervals allow for looking at all of them.",
        details=True,
    )


def episode_error_sheet(prediction: Prediction) -> Sheet | None:
    """N of every model in each test episode; None with fewer than two episodes."""
    horizon, models = main_horizon(prediction), [m for m in prediction.models if m.episodes]
    if horizon is None or not models or len(models[0].episodes) < 2:
        return None
    place = prediction.cases.horizons.index(horizon)
    rows = [
        (episode.name, *(three_digits(model.episodes[row].n[place]) for model in models))
        for row, episode in enumerate(models[0].episodes[:SHOWN_EPISODES])
    ]
    return Sheet(
        f"N of each test episode, {horizon_name(prediction, horizon)}",
        ("episode", *(model.name for model in models)),
        tuple(rows),
        note="In units of the standard deviation of the whole test set, so that episodes can be compared.",
        details=True,
    )


def fit_sheet(prediction: Prediction) -> Sheet | None:
    """Fit in free run as MATLAB's ``compare`` shows it; None without a free run."""
    fits = {m.name: np.array([e.fit for e in m.episodes if np.isfinite(e.fit).any()]) for m in prediction.models}
    fits = {name: values for name, values in fits.items() if len(values)}
    if not fits:
        return None
    return Sheet(
        "Fit in free run (%)",
        ("model", *prediction.cases.system.state_names),
        tuple((lines(name, _clipped(prediction.model(name))), *map(_fit, values.T)) for name, values in fits.items()),
        note="100 (1 - norm(y - yhat) / norm(y - mean(y))), the fit that MATLAB's compare shows: 100 is perfect, 0 as "
        "good as the mean, below 0 worse. Of several test episodes the mean, and below it the range. clip: free runs "
        "that reached their clip, and the median time until then.",
        details=True,
    )


def _against(difference: Difference | None, best: bool) -> str:
    if difference is None:
        return "best" if best else "–"
    low, high = difference.interval
    between = f"{_signed(low)} to {_signed(high)}"
    return lines(
        _signed(difference.difference), between, "" if difference.significant else "no significant\ndifference"
    )


def _signed(value: float) -> str:
    return f"{'-' if value < 0.0 else '+'}{three_digits(abs(value))}"


def _left(model: ModelPrediction, prediction: Prediction, channel: int) -> str:
    found, dt = model.residuals, prediction.cases.system.dt
    assert found is not None
    if not np.isfinite(found.white_p[channel]):
        return "–"
    colour = "white"
    if not found.white[channel]:
        lag = found.largest_lag(channel)
        colour = lines("not white", f"{found.autocorrelation[lag - 1, channel]:+.2f} after {lag * dt:g} s")
    shown = []
    for place, control in enumerate(prediction.cases.system.control_names):
        if found.cross_p[place, channel] < LEVEL / prediction.cases.system.nu:
            lag = found.control_lag(place, channel)
            shown.append(f"{control}, {lag * dt:g} s: {found.cross_at(lag)[place, channel]:+.2f}")
    return lines(colour, *shown)


def _clipped(model: ModelPrediction) -> str:
    """Say in how many free runs a model reached its clip, and when."""
    times = () if model.divergence is None else model.divergence.free_run_times
    hit = [time for time in times if time is not None]
    return f"clip {len(hit)} of {len(times)}, {np.median(hit):.1f} s" if hit else ""


def _fit(values: np.ndarray) -> str:
    known = values[np.isfinite(values)]
    if not len(known):
        return "–"
    spread = f"{known.min():.1f} to {known.max():.1f}" if len(known) > 1 else ""
    return lines(number(float(known.mean())), spread)
