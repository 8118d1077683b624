"""How far a prediction may be off: the noise of every step, scaled on measured free runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from sklearn.base import clone

from sysid_evo.arrays import Array
from sysid_evo.data import Windows
from sysid_evo.dynamics import DynamicsModel

SAMPLES = 40
SHARE = 0.9
MOST_WINDOWS = 200


def calibrated_scale(
    model: DynamicsModel, windows: Windows, rng: np.random.Generator, *, share: float = SHARE, rounds: int = 6
) -> Array:
    """Return the ``noise_scale_`` (nx,) with which ``share`` of the last states of ``windows`` lie inside.

    ``model`` is fitted, has the hyper-parameter ``stochastic`` and multiplies its noise with
    ``noise_scale_``. Every channel is found by bisection in the logarithm, between 0.1 and 30; the
    same noise is drawn each time.
    """
    few = windows[:: max(1, len(windows) // MOST_WINDOWS)]
    noisy = clone(model).set_params(stochastic=True)
    noisy.__dict__.update({name: value for name, value in vars(model).items() if name.endswith("_")})
    seed = int(rng.integers(2**32))
    nx = windows.states.shape[2]
    low, high = np.full(nx, np.log(0.1)), np.full(nx, np.log(30.0))
    for _ in range(rounds):
        middle = 0.5 * (low + high)
        noisy.noise_scale_ = np.exp(middle)
        drawn = noisy.simulate(
            few.past_states, few.past_controls, few.controls, samples=SAMPLES, rng=np.random.default_rng(seed)
        )
        wide = coverage(drawn[:, :, -1], few.states[:, -1], share=share) >= share
        low, high = np.where(wide, low, middle), np.where(wide, middle, high)
    return np.exp(0.5 * (low + high))


def coverage(samples: Array, truth: Array, *, share: float = SHARE) -> Array:
    """Return how much of ``truth`` (N, nx) lies in the central ``share`` of ``samples`` (S, N, nx), (nx,)."""
    low, high = np.quantile(samples, [0.5 - share / 2, 0.5 + share / 2], axis=0)
    return ((truth >= low) & (truth <= high)).mean(axis=0)


def joined(parts: Sequence[Windows]) -> Windows:
    """Return windows of equal length from several sources, those of the shortest horizon deciding."""
    horizon = min(part.controls.shape[1] for part in parts)
    cut = {"controls", "states"}
    columns = {
        field.name: np.concatenate(
            [
                getattr(part, field.name)[:, :horizon] if field.name in cut else getattr(part, field.name)
                for part in parts
            ]
        )
        for field in fields(Windows)
    }
    return Windows(**columns)
