from .experiment import Experiment
from .exploitability.assessment import assess_exploitability
from .exploitability.results import ModelExploitability
from .planning import plan_comparison
from .prediction.cases import PredictionProtocol
from .prediction.scores import Prediction
from .prediction.scoring import assess_prediction
from .report.report import save_report, tables, to_html, to_json
from .results import DataSummary, Failure, ModelSummary, Report
from .running import compare, run_study
from .study.results import StudyResults
from .study.study import Study
from .transfer import Cell
from .transfer.matrix import TransferMatrix, run_cell, transfer, transfer_seeds
from .transfer.summary import TransferSummary, summarise

__all__ = [
    "Cell",
    "DataSummary",
    "Experiment",
    "Failure",
    "ModelExploitability",
    "ModelSummary",
    "Prediction",
    "PredictionProtocol",
    "Report",
    "Study",
    "StudyResults",
    "TransferMatrix",
    "TransferSummary",
    "assess_exploitability",
    "assess_prediction",
    "compare",
    "plan_comparison",
    "run_cell",
    "run_study",
    "save_report",
    "summarise",
    "tables",
    "to_html",
    "to_json",
    "transfer",
    "transfer_seeds",
]
