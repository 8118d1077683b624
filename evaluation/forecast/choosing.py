"""Choosing controllers by their forecasts: which one to drive, and which finalists go on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from evaluation.forecast.credibility import credibilities, weighted_median
from evaluation.forecast.forecasting import Forecast, forecasts
from evaluation.forecast.rule import RULE, Rule
from evaluation.transfer import RankCorrelation, TransferMatrix, TransferSummary, summarise
from evaluation.transfer.ranks import rank_correlation
from sysid_evo.arrays import Array
from sysid_evo.evolution import Champion, Judgement

FIGURE = "forecast"


def summary_of(matrix: TransferMatrix, errors: Mapping[str, float | None] | None = None) -> TransferSummary:
    """Return the summary of a matrix with the controller of the highest forecast as its pick.

    Without the prediction ``errors`` of its models (see `error_of`) all are believed alike.
    """
    return chosen_by(summarise(matrix), forecasts(matrix, errors or {}))


def chosen_by(summary: TransferSummary, found: Mapping[str, Forecast]) -> TransferSummary:
    """Return ``summary`` with the evolved controller of the highest forecast as its pick, and how forecasts rank.

    Where no controller that was evolved in models has one, nothing is picked.
    """
    evolved = [one for one in summary.controllers if one.name in found and one.against and not one.on_robot]
    if not evolved:
        return replace(summary, pick=None)
    best = highest(found, [one.name for one in evolved])
    pairs = [(found[one.name].value, one.achieved.value) for one in evolved if one.achieved is not None]
    ranked = (RankCorrelation(FIGURE, rank_correlation(pairs), len(pairs)),) if summary.correlations else ()
    return replace(summary, pick=best, correlations=(*summary.correlations, *ranked))


def highest(found: Mapping[str, Forecast], names: Iterable[str]) -> str | None:
    """Return which of ``names`` has the highest forecast, of equals the first; None where none has one."""
    return max((name for name in names if name in found), key=lambda name: found[name].value, default=None)


def worth_by(errors: Mapping[str, float | None], families: Mapping[str, str], *, rule: Rule = RULE) -> Judgement:
    """Return what finalists are ranked by: their forecasts, from the models' prediction errors and families."""

    def worth(champion: Champion, models: tuple[str, ...], by_model: Array) -> Array:
        met = {families.get(model, model) for model in champion.against}
        own = np.array([families.get(model, model) in met for model in models])
        return weighted_median(by_model, credibilities([errors.get(model) for model in models], own, rule=rule))

    return worth
