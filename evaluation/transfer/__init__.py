"""Transfer of controllers to systems other than those they were evolved in."""

from evaluation.transfer.matrix import (
    AT_REST,
    NOT_RUN,
    MeasuredResult,
    Trace,
    TransferMatrix,
    TransferResult,
    human_driver,
    kept_traces,
    load_measured,
    result_of,
    run_controller,
    save_measured,
    transfer,
    transfer_seeds,
    try_controller,
    with_measured,
)
from evaluation.transfer.matrix import TransferResult as Cell
from evaluation.transfer.summary import (
    ControllerSummary,
    MatrixEstimates,
    RankCorrelation,
    TransferSummary,
    is_exploited,
    summarise,
)
from sysid_evo.validation.estimates import Estimate

__all__ = [
    "AT_REST",
    "NOT_RUN",
    "Cell",
    "ControllerSummary",
    "Estimate",
    "MatrixEstimates",
    "MeasuredResult",
    "RankCorrelation",
    "Trace",
    "TransferMatrix",
    "TransferResult",
    "TransferSummary",
    "human_driver",
    "is_exploited",
    "kept_traces",
    "load_measured",
    "result_of",
    "run_controller",
    "save_measured",
    "summarise",
    "transfer",
    "transfer_seeds",
    "try_controller",
    "with_measured",
]
