"""Simulates the cases with a model and scores it; persistence; errors within and across conditions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from evaluation.prediction.cases import MeasuredCases, PredictionProtocol, main_horizon, measured_cases
from evaluation.prediction.regions import region_errors
from evaluation.prediction.residuals import analyse_residuals, step_errors
from evaluation.prediction.scores import (
    PERSISTENCE,
    ConditionError,
    Coverage,
    Divergence,
    EpisodeError,
    ErrorScore,
    ModelPrediction,
    Prediction,
)
from sysid_evo.data import Dataset
from sysid_evo.data.trajectory import evenly_spaced
from sysid_evo.errors import InvalidArgument, InvalidData, described
from sysid_evo.models import DynamicsModel
from sysid_evo.models.sanity import SanityCheck
from sysid_evo.progress import Counter, Progress, reporting
from sysid_evo.types import Array, BoolArray, IntArray
from sysid_evo.validation import measures
from sysid_evo.validation.estimates import Draws, drawn_rms, drawn_sums
from sysid_evo.validation.measures import mean_over_channels


def assess_prediction(
    models: Mapping[str, DynamicsModel],
    training: Dataset,
    test: Dataset,
    *,
    protocol: PredictionProtocol | None = None,
    families: Mapping[str, str] | None = None,
    progress: Progress | bool | None = None,
) -> Prediction:
    """Measure the prediction error of fitted ``models`` on ``test``; persistence is the first row.

    ``training`` gives the guard. ``families`` names the family of each model (default: its class). A model that fails
    gives a row with its reason. Raises `InvalidData` if the test set is not usable.
    """
    if PERSISTENCE in models:
        raise InvalidArgument(f"prediction: a model cannot be called {PERSISTENCE!r}, the name of the reference")
    cases, check = measured_cases(training, test, protocol or PredictionProtocol()), SanityCheck.of((training, test))
    no_change = Persistence().fit(training, rng=np.random.default_rng(0))
    rows = [assess_model(PERSISTENCE, no_change, cases, family=PERSISTENCE)]
    families = families or {}
    with reporting(progress, "predict") as report:
        counter = Counter(report, len(models))
        for name, model in models.items():
            rows.append(assess_model(name, model, cases, family=families.get(name), check=check))
            counter.advance(1)
    return Prediction(cases, tuple(rows))


def assess_model(
    name: str,
    model: DynamicsModel,
    cases: MeasuredCases,
    *,
    family: str | None = None,
    check: SanityCheck | None = None,
) -> ModelPrediction:
    """Return the scores of one model, see `score_model`; an error becomes the reason of a failed row."""
    family = family or type(model).__name__
    try:
        return score_model(name, model, cases, family=family, check=check)
    except Exception as error:  # a plugin may fail in any way; the other rows must be computed
        return ModelPrediction(name, family, reason=described(error))


def score_model(
    name: str, model: DynamicsModel, cases: MeasuredCases, *, family: str, check: SanityCheck | None = None
) -> ModelPrediction:
    """Simulate the measured cases with one model and return its scores, with the result of ``check``."""
    forecasts = simulate_cases(model.without_noise(), cases)
    notes = [f"{name}: {model.fit_note}"] if model.fit_note else []
    notes += _short_of_history(name, model, cases)
    curve, curve_interval = _curve(forecasts, cases)
    horizon, states, dt = cases.near_horizon, cases.windows.states, cases.system.dt
    hit = forecasts.touched[forecasts.touched != NEVER]
    divergence = Divergence(
        share=len(hit) / len(forecasts.touched) if len(forecasts.touched) else 0.0,
        median_time=float(np.median(hit) * dt) if len(hit) else None,
        free_run_times=tuple(None if step == NEVER else float(step * dt) for step in forecasts.free_touched),
    )
    return ModelPrediction(
        name=name,
        family=family,
        scores=tuple(
            _score(h, states[:, h - 1], forecasts.windows[:, h - 1], cases.moving[:, h - 1], cases.window_block, cases)
            for h in cases.horizons
        ),
        free_run=_free_run(forecasts, cases),
        curve=curve,
        curve_interval=curve_interval,
        divergence=divergence,
        residuals=analyse_residuals(step_errors(model.without_noise(), cases.test, first=cases.protocol.first)),
        regions=() if horizon is None else region_errors(cases, forecasts.windows, horizon),
        episodes=episode_errors(cases, forecasts.windows, forecasts.free_runs),
        coverage=interval_coverage(model, cases),
        free_states=forecasts.free_runs,
        notes=tuple(notes),
        warning="" if check is None or not (failure := check.warning(model)) else f"{name} {failure}",
    )


def _short_of_history(name: str, model: DynamicsModel, cases: MeasuredCases) -> list[str]:
    """Return notes if fewer samples were given than the model uses."""
    limit, padded = cases.protocol.history, "was padded with the first state and neutral controls"
    if limit is not None:
        few = model.n_lags > limit
        return [f"{name} uses {model.n_lags} earlier samples and got {limit}: the rest {padded}"] if few else []
    early = int((cases.windows.start < model.n_lags).sum())
    if model.n_lags <= cases.protocol.first:
        return []
    return [
        f"{name} uses {model.n_lags} earlier samples: for {early} of {len(cases.windows)} windows and for whole "
        f"episodes, which begin too early in their record, the rest {padded}"
    ]


NEVER = -1


@dataclass(frozen=True)
class SimulatedCases:
    """Predicted states: ``windows`` (N, H, nx) and one (T, nx) for each whole episode, clipped to the guard.

    ``touched`` (N,) and ``free_touched`` (number of episodes,) are the first step (from 1) at which a simulation
    reached the model's state bounds or the guard, or was no longer a number; -1 for never.
    """

    windows: Array
    touched: IntArray
    free_runs: tuple[Array, ...]
    free_touched: IntArray


def simulate_cases(model: DynamicsModel, cases: MeasuredCases) -> SimulatedCases:
    """Simulate all cases with ``model``. A short history is padded: first state, neutral controls."""
    windows, touched = _simulate(model, *cases.history(model.n_lags), cases.windows.controls, cases.guard)
    free_runs, free_touched = [], []
    first = np.array([cases.protocol.first])
    long = [episode for episode in cases.test.episodes if len(episode) > first[0]]
    for run, episode in zip(cases.free_runs, long, strict=True):
        history = cases.before(episode, first, model.n_lags)
        states, limited = _simulate(model, *history, run.controls[None], cases.guard)
        free_runs.append(states[0])
        free_touched.append(int(limited[0]))
    return SimulatedCases(windows, touched, tuple(free_runs), np.array(free_touched, dtype=np.int64))


def _simulate(
    model: DynamicsModel, past_states: Array, past_controls: Array, controls: Array, guard: Array
) -> tuple[Array, IntArray]:
    if not len(controls):
        return np.empty((*controls.shape[:2], past_states.shape[2])), np.empty(0, dtype=np.int64)
    states = model.simulate(past_states, past_controls, controls)
    hit = ~np.isfinite(states).all(axis=2) | _at_limit(states, guard)
    if model.state_bounds is not None:
        hit |= _at_limit(states, model.state_bounds)
    touched = np.where(hit.any(axis=1), hit.argmax(axis=1) + 1, NEVER).astype(np.int64)
    low, high = guard
    return np.clip(np.where(np.isfinite(states), states, np.where(np.isfinite(high), high, 0.0)), low, high), touched


def _at_limit(states: Array, limits: Array) -> BoolArray:
    """Return where a state (..., nx) is on or beyond a limit; a channel with equal limits has none."""
    low, high = limits
    slack = 1e-9 * np.where(np.isfinite(high - low), high - low, 0.0)
    with np.errstate(invalid="ignore"):
        reached = ((states <= low + slack) | (states >= high - slack)) & (high - low > 1e-12)
    return np.asarray(reached.any(axis=-1))


def _free_run(forecasts: SimulatedCases, cases: MeasuredCases) -> ErrorScore | None:
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
    truth = true[scored]
    guess = cases.system.unwrap_towards(predicted[scored], truth)
    drawn = mean_over_channels(drawn_rms(guess - truth, blocks[scored]) / cases.scale)
    return ErrorScore(
        horizon=horizon,
        samples=len(truth),
        rmse=measures.rmse(truth, guess),
        error_std=measures.error_std(truth, guess),
        relative_percent=measures.relative_percent(truth, guess, rms=cases.rms),
        nrmse=measures.nrmse(truth, guess, std=cases.std),
        draws=Draws(drawn, len(np.unique(blocks[scored]))),
    )


def _curve(forecasts: SimulatedCases, cases: MeasuredCases) -> tuple[Array, Array]:
    """Return N (H,) after every step, NaN at a step where no target moves, and its interval (2, H)."""
    errors = cases.system.difference(forecasts.windows, cases.windows.states)
    squares = np.where(cases.moving[:, :, None], errors**2, 0.0)
    steps, nx = squares.shape[1:]
    columns = np.concatenate([squares, cases.moving[:, :steps, None]], axis=2)
    drawn = cases.n_of_sums(drawn_sums(columns.reshape(len(squares), steps * (nx + 1)), cases.window_block))
    count = len(np.unique(cases.window_block))
    band = [Draws(column, count).estimate.clipped(low=0.0).interval for column in drawn.T]
    return drawn[0], np.array(band).reshape(steps, 2).T


SHARE = 0.9
"""Nominal coverage of the intervals."""
SAMPLES = 100
MOST_WINDOWS = 400
BATCH = 50
"""Number of windows that are simulated together."""


def interval_coverage(model: DynamicsModel, cases: MeasuredCases) -> tuple[Coverage, ...]:
    """Return the coverage of the central 90 % of 100 samples at every horizon; empty for a model without noise.

    At most 400 evenly spread windows are used. Only targets that move count. The draws are the same every time.
    """
    if not (model.n_noise or model.n_draws) or not len(cases.windows):
        return ()
    windows = cases.windows
    few = evenly_spaced(len(windows), MOST_WINDOWS)
    batches = np.array_split(few, -(-len(few) // BATCH))
    held, width = (
        np.concatenate(parts, axis=1)
        for parts in zip(*(_intervals(model, cases, rows) for rows in batches), strict=True)
    )
    found = []
    for place, horizon in enumerate(cases.horizons):
        rows = cases.moving[few, horizon - 1]
        if rows.any():
            inside, wide = held[place][rows].mean(axis=0), width[place][rows].mean(axis=0) / cases.scale
            found.append(Coverage(horizon, int(rows.sum()), SHARE, inside, wide))
    return tuple(found)


def _intervals(model: DynamicsModel, cases: MeasuredCases, rows: IntArray) -> tuple[Array, Array]:
    """Return whether each target is inside the interval, and its width, (horizons, N, nx), for the windows ``rows``."""
    windows = cases.windows[rows]
    past_states, past_controls = cases.history(model.n_lags + model.n_recent)
    drawn = model.simulate(
        past_states[rows],
        past_controls[rows],
        windows.controls,
        samples=SAMPLES,
        rng=np.random.default_rng(int(rows[0])),
    )
    ends = [horizon - 1 for horizon in cases.horizons]
    low, high = np.quantile(drawn[:, :, ends], [0.5 - SHARE / 2, 0.5 + SHARE / 2], axis=0, method="weibull")
    truth = cases.system.unwrap_towards(windows.states[:, ends], 0.5 * (low + high))
    inside = ((truth >= low) & (truth <= high)).astype(np.float64)
    return inside.transpose(1, 0, 2), (high - low).transpose(1, 0, 2)


def episode_errors(cases: MeasuredCases, windows: Array, free_runs: Sequence[Array]) -> tuple[EpisodeError, ...]:
    """Return the errors of each test episode from the predictions ``windows`` (N, H, nx) and ``free_runs``."""
    errors, system = cases.system.difference(windows, cases.windows.states), cases.system
    nothing = np.full(system.nx, np.nan)
    fits = {
        run.episode: measures.fit_percent(
            run.states, system.unwrap_towards(predicted, run.states), std=system.spread(run.states)
        )
        for run, predicted in zip(cases.free_runs, free_runs, strict=True)
        if len(run.states)
    }
    return tuple(
        EpisodeError(
            name,
            np.array([_n(errors, cases, cases.windows.episode == number, horizon) for horizon in cases.horizons]),
            fits.get(name, nothing),
        )
        for number, name in enumerate(cases.test.names)
    )


def _n(errors: Array, cases: MeasuredCases, inside: np.ndarray, horizon: int) -> float:
    scored = errors[inside & cases.moving[:, horizon - 1], horizon - 1]
    if not len(scored):
        return float("nan")
    return float(mean_over_channels(np.sqrt(np.mean(scored**2, axis=0)) / cases.scale))


class Persistence(DynamicsModel):
    """The next state is the present one; it has no parameters."""

    knowledge = "none"

    def __init__(self) -> None:
        """Take no arguments."""

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        return self

    def next_state(self, carry: Array, control: Array) -> Array:
        return carry


def condition_errors(
    model: DynamicsModel,
    learn: Callable[[Dataset], DynamicsModel],
    training: Dataset,
    test: Dataset,
    protocol: PredictionProtocol,
) -> tuple[ConditionError, ...]:
    """Return the errors in every condition of ``test``; ``learn`` fits the family of ``model`` to other data."""
    found = []
    dt = test.system.dt
    horizon = main_horizon(protocol.at(dt).horizons, dt) or 1
    for condition in test.conditions:
        here = test.of_condition(condition)
        others = [episode for episode in training if episode.condition != condition]
        within, across = _score_at(model, training, here, protocol, horizon), None
        if others and within is not None:
            rest = training.with_episodes(others)
            across = _score_at(learn(rest), rest, here, protocol, horizon)
        (own, _), (other, covered) = (scored or (None, None) for scored in (within, across))
        found.append(ConditionError(condition, horizon, own, other, covered))
    return tuple(found)


def _score_at(
    model: DynamicsModel, training: Dataset, test: Dataset, protocol: PredictionProtocol, horizon: int
) -> tuple[float, float | None] | None:
    """Return N and the coverage of the intervals, None without any, at ``horizon``; None without test data."""
    try:
        scores = score_model("", model, measured_cases(training, test, protocol), family="")
    except InvalidData:
        return None
    if (score := scores.score(horizon)) is None:
        return None
    return score.n, next((held.mean for held in scores.coverage if held.horizon == horizon), None)
