"""Plot of means with their intervals, a row for each name."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from evaluation.labels import folded
from evaluation.plots.canvas import COLOURS, MEASURED, axes_or_new

REACH = 0.62
"""Rows over which the groups of one name are spread."""
Spread = tuple[float, float, float]
"""A mean, and the low and high end of its interval; both are the mean where there is none."""


def plot_spreads(
    spreads: Mapping[str, Mapping[str, Spread]],
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
