"""What the verdict says on prediction."""

from __future__ import annotations

from evaluation.labels import percent
from evaluation.prediction import PERSISTENCE, ErrorScore, ModelPrediction, Prediction

N_IN_WORDS = "the mean error in standard deviations"
USELESS = 1.0
"""The N of the mean of what was measured, as a prediction."""


def main_horizon(prediction: Prediction) -> int | None:
    """Return the longest scored horizon of at most one second, in steps; None (free run) without any."""
    return prediction.cases.main_horizon


def horizon_name(prediction: Prediction, horizon: int | None) -> str:
    """Return ``20 steps (1 s)``, or ``free run`` over whole episodes."""
    if horizon is None:
        return "free run"
    seconds = horizon * prediction.cases.system.dt
    return f"{horizon} {'step' if horizon == 1 else 'steps'} ({seconds:g} s)"


def scored(prediction: Prediction, horizon: int | None) -> tuple[ModelPrediction, ...]:
    """Return the models with a score at ``horizon``, lowest N first, without persistence."""
    return tuple(model for model in prediction.ranking(horizon) if model.name != PERSISTENCE)


def predicts(prediction: Prediction, model: ModelPrediction, horizon: int | None) -> bool:
    """Whether a model is significantly better than the mean and than persistence."""
    score = model.score(horizon)
    return score is not None and _beats_mean(score) and _beats_persistence(prediction, model, horizon)


def predicting(prediction: Prediction) -> tuple[str, ...]:
    """Answer which models predict."""
    if not prediction.horizons:
        return ("The test set is too short to say: no horizon and no free run fits into it.",)
    horizon = main_horizon(prediction)
    models = scored(prediction, horizon)
    if not models:
        return ("No model could be scored.",)
    answers = [_best(prediction, models, horizon)]
    if any(predicts(prediction, model, horizon) for model in models):
        equal = [model.name for model in models[1:] if _no_worse(prediction, model, models[0], horizon)]
        if equal:
            answers.append(f"No significant difference from it: {', '.join(equal)}.")
        beaten = [model.name for model in models if not _beats_persistence(prediction, model, horizon)]
        if beaten:
            answers.append(f"Not significantly better than persistence: {', '.join(beaten)}.")
    if horizon is not None and (free := scored(prediction, None)):
        answers.append(_best_in_free_run(prediction, free))
    clipped = [
        f"{model.name} ({percent(model.divergence.share)} of windows)"
        for model in models
        if model.divergence is not None and model.divergence.share > 0
    ]
    if clipped:
        answers.append(f"Simulations reach their clip: {', '.join(clipped)}.")
    answers += [sentence for model in models if (sentence := intervals_hold(prediction, model))]
    return tuple(answers)


def intervals_hold(prediction: Prediction, model: ModelPrediction) -> str:
    """Return in a sentence what a model's intervals hold; empty for a model without a spread."""
    if not model.coverage:
        return ""
    aim = percent(model.coverage[0].share)
    wrong = [held for held in model.coverage if not held.honest]
    if not wrong:
        shares = sorted(held.mean for held in model.coverage)
        horizons = ", ".join(str(held.horizon) for held in model.coverage)
        return (
            f"The {aim} intervals of {model.name} are honest: they hold {percent(shares[0])} to {percent(shares[-1])} "
            f"after {horizons} steps."
        )
    parts = []
    for held in wrong:
        narrow = held.mean < held.share
        amount = f"{'only ' if narrow else ''}{percent(held.mean)}"
        verdict = "too narrow" if narrow else "wider than they need be"
        parts.append(f"hold {amount} after {horizon_name(prediction, held.horizon)}: {verdict}")
    return f"The {aim} intervals of {model.name} {'; they '.join(parts)}."


def _best(prediction: Prediction, models: tuple[ModelPrediction, ...], horizon: int | None) -> str:
    best, score = models[0], _score(models[0], horizon)
    still = prediction.model(PERSISTENCE).score(horizon)
    where = "in free run" if horizon is None else f"at {horizon_name(prediction, horizon)}"
    size = f"{score.n:.3f} ({score.interval.low:.3f} to {score.interval.high:.3f})"
    beside = f"; persistence has {still.n:.3f}" if still else ""
    if any(predicts(prediction, model, horizon) for model in models):
        return f"{where.capitalize()}, {best.name} is best: N, {N_IN_WORDS}, is {size}{beside}."
    if score.n >= USELESS:
        why = "from 1 on, a constant would do as well"
    elif not any(_beats_mean(_score(model, horizon)) for model in models):
        why = "no model is significantly better than a constant, which has 1"
    else:
        why = "no model is significantly better than that"
    return f"No model predicts here: {where} the lowest N, {N_IN_WORDS}, is {size}, of {best.name}{beside}; {why}."


def _best_in_free_run(prediction: Prediction, models: tuple[ModelPrediction, ...]) -> str:
    best, n = models[0].name, _score(models[0], None).n
    if any(predicts(prediction, model, None) for model in models):
        return f"In free run over whole episodes, {best} is best: N {n:.3f}."
    return f"In free run over whole episodes, no model predicts: the lowest N is {n:.3f}, of {best}."


def _score(model: ModelPrediction, horizon: int | None) -> ErrorScore:
    score = model.score(horizon)
    assert score is not None
    return score


def _beats_mean(score: ErrorScore) -> bool:
    return score.interval.high < USELESS


def _no_worse(prediction: Prediction, model: ModelPrediction, best: ModelPrediction, horizon: int | None) -> bool:
    difference = prediction.compare(model.name, best.name, horizon)
    return difference is not None and not difference.significant


def _beats_persistence(prediction: Prediction, model: ModelPrediction, horizon: int | None) -> bool:
    difference = prediction.compare(model.name, PERSISTENCE, horizon)
    return difference is not None and difference.significant and difference.difference < 0
