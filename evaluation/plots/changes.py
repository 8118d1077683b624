"""Plot of what changed from one run to another."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from evaluation.labels import folded
from evaluation.plots.canvas import COLOURS, MEASURED, axes_or_new

STEP = 0.15
"""Rows between the figures of one name."""
Changed = tuple[float, float, float]
"""A difference, and the low and high end of its interval."""


def plot_changes(
    changes: Mapping[str, Mapping[str, Changed]],
    ax: Axes | None = None,
    *,
    label: str = "difference",
    name_width: int = 26,
) -> Axes:
    """Draw differences with their intervals, a row for each name, a colour for each figure; 0 is no difference.

    ``changes`` are by figure and name: ``{"claimed": {"linear": (0.3, -0.1, 0.7)}}``.
    """
    names = list(dict.fromkeys(name for found in changes.values() for name in found))
    ax = axes_or_new(ax, 7.0, 1.2 + 0.34 * len(names))
    spread = STEP * (np.arange(len(changes)) - (len(changes) - 1) / 2.0)
    for number, (figure, found) in enumerate(changes.items()):
        rows = [names.index(name) for name in found]
        values = np.array(list(found.values())).reshape(-1, 3)
        ends = np.abs(values[:, 1:] - values[:, :1]).T
        colour = COLOURS[number % len(COLOURS)]
        ax.errorbar(values[:, 0], rows + spread[number], xerr=ends, fmt="o", markersize=5, color=colour, label=figure)
    ax.axvline(0.0, color=MEASURED, linewidth=0.9)
    ax.set_yticks(range(len(names)), [folded(name, name_width) for name in names])
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xlabel(label)
    if len(changes) > 1:
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=min(3, len(changes)))
    return ax
