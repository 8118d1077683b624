from .comparison import Experiment, compare, plan_comparison
from .exploitability import ModelExploitability, assess_exploitability
from .prediction import Prediction, PredictionProtocol, assess_prediction
from .report import DataSummary, Failure, ModelSummary, Report, save_report, tables, to_json
from .report.page import to_html
from .study import Study, StudyResults, run_study
from .transfer import Cell, TransferMatrix, TransferSummary, run_cell, summarise, transfer, transfer_seeds

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
