"""The figures of a report: drawings inside the page, each for a wide screen and for a phone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from evaluation.labels import folded
from evaluation.plots import (
    plot_claims,
    plot_fitness,
    plot_free_run,
    plot_horizon_curve,
    plot_state,
    plot_trace,
    plotted_places,
)
from evaluation.prediction import PERSISTENCE, Prediction
from evaluation.prediction.metrics import mean_over_channels
from evaluation.report.drawing import Drawing, Panel, Picture
from evaluation.report.replay import is_planar
from evaluation.transfer import Trace, TransferMatrix, TransferSummary
from sysid_evo.evolution import Champion

WIDE, NARROW, THIRD, QUARTER = 9.6, 3.55, 3.2, 2.6
"""Widths in inches: the page, a phone, and panels beside each other."""
SQUARE = (0.19, 0.17, 0.79, 0.79)
"""Left, bottom, width and height of the axes of a trace, as shares of its drawing."""
SHOWN_MODELS = 5
SHOWN_TRACES = 24
OVER_TIME = "Blue: what the states did, grey: what they were to do, with the tolerance"


def horizon_picture(prediction: Prediction) -> Picture:
    """N over the horizon."""

    def draw(figure: Figure) -> None:
        plot_horizon_curve(prediction, figure.add_subplot())

    return Picture(
        "Error over the horizon",
        "N at every step of a free run under recorded controls from measured states "
        f"({prediction.cases.protocol.history_in_words}). Bands: intervals of the block bootstrap. Vertical "
        "lines: the horizons of the table.",
        (_both("horizon", "N over the horizon, a line for each model", draw, 3.6, 2.9),),
    )


def free_run_picture(prediction: Prediction) -> Picture:
    """Measured and predicted states in free run, one plot for each channel."""
    ranked = [model.name for model in prediction.ranking(None) if model.name != PERSISTENCE]
    best, rest = ([name for name in prediction.names if name in part] for part in _parted(ranked))
    run, nx = _liveliest(prediction), prediction.cases.system.nx

    def draw(figure: Figure) -> None:
        plots = figure.subplots(nx, 1, sharex=True, squeeze=False)[:, 0]
        for channel, ax in enumerate(plots):
            plot_free_run(prediction, channel, models=best, besides=rest, run=run, ax=ax)
            ax.label_outer()
        figure.align_ylabels(plots)

    label = "states in free run, measured and predicted"
    left_out = f"; the {SHOWN_MODELS} best of {len(ranked)} models are switched on" if rest else ""
    return Picture(
        "Predicted and measured",
        f"Free run of {prediction.cases.free_runs[run].episode!r} from its sample {prediction.cases.protocol.first}, "
        f"under its recorded controls; at most 15 s from the first movement{left_out}.",
        (_both("free-run", label, draw, 0.5 + 1.5 * nx, 0.5 + 1.5 * nx, off=frozenset(rest)),),
    )


def claims_picture(matrix: TransferMatrix, summary: TransferSummary) -> Picture:
    """Claimed and achieved fitness of each controller."""
    names = [controller.name for controller in summary.controllers]

    def drawn(key: str, width: float, name_width: int) -> Drawing:
        lines = max(folded(name, name_width).count("\n") + 1 for name in names)
        height = 1.4 + (0.2 + 0.1 * lines) * len(names)
        return Drawing(
            key,
            "claimed and achieved fitness of each controller",
            lambda figure: plot_claims(summary, figure.add_subplot(), unit=matrix.unit, name_width=name_width),
            width,
            height,
            keyed=True,
        )

    several = any(len(controller.seed_fitness) > 1 for controller in summary.controllers)
    ticks = " Ticks: the champion of each evolution run." if several else ""
    return Picture(
        "Claimed and achieved",
        f"Bars are 90 % intervals over trials, those of the table below.{ticks}",
        (Panel(drawn("claims", WIDE, 26), drawn("claims-narrow", NARROW, 13)),),
    )


def fitness_picture(matrix: TransferMatrix) -> Picture | None:
    """Fitness over generations, one panel for each champion; None if there is no history."""
    champions = [champion for champion in matrix.champions if len(champion.history)]
    if not champions:
        return None
    everything = np.concatenate([champion.history for champion in champions])
    margin = 0.05 * (float(np.ptp(everything)) or 1.0)
    panels: list[Panel] = []
    for number, champion in enumerate(champions):

        def draw(figure: Figure, champion: Champion = champion) -> None:
            ax = plot_fitness(champion, figure.add_subplot(), unit=matrix.unit)
            ax.set_ylim(everything.min() - margin, everything.max() + margin)

        label = f"fitness of {champion.name} over generations"
        panels.append(Panel(Drawing(f"fitness-{number}", label, draw, THIRD, 2.1, keyed=True), title=champion.name))
    return Picture(
        "Fitness over generations",
        "Best, mean and worst of the candidates that count in each generation, on the models evolved against, "
        "in the trials of that generation.",
        tuple(panels),
        columns=3,
    )


def traces_picture(matrix: TransferMatrix) -> Picture | None:
    """What each controller did in its own model and on the robot, in the first trial: its path, or its states."""
    found = [(name, column, trace) for name in matrix.rows for column, trace in _traces(name, matrix)]
    if not found:
        return None
    paths = all(is_planar(trace) and not trace.targets for _, _, trace in found)
    panels = []
    for number, (name, column, trace) in enumerate(found[:SHOWN_TRACES]):
        label = f"{name} on {column}"
        drawing = _path(number, label, trace) if paths else _over_time(number, label, trace, _champion(name, matrix))
        panels.append(Panel(drawing, title=label, note=f"{trace.fitness:.4g} {matrix.unit}".strip()))
    left_out = " The first controllers only." if len(found) > SHOWN_TRACES else ""
    drawn = _path_words([trace for _, _, trace in found]) if paths else OVER_TIME
    return Picture(
        "Traces",
        f"{drawn}; the first trial, the same for all.{left_out}",
        tuple(panels),
        columns=4 if paths else 3,
    )


def _path_words(traces: Sequence[Trace]) -> str:
    walls = ", between the walls (grey)" if any(trace.walls for trace in traces) else ""
    waypoints = ", through the waypoints in order (green: passed)" if any(len(t.waypoints) for t in traces) else ""
    return f"Blue: forwards, orange: backwards; from the dot{walls}{waypoints}. Positions in metres"


def _path(number: int, label: str, trace: Trace) -> Drawing:
    def draw(figure: Figure) -> None:
        figure.set_layout_engine("none")
        plot_trace(trace, figure.add_axes(SQUARE))

    return Drawing(f"trace-{number}", f"path of {label}", draw, QUARTER, QUARTER)


def _over_time(number: int, label: str, trace: Trace, champion: Champion) -> Drawing:
    system = champion.system
    assert system is not None
    places = plotted_places(trace, system)

    def draw(figure: Figure) -> None:
        for place, ax in zip(places, figure.subplots(len(places), 1, sharex=True, squeeze=False)[:, 0], strict=True):
            plot_state(trace, system, place, ax)
            ax.label_outer()

    height = 0.5 + 1.3 * len(places)
    return Drawing(f"trace-{number}", f"states of {label} over time", draw, THIRD, height)


def _both(
    key: str,
    label: str,
    draw: Callable[[Figure], object],
    height: float,
    narrow_height: float,
    *,
    off: frozenset[str] = frozenset(),
) -> Panel:
    """Return a keyed drawing for a wide screen and for a phone, heights in inches."""
    wide = Drawing(key, label, draw, WIDE, height, keyed=True, off=off)
    return Panel(wide, replace(wide, key=f"{key}-narrow", width=NARROW, height=narrow_height))


def _parted(ranked: Sequence[str]) -> tuple[Sequence[str], Sequence[str]]:
    """Return the models that are shown at once, and those that a reader may switch on."""
    return ranked[:SHOWN_MODELS], ranked[SHOWN_MODELS:]


def _liveliest(prediction: Prediction) -> int:
    """Return the free run whose states vary most, in the scale of the test set."""
    cases = prediction.cases
    spread = [
        mean_over_channels(run.states.std(axis=0) / np.where(cases.std > 0, cases.std, np.nan))
        for run in cases.free_runs
    ]
    return int(np.argmax(spread))


def _champion(name: str, matrix: TransferMatrix) -> Champion:
    return next(champion for champion in matrix.champions if champion.name == name)


def _traces(name: str, matrix: TransferMatrix) -> Sequence[tuple[str, Trace]]:
    """Return the first trace of a champion on a model it was evolved against, and on the robot."""
    champion = _champion(name, matrix)

    def first(column: str) -> Trace | None:
        traces = matrix.cell(name, column).traces
        shown = bool(traces) and (is_planar(traces[0]) or champion.system is not None)
        return traces[0] if shown else None

    own = next((column for column in champion.against if column in matrix.models and first(column) is not None), None)
    columns = [column for column in (own, matrix.robot) if column is not None]
    return [(column, trace) for column in columns if (trace := first(column)) is not None]
