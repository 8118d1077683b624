"""Scores models: simulates them over the measured cases and condenses the errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from evaluation.prediction import metrics
from evaluation.prediction.bootstrap import BlockErrors, block_sums, draw_blocks, interval, resampled_sums
from evaluation.prediction.cases import MeasuredCases, measured_cases
from evaluation.prediction.coverage import interval_coverage
from evaluation.prediction.episodes import episode_errors
from evaluation.prediction.forecasts import NEVER, Forecasts, forecast
from evaluation.prediction.metrics import mean_over_channels
from evaluation.prediction.persistence import Persistence
from evaluation.prediction.protocol import PredictionProtocol
from evaluation.prediction.regions import region_errors
from evaluation.prediction.residuals import analyse, step_errors
from evaluation.prediction.scores import Divergence, ErrorScore, ModelPrediction, Prediction
from sysid_evo.arrays import Array, BoolArray, IntArray
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.errors import InvalidArgument
from sysid_evo.progress import Progress

PERSISTENCE = "persistence"


def assess_prediction(
    models: Mapping[str, DynamicsModel],
    training: Dataset,
    test: Dataset,
    *,
    protocol: PredictionProtocol | None = None,
    families: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> Prediction:
    """Measure the prediction error of fitted ``models`` on ``test``; persistence is the first row.

    ``training`` gives the guard. ``families`` names the family of each model (default: its class).
    A model that fails is a row with its reason. Raises `InvalidData` if the test set is of no use.
    """
    if PERSISTENCE in models:
        raise InvalidArgument(f"prediction: a model cannot be called {PERSISTENCE!r}, the name of the yardstick")
    cases = measured_cases(training, test, protocol or PredictionProtocol())
    still = Persistence().fit(training, rng=np.random.default_rng(0))
    rows = [assess_model(PERSISTENCE, still, cases, family=PERSISTENCE)]
    families = families or {}
    for name, model in models.items():
        rows.append(assess_model(name, model, cases, family=families.get(name)))
        if progress is not None:
            progress(len(rows) - 1, len(models))
    return Prediction(cases, tuple(rows))


def assess_model(
    name: str, model: DynamicsModel, cases: MeasuredCases, *, family: str | None = None
) -> ModelPrediction:
    """Measure one model, see `score_model`; whatever it raises becomes the reason of a failed row."""
    family = family or type(model).__name__
    try:
        return score_model(name, model, cases, family=family)
    except Exception as error:  # a plugin may fail in any way; the other rows must go on
        return ModelPrediction(name, family, reason=f"{type(error).__name__}: {error}")


def score_model(name: str, model: DynamicsModel, cases: MeasuredCases, *, family: str) -> ModelPrediction:
    """Simulate the measured cases with one model and condense the errors."""
    forecasts = forecast(model.without_noise(), cases)
    notes = [f"{name} {model.fit_note}"] if model.fit_note else []
    notes += _short_of_history(name, model, cases)
    curve, curve_interval = _curve(forecasts, cases)
    horizon = cases.near_horizon
    return ModelPrediction(
        name=name,
        family=family,
        at=tuple(_at_horizon(forecasts, cases, horizon) for horizon in cases.horizons),
        free_run=_free_run(forecasts, cases),
        curve=curve,
        curve_interval=curve_interval,
        divergence=_divergence(forecasts, cases),
        residuals=analyse(step_errors(model.without_noise(), cases.test, first=cases.protocol.first)),
        regions=() if horizon is None else region_errors(cases, forecasts.windows, horizon),
        episodes=episode_errors(cases, forecasts.windows, forecasts.free_runs),
        coverage=interval_coverage(model, cases),
        free_states=forecasts.free_runs,
        notes=tuple(notes),
    )


def _short_of_history(name: str, model: DynamicsModel, cases: MeasuredCases) -> list[str]:
    """Return what there is to say where fewer samples were given than the model wants."""
    limit, padded = cases.protocol.history, "was padded with the first state and neutral controls"
    if limit is not None:
        few = model.n_lags > limit
        return [f"{name} wants {model.n_lags} earlier samples and got {limit}: the rest {padded}"] if few else []
    early = int((cases.windows.start < model.n_lags).sum())
    if model.n_lags <= cases.protocol.first:
        return []
    return [
        f"{name} wants {model.n_lags} earlier samples: for {early} of {len(cases.windows)} windows and the free runs, "
        f"which begin earlier in their record, the rest {padded}"
    ]


def _at_horizon(forecasts: Forecasts, cases: MeasuredCases, horizon: int) -> ErrorScore:
    true, predicted = cases.windows.states[:, horizon - 1], forecasts.windows[:, horizon - 1]
    return _score(horizon, true, predicted, cases.moving[:, horizon - 1], cases.window_block, cases)


def _free_run(forecasts: Forecasts, cases: MeasuredCases) -> ErrorScore | None:
    moving = [run.moving for run in cases.free_runs]
    if not any(rows.any() for rows in moving):
        return None
    blocks, offset = [], 0
    for rows in moving:
        blocks.append(offset + np.arange(len(rows), dtype=np.int64) // cases.protocol.block_samples)
        offset = int(blocks[-1][-1]) + 1
    true = np.concatenate([run.states for run in cases.free_runs])
    predicted = np.concatenate(forecasts.free_runs)
    return _score(None, true, predicted, np.concatenate(moving), np.concatenate(blocks), cases)


def _score(
    horizon: int | None, true: Array, predicted: Array, scored: BoolArray, blocks: IntArray, cases: MeasuredCases
) -> ErrorScore:
    """Score the rows ``scored`` (N,) of (N, nx); blocks without such a row are not drawn."""
    protocol = cases.protocol
    truth = true[scored]
    guess = cases.system.near(predicted[scored], truth)
    errors = BlockErrors.of(guess - truth, blocks[scored])
    resampled = errors.resampled_n(cases.std, protocol.resamples, protocol.seed)
    return ErrorScore(
        horizon=horizon,
        samples=len(truth),
        rmse=metrics.rmse(truth, guess),
        error_std=metrics.error_std(truth, guess),
        relative_percent=metrics.relative_percent(truth, guess, rms=cases.rms),
        nrmse=metrics.nrmse(truth, guess, std=cases.std),
        interval=interval(resampled, protocol.confidence),
        resampled_n=resampled,
    )


def _curve(forecasts: Forecasts, cases: MeasuredCases) -> tuple[Array, Array]:
    """Return N (H,) after every step, nan at a step where no target moves, and its interval (2, H)."""
    errors = cases.system.difference(forecasts.windows, cases.windows.states)
    squares = np.where(cases.moving[:, :, None], errors**2, 0.0)
    steps, nx = squares.shape[1:]
    columns = np.concatenate([squares, cases.moving[:, :steps, None]], axis=2)
    sums = block_sums(columns.reshape(len(squares), steps * (nx + 1)), cases.window_block)
    scale = np.where(cases.std > 0, cases.std, np.nan)

    def curves(summed: Array) -> Array:
        parts = summed.reshape(len(summed), steps, nx + 1)
        squares, counts = parts[..., :-1], parts[..., -1:]
        mean = np.divide(squares, counts, out=np.full(squares.shape, np.nan), where=counts > 0)
        return mean_over_channels(np.sqrt(mean) / scale)

    picks = draw_blocks(len(sums), cases.protocol.resamples, cases.protocol.seed)
    drawn = curves(resampled_sums(sums, picks))
    band = [interval(column, cases.protocol.confidence) for column in drawn.T]
    return curves(sums.sum(axis=0)[None])[0], np.array(band).reshape(steps, 2).T


def _divergence(forecasts: Forecasts, cases: MeasuredCases) -> Divergence:
    dt = cases.system.dt
    hit = forecasts.touched[forecasts.touched != NEVER]
    return Divergence(
        share=len(hit) / len(forecasts.touched) if len(forecasts.touched) else 0.0,
        median_time=float(np.median(hit) * dt) if len(hit) else None,
        free_run_times=tuple(None if step == NEVER else float(step * dt) for step in forecasts.free_touched),
    )
