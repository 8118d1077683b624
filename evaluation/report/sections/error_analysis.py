"""Where errors are and what they still hold: regions, residuals, episodes, channels. A part of Prediction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from evaluation.formatting import horizon_name, lines, number, percent, three_digits
from evaluation.prediction.regions import worst_region
from evaluation.prediction.residuals import AHEAD, LAGS, LEVEL, Residuals
from evaluation.prediction.scores import EpisodeError, ModelPrediction, Prediction
from evaluation.report.elements import TableElement
from sysid_evo.system import System


def region_sheet(prediction: Prediction) -> TableElement | None:
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
        times = lines(f"{worst.ratio.value:.1f}", f"{worst.ratio.low:.1f}-{worst.ratio.high:.1f}")
        rows.append((model.name, worst.region.words, times, percent(worst.share)))
    return TableElement(
        "Where the error is largest",
        ("model", "windows that start at", "times N\nof all", "share"),
        tuple(rows),
        note=f"N after {horizon_name(steps, prediction.cases.system.dt)} of the windows that start with this state or "
        "control, divided by that of all windows. Of every channel the lowest and highest fifth are looked at, and "
        "that farthest from neutral; intervals allow for looking at all of them.",
        details=True,
    )


def residual_sheet(prediction: Prediction) -> TableElement | None:
    """What one-step errors still hold: whether they are white, and which earlier controls show; None without any."""
    system, models = prediction.cases.system, [m for m in prediction.models if m.residuals is not None]
    if not models:
        return None
    rows = [(m.name, *(_left(m, prediction, channel) for channel in range(system.nx))) for m in models]
    return TableElement(
        "What is left one step ahead",
        ("model", *system.state_names),
        tuple(rows),
        note="White: nothing in the one-step error foretells the next one. Not white: the correlation with an earlier "
        "error. A control and a time: what it was set to that long before the step still shows in the error, with the "
        f"correlation; both at {100 * LEVEL:g} %, all lags together.",
        details=True,
    )


def _left(model: ModelPrediction, prediction: Prediction, channel: int) -> str:
    found, dt = model.residuals, prediction.cases.system.dt
    assert found is not None
    if not np.isfinite(found.white_p[channel]):
        return "–"
    colour = "white"
    if not found.white[channel]:
        lag = found.largest_lag(channel)
        colour = lines("not white", f"{found.autocorrelation[lag - 1, channel]:+z.2f} after {lag * dt:g} s")
    shown = []
    for place, control in enumerate(prediction.cases.system.control_names):
        if found.cross_p[place, channel] < LEVEL / prediction.cases.system.nu:
            lag = found.control_lag(place, channel)
            shown.append(f"{control}, {lag * dt:g} s: {found.cross_at(lag)[place, channel]:+z.2f}")
    return lines(colour, *shown)


SHOWN_EPISODES = 40
"""Test episodes that a table lists; ``report.json`` has them all."""


def episode_error_sheet(prediction: Prediction) -> TableElement | None:
    """N of every model in each test episode; None with fewer than two episodes."""
    horizon, models = prediction.cases.main_horizon, [m for m in prediction.models if m.episodes]
    if horizon is None or not models or len(models[0].episodes) < 2:
        return None
    place = prediction.cases.horizons.index(horizon)
    rows = [
        (episode.name, *(three_digits(model.episodes[row].n[place]) for model in models))
        for row, episode in enumerate(models[0].episodes[:SHOWN_EPISODES])
    ]
    return TableElement(
        f"N of each test episode, {horizon_name(horizon, prediction.cases.system.dt)}",
        ("episode", *(model.name for model in models)),
        tuple(rows),
        note="In units of the standard deviation of the whole test set, so that episodes can be compared.",
        details=True,
    )


def fit_sheet(prediction: Prediction) -> TableElement | None:
    """Fit in free run as MATLAB's ``compare`` shows it; None without a free run."""
    fits = {m.name: np.array([e.fit for e in m.episodes if np.isfinite(e.fit).any()]) for m in prediction.models}
    fits = {name: values for name, values in fits.items() if len(values)}
    if not fits:
        return None
    return TableElement(
        "Fit in free run (%)",
        ("model", *prediction.cases.system.state_names),
        tuple((lines(name, _clipped(prediction.model(name))), *map(_fit, values.T)) for name, values in fits.items()),
        note="100 (1 - norm(y - yhat) / norm(y - mean(y))), the fit that MATLAB's compare shows: 100 is perfect, 0 as "
        "good as the mean, below 0 worse. Of several test episodes the mean, and below it the range. clip: free runs "
        "that reached their clip, and the median time until then.",
        details=True,
    )


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


def residuals_to_json(found: Residuals, system: System) -> dict[str, Any]:
    """Return what the document holds of a model's one-step errors."""
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


def episode_to_json(episode: EpisodeError, horizons: Sequence[int], system: System) -> dict[str, Any]:
    """Return what the document holds of a model's errors in one test episode."""
    return {
        "name": episode.name,
        "n": {str(horizon): n for horizon, n in zip(horizons, episode.n, strict=True)},
        "fit_percent": dict(zip(system.state_names, episode.fit, strict=True)),
    }
