"""Which controllers work elsewhere than where they were evolved."""

from evaluation.transfer.cell import NOT_RUN, Cell, Trace, cell_of, kept_traces, run_cell, run_on, transfer_seeds
from evaluation.transfer.claims import Estimate, fitness_on, is_exploited
from evaluation.transfer.matrix import TransferMatrix, transfer
from evaluation.transfer.measured import Measured, load_measured, person, save_measured, with_measured
from evaluation.transfer.standing import Figures, Standing, standings
from evaluation.transfer.storage import load_cell, save_cell
from evaluation.transfer.summary import (
    AT_REST,
    ControllerSummary,
    RankCorrelation,
    TransferSummary,
    summarise,
)
from evaluation.transfer.uncertainty import PairedEstimate

__all__ = [
    "AT_REST",
    "Cell",
    "NOT_RUN",
    "ControllerSummary",
    "Estimate",
    "Figures",
    "Measured",
    "PairedEstimate",
    "RankCorrelation",
    "Standing",
    "Trace",
    "TransferMatrix",
    "TransferSummary",
    "cell_of",
    "fitness_on",
    "is_exploited",
    "kept_traces",
    "load_cell",
    "load_measured",
    "person",
    "run_cell",
    "run_on",
    "save_cell",
    "save_measured",
    "standings",
    "summarise",
    "transfer",
    "transfer_seeds",
    "with_measured",
]
