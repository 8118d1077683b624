"""What a model would have to remember: controls that act later than it knows, and states that nobody measures."""

from __future__ import annotations

import numpy as np

from evaluation.advice.evidence import Evidence
from evaluation.advice.explaining import lagged, unexplained, with_products
from evaluation.advice.remark import Remark
from evaluation.labels import percent
from evaluation.prediction.residuals import LAGS
from sysid_evo.arrays import Array
from sysid_evo.data.linear_fit import acting_controls
from sysid_evo.data.suggestions import spell

SHARE = 0.1
"""Share of what a model leaves that the past must explain: a twentieth of the error, the least that a paired comparison
of a few minutes can tell apart."""
LOOKED_BACK = (1, 2, 3, 4, 6, 8, 12, LAGS)
"""Lags beyond the memory of a model that are tried together."""
NEARLY = 0.9
"""Of what all lags explain, the part after which the rest is not waited for."""
COUNTS = 0.1
"""A channel whose squared error in standard deviations is less than this share of the largest does not count."""
EARLIER = 4
"""Earlier errors, from which whoever keeps track of a hidden state would know it."""
FEWEST = 250


def late_controls(evidence: Evidence) -> Remark | None:
    """Return that controls act later than the model can know."""
    memory = evidence.model.lags[1]
    if not evidence.system.nu or memory >= LAGS:
        return None
    found = _beyond(evidence)
    if found is None:
        return None
    base, left, controls, earlier = found
    inputs = controls.shape[1] // (LAGS - memory)
    counts = [count for count in LOOKED_BACK if count <= LAGS - memory]
    tried = [controls[:, : inputs * count] for count in counts]
    gains = [_gain(base, np.concatenate([base, some], axis=1), left)[0] for some in tried]
    beside = np.concatenate([base, earlier], axis=1)
    own = [_gain(beside, np.concatenate([beside, some], axis=1), left)[0] for some in tried]
    best = max(gains)
    if min(best, max(own)) < SHARE:
        return None
    latest = memory + next(count for count, gain in zip(counts, gains, strict=True) if gain >= NEARLY * best)
    _, channel = _gain(base, np.concatenate([base, tried[gains.index(best)]], axis=1), left)
    dt = evidence.system.dt
    knows = f"those of the last {spell(memory * dt)}" if memory else "only that of the moment"
    remedy = (
        f"fit it with control_lags={latest}"
        if "control_lags" in evidence.model.get_params()
        else "take a family with control_lags or with a hidden state"
    )
    return Remark(
        "late controls",
        f"Controls act up to {spell(latest * dt)} later: earlier ones explain {percent(best)} of what {evidence.name}, "
        f"which knows {knows}, leaves of {evidence.system.state_names[channel]} one step ahead. To mend it, {remedy}.",
        1.0 - np.sqrt(1.0 - best),
        {"explained": best, "steps": float(latest)},
    )


def hidden_state(evidence: Evidence) -> Remark | None:
    """Return that earlier errors tell more: of a state that is not measured, or of noise to be averaged out."""
    white = evidence.residuals.white
    found = _beyond(evidence)
    if white.all() or found is None:
        return None
    base, left, controls, earlier = found
    beside = np.concatenate([base, controls], axis=1)
    known = beside if _gain(base, beside, left)[0] >= SHARE else base
    gain, channel = _gain(known, np.concatenate([known, earlier], axis=1), left)
    if gain < SHARE or white[channel]:
        return None
    size = float(evidence.residuals.autocorrelation[0, channel])
    unseen = size > 0.0
    wanted = evidence.model.lags[0] + 2
    remedy = f"state_lags={wanted}" if "state_lags" in evidence.model.get_params() else "a family with state_lags"
    why = (
        "something that moves is not measured. Measure it if you can; else try"
        if unseen
        else "measured states are noisy, and several samples together tell them better. Try"
    )
    return Remark(
        "hidden state" if unseen else "noisy states",
        f"What {evidence.name} leaves of {evidence.system.state_names[channel]} one step ahead is not white "
        f"(correlation {size:+.2f} from step to step), and earlier errors explain {percent(gain)} of it: {why} "
        f"{remedy} or a family with a hidden state.",
        1.0 - np.sqrt(1.0 - gain),
        {"explained": gain, "autocorrelation": size},
    )


def _beyond(evidence: Evidence) -> tuple[Array, Array, Array, Array] | None:
    """Return what the model knows, what it leaves, controls before its memory and earlier errors; None with few steps.

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
    earlier = lagged(steps.errors, range(1, EARLIER + 1), rows)
    known = np.isfinite(np.concatenate([inside, older_controls, earlier], axis=1)).all(axis=1)
    if known.sum() < FEWEST:
        return None
    base = np.concatenate([with_products(now[known]), inside[known]], axis=1)
    return base, steps.errors[rows][known] / evidence.std, older_controls[known], earlier[known]


def _gain(before: Array, after: Array, left: Array) -> tuple[float, int]:
    """Return the share of what ``before`` leaves that ``after`` explains, in the channel where it is largest.

    ``left`` (N, nx) is in standard deviations of the states; channels that are hardly wrong do not count.
    """
    remaining = np.minimum(unexplained(before, left), 1.0)
    gains = 1.0 - unexplained(after, left) / np.maximum(remaining, 1e-12)
    size = np.mean(left**2, axis=0)
    gains = np.where(size >= COUNTS * size.max(), gains, -np.inf)
    return float(gains.max()), int(gains.argmax())
