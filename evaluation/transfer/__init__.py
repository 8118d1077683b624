"""Which controllers work elsewhere than where they were evolved."""

from evaluation.transfer.cell import Cell, Trace, run_cell, transfer_seeds
from evaluation.transfer.matrix import TransferMatrix, transfer
from evaluation.transfer.summary import (
    ControllerSummary,
    Estimate,
    RankCorrelation,
    TransferSummary,
    summarise,
)

__all__ = [
    "Cell",
    "ControllerSummary",
    "Estimate",
    "RankCorrelation",
    "Trace",
    "TransferMatrix",
    "TransferSummary",
    "run_cell",
    "summarise",
    "transfer",
    "transfer_seeds",
]
