"""Which controllers work elsewhere than where they were evolved."""

from evaluation.transfer.matrix import (
    AT_REST,
    NOT_RUN,
    MeasuredResult,
    Trace,
    TransferMatrix,
    TransferResult,
    cell_of,
    kept_traces,
    load_measured,
    person,
    run_cell,
    run_on,
    save_measured,
    transfer,
    transfer_seeds,
    with_measured,
)
from evaluation.transfer.matrix import TransferResult as Cell
from evaluation.transfer.summary import (
    ControllerSummary,
    Figures,
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
    "Figures",
    "MeasuredResult",
    "RankCorrelation",
    "Trace",
    "TransferMatrix",
    "TransferResult",
    "TransferSummary",
    "cell_of",
    "is_exploited",
    "kept_traces",
    "load_measured",
    "person",
    "run_cell",
    "run_on",
    "save_measured",
    "summarise",
    "transfer",
    "transfer_seeds",
    "with_measured",
]
