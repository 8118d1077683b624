"""Plots of transfer: the matrix as a heat map, and what controllers claim against what they achieve."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from evaluation.labels import folded
from evaluation.plots.canvas import COLOURS, MEASURED, REFERENCE, axes_or_new
from evaluation.transfer import NOT_RUN, TransferMatrix, TransferSummary

MARKS = (
    ("claimed", "claimed (where evolved)", "o", "none", COLOURS[0]),
    ("others", "mean on other models", "s", COLOURS[5], COLOURS[5]),
    ("other_families", "median on other families", "D", COLOURS[4], COLOURS[4]),
    ("achieved", "achieved on the robot", "o", COLOURS[1], COLOURS[1]),
)


def plot_transfer(matrix: TransferMatrix, ax: Axes | None = None) -> Axes:
    """Draw mean fitness (and standard deviation over trials) of every controller on every system.

    A black frame marks the models a controller was evolved against; a line sets the robot apart.
    """
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
            spread = f"\n({stds[i, j]:.1f})" if np.isfinite(stds[i, j]) else ""
            text = f"{means[i, j]:.1f}{spread}"
            if not np.isfinite(means[i, j]):
                text = "–" if matrix.cell(champion.name, column).reason == NOT_RUN else "failed"
            ax.text(j, i, text, ha="center", va="center", fontsize=8, color="white" if dark else MEASURED)
    if matrix.robot is not None and columns > 1:
        ax.axvline(columns - 1.5, color=MEASURED, linewidth=2.0)
    ax.set_xticks(range(columns), [folded(c) for c in matrix.columns])
    ax.set_yticks(range(rows), [folded(name, 26) for name in matrix.rows])
    ax.xaxis.tick_top()
    ax.xaxis.set_label_position("top")
    ax.set_xlabel("run on", labelpad=8, fontweight="bold")
    ax.set_ylabel("controller", fontweight="bold")
    ax.tick_params(length=0)
    ax.grid(visible=False)
    for spine in ax.spines.values():
        spine.set_visible(False)
    unit = f" ({matrix.unit})" if matrix.unit else ""
    ax.figure.colorbar(image, ax=ax, label=f"mean fitness{unit}", fraction=0.05, pad=0.02)
    return ax


def plot_claims(summary: TransferSummary, ax: Axes | None = None, *, unit: str = "", name_width: int = 26) -> Axes:
    """Draw, for each controller, claimed fitness and fitness elsewhere, with 90 % intervals.

    Ticks below a claim are the champions of several evolution runs. Names are folded to ``name_width``.
    """
    ax = axes_or_new(ax, 7.0, 1.2 + 0.34 * len(summary.controllers))
    for kind, label, marker, face, edge in MARKS:
        found = [
            (row, estimate)
            for row, controller in enumerate(summary.controllers)
            if (estimate := controller.shown.get(kind)) is not None
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
        values = [estimate.value for estimate in controller.shown.values()]
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
