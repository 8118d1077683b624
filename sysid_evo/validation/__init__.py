"""What is held out, how far off a model is there, and whether another one is better.

Validation knows data and arrays; a model is what keeps the protocol `Simulator`. The error of one simulation is
`sysid_evo.validation.simulation_error.simulation_error`, which has the name of its module.
"""

from sysid_evo.validation.acceptance import Held, Trial, failed, inside, judged, surely_positive
from sysid_evo.validation.bootstrap import (
    BlockErrors,
    Errors,
    Interval,
    block_sums,
    draw_blocks,
    interval,
    paired_interval,
    resampled_sums,
)
from sysid_evo.validation.folds import (
    Block,
    ConditionFold,
    EpisodeFold,
    blocks_of,
    folds_of,
    time_blocks,
    unseen_parts,
    unseen_recordings,
)
from sysid_evo.validation.held_out import HeldOut, best, lag_candidates, trials
from sysid_evo.validation.intervals import (
    HORIZONS,
    Case,
    conformal_scale,
    growth_on_unseen_recordings,
    horizon_scales,
    persistent_share,
    usable_horizon,
)
from sysid_evo.validation.measures import (
    error_std,
    fit_percent,
    mean_over_channels,
    nrmse,
    relative_percent,
    rmse,
)
from sysid_evo.validation.simulation_error import (
    HeldOutTest,
    Judge,
    Simulator,
    history_of,
    horizons_of,
    judging_windows,
    relative_error,
)

__all__ = [
    "HORIZONS",
    "Block",
    "BlockErrors",
    "Case",
    "ConditionFold",
    "EpisodeFold",
    "Errors",
    "Held",
    "HeldOut",
    "HeldOutTest",
    "Interval",
    "Judge",
    "Simulator",
    "Trial",
    "best",
    "block_sums",
    "blocks_of",
    "conformal_scale",
    "draw_blocks",
    "error_std",
    "failed",
    "fit_percent",
    "folds_of",
    "growth_on_unseen_recordings",
    "history_of",
    "horizon_scales",
    "horizons_of",
    "inside",
    "interval",
    "judged",
    "judging_windows",
    "lag_candidates",
    "mean_over_channels",
    "nrmse",
    "paired_interval",
    "persistent_share",
    "relative_error",
    "relative_percent",
    "resampled_sums",
    "rmse",
    "surely_positive",
    "time_blocks",
    "trials",
    "unseen_parts",
    "unseen_recordings",
    "usable_horizon",
]
