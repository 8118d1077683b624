"""Plots of prediction errors: N over the horizon, and predicted against measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from evaluation.plots.canvas import MEASURED, REFERENCE, Band, axes_or_new, line_style
from evaluation.prediction import PERSISTENCE, Prediction
from sysid_evo.arrays import Array
from sysid_evo.system import System

FLOOR = 1e-3
BAND = 0.13
"""How opaque an interval is drawn."""


def model_style(prediction: Prediction, name: str) -> dict[str, Any]:
    """Return how a model is drawn in every plot; persistence is grey."""
    if name == PERSISTENCE:
        return {"color": REFERENCE, "linestyle": "--"}
    return line_style([other for other in prediction.names if other != PERSISTENCE].index(name))


def plot_horizon_curve(prediction: Prediction, ax: Axes | None = None) -> Axes:
    """Draw N after every step, from measured states, for each model, with its interval as a band."""
    ax = axes_or_new(ax)
    dt = prediction.cases.system.dt
    drawn = []
    for model in prediction.models:
        if len(model.curve) and np.isfinite(model.curve).any():
            seconds = dt * np.arange(1.0, len(model.curve) + 1.0)
            curve = np.maximum(model.curve, FLOOR)
            ax.plot(seconds, curve, label=model.name, linewidth=1.6, **model_style(prediction, model.name))
            if model.curve_interval.shape[1] == len(curve):
                low, high = np.maximum(model.curve_interval, FLOOR)
                colour = model_style(prediction, model.name)["color"]
                ax.add_collection(Band(model.name, seconds, low, high, color=colour, alpha=BAND))
            drawn.append(curve[np.isfinite(curve)])
    for horizon in prediction.cases.horizons:
        ax.axvline(horizon * dt, color=REFERENCE, linewidth=0.6, alpha=0.5)
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("horizon (s)")
    ax.set_ylabel("N (standard deviations)")
    if drawn:
        values = np.concatenate(drawn)
        ax.set_ylim(max(FLOOR, 0.8 * values.min()), 1.25 * values.max())
        ax.set_xlim(0.0, None)
        ax.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return ax


def plot_free_run(
    prediction: Prediction,
    channel: int,
    *,
    models: Sequence[str] | None = None,
    besides: Sequence[str] = (),
    run: int = 0,
    seconds: tuple[float, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw one state channel as measured and as predicted in free run from the start of an episode.

    ``seconds`` is the part to show (default: 15 s from the first movement); values beyond three
    half ranges of what was measured there are cut off. The models ``besides`` are drawn too, as far as they fit.
    """
    ax = axes_or_new(ax)
    cases = prediction.cases
    case, dt = cases.free_runs[run], cases.system.dt
    first, last = excerpt(prediction, run) if seconds is None else seconds
    begin = cases.protocol.first + 1
    time = dt * (begin + np.arange(len(case.states)))
    shown = (time >= first) & (time <= last)
    measured = _drawn(cases.system, case.states[shown], channel)
    ax.plot(time[shown], measured, color=MEASURED, linewidth=2.2, label="measured", alpha=0.85)

    def draw(names: Sequence[str]) -> None:
        for name in names:
            states = _drawn(cases.system, prediction.model(name).free_states[run][shown], channel)
            ax.plot(time[shown], states, linewidth=1.1, label=name, **model_style(prediction, name))

    draw([m.name for m in prediction.models if m.free_states] if models is None else models)
    if len(measured):
        middle = (np.nanmax(measured) + np.nanmin(measured)) / 2.0
        half = (np.nanmax(measured) - np.nanmin(measured)) / 2.0
        low, high = ax.get_ylim()
        reach = 3.0 * max(half, 1e-9)
        ax.set_ylim(max(low, middle - reach), min(high, middle + reach))
    limits = ax.get_ylim()
    draw(besides)
    ax.set_ylim(*limits)
    state = cases.system.states[channel]
    ax.set_xlim(first, last)
    ax.set_ylabel(f"{state.name} ({state.unit})" if state.unit else state.name)
    ax.set_xlabel("time (s)")
    return ax


def _drawn(system: System, states: Array, channel: int) -> Array:
    """Return one channel of a run (T, nx) to draw; a periodic one is wrapped, and its line breaks at a jump."""
    values = np.array(system.wrapped(states)[:, channel])
    if channel in system.periods:
        values[1:][np.abs(np.diff(values)) > 0.5 * system.periods[channel]] = np.nan
    return values


def excerpt(prediction: Prediction, run: int = 0, length: float = 15.0) -> tuple[float, float]:
    """Return the first and last second of ``length`` seconds from the first movement of a free run."""
    case, dt = prediction.cases.free_runs[run], prediction.cases.system.dt
    moving = np.flatnonzero(case.moving)
    offset = prediction.cases.protocol.first + 1
    first = max(0, min(int(moving[0]) if len(moving) else 0, len(case.states) - round(length / dt)))
    return (offset + first) * dt, min(offset + first + round(length / dt), offset + len(case.states) - 1) * dt
