"""The figures of a report, each a self-contained picture."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from evaluation.exploitability import ModelExploitability
from evaluation.labels import shortened
from evaluation.plots import (
    new_figure,
    plot_claims,
    plot_fitness,
    plot_free_run,
    plot_horizon_curve,
    plot_probes,
    plot_trace,
    plot_transfer,
    style,
    to_svg,
)
from evaluation.prediction import PERSISTENCE, Prediction
from evaluation.prediction.metrics import mean_over_channels
from evaluation.transfer import Trace, TransferMatrix, TransferSummary

Panels: TypeAlias = NDArray[Any]
"""Axes in rows and columns, as `Figure.subplots` returns them."""

WIDTH = 9.6  # inches, the width of the page
SHOWN_MODELS = 5
SHOWN_CHAMPIONS = 12


@dataclass(frozen=True)
class Picture:
    """An SVG; ``width`` is its share of the page's width, ``caption`` says what it shows."""

    title: str
    caption: str
    svg: str
    width: float

    @property
    def source(self) -> str:
        """The picture as a data URI."""
        return "data:image/svg+xml;base64," + base64.b64encode(self.svg.encode()).decode()


def horizon_picture(prediction: Prediction) -> Picture:
    """N over the horizon."""
    with style():
        figure = new_figure(WIDTH, 3.6)
        plot_horizon_curve(prediction, figure.add_subplot())
    return _picture(
        "Error over the horizon",
        "N at every step of a free run under recorded controls from measured states "
        f"({prediction.cases.protocol.history} samples of history). Vertical lines: the horizons of the table.",
        figure,
    )


def free_run_picture(prediction: Prediction) -> Picture:
    """Measured and predicted states in free run, one panel for each channel."""
    ranked = [model.name for model in prediction.ranking(None) if model.name != PERSISTENCE]
    models = [name for name in prediction.names if name in ranked[:SHOWN_MODELS]]
    nx = prediction.cases.system.nx
    run = _liveliest(prediction)
    with style():
        figure = new_figure(WIDTH, 0.7 + 1.7 * nx)
        panels = figure.subplots(nx, 1, sharex=True, squeeze=False)[:, 0]
        for channel, ax in enumerate(panels):
            plot_free_run(prediction, channel, models=models, run=run, ax=ax)
            ax.label_outer()
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=min(6, len(labels)))
    left_out = f"; the {SHOWN_MODELS} best of {len(ranked)} models" if len(ranked) > SHOWN_MODELS else ""
    return _picture(
        "Predicted and measured",
        f"Free run of {prediction.cases.free_runs[run].episode!r} from its sample {prediction.cases.protocol.first}, "
        f"under its recorded controls; at most 15 s from the first movement{left_out}.",
        figure,
    )


def fitness_picture(matrix: TransferMatrix) -> Picture | None:
    """Fitness over generations, one panel for each champion; None if there is no history."""
    champions = [champion for champion in matrix.champions if len(champion.history)]
    if not champions:
        return None
    columns = min(4, len(champions))
    rows = math.ceil(len(champions) / columns)
    with style():
        figure = new_figure(WIDTH * max(columns, 2) / 4, 0.6 + 1.9 * rows)
        panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
        for ax, champion in zip(panels.flat, champions, strict=False):
            plot_fitness(champion, ax, unit=matrix.unit)
            ax.set_title(shortened(champion.name, 26), fontsize=8)
        _hide(panels, len(champions))
        _outer(panels, len(champions))
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return _picture(
        "Fitness over generations",
        "Best, mean and worst of each generation on the models evolved against, in the trials of that generation.",
        figure,
        max(columns, 2) / 4,
    )


def transfer_picture(matrix: TransferMatrix) -> Picture:
    """The transfer matrix as a heat map."""
    width = min(WIDTH, 2.6 + 0.95 * len(matrix.columns))
    with style():
        figure = new_figure(width, 1.0 + 0.48 * len(matrix.rows))
        plot_transfer(matrix, figure.add_subplot())
    robot = " The robot stands right of the line." if matrix.robot is not None else ""
    return _picture(
        "Transfer matrix",
        f"Mean fitness (standard deviation over {matrix.trials} fresh trials) of each controller on each system. "
        f"Framed: the models it was evolved against.{robot}",
        figure,
        width / WIDTH,
    )


def claims_picture(matrix: TransferMatrix, summary: TransferSummary) -> Picture:
    """Claimed and achieved fitness of each controller."""
    with style():
        figure = new_figure(0.8 * WIDTH, 1.4 + 0.32 * len(summary.controllers))
        plot_claims(summary, figure.add_subplot(), unit=matrix.unit)
    return _picture("Claimed and achieved", "Bars are two standard errors over trials.", figure, 0.8)


def traces_picture(matrix: TransferMatrix) -> Picture | None:
    """Where each controller drove in its own model and on the robot, in the first trial of all."""
    found = [pair for name in matrix.rows for pair in _traces(name, matrix)]
    if not found:
        return None
    per_champion = 2 if matrix.robot is not None else 1
    shown = found[: SHOWN_CHAMPIONS * per_champion]
    columns = min(4, len(shown))
    rows = math.ceil(len(shown) / columns)
    with style():
        figure = new_figure(WIDTH * max(columns, 2) / 4, 3.0 * rows)
        panels = figure.subplots(rows, columns, squeeze=False)
        for ax, (title, trace) in zip(panels.flat, shown, strict=False):
            plot_trace(trace, ax)
            ax.set_title(f"{title}\n{trace.fitness:g} {matrix.unit}", fontsize=8)
        _hide(panels, len(shown))
    left_out = " The first controllers only." if len(shown) < len(found) else ""
    return _picture(
        "Traces",
        "Blue: forwards, orange: backwards; from the dot, through the waypoints in order (green: passed). Positions "
        f"in metres; the first trial, the same for all.{left_out}",
        figure,
        max(columns, 2) / 4,
    )


def probe_picture(models: Sequence[ModelExploitability]) -> Picture | None:
    """What controllers do in each model that the data do not show; None if nothing was visited."""
    seen = [model for model in models if model.outside_visited is not None]
    if not seen:
        return None
    columns = 1 + len(seen[0].probes)
    width = min(WIDTH, 2.2 + 1.0 * columns)
    with style():
        figure = new_figure(width, 0.9 + 0.34 * (len(seen) + 1))
        plot_probes(seen, figure.add_subplot())
    return _picture(
        "What controllers do that the data do not show",
        "Share of visited steps outside the training data, and beyond the 99.9 % quantile of each probe.",
        figure,
        width / WIDTH,
    )


def _liveliest(prediction: Prediction) -> int:
    """Return the free run whose states vary most, in the scale of the test set."""
    cases = prediction.cases
    spread = [
        mean_over_channels(run.states.std(axis=0) / np.where(cases.std > 0, cases.std, np.nan))
        for run in cases.free_runs
    ]
    return int(np.argmax(spread))


def _traces(name: str, matrix: TransferMatrix) -> list[tuple[str, Trace]]:
    """Return the first planar trace of a champion on a model it was evolved against, and on the robot."""
    champion = next(champion for champion in matrix.champions if champion.name == name)
    own = next((c for c in champion.against if c in matrix.models and _planar(matrix, name, c)), None)
    columns = [column for column in (own, matrix.robot) if column is not None and _planar(matrix, name, column)]
    titles = [f"{shortened(name, 24)}\non {shortened(column, 24)}" for column in columns]
    return [(title, matrix.cell(name, column).traces[0]) for title, column in zip(titles, columns, strict=True)]


def _planar(matrix: TransferMatrix, name: str, column: str) -> bool:
    traces = matrix.cell(name, column).traces
    pose = traces[0].trajectory.pose if traces else None
    return pose is not None and pose.shape[1] == 3


def _hide(panels: Panels, used: int) -> None:
    for ax in list(panels.flat)[used:]:
        ax.set_visible(False)


def _outer(panels: Panels, used: int) -> None:
    """Keep labels only at the left, and where no panel stands below."""
    columns = panels.shape[1]
    for i in range(used):
        if i % columns:
            panels.flat[i].set_ylabel("")
        if i + columns < used:
            panels.flat[i].set_xlabel("")


def _picture(title: str, caption: str, figure: Figure, width: float = 1.0) -> Picture:
    return Picture(title, caption, to_svg(figure), width)
