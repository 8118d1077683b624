"""Comparisons: an experiment, the plan of its cells, and the report that is made of them."""

from evaluation.comparison.again import comparison_again
from evaluation.comparison.champion_cells import EvolveCell, ensemble_name
from evaluation.comparison.columns import Column, emulated, runner_of
from evaluation.comparison.comparing import check_run_folder, compare, finished, is_run
from evaluation.comparison.controller_cells import ExploitCell, Matrix, RunCell
from evaluation.comparison.data_cells import DataCell, GivenData, Parts, RecordedData, Split
from evaluation.comparison.experiment import BUDGETS, FILE, Experiment
from evaluation.comparison.exploit_cells import SearchCell
from evaluation.comparison.model_cells import FitCell, PredictCell, StoredModel
from evaluation.comparison.planning import Comparison, check_experiment, plan_comparison, unsettled
from evaluation.comparison.recipes import controller_cell

__all__ = [
    "BUDGETS",
    "Column",
    "Comparison",
    "DataCell",
    "EvolveCell",
    "Experiment",
    "FILE",
    "ExploitCell",
    "FitCell",
    "GivenData",
    "Matrix",
    "Parts",
    "PredictCell",
    "RecordedData",
    "RunCell",
    "SearchCell",
    "Split",
    "StoredModel",
    "check_experiment",
    "check_run_folder",
    "compare",
    "comparison_again",
    "controller_cell",
    "emulated",
    "ensemble_name",
    "finished",
    "is_run",
    "plan_comparison",
    "runner_of",
    "unsettled",
]
