"""Models' forecasts: what the controllers that are evolved in a model will keep of their claims on the robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from evaluation.forecast.forecasting import Forecast
from evaluation.transfer import TransferMatrix
from sysid_evo.registry import make_aggregate


@dataclass(frozen=True)
class ModelForecast:
    """What ``controllers``, evolved in ``model`` alone, are expected to achieve on the robot, with a 90 % interval.

    ``claimed`` is what they claim; all are means over the controllers.
    """

    model: str
    controllers: tuple[str, ...]
    claimed: float
    value: float
    low: float
    high: float

    @property
    def kept(self) -> tuple[float, float, float] | None:
        """The share of the claim that is expected to be kept, and its interval; None where nothing is claimed."""
        if self.claimed <= 0.0:
            return None
        return self.value / self.claimed, self.low / self.claimed, self.high / self.claimed


def model_forecasts(matrix: TransferMatrix, found: Mapping[str, Forecast]) -> dict[str, ModelForecast]:
    """Return the forecast of every model in which a controller with a forecast was evolved alone.

    The interval is the mean of theirs, no narrower: what models miss together, they miss for all of them.
    """
    made = {}
    for model in matrix.models:
        alone = [champion for champion in matrix.champions if champion.against == (model,) and champion.name in found]
        alone = [champion for champion in alone if not matrix.cell(champion.name, model).failed]
        if not alone:
            continue
        own = [found[champion.name] for champion in alone]
        claims = [
            float(make_aggregate(champion.aggregate)(matrix.cell(champion.name, model).fitness[None, None])[0])
            for champion in alone
        ]
        value, low, high = (float(np.mean([getattr(one, name) for one in own])) for name in ("value", "low", "high"))
        names = tuple(champion.name for champion in alone)
        made[model] = ModelForecast(model, names, float(np.mean(claims)), value, low, high)
    return made
