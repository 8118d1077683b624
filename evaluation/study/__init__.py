"""Studies: a grid of comparisons as one plan, and its results over robots and seeds."""

from evaluation.study.figures import (
    CHOSEN,
    HINDSIGHT,
    ControllerFigures,
    ExploitFigures,
    ForecastFigures,
    PredictionFigures,
    Spread,
    controller_figures,
    differences,
    exploit_figures,
    forecast_figures,
    prediction_figures,
)
from evaluation.study.planning import PlannedStudy, plan_study
from evaluation.study.results import ControllerRow, ModelRow, PointRow, StudyResults, gather_study
from evaluation.study.study import STUDY_FILE, Point, Study

__all__ = [
    "CHOSEN",
    "HINDSIGHT",
    "STUDY_FILE",
    "ControllerFigures",
    "ControllerRow",
    "ExploitFigures",
    "ForecastFigures",
    "ModelRow",
    "PlannedStudy",
    "Point",
    "PointRow",
    "PredictionFigures",
    "Spread",
    "Study",
    "StudyResults",
    "controller_figures",
    "differences",
    "exploit_figures",
    "forecast_figures",
    "gather_study",
    "plan_study",
    "prediction_figures",
]
