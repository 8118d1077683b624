"""Studies: a grid of comparisons as one plan, and what it says over robots and seeds."""

from evaluation.study.controllers import CHOSEN, HINDSIGHT, ControllerFigures, controller_figures
from evaluation.study.forecasting import ForecastFigures, forecast_figures
from evaluation.study.gathering import gather
from evaluation.study.models import ExploitFigures, PredictionFigures, exploit_figures, prediction_figures
from evaluation.study.planning import PlannedStudy, plan_study
from evaluation.study.repeats import Spread, paired
from evaluation.study.results import ControllerRow, ModelRow, PointRow, StudyResults
from evaluation.study.running import finish, run_study, study_folder
from evaluation.study.study import FILE, Point, Study

__all__ = [
    "CHOSEN",
    "ControllerFigures",
    "ControllerRow",
    "ExploitFigures",
    "FILE",
    "ForecastFigures",
    "HINDSIGHT",
    "ModelRow",
    "PlannedStudy",
    "Point",
    "PointRow",
    "PredictionFigures",
    "Spread",
    "Study",
    "StudyResults",
    "controller_figures",
    "exploit_figures",
    "finish",
    "forecast_figures",
    "gather",
    "paired",
    "plan_study",
    "prediction_figures",
    "run_study",
    "study_folder",
]
