"""Analysis of errors: regions, residuals, episodes, states. A part of Prediction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from evaluation.formatting import horizon_name, lines, percent, three_digits
from evaluation.plots import plot_residual_correlation
from evaluation.prediction.regions import Region, worst_region
from evaluation.prediction.residuals import AHEAD, LAGS, LEVEL, Residuals
from evaluation.prediction.scores import PERSISTENCE, ModelPrediction, Prediction
from evaluation.report.document import Interval, Number, Numbers, Part
from evaluation.report.elements import THIRD, Drawing, DrawingPair, FigureElement, TableElement
from sysid_evo.system import System

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def region_sheet(prediction: Prediction) -> TableElement | None:
    """Return where the error of each model is clearly largest; None without scores."""
    steps, models = prediction.cases.near_horizon, [m for m in prediction.models if m.regions]
    if steps is None or not models:
        return None
    rows = []
    for model in models:
        worst = worst_region(model.regions)
        if worst is None:
            rows.append((model.name, "no region clearly", "–", "–"))
            continue
        times = lines(f"{worst.ratio.value:.1f}", f"{worst.ratio.low:.1f} to {worst.ratio.high:.1f}")
        rows.append((model.name, worst.region.words, times, percent(worst.share)))
    return TableElement(
        "Where the error is largest",
        ("model", "windows that start at", "N / N of\nall windows", "share of\nwindows"),
        tuple(rows),
        note=f"N after {horizon_name(steps, prediction.cases.system.dt)} of the windows that start with this state or "
        "control, divided by that of all windows. For every channel the lowest and the highest fifth are tested, and "
        "the fifth farthest from neutral; intervals allow for the number of tests.",
        details=True,
    )


def residual_sheet(prediction: Prediction) -> TableElement | None:
    """Return whether one-step residuals are white, and correlated with which controls; None without residuals."""
    system, models = prediction.cases.system, [m for m in prediction.models if m.residuals is not None]
    if not models:
        return None
    rows = [(m.name, *(_left(m, prediction, channel) for channel in range(system.nx))) for m in models]
    return TableElement(
        "White or correlated",
        ("model", *system.state_names),
        tuple(rows),
        note="White: a residual is not correlated with earlier ones. Correlated (not white): the largest correlation "
        "with an earlier residual, and its lag. A control and a time: the residual is correlated with the control that "
        f"long before the step. Both tests have a level of {100 * LEVEL:g} % for all lags together.",
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
        colour = lines(
            "correlated (not white)", f"{found.autocorrelation[lag - 1, channel]:+z.2f} after {lag * dt:g} s"
        )
    shown = []
    for place, control in enumerate(prediction.cases.system.control_names):
        if found.cross_p[place, channel] < LEVEL / prediction.cases.system.nu:
            lag = found.control_lag(place, channel)
            shown.append(f"{control}, {lag * dt:g} s: {found.cross[AHEAD + lag, place, channel]:+z.2f}")
    return lines(colour, *shown)


SHOWN_MODELS = 2
"""Models whose residuals are shown at first, the best ones; a reader may show the others."""


def residual_picture(prediction: Prediction) -> FigureElement | None:
    """Return the correlation of one-step residuals with earlier ones and with controls; None without residuals."""
    found = [(m, m.residuals) for m in prediction.models if m.residuals is not None and m.name != PERSISTENCE]
    names = [model.name for model, residuals in found if np.isfinite(residuals.autocorrelation).any()]
    if not names:
        return None
    ranked = [model.name for model in prediction.ranking(prediction.cases.main_horizon) if model.name in names]
    off = frozenset(set(names) - set(ranked[:SHOWN_MODELS]))
    panels = []
    for j, control in enumerate((None, *prediction.cases.system.control_names)):
        for i, state in enumerate(prediction.cases.system.state_names):

            def draw(figure: Figure, i: int = i, j: int = j) -> None:
                plot_residual_correlation(prediction, names, i, j - 1 if j else None, figure.add_subplot())

            title = f"{state} and {control or 'earlier residuals'}"
            label = f"correlation of residuals, {title}"
            drawing = Drawing(f"residuals-{i}-{j}", label, draw, THIRD, 2.0, keyed=True, off=off)
            panels.append(DrawingPair(drawing, title=title))
    return FigureElement(
        "Correlation of one-step residuals",
        "With earlier residuals, and with controls that long before the step. Dotted: the "
        f"{percent(1.0 - LEVEL)} band for uncorrelated residuals, the widest of all models. Beyond it the model misses "
        "something; before lag 0 of a control a driver who reacts shows. The best "
        f"{min(SHOWN_MODELS, len(ranked))} of {len(names)} models are shown at first.",
        tuple(panels),
        columns=3,
    )


SHOWN_EPISODES = 40
"""Test episodes in a table; ``report.json`` has all."""


def episode_error_sheet(prediction: Prediction) -> TableElement | None:
    """Return N of every model in each test episode; None with fewer than two episodes."""
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
        note="In standard deviations of all test data, so that episodes can be compared.",
        details=True,
    )


class ControlCorrelationPart(Part):
    """Correlation of the one-step residual with a control, at ``control_lags``; its probability if unrelated, ``p``."""

    p: Number
    correlation: Numbers
    band: Numbers


class ResidualPart(Part):
    """Correlation of the one-step residual of a state with earlier ones and with controls, with its 95 % bands."""

    white: bool
    white_p: Number
    autocorrelation: Numbers
    band: Numbers
    controls: dict[str, ControlCorrelationPart]


class ResidualsPart(Part):
    """One-step residuals of a model, by state; lags in steps."""

    samples: int
    control_lags: tuple[int, ...]
    channels: dict[str, ResidualPart]

    @classmethod
    def of(cls, found: Residuals, system: System) -> ResidualsPart:
        """Return the residuals with the names of states and controls."""
        channels = {
            name: ResidualPart(
                white=bool(found.white[i]),
                white_p=found.white_p[i],
                autocorrelation=tuple(found.autocorrelation[:, i]),
                band=tuple(found.band[:, i]),
                controls={
                    control: ControlCorrelationPart(
                        p=found.cross_p[j, i],
                        correlation=tuple(found.cross[:, j, i]),
                        band=tuple(found.cross_band[:, j, i]),
                    )
                    for j, control in enumerate(system.control_names)
                },
            )
            for i, name in enumerate(system.state_names)
        }
        return cls(samples=found.samples, control_lags=tuple(range(-AHEAD, LAGS + 1)), channels=channels)


class RegionErrorPart(Part):
    """N of the windows that start in a region, a ``share`` of all, and its ratio to the N of all windows."""

    words: str
    region: Region
    share: Number
    n: Number
    ratio: Number
    interval: Interval


class EpisodeErrorPart(Part):
    """Errors of one test episode: N by the number of steps, and fit % of each state over the whole episode."""

    name: str
    n: dict[str, Number]
    fit_percent: dict[str, Number]


class ModelErrorsPart(Part):
    """Where the errors of one model are, and how its residuals are correlated."""

    name: str
    residuals: ResidualsPart | None
    regions: tuple[RegionErrorPart, ...]
    episodes: tuple[EpisodeErrorPart, ...]

    @classmethod
    def of(cls, model: ModelPrediction, prediction: Prediction) -> ModelErrorsPart:
        """Return the errors of a model with the names of states and horizons."""
        system, horizons = prediction.cases.system, [str(horizon) for horizon in prediction.cases.horizons]
        return cls.made_of(
            model,
            residuals=None if model.residuals is None else ResidualsPart.of(model.residuals, system),
            regions=[
                RegionErrorPart.made_of(one, ratio=one.ratio.value, interval=one.ratio.interval)
                for one in model.regions
            ],
            episodes=[
                EpisodeErrorPart(
                    name=one.name,
                    n=dict(zip(horizons, one.n, strict=True)),
                    fit_percent=dict(zip(system.state_names, one.fit, strict=True)),
                )
                for one in model.episodes
            ],
        )


class ErrorAnalysisPart(Part):
    """Where the errors of each model are: regions, episodes, correlation of one-step residuals."""

    models: tuple[ModelErrorsPart, ...]

    @classmethod
    def of(cls, prediction: Prediction) -> ErrorAnalysisPart:
        """Return the analysis of all models."""
        return cls(models=tuple(ModelErrorsPart.of(model, prediction) for model in prediction.models))
