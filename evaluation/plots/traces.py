"""Plots of what a controller did: its path among waypoints and walls, or its states over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from evaluation.plots.canvas import COLOURS, MEASURED, REFERENCE, axes_or_new
from evaluation.transfer import Trace
from sysid_evo.angles import rotate, wrap
from sysid_evo.errors import InvalidData
from sysid_evo.system import System

FORWARD, BACKWARD, PASSED = COLOURS[:3]


SHOWN_STATES = 3
"""States that are drawn of a trial without targets."""


def plotted_places(trace: Trace, system: System) -> tuple[int, ...]:
    """Return which states of a trial are drawn: those that were led to a target, else the first ones."""
    return tuple(target.place for target in trace.targets) or tuple(range(min(SHOWN_STATES, system.nx)))


def plot_state(trace: Trace, system: System, place: int, ax: Axes | None = None) -> Axes:
    """Draw one state over time (blue), what it was to be (grey) and the tolerance about that.

    A periodic state is drawn within half a period of what it was to be, and its line breaks where it jumps.
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


def plot_trace(trace: Trace, ax: Axes | None = None) -> Axes:
    """Draw the path (blue forwards, orange backwards), the walls and the numbered waypoints, in metres.

    Raises `InvalidData` for a trajectory without a pose in the plane.
    """
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
