from .advice.advise import advise_recording
from .advice.evidence import Remark
from .experiment import Experiment
from .exploitability.assessment import assess_exploitability
from .exploitability.results import ModelExploitability, exploitability_card
from .formatting import by_error, horizon_name, three_digits
from .members import (
    check_fit,
    dynamics_of,
    find_column,
    is_model_of_a_run,
    matrix_of,
    stored_controllers,
    transfer_targets,
)
from .planning import Comparison, check_experiment, comparison_of, plan_comparison, unsettled
from .prediction.cases import PredictionProtocol, main_horizon
from .prediction.scores import PERSISTENCE, Prediction
from .prediction.scoring import assess_prediction
from .report.report import (
    brief,
    load_report,
    save_report,
    story_of,
    tables,
    to_json,
    transfer_tables,
    transfer_to_json,
)
from .report.save import FORMATS, write_format
from .report.sections.advice import advice_lines, remark_lines
from .report.sections.summary import is_empty
from .report.study import study_brief, study_document
from .results import ComparisonResults, DataSummary, Failure, ModelSummary
from .run_evolution import (
    EvolutionPlan,
    EvolutionResult,
    ExploitPlan,
    driven_by,
    evolution_result,
    exploit_result,
    plan_evolution,
    plan_exploit,
)
from .run_folder import (
    CHOSEN,
    check_run_folder,
    latest_run_folder,
    run_of_controller,
    runs_in,
    seed_of_run,
    settings_of_run,
    store_of_run,
    summary_of_run,
    unneeded_files,
)
from .running import (
    compare,
    plan_run,
    report_again,
    report_of,
    run_study,
    study_folder,
    with_further_families,
    write_study,
)
from .storage import plain
from .study.planning import PlannedStudy, plan_study, seconds_about
from .study.results import StudyResults
from .study.study import STUDY_FILE, Study
from .sufficiency import enough_blocks
from .transfer.matrix import (
    MeasuredResult,
    TransferMatrix,
    TransferResult,
    load_measured,
    measured_by_person,
    result_of,
    save_measured,
    transfer,
    transfer_seeds,
    try_controller,
)
from .transfer.summary import TransferSummary, summarise

__all__ = [
    "CHOSEN",
    "FORMATS",
    "PERSISTENCE",
    "STUDY_FILE",
    "Comparison",
    "ComparisonResults",
    "DataSummary",
    "EvolutionPlan",
    "EvolutionResult",
    "Experiment",
    "ExploitPlan",
    "Failure",
    "MeasuredResult",
    "ModelExploitability",
    "ModelSummary",
    "PlannedStudy",
    "Prediction",
    "PredictionProtocol",
    "Remark",
    "Study",
    "StudyResults",
    "TransferMatrix",
    "TransferResult",
    "TransferSummary",
    "advice_lines",
    "advise_recording",
    "assess_exploitability",
    "assess_prediction",
    "brief",
    "by_error",
    "check_experiment",
    "check_fit",
    "check_run_folder",
    "compare",
    "comparison_of",
    "stored_controllers",
    "driven_by",
    "dynamics_of",
    "enough_blocks",
    "evolution_result",
    "exploit_result",
    "exploitability_card",
    "find_column",
    "horizon_name",
    "is_model_of_a_run",
    "latest_run_folder",
    "load_measured",
    "load_report",
    "main_horizon",
    "matrix_of",
    "measured_by_person",
    "plain",
    "plan_comparison",
    "plan_evolution",
    "plan_exploit",
    "plan_run",
    "plan_study",
    "remark_lines",
    "report_again",
    "report_of",
    "result_of",
    "run_of_controller",
    "run_study",
    "runs_in",
    "save_measured",
    "save_report",
    "seconds_about",
    "seed_of_run",
    "settings_of_run",
    "store_of_run",
    "story_of",
    "study_brief",
    "study_document",
    "study_folder",
    "summarise",
    "summary_of_run",
    "tables",
    "is_empty",
    "three_digits",
    "to_json",
    "transfer",
    "transfer_seeds",
    "transfer_tables",
    "transfer_targets",
    "transfer_to_json",
    "try_controller",
    "unneeded_files",
    "unsettled",
    "write_format",
    "with_further_families",
    "write_study",
]
