"""Whether there is enough behind a figure to state it: test data, variation, more than what is trivial.

Verdict, tables, drawings, document and advice ask here. A figure that may not be stated stands without star, interval
and praise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evaluation.exploitability.results import TIMES_NORMAL, ModelExploitability
from evaluation.formatting import percent
from evaluation.prediction.scores import PERSISTENCE, ErrorScore, ModelPrediction, Prediction
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.summary import Figures
from evaluation.transfer.uncertainty import PairedEstimate
from sysid_evo.evolution.aggregates import mean

FEWEST_BLOCKS = 10
"""Blocks of time, independent of each other, from which on models are told apart.

A bootstrap over fewer gives intervals that are much too narrow; ten is the usual rule of thumb, not measured here.
"""
USELESS = 1.0
"""The N of the mean of what was measured, as a prediction."""


def enough_blocks(blocks: int) -> bool:
    """Whether errors over so many blocks of time have an interval worth stating."""
    return blocks >= FEWEST_BLOCKS


def tells_apart(prediction: Prediction, horizon: int | None) -> bool:
    """Whether the test data are enough to tell models apart at ``horizon`` (None: in free run)."""
    return enough_blocks(prediction.cases.blocks(horizon))


def too_little(prediction: Prediction, horizon: int | None) -> str:
    """Return in a sentence that the test data are too few to tell models apart at ``horizon``; empty if they are not.

    It says how many blocks there are, how long each is, and what to do.
    """
    if tells_apart(prediction, horizon):
        return ""
    cases = prediction.cases
    protocol, blocks = cases.protocol, cases.blocks(horizon)
    samples = protocol.block_samples if horizon is None else protocol.block_windows * protocol.stride
    return (
        f"Too little test data to tell models apart: {blocks} {'block' if blocks == 1 else 'blocks'} of "
        f"{samples * cases.system.dt:g} s, {FEWEST_BLOCKS} are needed. Record more, or hold out more (--test)."
    )


def leads(prediction: Prediction, model: ModelPrediction, horizon: int | None) -> bool:
    """Whether a model is the best at ``horizon``, or not significantly worse, as far as models can be told apart."""
    ranking = prediction.ranking(horizon)
    if not ranking or not tells_apart(prediction, horizon):
        return False
    return model.name == ranking[0].name or no_worse(prediction, model, ranking[0], horizon)


def no_worse(prediction: Prediction, model: ModelPrediction, best: ModelPrediction, horizon: int | None) -> bool:
    """Whether a model does not differ significantly from the best one."""
    difference = prediction.compare(model.name, best.name, horizon)
    return difference is not None and not difference.significant


def predicts(prediction: Prediction, model: ModelPrediction, horizon: int | None) -> bool:
    """Whether a model is significantly better than what is trivial: the mean, and persistence."""
    score = model.score(horizon)
    known = score is not None and tells_apart(prediction, horizon)
    return known and beats_mean(score) and beats_persistence(prediction, model, horizon)


def beats_mean(score: ErrorScore | None) -> bool:
    """Whether an error is significantly below that of the mean of what was measured."""
    return score is not None and score.interval.high < USELESS


def beats_persistence(prediction: Prediction, model: ModelPrediction, horizon: int | None) -> bool:
    """Whether a model is significantly better than no change at all."""
    difference = prediction.compare(model.name, PERSISTENCE, horizon)
    return difference is not None and difference.significant and difference.difference < 0


def gain_over_rest(matrix: TransferMatrix, name: str) -> PairedEstimate | None:
    """Return by how much a controller does better than controls at rest; None where that is not known.

    On the robot, else on average over the models that it was not evolved in, else over all: the first where both were
    run. Controls at rest that were run nowhere count as 0, unless some fitness is negative: then nothing is known.
    """
    figures, champions = Figures(matrix), {one.name: one for one in matrix.champions}
    others = [model for model in matrix.models if model not in champions[name].against]
    for columns in ([] if matrix.robot is None else [matrix.robot], others, matrix.models):
        own = figures.on(champions[name], columns, mean)
        rest = figures.on(champions[matrix.at_rest[0]], columns, mean) if matrix.at_rest else None
        if own is not None and rest is not None:
            return own - rest
        if own is not None and not matrix.at_rest:
            return own if all(cell.mean >= 0.0 for cell in matrix.cells.values() if not cell.failed) else None
    return None


def beats_rest(matrix: TransferMatrix, name: str) -> bool | None:
    """Whether a controller is surely better than controls at rest; None where that is not known."""
    gain = gain_over_rest(matrix, name)
    if gain is None:
        return None
    low = gain.interval()[0]
    return (low if np.isfinite(low) else gain.value) > 0.0


def none_beats_rest(matrix: TransferMatrix) -> bool:
    """Whether it is known of every controller that it is no better than controls at rest."""
    judged = [beats_rest(matrix, name) for name in matrix.rows if name not in matrix.at_rest]
    return bool(judged) and not any(one is None or one for one in judged)


GUESSED, MOSTLY_GUESSED = 0.1, 0.5
"""Shares of the time outside the data from which on a forecast is a guess: if three times what is normal, and always.

Round numbers, not measured.
"""


def guessed_share(models: Sequence[ModelExploitability], controller: str) -> float | None:
    """Return the share of its time that a controller is outside the data, in the models that it was evolved in.

    None where that is below a tenth, or below a half and less than three times that of held-out driving, or not known.
    """
    found = [
        (share, one.outside_held_out or 0.0) for one in models for name, share in one.outside if name == controller
    ]
    if not found:
        return None
    share, normal = np.mean(found, axis=0)
    return float(share) if share >= max(GUESSED, min(TIMES_NORMAL * normal, MOSTLY_GUESSED)) else None


def guess_warning(models: Sequence[ModelExploitability], controller: str) -> str:
    """Return in a sentence that a controller's forecast is a guess; empty where it is none."""
    share = guessed_share(models, controller)
    return (
        "" if share is None else f"{percent(share)} of its time lies outside the data: there its forecast is a guess."
    )
