"""Pieces of a recording that a correction learns from, and the free runs of a model over them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sysid_evo.adaptation.terms import Terms, state_scale
from sysid_evo.arrays import Array, BoolArray, IntArray
from sysid_evo.data import Dataset
from sysid_evo.dynamics.stepping import Dynamics, clip_state
from sysid_evo.errors import InvalidData

SECOND, FEWEST_STEPS, MOST_STEPS = 1.0, 10, 20
STRIDE = 3
FARTHEST = 10.0
"""Standard deviations that an error counts at most."""
ROWS = 2**14
"""Free runs side by side."""


@dataclass(frozen=True)
class Pieces:
    """B windows of H steps as a model starts and is judged.

    ``carry`` (B, n_carry) at the start, ``controls`` (B, H, nu), ``truth`` (B, H, nx), ``first`` (B,) the sample at
    which each starts, counted over all episodes; ``scale`` (nx,) is the spread of the states, ``envelope`` (2, nx)
    what a free run is clipped to.
    """

    carry: Array
    controls: Array
    truth: Array
    first: IntArray
    scale: Array
    envelope: Array | None

    @classmethod
    def of(cls, model: Dynamics, dataset: Dataset, *, stride: int = STRIDE) -> Self:
        """Cut windows of one second, 10 to 20 steps, that start in motion. Raises `InvalidData` if there is none."""
        system, lags = dataset.system, model.n_lags
        horizon = int(np.clip(round(SECOND / system.dt), FEWEST_STEPS, MOST_STEPS))
        windows = dataset.windows(horizon, stride=stride, history=lags, moving=True)
        if not len(windows):
            windows = dataset.windows(horizon, stride=stride, history=lags)
        if not len(windows):
            raise InvalidData(
                f"adaptation: expected an episode of more than {horizon + lags} steps, {lags} of history and {horizon} "
                f"to run freely; the longest has {max(len(episode) for episode in dataset)}"
            )
        begins = np.cumsum([0, *(len(episode) for episode in dataset)])[:-1]
        draws = np.zeros((len(windows), model.n_draws))
        carry = model.start(windows.past_states, windows.past_controls, draws)
        states = np.concatenate([e.states[rows] for e, rows in zip(dataset, dataset.moving, strict=True)])
        states = states if len(states) else np.concatenate([episode.states for episode in dataset])
        scale = state_scale(system, states)
        first = windows.start + begins[windows.episode]
        return cls(carry, windows.controls, windows.states, first, scale, model.envelope)

    def __len__(self) -> int:
        return len(self.first)

    def __getitem__(self, rows: BoolArray | IntArray | slice) -> Pieces:
        return replace(
            self, carry=self.carry[rows], controls=self.controls[rows], truth=self.truth[rows], first=self.first[rows]
        )

    @property
    def horizon(self) -> int:
        """Steps of each window."""
        return int(self.controls.shape[1])


def free_runs(model: Dynamics, terms: Terms, candidates: Array, pieces: Pieces) -> Array:
    """Return where ``model`` with each correction (P, size, nx) goes, (P, B, H, nx)."""
    at_once = max(1, ROWS // max(1, len(pieces)))
    parts = [_beside(model, terms, candidates[i : i + at_once], pieces) for i in range(0, len(candidates), at_once)]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _beside(model: Dynamics, terms: Terms, candidates: Array, pieces: Pieces) -> Array:
    """Return the free runs with all of the ``candidates`` at once."""
    count, (batch, horizon, nu), nx = len(candidates), pieces.controls.shape, terms.system.nx
    carry = np.tile(pieces.carry, (count, 1))
    noise = np.zeros((len(carry), model.n_noise)) if model.n_noise else None
    out = np.empty((count, batch, horizon, nx))
    with np.errstate(all="ignore"):
        for k in range(horizon):
            control = np.tile(pieces.controls[:, k], (count, 1))
            after = model.step(carry, control, noise)
            before, reached = (x[:, :nx].reshape(count, batch, nx) for x in (carry, after))
            moved = terms.corrected(before, control.reshape(count, batch, nu), reached, candidates[:, None])
            carry, _ = clip_state(np.concatenate([moved.reshape(-1, nx), after[:, nx:]], axis=1), pieces.envelope)
            out[:, :, k] = carry[:, :nx].reshape(count, batch, nx)
    return out


def off(terms: Terms, runs: Array, pieces: Pieces) -> Array:
    """Return the errors (..., B, H, nx) of ``runs`` in standard deviations; what is not finite counts most."""
    wrong = terms.system.difference(runs, np.broadcast_to(pieces.truth, runs.shape)) / pieces.scale
    return np.where(np.isfinite(wrong), np.clip(wrong, -FARTHEST, FARTHEST), FARTHEST)


def error_of(errors: Array) -> float:
    """Return the mean over steps and states of the root mean square over windows of ``errors`` (B, H, nx)."""
    return float(np.mean(np.sqrt(np.mean(errors**2, axis=0))))
