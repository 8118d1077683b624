"""How well models predict: errors at several horizons and in free run, with intervals."""

from evaluation.prediction.assess import PERSISTENCE, assess_model, assess_prediction, score_model
from evaluation.prediction.bootstrap import Interval
from evaluation.prediction.cases import MeasuredCases, measured_cases
from evaluation.prediction.episodes import EpisodeError
from evaluation.prediction.persistence import Persistence
from evaluation.prediction.protocol import PredictionProtocol
from evaluation.prediction.regions import Region, RegionError, worst_region
from evaluation.prediction.residuals import Residuals, StepErrors, analyse, step_errors
from evaluation.prediction.scores import Coverage, Difference, Divergence, ErrorScore, ModelPrediction, Prediction
from evaluation.prediction.storage import FORM, load_prediction, save_prediction

__all__ = [
    "FORM",
    "PERSISTENCE",
    "Coverage",
    "Difference",
    "Divergence",
    "EpisodeError",
    "ErrorScore",
    "Interval",
    "MeasuredCases",
    "ModelPrediction",
    "Persistence",
    "Prediction",
    "PredictionProtocol",
    "Region",
    "RegionError",
    "Residuals",
    "StepErrors",
    "analyse",
    "assess_model",
    "assess_prediction",
    "load_prediction",
    "measured_cases",
    "save_prediction",
    "score_model",
    "step_errors",
    "worst_region",
]
