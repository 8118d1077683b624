"""Plots of results, for the report and for notebooks; each draws on axes and returns them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.formatting import folded
from evaluation.plot_style import COLOURS, MEASURED, REFERENCE, draw_band, line_style
from evaluation.prediction.residuals import AHEAD, LAGS
from evaluation.prediction.scores import PERSISTENCE, Prediction
from evaluation.sufficiency import tells_apart
from evaluation.transfer.matrix import Trace
from evaluation.transfer.summary import ControllerSummary
from sysid_evo.angles import rotate, wrap
from sysid_evo.errors import InvalidData
from sysid_evo.evolution import Champion
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plot_claimed_measured(
    controllers: Sequence[ControllerSummary],
    ax: Axes,
    *,
    unit: str = "",
    label: str,
    pick: str | None = None,
    letters: int = 22,
) -> Axes:
    """Draw claimed against measured fitness with intervals, a dot for each controller, and the diagonal.

    All controllers have claimed fitness, and are measured on the robot or on the other models; ``label`` names the
    second axis. Both labels break into lines that are shorter than the axes. Names are on the right in the order of the
    dots, cut to a number of ``letters``; that of the controller ``pick`` is bold. Exploited controllers are orange. The
    artists of controller i have the id ``link-i``.
    """
    pairs = [(one.claimed, one.elsewhere) for one in controllers]
    values = np.array([(a.value, b.value) for a, b in pairs if a is not None and b is not None])
    ends = np.array([(a.low, a.high, b.low, b.high) for a, b in pairs if a is not None and b is not None])
    known = np.concatenate([values.ravel(), ends[np.isfinite(ends)]])
    low, high = min(0.0, known.min()), known.max()
    margin = 0.04 * ((high - low) or 1.0)
    low, high = (low if low == 0.0 else low - margin), high + margin
    ax.plot([low, high], [low, high], color=REFERENCE, linewidth=0.9, zorder=1)
    ax.set_xlim(low, high)
    ax.set_ylim(low, high)
    order = np.argsort(-values[:, 1], kind="stable")
    top = min(0.97, (values[:, 1].max() - low) / (high - low) + 0.2)
    for place, i in zip(top - min(0.08, 0.97 / len(order)) * np.arange(len(order)), order, strict=True):
        one, (x, y) = controllers[i], values[i]
        colour = COLOURS[1] if one.exploited else COLOURS[0]
        left, right, bottom, top = np.where(np.isfinite(ends[i]), ends[i], [x, x, y, y])
        ax.plot([left, right, np.nan, x, x], [y, y, np.nan, bottom, top], color=colour, linewidth=1.0, gid=f"link-{i}")
        ax.plot(x, y, "o", color=colour, markersize=7, gid=f"link-{i}")
        ax.plot(x, y, "o", color=colour, alpha=0.0, markersize=20, gid=f"link-{i}")  # easier to hit
        ax.annotate(
            "",
            (x, y),
            xytext=(1.02, place),
            textcoords="axes fraction",
            arrowprops={"arrowstyle": "-", "color": REFERENCE, "linewidth": 0.4, "shrinkB": 3.5},
            annotation_clip=False,
        )
        name = one.name if len(one.name) <= letters else f"{one.name[: letters - 1]}…"
        weight = "bold" if one.name == pick else "normal"
        ax.text(1.03, place, name, transform=ax.transAxes, va="center", fontsize=8, weight=weight, gid=f"link-{i}")
    wrap_at = int(LETTERS_PER_INCH * ax.bbox.height / ax.figure.dpi)
    ax.set_xlabel(folded(f"claimed ({unit})" if unit else "claimed", wrap_at))
    ax.set_ylabel(folded(label, wrap_at))
    return ax


LETTERS_PER_INCH = 12
"""Letters of an axis label on an inch of the axes, wide ones such as "m" included."""

REACH = 0.62
"""Rows over which the groups of one name are spread."""

MeanAndInterval = tuple[float, float, float]
"""A mean, and the low and high end of its interval; both equal the mean if there is none."""


def plot_spreads(
    spreads: Mapping[str, Mapping[str, MeanAndInterval]],
    ax: Axes,
    *,
    label: str,
    name_width: int = 26,
    line: float | None = None,
) -> Axes:
    """Draw means with their intervals, a row for each name, a colour for each group; ``line`` marks a value.

    ``spreads`` are by group and name: ``{"plain": {"linear": (0.8, 0.7, 0.9)}}``.
    """
    names = list(dict.fromkeys(name for found in spreads.values() for name in found))
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


def plot_fitness(champion: Champion, ax: Axes, *, unit: str = "") -> Axes:
    """Draw best, mean and worst fitness of each generation of the evolution."""
    from matplotlib.ticker import MaxNLocator

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


def plot_horizon_curve(prediction: Prediction, ax: Axes) -> Axes:
    """Draw N after every step, from measured states, for each model, with its interval as a band."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    dt, last = prediction.cases.system.dt, max(prediction.cases.horizons, default=None)
    drawn, banded = [], tells_apart(prediction, last)
    for model in prediction.models:
        if len(model.curve) and np.isfinite(model.curve).any():
            seconds = dt * np.arange(1.0, len(model.curve) + 1.0)
            curve = np.maximum(model.curve, LOWEST_N)
            style = model_style(prediction, model.name)
            ax.plot(seconds, curve, label=model.name, linewidth=1.6, **style)
            if banded and model.curve_interval.shape[1] == len(curve):
                low, high = np.maximum(model.curve_interval, LOWEST_N)
                draw_band(ax, model.name, seconds, low, high, style["color"])
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


def plot_residual_correlation(
    prediction: Prediction, models: Sequence[str], state: int, control: int | None, ax: Axes
) -> Axes:
    """Draw the correlation of the one-step residuals of a state with earlier ones, or with a control, over the lag.

    Dotted lines are the widest band of ``models`` for uncorrelated residuals, see `Residuals`.
    """
    dt, bands = prediction.cases.system.dt, []
    lags = dt * (np.arange(1, LAGS + 1) if control is None else np.arange(-AHEAD, LAGS + 1))
    for name in models:
        found = prediction.model(name).residuals
        assert found is not None
        values = found.autocorrelation[:, state] if control is None else found.cross[:, control, state]
        bands.append(found.band[:, state] if control is None else found.cross_band[:, control, state])
        ax.plot(lags, values, label=name, linewidth=1.3, **model_style(prediction, name))
    known = np.array([band for band in bands if np.isfinite(band).all()])
    if len(known):
        for side in (-1.0, 1.0):
            ax.plot(lags, side * known.max(axis=0), color=REFERENCE, linestyle=":", linewidth=1.0)
    ax.axhline(0.0, color=REFERENCE, linewidth=0.6)
    ax.set_xlabel("lag (s)")
    ax.set_ylabel("correlation")
    return ax


def plot_free_run(
    prediction: Prediction,
    channel: int,
    ax: Axes,
    *,
    models: Sequence[str],
    besides: Sequence[str] = (),
    run: int = 0,
) -> Axes:
    """Draw one state channel as measured and as simulated from the start of an episode, 15 s from the first movement.

    Values beyond three half ranges of the measurement there are cut off. The models ``besides`` are drawn, too, if
    their values are in that range.
    """
    cases = prediction.cases
    case, dt = cases.free_runs[run], cases.system.dt
    first, last = excerpt(prediction, run)
    begin = cases.protocol.first + 1
    time = dt * (begin + np.arange(len(case.states)))
    shown = (time >= first) & (time <= last)
    measured = _continuous(cases.system, case.states[shown], channel)
    ax.plot(time[shown], measured, color=MEASURED, linewidth=2.2, label="measured", alpha=0.85)

    def draw(names: Sequence[str]) -> None:
        for name in names:
            states = _continuous(cases.system, prediction.model(name).free_states[run][shown], channel)
            ax.plot(time[shown], states, linewidth=1.1, label=name, **model_style(prediction, name))

    draw(models)
    if len(measured):
        middle = (np.nanmax(measured) + np.nanmin(measured)) / 2.0
        half = (np.nanmax(measured) - np.nanmin(measured)) / 2.0
        low, high = ax.get_ylim()
        reach = 3.0 * max(half, 1e-9)
        ax.set_ylim(max(low, middle - reach), min(high, middle + reach))
    limits = ax.get_ylim()
    draw(besides)
    ax.set_ylim(*limits)
    ax.set_xlim(first, last)
    ax.set_ylabel(with_unit(cases.system.states[channel]))
    ax.set_xlabel("time (s)")
    return ax


def _continuous(system: System, states: Array, channel: int) -> Array:
    """Return one channel of a run (T, nx) to draw; a periodic one is wrapped, and its line breaks at a jump."""
    values = np.array(system.wrap(states)[:, channel])
    if channel in system.periods:
        values[1:][np.abs(np.diff(values)) > 0.5 * system.periods[channel]] = np.nan
    return values


EXCERPT = 15.0
"""Seconds of a simulation that are drawn."""


def excerpt(prediction: Prediction, run: int) -> tuple[float, float]:
    """Return the first and last second of the excerpt, which begins with the first movement of a simulation."""
    case, dt = prediction.cases.free_runs[run], prediction.cases.system.dt
    moving = np.flatnonzero(case.moving)
    offset, length = prediction.cases.protocol.first + 1, round(EXCERPT / dt)
    first = max(0, min(int(moving[0]) if len(moving) else 0, len(case.states) - length))
    return (offset + first) * dt, min(offset + first + length, offset + len(case.states) - 1) * dt


def model_style(prediction: Prediction, name: str) -> dict[str, Any]:
    """Return the line style of a model, the same in every plot; persistence is grey."""
    if name == PERSISTENCE:
        return {"color": REFERENCE, "linestyle": "--"}
    return line_style([other for other in prediction.names if other != PERSISTENCE].index(name))


FORWARD, BACKWARD, PASSED = COLOURS[:3]


def plot_trace(trace: Trace, ax: Axes) -> Axes:
    """Draw the path (blue forwards, orange backwards), the walls and the numbered waypoints, in metres.

    Raises `InvalidData` for a trajectory without a pose in the plane.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Circle
    from matplotlib.ticker import MaxNLocator

    pose = trace.trajectory.pose
    if pose is None or pose.shape[1] != 3:
        raise InvalidData(f"trace {trace.trajectory.name!r}: expected a pose x, y, heading to draw")
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


def plot_state(trace: Trace, system: System, place: int, ax: Axes) -> Axes:
    """Draw one state over time (blue), its target (grey) and the tolerance around the target.

    A periodic state is drawn within half a period of its target, and its line breaks where it jumps.
    """
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
    ax.set_ylabel(with_unit(channel))
    return ax


SHOWN_STATES = 3
"""States to draw of a trial without targets."""


def plotted_states(trace: Trace, system: System) -> tuple[int, ...]:
    """Return the places of the states to draw: those with a target, else the first ones."""
    return tuple(target.place for target in trace.targets) or tuple(range(min(SHOWN_STATES, system.nx)))


ROOM = 1.0
"""Room above and below the first line and the median one, in their range: a line that grows without bound is cut."""
TWO_DECADES = 100.0
"""Ratio of the ends of a logarithmic axis below which 2 and 5 have a mark too."""


def plot_responses(
    figure: Figure,
    x: Array,
    responses: Mapping[str, Array],
    states: Sequence[Channel],
    controls: Sequence[Channel],
    *,
    label: str,
    log: bool = False,
) -> None:
    """Draw responses (T, states, controls) over ``x`` by name, a row for each state; the first one is grey.

    ``label`` names the x-axis. With ``log`` both axes are logarithmic.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator

    axes = figure.subplots(len(states), len(controls), sharex=True, squeeze=False)
    for (row, column), ax in np.ndenumerate(axes):
        lines = np.array([found[:, row, column] for found in responses.values()])
        lines = np.where(lines > 0.0, lines, np.nan) if log else lines
        for number, (name, line) in enumerate(zip(responses, lines, strict=True)):
            style = {"color": REFERENCE, "linewidth": 2.5} if number == 0 else line_style(number - 1)
            ax.plot(x, line, label=name, **{"linewidth": 1.1, **style})
        if log:
            ax.set(xscale="log", yscale="log")
            ax.minorticks_off()
            for axis, ends in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if ends[1] < TWO_DECADES * ends[0] else (1.0,)))
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        else:
            ends = np.nan_to_num(np.array([lines.min(axis=1), lines.max(axis=1)]))
            low, high = min(ends[0, 0], np.median(ends[0])), max(ends[1, 0], np.median(ends[1]))
            room = ROOM * (high - low) or 1.0
            ax.set_ylim(max(ends[0].min() - 0.05 * room, low - room), min(ends[1].max() + 0.05 * room, high + room))
        if row == 0:
            ax.set_title(with_unit(controls[column]))
        if column == 0:
            ax.set_ylabel(folded(with_unit(states[row])))
        if row == len(states) - 1:
            ax.set_xlabel(label)
    figure.align_ylabels(axes[:, 0])


def with_unit(channel: Channel) -> str:
    return f"{channel.name} ({channel.unit})" if channel.unit else channel.name
