"""Prediction error of models: at several horizons and in simulation of whole episodes, with intervals."""

from evaluation.prediction.cases import MeasuredCases, PredictionProtocol, measured_cases
from evaluation.prediction.regions import Region, RegionError, worst_region
from evaluation.prediction.residuals import OneStepErrors, Residuals, analyse_residuals, step_errors
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
    "OneStepErrors",
    "Persistence",
    "Prediction",
    "PredictionProtocol",
    "Region",
    "RegionError",
    "Residuals",
    "analyse_residuals",
    "assess_model",
    "assess_prediction",
    "measured_cases",
    "score_model",
    "step_errors",
    "worst_region",
]
