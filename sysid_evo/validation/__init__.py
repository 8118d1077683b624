"""What is held out, how far off a model is there, and whether another one is better.

Validation knows data and arrays; a model is what keeps the protocol `Simulator`. The error of one simulation is
`sysid_evo.validation.simulation_error.simulation_error`, which has the name of its module.
"""

from sysid_evo.validation.estimates import CONFIDENCE, Draws, Estimate, across, paired
from sysid_evo.validation.folds import (
    ConditionFold,
    EpisodeFold,
    folds_of,
    time_blocks,
    unseen_parts,
    unseen_recordings,
)  # fmt: skip
from sysid_evo.validation.held_out import HeldOut, best, lag_candidates
from sysid_evo.validation.intervals import conformal_scale, horizon_scales
from sysid_evo.validation.measures import error_std, fit_percent, mean_over_channels, nrmse, relative_percent, rmse
from sysid_evo.validation.simulation_error import HeldOutTest, Judge, Simulator, judging_windows, relative_error

__all__ = [
    "CONFIDENCE", "ConditionFold", "Draws", "EpisodeFold", "Estimate", "HeldOut", "HeldOutTest", "Judge",
    "Simulator", "across", "best", "conformal_scale", "error_std", "fit_percent", "folds_of", "horizon_scales",
    "judging_windows", "lag_candidates", "mean_over_channels", "nrmse", "paired", "relative_error",
    "relative_percent", "rmse", "time_blocks", "unseen_parts", "unseen_recordings",
]  # fmt: skip
