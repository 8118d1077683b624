"""Plots for the report and for notebooks; each draws on ``ax`` or on a new figure and returns the axes."""

from evaluation.plots.canvas import Band, new_figure, style, to_svg
from evaluation.plots.evolution import plot_fitness
from evaluation.plots.exploitability import plot_probes
from evaluation.plots.prediction import plot_free_run, plot_horizon_curve
from evaluation.plots.spreads import plot_spreads
from evaluation.plots.traces import plot_state, plot_trace, plotted_places
from evaluation.plots.transfer import plot_claims, plot_transfer

__all__ = [
    "Band",
    "new_figure",
    "plot_claims",
    "plot_fitness",
    "plot_free_run",
    "plot_horizon_curve",
    "plot_probes",
    "plot_spreads",
    "plot_state",
    "plot_trace",
    "plot_transfer",
    "plotted_places",
    "style",
    "to_svg",
]
