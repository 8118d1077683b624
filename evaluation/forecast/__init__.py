"""What a controller will do on the robot, said before it runs there."""

from evaluation.forecast.choosing import chosen_by, highest, summary_of, worth_by
from evaluation.forecast.credibility import credibilities, error_of, weighted_median
from evaluation.forecast.forecasting import Forecast, forecast_of, forecasts
from evaluation.forecast.of_models import ModelForecast, model_forecasts
from evaluation.forecast.rule import RULE, Rule

__all__ = [
    "Forecast",
    "ModelForecast",
    "RULE",
    "Rule",
    "chosen_by",
    "credibilities",
    "error_of",
    "forecast_of",
    "forecasts",
    "highest",
    "model_forecasts",
    "summary_of",
    "weighted_median",
    "worth_by",
]
