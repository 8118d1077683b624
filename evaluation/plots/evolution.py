"""Plot of an evolutionary run."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from evaluation.plots.canvas import COLOURS, REFERENCE, axes_or_new
from sysid_evo.evolution import Champion


def plot_fitness(champion: Champion, ax: Axes | None = None, *, unit: str = "") -> Axes:
    """Draw best, mean and worst fitness of each generation, as the evolution saw them."""
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
