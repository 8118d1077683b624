"""How well models predict: errors at several horizons and in free run, with intervals."""

from evaluation.prediction.cases import MeasuredCases, PredictionProtocol, measured_cases
from evaluation.prediction.regions import Region, RegionError, worst_region
from evaluation.prediction.residuals import Residuals, StepErrors, analyse, step_errors
from evaluation.prediction.scores import (
    PERSISTENCE,
    Coverage,
    Difference,
    Divergence,
    EpisodeError,
    ErrorScore,
    ModelPrediction,
    Prediction,
)
from evaluation.prediction.scoring import Persistence, assess_model, assess_prediction, score_model

__all__ = [
    "PERSISTENCE",
    "Coverage",
    "Difference",
    "Divergence",
    "EpisodeError",
    "ErrorScore",
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
    "measured_cases",
    "score_model",
    "step_errors",
    "worst_region",
]
