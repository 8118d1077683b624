"""Whether the evidence for a figure suffices: enough test data, and better than a trivial prediction or controller.

Verdict, tables, plots, report.json and advice all use these functions. Without enough evidence a figure gets no star,
no interval and no recommendation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from evaluation.exploitability.results import TIMES_NORMAL, ModelExploitability
from evaluation.formatting import percent
from evaluation.prediction.scores import PERSISTENCE, ErrorScore, ModelPrediction, Prediction
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.summary import MatrixEstimates
from sysid_evo.evolution.aggregates import mean
from sysid_evo.validation.estimates import Estimate

FEWEST_BLOCKS = 10
"""Independent blocks of time needed to compare models.

A bootstrap over fewer blocks gives intervals that are much too narrow. Ten is a rule of thumb, not measured here.
"""
USELESS = 1.0
"""Normalised error N of predicting the mean of the measurements."""


def enough_blocks(blocks: int) -> bool:
    """Whether that many blocks of time suffice for an interval."""
    return blocks >= FEWEST_BLOCKS


def tells_apart(prediction: Prediction, horizon: int | None) -> bool:
    """Whether the test data suffice to compare models at ``horizon`` (None: in simulation)."""
    return enough_blocks(prediction.cases.blocks(horizon))


def too_little(prediction: Prediction, horizon: int | None) -> str:
    """Return a sentence if the test data do not suffice to compare models at ``horizon``, else an empty text.

    It gives the number and length of the blocks, and what to do.
    """
    if tells_apart(prediction, horizon):
        return ""
    cases = prediction.cases
    protocol, blocks = cases.protocol, cases.blocks(horizon)
    samples = protocol.block_samples if horizon is None else protocol.block_windows * protocol.stride
    return (
        f"Too little test data to compare models: {blocks} {'block' if blocks == 1 else 'blocks'} of "
        f"{samples * cases.system.dt:g} s, {FEWEST_BLOCKS} are needed. Record more, or hold out more (--test)."
    )


def leads(prediction: Prediction, model: ModelPrediction, horizon: int | None) -> bool:
    """Whether a model is the best at ``horizon`` or not significantly worse; False if the test data do not suffice."""
    ranking = prediction.ranking(horizon)
    if not ranking or not tells_apart(prediction, horizon):
        return False
    return model.name == ranking[0].name or no_worse(prediction, model, ranking[0], horizon)


def no_worse(prediction: Prediction, model: ModelPrediction, best: ModelPrediction, horizon: int | None) -> bool:
    """Whether a model does not differ significantly from the best one."""
    difference = prediction.compare(model.name, best.name, horizon)
    return difference is not None and not difference.significant


def predicts(prediction: Prediction, model: ModelPrediction, horizon: int | None) -> bool:
    """Whether a model is significantly better than both trivial predictions: the mean and persistence."""
    if not tells_apart(prediction, horizon) or not beats_mean(model.score(horizon)):
        return False
    difference = prediction.compare(model.name, PERSISTENCE, horizon)
    return difference is not None and difference.significant and difference.difference.value < 0


def beats_mean(score: ErrorScore | None) -> bool:
    """Whether an error is significantly below that of predicting the mean."""
    return score is not None and score.estimate.high < USELESS


def gain_over_rest(matrix: TransferMatrix, name: str) -> Estimate | None:
    """Return the fitness gain of a controller over neutral controls; None if unknown.

    It is measured on the robot, else on average over the models that the controller was not evolved in, else over all
    models: the first of these on which both were run. If neutral controls were not run at all they count as 0, unless
    some fitness is negative: then the gain is unknown.
    """
    figures, champions = MatrixEstimates(matrix), {one.name: one for one in matrix.champions}
    others = [model for model in matrix.models if model not in champions[name].against]
    for columns in ([] if matrix.robot is None else [matrix.robot], others, matrix.models):
        own = figures.on(champions[name], columns, mean)
        rest = figures.on(champions[matrix.at_rest[0]], columns, mean) if matrix.at_rest else None
        if own is not None and rest is not None:
            return (own - rest).estimate
        if own is not None and not matrix.at_rest:
            return own.estimate if all(cell.mean >= 0.0 for cell in matrix.cells.values() if not cell.failed) else None
    return None


def beats_rest(matrix: TransferMatrix, name: str) -> bool | None:
    """Whether a controller is significantly better than neutral controls; None if unknown.

    It is so by its gain, or by a sign test if the gain is positive: where a few trials lose much at rest, the mean of
    ten trials has a wide interval, though each of the ten is better.
    """
    gain = gain_over_rest(matrix, name)
    if gain is None:
        return None
    return (gain.low if np.isfinite(gain.low) else gain.value) > 0.0 or (gain.value > 0.0 and _wins(matrix, name))


def _wins(matrix: TransferMatrix, name: str) -> bool:
    """Whether a controller is better than rest in more trials on the robot than chance explains (2.5 %)."""
    if matrix.robot is None or not matrix.at_rest:
        return False
    cells = [matrix.cells.get((row, matrix.robot)) for row in (name, matrix.at_rest[0])]
    own, rest = (np.empty(0) if cell is None else cell.fitness for cell in cells)
    if len(own) != len(rest):
        return False
    won, count = int((own > rest).sum()), int((own != rest).sum())
    return sum(math.comb(count, k) for k in range(won, count + 1)) < 0.025 * 2.0**count


def none_beats_rest(matrix: TransferMatrix) -> bool:
    """Whether every controller is known to be no better than neutral controls."""
    judged = [beats_rest(matrix, name) for name in matrix.rows if name not in matrix.at_rest]
    return bool(judged) and not any(one is None or one for one in judged)


EXTRAPOLATED, MOSTLY_EXTRAPOLATED = 0.1, 0.5
"""Shares of the time outside the data that make a forecast an extrapolation.

The first if it is also three times the share in held-out data, the second always. Round numbers, not measured.
"""


def guessed_share(models: Sequence[ModelExploitability], controller: str) -> float | None:
    """Return the share of the time outside the data of a controller in the models that it was evolved in.

    None if that is below the limits `EXTRAPOLATED` and `MOSTLY_EXTRAPOLATED`, or unknown.
    """
    found = [
        (share, one.outside_held_out or 0.0)
        for one in models
        if controller in one.controllers
        for name, share in one.outside
        if name == controller
    ]
    if not found:
        return None
    share, normal = np.mean(found, axis=0)
    return float(share) if share >= max(EXTRAPOLATED, min(TIMES_NORMAL * normal, MOSTLY_EXTRAPOLATED)) else None


def guess_warning(models: Sequence[ModelExploitability], controller: str) -> str:
    """Return a sentence if the forecast of a controller is an extrapolation, else an empty text."""
    share = guessed_share(models, controller)
    return (
        "" if share is None else f"{percent(share)} of its time is outside the data: its forecast is an extrapolation."
    )
