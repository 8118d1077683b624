"""Two runs side by side: what changed, and what differs by more than chance."""

from evaluation.report.two_runs.differences import Change, ControllerChange, Differences, differences
from evaluation.report.two_runs.telling import save_comparison, stem, terminal, to_json, two_stories

__all__ = [
    "Change",
    "ControllerChange",
    "Differences",
    "differences",
    "save_comparison",
    "stem",
    "terminal",
    "to_json",
    "two_stories",
]
