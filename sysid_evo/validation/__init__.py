"""Validation: held-out data, simulation errors, prediction intervals, comparison of models.

It depends on data and arrays only; models are used through the protocol `Simulator`. The error of a simulation is
`sysid_evo.validation.simulation_error.simulation_error`.
"""

from sysid_evo.validation.estimates import CONFIDENCE, Draws, Estimate, across, paired
from sysid_evo.validation.folds import (
    ConditionFold,
    EpisodeFold,
    make_folds,
    recording_folds,
    recording_or_time_folds,
    time_fold,
)  # fmt: skip
from sysid_evo.validation.held_out import HeldOutError, best_candidate, lag_candidates
from sysid_evo.validation.intervals import horizon_scales
from sysid_evo.validation.measures import error_std, fit_percent, mean_over_channels, nrmse, relative_percent, rmse
from sysid_evo.validation.simulation_error import HeldOutTest, Scorer, Simulator, error_windows, relative_error

__all__ = [
    "CONFIDENCE",
    "ConditionFold",
    "Draws",
    "EpisodeFold",
    "Estimate",
    "HeldOutError",
    "HeldOutTest",
    "Scorer",
    "Simulator",
    "across",
    "best_candidate",
    "error_std",
    "error_windows",
    "fit_percent",
    "horizon_scales",
    "lag_candidates",
    "make_folds",
    "mean_over_channels",
    "nrmse",
    "paired",
    "recording_folds",
    "recording_or_time_folds",
    "relative_error",
    "relative_percent",
    "rmse",
    "time_fold",
]  # fmt: skip
