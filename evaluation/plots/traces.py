"""Plot of where a controller drove: path, waypoints, driving direction."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from evaluation.plots.canvas import COLOURS, MEASURED, REFERENCE, axes_or_new
from evaluation.transfer import Trace
from sysid_evo.errors import InvalidData
from sysid_evo.motion import rotate

FORWARD, BACKWARD, PASSED = COLOURS[:3]


def plot_trace(trace: Trace, ax: Axes | None = None) -> Axes:
    """Draw the path (blue forwards, orange backwards) and the numbered waypoints, in metres.

    Raises `InvalidData` for a trajectory without a pose in the plane.
    """
    pose = trace.trajectory.pose
    if pose is None or pose.shape[1] != 3:
        raise InvalidData(f"trace {trace.trajectory.name!r}: expected a pose x, y, heading to draw")
    ax = axes_or_new(ax, 3.4, 3.4)
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
    everything = np.concatenate([ends, trace.waypoints])
    centre = (everything.max(axis=0) + everything.min(axis=0)) / 2.0
    half = max(1.9, float((everything.max(axis=0) - everything.min(axis=0)).max()) / 2.0 + 0.4)
    ax.set_xlim(centre[0] - half, centre[0] + half)
    ax.set_ylim(centre[1] - half, centre[1] + half)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(5, integer=True))
    ax.set_aspect("equal")
    ax.set_xlabel("x (m)")
    ax.set_ylabel("y (m)")
    return ax
