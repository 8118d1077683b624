"""Subspace identification of linear state spaces, the start of every training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from model_zoo.state_space.recordings import ScaledEpisode
from sysid_evo.types import Array

MAX_PAST = 20
"""Samples of the past from which the state is estimated."""
SHARE = 4
"""Samples per coefficient of the predictor, at least."""
RIDGE = 1e-8
FASTEST = 0.1
"""Smallest remainder, after one sample, of the fastest mode of a differential equation."""


@dataclass(frozen=True)
class Subspace:
    """States (N, n) that predict the outputs, in order of importance, with ``controls`` and ``outputs``.

    ``controls`` (N, nu) and ``outputs`` (N, ny) belong to the same times; ``follows`` (N,) is true if the next row is
    the next sample.
    """

    states: Array
    controls: Array
    outputs: Array
    follows: Array

    @classmethod
    def of(cls, parts: list[ScaledEpisode]) -> Self:
        """Find the states by the predictor-based subspace method (Chiuso 2007, PBSID).

        Outputs are regressed on ``past`` samples of outputs and controls. The coefficients, shifted by one sample per
        row, predict future outputs from the past; the principal components of these predictions are the states.
        """
        ny, nu = parts[0].outputs.shape[1], parts[0].controls.shape[1]
        total = sum(len(part) for part in parts)
        past = max(1, min(MAX_PAST, total // (SHARE * (ny + nu)), max(len(part) for part in parts) // 2))
        rows = [_with_past(part, past) for part in parts if len(part) >= past]
        before, outputs, controls = (np.concatenate(columns) for columns in zip(*rows, strict=True))
        follows = np.concatenate([np.arange(len(row[1])) < len(row[1]) - 1 for row in rows])
        flat = before.reshape(len(before), -1)
        markov = np.linalg.solve(flat.T @ flat + RIDGE * len(flat) * np.eye(flat.shape[1]), flat.T @ outputs)
        lagged = markov.reshape(past, ny + nu, ny)  # of the sample 1, 2, ... steps ago
        ahead = [np.concatenate([lagged[i:], np.zeros((i, ny + nu, ny))]).reshape(-1, ny) for i in range(past)]
        predicted = flat @ np.concatenate(ahead, axis=1)
        left, sizes, _ = np.linalg.svd(predicted, full_matrices=False)
        return cls(left * np.sqrt(len(left)) * (sizes > 1e-9 * sizes[0]), controls, outputs, follows)


def linear_space(sequence: Subspace, order: int) -> tuple[Array, Array]:
    """Return rates and pace of the linear state space of ``order`` states, at least one for each output.

    It steps by x' = x + rates (x, u, 1), with rates (n, n + nu + 1); the pace (n,) is the typical change of each state
    in a step. The first states are the predicted outputs, the others the next components, made independent of them and
    scaled to deviation 1.
    """
    ny = sequence.outputs.shape[1]
    found = sequence.states[:, :order]
    seen = found @ np.linalg.lstsq(found, sequence.outputs, rcond=None)[0]
    rest = found - seen @ np.linalg.lstsq(seen, found, rcond=None)[0]
    left, sizes, _ = np.linalg.svd(rest, full_matrices=False)
    hidden = left[:, : order - ny] * np.sqrt(len(left)) * (sizes[: order - ny] > 1e-9)
    hidden = np.pad(hidden, ((0, 0), (0, order - ny - hidden.shape[1])))
    states = np.concatenate([seen, hidden], axis=1)
    now, after = np.flatnonzero(sequence.follows), np.flatnonzero(sequence.follows) + 1
    regressors = np.concatenate([states[now], sequence.controls[now], np.ones((len(now), 1))], axis=1)
    change = states[after] - states[now]
    penalty = RIDGE * len(now) * np.eye(regressors.shape[1])
    rates = np.linalg.solve(regressors.T @ regressors + penalty, regressors.T @ change).T
    return rates, np.maximum(np.sqrt(np.mean(change**2, axis=0)), 1e-3)


def flowing(rates: Array) -> Array:
    """Return the rates of the differential equation equivalent to x' = x + ``rates`` (n, n + nu + 1) (x, u, 1).

    Modes that alternate in sign or vanish within a sample have no continuous equivalent; they are replaced by fast
    decaying modes with the same final value.
    """
    n = len(rates)
    modes, vectors = np.linalg.eig(np.eye(n) + rates[:, :n])
    followed = np.where((modes.imag == 0.0) & (modes.real < FASTEST), FASTEST, modes.astype(np.complex128))
    slow = np.log(followed * np.maximum(1.0, FASTEST / np.abs(followed)))
    near = np.abs(modes - 1.0) < 1e-6
    share = np.where(near, 1.0, slow / np.where(near, 1.0, modes - 1.0))
    back = np.linalg.pinv(vectors)
    drift, drive = (vectors * slow) @ back, (vectors * share) @ back @ rates[:, n:]
    return np.concatenate([drift.real, drive.real], axis=1)


def _with_past(part: ScaledEpisode, past: int) -> tuple[Array, Array, Array]:
    """Return controls and outputs of the ``past`` samples, newest first, and the present output and control."""
    both = np.concatenate([part.controls, part.outputs[:-1]], axis=1)
    windows = np.lib.stride_tricks.sliding_window_view(both, past, axis=0)[..., ::-1]
    before = np.ascontiguousarray(np.moveaxis(windows, 2, 1))
    # the window that ends at k - 1 predicts sample k; the last sample has no control
    return before[:-1], part.outputs[past:-1], part.controls[past:]
