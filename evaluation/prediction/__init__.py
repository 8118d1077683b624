"""How well models predict: errors at several horizons and in free run, with intervals."""

from evaluation.prediction.assess import PERSISTENCE, assess_model, assess_prediction, score_model
from evaluation.prediction.bootstrap import Interval
from evaluation.prediction.cases import MeasuredCases, measured_cases
from evaluation.prediction.persistence import Persistence
from evaluation.prediction.protocol import PredictionProtocol
from evaluation.prediction.scores import Coverage, Difference, Divergence, ErrorScore, ModelPrediction, Prediction
from evaluation.prediction.storage import load_prediction, save_prediction

__all__ = [
    "PERSISTENCE",
    "Coverage",
    "Difference",
    "Divergence",
    "ErrorScore",
    "Interval",
    "MeasuredCases",
    "ModelPrediction",
    "Persistence",
    "Prediction",
    "PredictionProtocol",
    "assess_model",
    "assess_prediction",
    "load_prediction",
    "measured_cases",
    "save_prediction",
    "score_model",
]
