"""Checks of one-step errors: noise, model structure, delayed controls, hidden states."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from evaluation.advice.evidence import Evidence, Remark
from evaluation.formatting import percent
from evaluation.prediction.residuals import LAGS
from sysid_evo.data.response import acting_controls
from sysid_evo.data.trajectory import evenly_spaced
from sysid_evo.data.units import spelled_time
from sysid_evo.types import Array, BoolArray

FEWEST = 250
"""Minimum number of steps with the whole history that a model uses; with fewer there is no remark."""

MAX_NOISE_RATIO = 1.25
"""Ratio of the one-step error to the noise up to which little is left to gain: differences between families that matter
are larger."""
MIN_FORM_SHARE = 0.2
"""Share of the residual variance, explained by a plain regression on the model's own inputs, from which the form of the
model limits it: a tenth of the error."""
NEIGHBOURS, MIN_PAIR_DISTANCE = 4, 20
"""Neighbours of a step that form pairs with it, and their minimum distance in steps: correlated noise is in both."""

MOST_PAIRS = 4000


def noise_floor(evidence: Evidence) -> Remark | None:
    """Return a remark if little is left to gain one step ahead, or if the form of the model limits it."""
    found = estimate_noise(evidence)
    if found is None:
        return None
    n, floor, share = found
    figures = {"n": n, "noise": floor, "explained": share}
    if share >= MIN_FORM_SHARE:
        return Remark(
            "form",
            f"The form of {evidence.name} limits it: a plain regression on the same inputs explains "
            f"{percent(share)} of its one-step residual. Try a more flexible family, or one with more "
            "physics.",
            1.0 - np.sqrt(1.0 - share),
            figures,
        )
    if n <= MAX_NOISE_RATIO * floor:
        return Remark(
            "noise",
            f"The one-step error of {evidence.name}, N {n:.3f}, is {n / floor:.2f} times the noise, "
            f"{floor:.3f}: little is left to gain with these inputs.",
            0.05,
            figures,
        )
    return None


def estimate_noise(evidence: Evidence) -> tuple[float, float, float] | None:
    """Return N one step ahead, its noise, and the share that a regression explains; None with too few steps.

    Two steps from nearly the same inputs differ by their noise alone: half the mean squared difference of the
    residuals of such pairs is the variance of the noise (the model removes the change between them), as in Rice (1984)
    and in the gamma test. Everything that the model's inputs do not determine counts as noise.
    """
    steps, system = evidence.steps, evidence.system
    rows = steps.scored
    state_lags, control_lags = evidence.model.lags
    states = system.regressors(np.nan_to_num(steps.states))
    states[~np.isfinite(steps.states).all(axis=1)] = np.nan
    now = np.concatenate([states[rows], steps.controls[rows]], axis=1)
    earlier = np.concatenate(
        [lagged(states, range(1, state_lags + 1), rows), lagged(steps.controls, range(1, control_lags + 1), rows)],
        axis=1,
    )
    known = np.isfinite(earlier).all(axis=1)
    if known.sum() < FEWEST:
        return None
    left = steps.errors[rows][known] / evidence.std
    now, earlier, places = now[known], earlier[known], np.flatnonzero(rows)[known]
    some = evenly_spaced(len(left), MOST_PAIRS, nearest=True)
    points, places = standardised(np.concatenate([now, earlier], axis=1))[some], places[some]
    count = min(len(points), NEIGHBOURS + 2 * MIN_PAIR_DISTANCE + 1)
    near = np.asarray(cKDTree(points).query(points, k=count)[1], dtype=np.int64)
    apart = np.abs(places[near] - places[:, None]) > MIN_PAIR_DISTANCE  # in time
    pairs = near[np.arange(len(near)), apart.argmax(axis=1)]
    floor = np.sqrt(0.5 * np.mean((left[some] - left[some][pairs]) ** 2, axis=0))
    features = np.concatenate([with_products(now), earlier], axis=1)
    return float(np.sqrt(np.mean(left**2, axis=0)).mean()), float(floor.mean()), explained(features, left)


SHARE = 0.1
"""Share of the residual variance that the past must explain: a twentieth of the error, the least that a paired
comparison of a few minutes can detect."""
TESTED_LAGS = (1, 2, 3, 4, 6, 8, 12, LAGS)
"""Lags beyond the memory of a model that are tested together."""
MIN_GAIN_SHARE = 0.9
"""Share of the gain of all lags that the reported number of lags must reach."""
MIN_ERROR_SHARE = 0.1
"""A channel whose squared error in standard deviations is below this share of the largest is ignored."""
N_EARLIER_ERRORS = 4
"""Number of earlier errors, from which a hidden state could be estimated."""


def late_controls(evidence: Evidence) -> Remark | None:
    """Return a remark if controls act later than the memory of the model."""
    memory = evidence.model.lags[1]
    if not evidence.system.nu or memory >= LAGS:
        return None
    found = _beyond(evidence)
    if found is None:
        return None
    base, left, controls, earlier = found
    inputs = controls.shape[1] // (LAGS - memory)
    counts = [count for count in TESTED_LAGS if count <= LAGS - memory]
    tried = [controls[:, : inputs * count] for count in counts]
    gains = [_gain(base, np.concatenate([base, some], axis=1), left)[0] for some in tried]
    extended = np.concatenate([base, earlier], axis=1)
    own = [_gain(extended, np.concatenate([extended, some], axis=1), left)[0] for some in tried]
    best = max(gains)
    if min(best, max(own)) < SHARE:
        return None
    latest = memory + next(count for count, gain in zip(counts, gains, strict=True) if gain >= MIN_GAIN_SHARE * best)
    _, channel = _gain(base, np.concatenate([base, tried[gains.index(best)]], axis=1), left)
    dt = evidence.system.dt
    knows = f"the controls of the last {spelled_time(memory * dt)}" if memory else "only the present controls"
    remedy = (
        f"fit it with control_lags={latest}"
        if "control_lags" in evidence.model.get_params()
        else "use a family with control_lags or with a hidden state"
    )
    return Remark(
        "late controls",
        f"Controls act up to {spelled_time(latest * dt)} later: earlier controls explain {percent(best)} of the "
        f"one-step residual of {evidence.system.state_names[channel]} ({evidence.name} uses {knows}). "
        f"To correct this, {remedy}.",
        1.0 - np.sqrt(1.0 - best),
        {"explained": best, "steps": float(latest)},
    )


def hidden_state(evidence: Evidence) -> Remark | None:
    """Return a remark if earlier errors explain the residual: a state is not measured, or noise can be averaged out."""
    white = evidence.residuals.white
    found = _beyond(evidence)
    if white.all() or found is None:
        return None
    base, left, controls, earlier = found
    extended = np.concatenate([base, controls], axis=1)
    known = extended if _gain(base, extended, left)[0] >= SHARE else base
    gain, channel = _gain(known, np.concatenate([known, earlier], axis=1), left)
    if gain < SHARE or white[channel]:
        return None
    size = float(evidence.residuals.autocorrelation[0, channel])
    unseen = size > 0.0
    wanted = evidence.model.lags[0] + 2
    remedy = f"state_lags={wanted}" if "state_lags" in evidence.model.get_params() else "a family with state_lags"
    why = (
        "a state is not measured. Measure it if you can; otherwise use"
        if unseen
        else "measured states are noisy, and several samples together are more accurate. Use"
    )
    return Remark(
        "hidden state" if unseen else "noisy states",
        f"The one-step residual of {evidence.system.state_names[channel]} is not white ({evidence.name}, correlation "
        f"{size:+z.2f} from step to step), and earlier errors explain {percent(gain)} of it: {why} "
        f"{remedy} or a family with a hidden state.",
        1.0 - np.sqrt(1.0 - gain),
        {"explained": gain, "autocorrelation": size},
    )


def _beyond(evidence: Evidence) -> tuple[Array, Array, Array, Array] | None:
    """Return the model's inputs, residuals, controls before its memory and earlier errors; None with too few steps.

    Rows are steps in order of time. Controls are those that act (`acting_controls`), in order of their lag.
    """
    steps, system = evidence.steps, evidence.system
    state_lags, control_lags = evidence.model.lags
    filled = np.nan_to_num(steps.states)
    states, controls = system.regressors(filled), acting_controls(system, filled, steps.controls)
    states[~np.isfinite(steps.states).all(axis=1)] = np.nan
    rows = steps.scored
    now = np.concatenate([states[rows], steps.controls[rows]], axis=1)
    inside = np.concatenate(
        [lagged(states, range(1, state_lags + 1), rows), lagged(controls, range(1, control_lags + 1), rows)], axis=1
    )
    older_controls = lagged(controls, range(control_lags + 1, LAGS + 1), rows)
    earlier = lagged(steps.errors, range(1, N_EARLIER_ERRORS + 1), rows)
    known = np.isfinite(np.concatenate([inside, older_controls, earlier], axis=1)).all(axis=1)
    if known.sum() < FEWEST:
        return None
    base = np.concatenate([with_products(now[known]), inside[known]], axis=1)
    return base, steps.errors[rows][known] / evidence.std, older_controls[known], earlier[known]


def _gain(before: Array, after: Array, left: Array) -> tuple[float, int]:
    """Return the share of the residual of ``before`` that ``after`` explains, in the channel where it is largest.

    ``left`` (N, nx) are residuals in standard deviations of the states; channels with small residuals are ignored.
    """
    remaining = np.minimum(unexplained(before, left), 1.0)
    gains = 1.0 - unexplained(after, left) / np.maximum(remaining, 1e-12)
    size = np.mean(left**2, axis=0)
    gains = np.where(size >= MIN_ERROR_SHARE * size.max(), gains, -np.inf)
    return float(gains.max()), int(gains.argmax())


FOLDS, BLOCK_ROWS = 5, 50
"""Number of folds and rows of a contiguous block: every fifth block is held out in turn."""
RIDGES = (1.0, 30.0, 1000.0)


def explained(features: Array, targets: Array) -> float:
    """Return the share of the variance of ``targets`` (N, k), equally scaled, that ``features`` (N, m) explain.

    Both are in order of time; each block is predicted from the others, by ridge regression with the best of three
    penalties. 0 if nothing is explained or there are too few rows.
    """
    if len(targets) < FOLDS * BLOCK_ROWS:
        return 0.0
    left = unexplained(features, targets)
    return max(0.0, 1.0 - float(np.mean(left)))


def unexplained(features: Array, targets: Array) -> Array:
    """Return the unexplained share (k,) of the variance of each column of ``targets``, with the best penalty."""
    x = standardised(features)
    y = targets - targets.mean(axis=0)
    total = np.mean(y**2, axis=0)
    total = np.where(total > 0.0, total, np.inf)
    fold = (np.arange(len(y)) // BLOCK_ROWS) % FOLDS
    squares = np.zeros((len(RIDGES), y.shape[1]))
    whole = x.T @ x, x.T @ y
    for number in range(FOLDS):
        held = fold == number
        gram, cross = whole[0] - x[held].T @ x[held], whole[1] - x[held].T @ y[held]
        for place, ridge in enumerate(RIDGES):
            weights = np.linalg.solve(gram + ridge * np.eye(len(gram)), cross)
            squares[place] += ((y[held] - x[held] @ weights) ** 2).sum(axis=0)
    shares = squares / len(y) / total
    return np.asarray(shares[shares.mean(axis=1).argmin()])


def standardised(features: Array) -> Array:
    """Return each column with mean 0 and standard deviation 1; a constant column becomes 0."""
    std = features.std(axis=0)
    return np.asarray((features - features.mean(axis=0)) / np.where(std > 0.0, std, np.inf))


def with_products(features: Array) -> Array:
    """Return the columns of ``features`` (N, m), standardised, and all products of two of them."""
    x = standardised(features)
    first, second = np.triu_indices(x.shape[1])
    return np.concatenate([x, x[:, first] * x[:, second]], axis=1)


def lagged(values: Array, lags: range, rows: BoolArray) -> Array:
    """Return ``values`` (M, c) at each of ``lags`` before the ``rows`` (M,), side by side; NaN before the start."""
    found = []
    for lag in lags:
        moved = np.full_like(values, np.nan)
        moved[lag:] = values[: len(values) - lag]
        found.append(moved[rows])
    return np.concatenate(found, axis=1) if found else np.empty((int(rows.sum()), 0))
