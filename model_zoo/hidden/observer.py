"""How the state is found from outputs: a first guess, and a gain that corrects it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model_zoo.hidden.records import Record
from model_zoo.hidden.shooting import FAR, Spaces
from sysid_evo.arrays import Array
from sysid_evo.data import Trajectory
from sysid_evo.data.windows import WindowPlaces, Windows

RATIOS = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Noise of the state in one step, in units of its usual change, to noise of the output in units of its deviation."""
RICCATI_STEPS, SETTLED = 400, 1e-6
HORIZON, MOST_WINDOWS = 30, 300
FORGOTTEN = 0.02
"""Share of a wrong first guess that may be left after the history."""
SHORTEST, LONGEST = 4, 64
"""Samples of history."""
EPISODE_SHARE = 12
"""A history takes at most one part in so many of the longest episode."""
RIDGE = 1e-6


@dataclass(frozen=True)
class Observer:
    """What corrects the states of one space by the output: ``gain`` (n, ny); the first guess is ``first`` (n, ny + 1).

    ``history`` samples are enough to forget the first guess.
    """

    gain: Array
    first: Array
    history: int


def observer(space: Spaces, runs: Array, outputs: Array, parts: list[Record]) -> Observer:
    """Return the observer of one space, with the ratio of noises that makes free runs best.

    ``runs`` (N, n) are states of the training runs and ``outputs`` (N, ny) what was measured then.
    """
    ny = outputs.shape[1]
    regressors = np.concatenate([outputs, np.ones((len(outputs), 1))], axis=1)
    square = regressors.T @ regressors + RIDGE * len(regressors) * np.eye(ny + 1)
    first = np.linalg.solve(square, regressors.T @ runs).T
    first[:ny] = np.eye(ny, ny + 1)
    controls = np.concatenate([part.controls for part in parts])
    longest = max(len(part) for part in parts)
    room = min(max(SHORTEST, min(LONGEST, longest // EPISODE_SHARE)), longest - 1)
    places = np.linspace(0, len(runs) - 1, min(200, len(runs))).astype(np.int64)
    middle = controls[np.linspace(0, len(controls) - 1, len(places)).astype(np.int64)]
    slope = space.jacobian(runs[None, places], middle)[0].mean(axis=0)
    gains = _riccati(slope, space.pace, ny)
    errors = _errors(space, gains, first, _windows(parts, room))
    best = int(np.argmin(errors))
    closed = slope.copy()
    closed[:, :ny] -= gains[best]
    radius = float(np.abs(np.linalg.eigvals(closed)).max())
    memory = LONGEST if radius >= 1.0 else np.log(FORGOTTEN) / np.log(max(radius, 1e-3))
    return Observer(gains[best], first, int(min(max(np.ceil(memory), SHORTEST), room)))


def _riccati(slope: Array, pace: Array, ny: int) -> Array:
    """Return the stationary gains (G, n, ny) of the Kalman predictors, for all `RATIOS`."""
    ratios = np.array(RATIOS)[:, None, None]
    drift, spread = (ratios * np.diag(pace)) ** 2, np.eye(len(slope)) * (ratios > 0.0)
    gain = np.zeros((len(ratios), len(slope), ny))
    for _ in range(RICCATI_STEPS):
        before = gain
        gain = slope @ spread[:, :, :ny] @ np.linalg.inv(spread[:, :ny, :ny] + np.eye(ny))
        spread = slope @ spread @ slope.T - gain @ (spread[:, :ny] @ slope.T) + drift
        spread = np.clip(0.5 * (spread + spread.swapaxes(1, 2)), -1e6, 1e6)
        if np.abs(gain - before).max() < SETTLED:
            break
    return gain


def _errors(space: Spaces, gains: Array, first: Array, windows: Windows) -> Array:
    """Return the mean square error (G,) of free runs from what each of the ``gains`` (G, n, ny) finds."""
    ny, many = first.shape[1] - 1, space[np.zeros(len(gains), dtype=np.int64)]
    past, history = windows.past_states, windows.past_controls.shape[1]
    states = past[:, 0] @ first[:, :ny].T + first[:, ny]
    states = np.broadcast_to(states, (len(gains), *states.shape))
    for k in range(history + 1):
        control = windows.past_controls[:, k] if k < history else windows.controls[:, 0]
        off = past[:, k] - states[..., :ny]
        states = np.clip(many.step(states, control) + off @ gains.swapaxes(1, 2), -FAR, FAR)
    runs = many.run(states, windows.controls[:, 1:])[..., :ny]
    return np.asarray(((runs - windows.states) ** 2).mean(axis=(1, 2, 3)))


def _windows(parts: list[Record], history: int) -> Windows:
    """Return some windows of the records, in their units, each with ``history`` samples before it."""
    episodes = [Trajectory(part.outputs, part.controls, 1.0) for part in parts]
    ahead = max(1, min(HORIZON, max(len(part) for part in parts) - history))
    places = WindowPlaces.of(episodes, ahead, history=history)
    return places[np.unique(np.linspace(0, len(places) - 1, min(MOST_WINDOWS, len(places))).astype(np.int64))]
