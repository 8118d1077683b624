"""Plots of results, for the report and for notebooks; each draws on axes and returns them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.exploitability.results import ModelExploitability
from evaluation.formatting import by_error, folded
from evaluation.plot_style import COLOURS, MEASURED, REFERENCE, axes_or_new, draw_band, line_style
from evaluation.prediction.scores import PERSISTENCE, Prediction
from evaluation.sufficiency import tells_apart
from evaluation.transfer.matrix import NOT_RUN, Trace, TransferMatrix
from evaluation.transfer.summary import TransferSummary
from sysid_evo.angles import rotate, wrap
from sysid_evo.errors import InvalidData
from sysid_evo.evolution import Champion
from sysid_evo.system import System
from sysid_evo.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes


MARKS = (
    ("claimed", "claimed (where evolved)", "o", "none", COLOURS[0]),
    ("other_models", "mean on other models", "s", COLOURS[5], COLOURS[5]),
    ("other_families", "median on other families", "D", COLOURS[4], COLOURS[4]),
    ("achieved", "achieved on the robot", "o", COLOURS[1], COLOURS[1]),
)


def plot_transfer(matrix: TransferMatrix, ax: Axes | None = None) -> Axes:
    """Draw mean fitness (and standard deviation over trials) of every controller on every system.

    A black frame marks the models a controller was evolved against; a line separates the robot.
    """
    from matplotlib.patches import Rectangle

    rows, columns = len(matrix.rows), len(matrix.columns)
    ax = axes_or_new(ax, 1.8 + 0.95 * columns, 1.3 + 0.46 * rows)
    means, stds = matrix.means(), matrix.stds()
    top = float(np.nanmax(means)) if np.isfinite(means).any() else 1.0
    low = min(0.0, float(np.nanmin(means))) if np.isfinite(means).any() else 0.0
    image = ax.imshow(np.ma.masked_invalid(means), cmap="YlGnBu", vmin=low, vmax=max(top, low + 1e-9), aspect="auto")
    for i, champion in enumerate(matrix.champions):
        for j, column in enumerate(matrix.columns):
            if column in champion.against:
                ax.add_patch(Rectangle((j - 0.48, i - 0.47), 0.96, 0.94, fill=False, edgecolor=MEASURED, linewidth=1.6))
            dark = np.isfinite(means[i, j]) and (means[i, j] - low) > 0.6 * (top - low)
            error = matrix.cell(champion.name, column).standard_error
            spread = f"\n({by_error(stds[i, j], error)})" if np.isfinite(stds[i, j]) else ""
            text = f"{by_error(means[i, j], error)}{spread}"
            if not np.isfinite(means[i, j]):
                text = "–" if matrix.cell(champion.name, column).reason == NOT_RUN else "failed"
            ax.text(j, i, text, ha="center", va="center", fontsize=8, color="white" if dark else MEASURED)
    if matrix.robot is not None and columns > 1:
        ax.axvline(columns - 1.5, color=MEASURED, linewidth=2.0)
    _as_table(ax, [folded(c) for c in matrix.columns], [folded(name, 26) for name in matrix.rows])
    ax.xaxis.set_label_position("top")
    ax.set_xlabel("run on", labelpad=8, fontweight="bold")
    ax.set_ylabel("controller", fontweight="bold")
    unit = f" ({matrix.unit})" if matrix.unit else ""
    ax.figure.colorbar(image, ax=ax, label=f"mean fitness{unit}", fraction=0.05, pad=0.02)
    return ax


def plot_claims(summary: TransferSummary, ax: Axes | None = None, *, unit: str = "", name_width: int = 26) -> Axes:
    """Draw, for each controller, claimed fitness and fitness elsewhere, with intervals.

    Ticks below a claim are the champions of several evolution runs. Names are folded to ``name_width``.
    """
    ax = axes_or_new(ax, 7.0, 1.2 + 0.34 * len(summary.controllers))
    for kind, label, marker, face, edge in MARKS:
        found = [
            (row, estimate)
            for row, controller in enumerate(summary.controllers)
            if (estimate := getattr(controller, kind)) is not None
        ]
        if found:
            value, low, high = np.array([(one.value, one.low, one.high) for _, one in found]).T
            ax.errorbar(
                value,
                [row for row, _ in found],
                xerr=np.nan_to_num(np.maximum([value - low, high - value], 0.0)),
                fmt=marker,
                markersize=6,
                markerfacecolor=face,
                markeredgecolor=edge,
                ecolor=edge,
                elinewidth=1.0,
                label=label,
            )
    for row, controller in enumerate(summary.controllers):
        values = [one.value for kind, *_ in MARKS if (one := getattr(controller, kind)) is not None]
        if len(values) > 1:
            ax.plot([min(values), max(values)], [row, row], color=REFERENCE, linewidth=0.8, zorder=0)
        if len(controller.seed_fitness) > 1:
            each = controller.seed_fitness
            ax.plot(each, [row + 0.3] * len(each), "|", color=COLOURS[0], markersize=6)
    ax.set_yticks(range(len(summary.controllers)), [folded(c.name, name_width) for c in summary.controllers])
    ax.set_ylim(len(summary.controllers) - 0.5, -0.5)
    ax.set_xlim(min(0.0, ax.get_xlim()[0]), None)
    ax.set_xlabel(f"fitness ({unit})" if unit else "fitness")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2 if name_width > 20 else 1)
    return ax


REACH = 0.62
"""Rows over which the groups of one name are spread."""

MeanAndInterval = tuple[float, float, float]
"""A mean, and the low and high end of its interval; both equal the mean if there is none."""


def plot_spreads(
    spreads: Mapping[str, Mapping[str, MeanAndInterval]],
    ax: Axes | None = None,
    *,
    label: str,
    name_width: int = 26,
    line: float | None = None,
) -> Axes:
    """Draw means with their intervals, a row for each name, a colour for each group; ``line`` marks a value.

    ``spreads`` are by group and name: ``{"plain": {"linear": (0.8, 0.7, 0.9)}}``.
    """
    names = list(dict.fromkeys(name for found in spreads.values() for name in found))
    ax = axes_or_new(ax, 7.0, 1.2 + 0.4 * len(names))
    places = REACH * (np.arange(len(spreads)) / max(1, len(spreads) - 1) - 0.5) if len(spreads) > 1 else np.zeros(1)
    for number, (group, found) in enumerate(spreads.items()):
        rows = np.array([names.index(name) for name in found])
        values = np.array(list(found.values())).reshape(-1, 3)
        ends = np.abs(values[:, 1:] - values[:, :1]).T
        colour = COLOURS[number % len(COLOURS)]
        place = rows + np.clip(places[number], -0.49, 0.49)
        ax.errorbar(values[:, 0], place, xerr=ends, fmt="o", markersize=4.5, color=colour, label=group)
    if line is not None:
        ax.axvline(line, color=MEASURED, linewidth=0.9)
    ax.set_yticks(range(len(names)), [folded(name, name_width) for name in names])
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xlabel(label)
    if len(spreads) > 1:
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2 if name_width > 20 else 1)
    return ax


def plot_fitness(champion: Champion, ax: Axes | None = None, *, unit: str = "") -> Axes:
    """Draw best, mean and worst fitness of each generation of the evolution."""
    from matplotlib.ticker import MaxNLocator

    ax = axes_or_new(ax, 4.0, 2.8)
    generation = np.arange(1, len(champion.history) + 1)
    best, mean, worst = champion.history.T
    ax.fill_between(generation, worst, best, color=COLOURS[0], alpha=0.12, linewidth=0)
    ax.plot(generation, best, color=COLOURS[0], linewidth=1.2, label="best")
    ax.plot(generation, mean, color=COLOURS[1], linewidth=1.2, label="mean")
    ax.plot(generation, worst, color=REFERENCE, linewidth=0.8, label="worst")
    ax.xaxis.set_major_locator(MaxNLocator(nbins=5, integer=True))
    ax.set_xlabel("generation")
    ax.set_ylabel(f"fitness ({unit})" if unit else "fitness")
    return ax


LOWEST_N = 1e-3
"""Lowest N on the logarithmic axis."""

OPAQUE = 0.13
"""How opaque an interval is drawn."""
"""Opacity of an interval."""


def plot_horizon_curve(prediction: Prediction, ax: Axes | None = None) -> Axes:
    """Draw N after every step, from measured states, for each model, with its interval as a band."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    ax = axes_or_new(ax)
    dt, last = prediction.cases.system.dt, max(prediction.cases.horizons, default=None)
    drawn, banded = [], tells_apart(prediction, last)
    for model in prediction.models:
        if len(model.curve) and np.isfinite(model.curve).any():
            seconds = dt * np.arange(1.0, len(model.curve) + 1.0)
            curve = np.maximum(model.curve, LOWEST_N)
            ax.plot(seconds, curve, label=model.name, linewidth=1.6, **model_style(prediction, model.name))
            if banded and model.curve_interval.shape[1] == len(curve):
                low, high = np.maximum(model.curve_interval, LOWEST_N)
                colour = model_style(prediction, model.name)["color"]
                draw_band(ax, model.name, seconds, low, high, color=colour, alpha=OPAQUE)
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
        ax.set_ylim(max(LOWEST_N, 0.8 * values.min()), 1.25 * values.max())
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
    """Draw one state channel as measured and as simulated from the start of an episode.

    ``seconds`` is the part to show (default: 15 s from the first movement); values beyond three half ranges of the
    measurement there are cut off. The models ``besides`` are drawn, too, if their values are in that range.
    """
    ax = axes_or_new(ax)
    cases = prediction.cases
    case, dt = cases.free_runs[run], cases.system.dt
    first, last = excerpt(prediction, run) if seconds is None else seconds
    begin = cases.protocol.first + 1
    time = dt * (begin + np.arange(len(case.states)))
    shown = (time >= first) & (time <= last)
    measured = _continuous(cases.system, case.states[shown], channel)
    ax.plot(time[shown], measured, color=MEASURED, linewidth=2.2, label="measured", alpha=0.85)

    def draw(names: Sequence[str]) -> None:
        for name in names:
            states = _continuous(cases.system, prediction.model(name).free_states[run][shown], channel)
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


def _continuous(system: System, states: Array, channel: int) -> Array:
    """Return one channel of a run (T, nx) to draw; a periodic one is wrapped, and its line breaks at a jump."""
    values = np.array(system.wrap(states)[:, channel])
    if channel in system.periods:
        values[1:][np.abs(np.diff(values)) > 0.5 * system.periods[channel]] = np.nan
    return values


def excerpt(prediction: Prediction, run: int = 0, length: float = 15.0) -> tuple[float, float]:
    """Return the first and last second of ``length`` seconds from the first movement of a simulation."""
    case, dt = prediction.cases.free_runs[run], prediction.cases.system.dt
    moving = np.flatnonzero(case.moving)
    offset = prediction.cases.protocol.first + 1
    first = max(0, min(int(moving[0]) if len(moving) else 0, len(case.states) - round(length / dt)))
    return (offset + first) * dt, min(offset + first + round(length / dt), offset + len(case.states) - 1) * dt


def model_style(prediction: Prediction, name: str) -> dict[str, Any]:
    """Return the line style of a model, the same in every plot; persistence is grey."""
    if name == PERSISTENCE:
        return {"color": REFERENCE, "linestyle": "--"}
    return line_style([other for other in prediction.names if other != PERSISTENCE].index(name))


FORWARD, BACKWARD, PASSED = COLOURS[:3]


def plot_trace(trace: Trace, ax: Axes | None = None) -> Axes:
    """Draw the path (blue forwards, orange backwards), the walls and the numbered waypoints, in metres.

    Raises `InvalidData` for a trajectory without a pose in the plane.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Circle
    from matplotlib.ticker import MaxNLocator

    pose = trace.trajectory.pose
    if pose is None or pose.shape[1] != 3:
        raise InvalidData(f"trace {trace.trajectory.name!r}: expected a pose x, y, heading to draw")
    ax = axes_or_new(ax, 3.4, 3.4)
    for wall in trace.walls:
        ax.plot(*wall.T, color=REFERENCE, linewidth=0.9)
    ends = pose[:, :2]
    moved = np.diff(ends, axis=0)
    along, _ = rotate(moved[:, 0], moved[:, 1], -pose[:-1, 2])
    forwards = along >= 0
    runs = np.split(np.arange(len(moved)), np.flatnonzero(np.diff(forwards)) + 1)
    pieces = [ends[run[0] : run[-1] + 2] for run in runs if len(run)]
    colours = [FORWARD if forwards[run[0]] else BACKWARD for run in runs if len(run)]
    ax.add_collection(LineCollection(pieces, colors=colours, linewidths=1.0))
    for number, (x, y) in enumerate(trace.waypoints, start=1):
        reached = number < len(trace.waypoints)
        edge = PASSED if reached else REFERENCE
        if trace.waypoint_radius > 0:
            ax.add_patch(
                Circle((x, y), trace.waypoint_radius, facecolor=(edge, 0.14), edgecolor=(edge, 0.8), linewidth=0.7)
            )
        ax.text(x, y, str(number), ha="center", va="center", fontsize=7, color=edge, zorder=5)
    ax.plot(*ends[0], marker="o", color=MEASURED, markersize=4, linestyle="none")
    everything = np.concatenate([ends, trace.waypoints, *trace.walls])
    centre = (everything.max(axis=0) + everything.min(axis=0)) / 2.0
    least, margin = (0.0, 0.1) if trace.walls else (1.9, 0.4)
    half = max(least, float((everything.max(axis=0) - everything.min(axis=0)).max()) / 2.0 + margin)
    ax.set_xlim(centre[0] - half, centre[0] + half)
    ax.set_ylim(centre[1] - half, centre[1] + half)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(5, integer=True))
    ax.set_aspect("equal")
    ax.set_xlabel("x (m)")
    ax.set_ylabel("y (m)")
    return ax


def plot_state(trace: Trace, system: System, place: int, ax: Axes | None = None) -> Axes:
    """Draw one state over time (blue), its target (grey) and the tolerance around the target.

    A periodic state is drawn within half a period of its target, and its line breaks where it jumps.
    """
    ax = axes_or_new(ax, 3.4, 1.6)
    channel, values = system.states[place], trace.trajectory.states[:, place].copy()
    time = trace.trajectory.dt * np.arange(len(values))
    target = next((target for target in trace.targets if target.place == place), None)
    wanted = np.full(len(values), channel.neutral)
    if target is not None:
        wanted = target.values[np.minimum(np.arange(len(values)), len(target.values) - 1)]
        ax.fill_between(
            time, wanted - target.tolerance, wanted + target.tolerance, color=REFERENCE, alpha=0.2, linewidth=0
        )
        ax.plot(time, wanted, color=REFERENCE, linewidth=1.0)
    if channel.period is not None:
        values = wanted + wrap(values - wanted, channel.period)
        values[1:][np.abs(np.diff(values)) > 0.5 * channel.period] = np.nan
    ax.plot(time, values, color=FORWARD, linewidth=1.0)
    ax.set_xlim(0.0, time[-1])
    ax.set_xlabel("time (s)")
    ax.set_ylabel(f"{channel.name} ({channel.unit})" if channel.unit else channel.name)
    return ax


SHOWN_STATES = 3
"""Number of states that are drawn for a trial without targets."""


def plotted_states(trace: Trace, system: System) -> tuple[int, ...]:
    """Return the states of a trial to draw: those with a target, else the first ones."""
    return tuple(target.place for target in trace.targets) or tuple(range(min(SHOWN_STATES, system.nx)))


FAINTEST = 0.1
"""Share, in percent, from which a cell is coloured."""


def plot_probes(models: Sequence[ModelExploitability], ax: Axes | None = None) -> Axes:
    """Draw the share of visited steps beyond the limits of the data, in percent, by model and probe.

    A last row shows held-out data. Shares below 0.1 % stay white; the colours are logarithmic.
    """
    names = [probe.name for probe in models[0].probes]
    rows = [model.model for model in models] + ["held-out data"]
    shares = np.array(
        [[_percent(model.outside_visited), *(_percent(probe.visited) for probe in model.probes)] for model in models]
        + [[_percent(models[0].outside_held_out), *(_percent(probe.held_out) for probe in models[0].probes)]]
    )
    ax = axes_or_new(ax, 2.0 + 0.95 * shares.shape[1], 1.3 + 0.36 * len(rows))
    known = np.isfinite(shares)
    depth = np.log10(np.clip(np.where(known, shares, FAINTEST), FAINTEST, 100.0))
    shown = np.ma.masked_where(~known | (depth <= np.log10(FAINTEST)), depth)
    ax.imshow(shown, cmap="OrRd", vmin=np.log10(FAINTEST), vmax=2.0, aspect="auto")
    for i, j in np.ndindex(*shares.shape):
        share = shares[i, j]
        text = f"{share:.{1 if 0.0 < share < 10.0 else 0}f} %" if known[i, j] else "n/a"
        dark = known[i, j] and share > 20.0
        ax.text(j, i, text, ha="center", va="center", fontsize=8, color="white" if dark else MEASURED)
    ax.axhline(len(models) - 0.5, color=MEASURED, linewidth=1.5)
    ax.axvline(0.5, color=MEASURED, linewidth=1.5)
    labels = ["outside\nthe data", *(name.replace("_", "\n", 1).replace("_", " ") for name in names)]
    _as_table(ax, labels, rows)
    return ax


def _as_table(ax: Axes, columns: Sequence[str], rows: Sequence[str]) -> None:
    """Name columns above and rows next to a heat map, without ticks, grid and frame."""
    ax.set_xticks(range(len(columns)), columns)
    ax.set_yticks(range(len(rows)), rows)
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    ax.grid(visible=False)
    for spine in ax.spines.values():
        spine.set_visible(False)


def _percent(share: float | None) -> float:
    return float("nan") if share is None else 100.0 * share
