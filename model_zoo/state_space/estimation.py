"""From recordings to trained spaces: start by subspace identification, simulations, observers, stability screening."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from model_zoo.state_space.recordings import ScaledEpisode, Scales, ShootingWindows
from model_zoo.state_space.shooting import DIVERGED_DISTANCE, StateSpaceBatch, Trained, train
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.data.trajectory import WindowIndex, Windows
from sysid_evo.types import Array, BoolArray

SHORT, MIDDLE = 100, 300
"""Steps of the first and the following simulations: long ones of a poor model carry little information."""
UNSTABLE, STABLE = 1.0005, 0.999
"""Spectral radius above which a linear space is unstable, and its value after stabilisation."""
MAX_REORDERED, BLOCK, SHUFFLES, OUTPUT_MULTIPLE = 10_000, 25, 8, 1.5
"""Most steps under reordered controls, length of the permuted blocks, number of permutations, and the multiple of the
largest recorded output that counts as divergence."""
HOLD_FACTOR, AMPLITUDE_FACTOR = 2, 1.25
"""Factors by which controls are held longer, and by which their distance from the mean is larger, within their
range."""
OUTLIER_MULTIPLE, MIN_OUTLIER_DISTANCE = 5.0, 0.1
"""A space diverges if its distance from the median exceeds this multiple of the typical one, and this many
deviations."""
RESTART_ERROR = 1.0
"""Root mean square residual, in deviations, above which training restarts from the linear space."""


@dataclass(frozen=True)
class EstimationProblem:
    """Scaled recordings in windows of at most ``horizon`` steps; with ``flow`` for differential equations."""

    scales: Scales
    parts: list[ScaledEpisode]
    horizon: int
    flow: bool = False

    @classmethod
    def of(cls, dataset: Dataset, horizon: int, *, flow: bool = False) -> Self:
        """Scale ``dataset`` to units of its own deviation."""
        scales = Scales.of(dataset)
        return cls(scales, [scales.scaled(episode) for episode in dataset.episodes], horizon, flow)

    @cached_property
    def subspace(self) -> Subspace:
        """The states predicted from the past."""
        return Subspace.of(self.parts)

    @cached_property
    def short(self) -> ShootingWindows:
        return ShootingWindows.of(self.parts, min(SHORT, self.horizon))

    @cached_property
    def middle(self) -> ShootingWindows:
        return ShootingWindows.of(self.parts, MIDDLE) if self.horizon > MIDDLE else self.long

    @cached_property
    def long(self) -> ShootingWindows:
        return ShootingWindows.of(self.parts, self.horizon) if self.horizon > SHORT else self.short

    def linear(self, order: int) -> StateSpaceBatch:
        """Return the linear space from the subspace, stabilised if necessary."""
        rates, pace = linear_space(self.subspace, order)
        rates = flowing(rates) if self.flow else rates
        return stabilised(StateSpaceBatch.linear((rates / pace[:, None])[None], pace, flow=self.flow))

    def linear_trained(self, order: int, short: int, long: int, report: Callable[[], None]) -> Trained:
        """Train a linear space on short and on long simulations; if that makes it unstable, on long ones alone."""
        start = self.linear(order)
        trained = train(start, self.short, self.initial_states(self.short, start), short, report)
        if radius(trained.spaces) > UNSTABLE:
            trained = train(start, self.short, self.initial_states(self.short, start), 1)
        trained = self.lengthened(trained, start, long, report)
        if radius(trained.spaces) <= UNSTABLE:
            return trained
        stable = stabilised(trained.spaces)
        return train(stable, self.long, self.initial_states(self.long, stable), 1)

    def initial_states(self, windows: ShootingWindows, spaces: StateSpaceBatch) -> Array:
        """Return initial states (S, B, n) with the measured outputs and zeros for the rest."""
        starts = np.zeros((len(spaces), len(windows), spaces.n))
        ny = windows.outputs.shape[2]
        starts[:, :, :ny] = windows.outputs[:, 0]
        return starts

    def states(self, trained: Trained, windows: ShootingWindows) -> Array:
        """Return the states (S, N, n) of the runs at all samples that count, in sequence."""
        runs = trained.spaces.run(trained.starts, windows.controls)
        return np.stack([windows.rows(run) for run in runs])

    def lengthened(
        self, trained: Trained, fallback: StateSpaceBatch, iterations: int, report: Callable[[], None]
    ) -> Trained:
        """Continue on longer simulations for ``iterations``; spaces that diverge restart from ``fallback``."""
        before, later = self.short, [one for one in (self.middle, self.long) if one is not self.short]
        later = later[:1] if later and later[0] is later[-1] else later
        for number, windows in enumerate(later):
            starts = self.states(trained, before)[:, windows.begins]
            spaces = trained.spaces
            runs = spaces.run(starts, windows.controls)[..., : windows.outputs.shape[2]]
            off = ((runs - windows.outputs) ** 2 * windows.counts[:, :, None]).sum(axis=(1, 2, 3))
            lost = off > RESTART_ERROR**2 * windows.counts.sum() * runs.shape[3]
            if lost.any():
                outer = spaces.outer.copy()
                outer[lost] = 0.0
                outer[lost, :, : fallback.outer.shape[2]] = fallback.outer[0]
                spaces = replace(spaces, outer=outer)
                starts[lost] = self.initial_states(windows, spaces)[lost]
            share = iterations * (number + 1) // len(later) - iterations * number // len(later)
            trained, before = train(spaces, windows, starts, share, report), windows
        for _ in range(0 if later else iterations):
            report()
        return trained

    def observers(self, trained: Trained) -> list[StateObserver]:
        """Return an observer of every space of a training on long simulations."""
        runs, outputs = self.states(trained, self.long), self.long.rows(self.long.outputs)
        return [observer(trained.spaces[[s]], runs[s], outputs, self.parts) for s in range(len(runs))]

    def assessed(self, trained: Trained) -> tuple[list[StateObserver], Array]:
        """Return the observers of a training on long simulations, and the errors (S,) of simulations with them."""
        found = self.observers(trained)
        return found, np.array([self.from_history(trained.spaces[[s]], own) for s, own in enumerate(found)])

    def from_history(self, space: StateSpaceBatch, own: StateObserver) -> float:
        """Return the mean square error of one space on long simulations that start from its observer's estimate.

        In training the initial states are free, which hides slow or unstable states that the history does not
        determine.
        """
        outputs, controls = self.long.outputs, self.long.controls
        ny, history = outputs.shape[2], min(own.history, controls.shape[1] // 2)
        states = (outputs[:, 0] @ own.first[:, :ny].T + own.first[:, ny])[None]
        for k in range(history + 1):
            off = outputs[:, k] - states[..., :ny]
            states = np.clip(
                space.step(states, controls[:, k]) + off @ own.gain.T, -DIVERGED_DISTANCE, DIVERGED_DISTANCE
            )
        runs = space.run(states, controls[:, history + 1 :])[0, ..., :ny]
        counts = self.long.counts[:, history + 1 :, None]
        off = (runs - outputs[:, history + 1 :]) ** 2 * counts
        return float(off.sum() / max(counts.sum() * ny, 1.0))

    def escapes(self, spaces: list[StateSpaceBatch], observers: list[StateObserver]) -> BoolArray:
        """Return which members (S,), each a batch of one space, diverge under plausible other controls.

        The recorded controls are reversed and permuted in blocks, for as long as the longest episode (at most 10 000
        steps); a member diverges if an output goes far beyond the recorded ones. Of three or more members, one also
        diverges if it is far from the median of all, under these controls, under controls held longer, or under larger
        ones: only the other members show that the system itself would not.
        """
        longest = max(self.parts, key=len)
        ny, controls = longest.outputs.shape[1], longest.controls[:MAX_REORDERED]
        orders = [np.arange(len(controls))[::-1]]
        blocks = np.array_split(np.arange(len(controls)), max(1, len(controls) // BLOCK))
        for seed in range(SHUFFLES):
            places = np.random.default_rng(seed).permutation(len(blocks))
            orders.append(np.concatenate([blocks[place] for place in places]))
        slower = np.array_split(controls.repeat(HOLD_FACTOR, axis=0), HOLD_FACTOR)
        low, middle, high = controls.min(axis=0), controls.mean(axis=0), controls.max(axis=0)
        louder = np.clip(middle + AMPLITUDE_FACTOR * (controls - middle), low, high)

        def runs(driven: list[Array]) -> Array:
            first = [own.first[None, None, :, ny].repeat(len(driven), axis=1) for own in observers]
            each = zip(spaces, first, strict=True)
            return np.concatenate([space.run(begin, np.stack(driven))[..., :ny] for space, begin in each])

        reordered = runs([controls[order] for order in orders])
        limit = OUTPUT_MULTIPLE * np.max([np.abs(part.outputs).max(axis=0) for part in self.parts], axis=0)
        diverged = (np.abs(reordered) > limit).any(axis=(1, 2, 3))
        for found in (reordered, runs(slower), runs([louder])):  # two spaces are equally far from the median
            apart = np.sqrt(((found - np.median(found, axis=0)) ** 2).mean(axis=(1, 2, 3)))
            diverged |= apart > max(OUTLIER_MULTIPLE * float(np.median(apart)), MIN_OUTLIER_DISTANCE)
        return np.asarray(diverged)


def joined(one: Trained, other: Trained) -> Trained:
    """Return the spaces of both trainings, which differ only in their weights, as one batch."""
    spaces = replace(
        one.spaces,
        outer=np.concatenate([one.spaces.outer, other.spaces.outer]),
        inner=np.concatenate([one.spaces.inner, other.spaces.inner]),
        kinds=np.concatenate([one.spaces.kinds, other.spaces.kinds]),
    )
    return Trained(spaces, np.concatenate([one.starts, other.starts]), np.concatenate([one.error, other.error]))


def radius(space: StateSpaceBatch) -> float:
    """Return the spectral radius of the linear part of one space."""
    seen = space.inner.shape[2]
    linear = StateSpaceBatch.linear(space.outer[..., :seen], space.rate_scale, flow=space.flow)
    drift = linear.jacobian(np.zeros((1, 1, space.n)), np.zeros((1, seen - space.n - 1)))[0, 0]
    return float(np.abs(np.linalg.eigvals(drift)).max())


def stabilised(space: StateSpaceBatch) -> StateSpaceBatch:
    """Return a linear space whose unstable modes are made stable; a stable one unchanged."""
    if radius(space) <= UNSTABLE:
        return space
    one = np.zeros((space.n, space.n)) if space.flow else np.eye(space.n)
    values, vectors = np.linalg.eig(one + space.rate_scale[:, None] * space.outer[0, :, : space.n])
    if space.flow:
        values = np.minimum(values.real, np.log(STABLE)) + 1j * values.imag
    else:
        values = values * np.minimum(1.0, STABLE / np.maximum(np.abs(values), 1e-12))
    outer = space.outer.copy()
    kept = (vectors * values) @ np.linalg.pinv(vectors)
    outer[0, :, : space.n] = (kept.real - one) / space.rate_scale[:, None]
    return replace(space, outer=outer)


RATIOS = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Ratios of state noise in one step (in units of its typical change) to output noise (in units of its deviation)."""
RICCATI_STEPS, SETTLED = 400, 1e-6
HORIZON, MAX_WINDOWS = 30, 300
MAX_REMAINING_SHARE = 0.02
"""Share of an error of the first guess that may remain after the history."""
SHORTEST, LONGEST = 4, 64
"""Shortest and longest history in samples."""
EPISODE_SHARE = 12
"""A history is at most this fraction (1 / n) of the longest episode."""
RIDGE = 1e-6


@dataclass(frozen=True)
class StateObserver:
    """Observer of one space: ``gain`` (n, ny), ``first`` guess (n, ny + 1), ``history`` samples to forget the guess."""

    gain: Array
    first: Array
    history: int


def observer(space: StateSpaceBatch, runs: Array, outputs: Array, parts: list[ScaledEpisode]) -> StateObserver:
    """Return the observer of one space, with the noise ratio of the lowest simulation error.

    ``runs`` (N, n) are states of the training runs and ``outputs`` (N, ny) the measurements then.
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
    gains = _riccati(slope, space.rate_scale, ny)
    episodes = [Trajectory(part.outputs, part.controls, 1.0) for part in parts]
    windows = WindowIndex.of(episodes, max(1, min(HORIZON, longest - room)), history=room)
    some = np.linspace(0, len(windows) - 1, min(MAX_WINDOWS, len(windows))).astype(np.int64)
    errors = _errors(space, gains, first, windows[np.unique(some)])
    best = int(np.argmin(errors))
    closed = slope.copy()
    closed[:, :ny] -= gains[best]
    kept = float(np.abs(np.linalg.eigvals(closed)).max())  # share of an error that remains after a sample
    memory = LONGEST if kept >= 1.0 else np.log(MAX_REMAINING_SHARE) / np.log(max(kept, 1e-3))
    return StateObserver(gains[best], first, int(min(max(np.ceil(memory), SHORTEST), room)))


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


def _errors(space: StateSpaceBatch, gains: Array, first: Array, windows: Windows) -> Array:
    """Return the mean square error (G,) of simulations from the estimates of each of the ``gains`` (G, n, ny)."""
    ny, many = first.shape[1] - 1, space[np.zeros(len(gains), dtype=np.int64)]
    past, history = windows.past_states, windows.past_controls.shape[1]
    states = past[:, 0] @ first[:, :ny].T + first[:, ny]
    states = np.broadcast_to(states, (len(gains), *states.shape))
    for k in range(history + 1):
        control = windows.past_controls[:, k] if k < history else windows.controls[:, 0]
        off = past[:, k] - states[..., :ny]
        states = np.clip(many.step(states, control) + off @ gains.swapaxes(1, 2), -DIVERGED_DISTANCE, DIVERGED_DISTANCE)
    runs = many.run(states, windows.controls[:, 1:])[..., :ny]
    return np.asarray(((runs - windows.states) ** 2).mean(axis=(1, 2, 3)))


MAX_PAST = 20
"""Samples of the past from which the state is estimated."""
SHARE = 4
"""Samples per coefficient of the predictor, at least."""
SUBSPACE_RIDGE = 1e-8
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
        markov = np.linalg.solve(flat.T @ flat + SUBSPACE_RIDGE * len(flat) * np.eye(flat.shape[1]), flat.T @ outputs)
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
    penalty = SUBSPACE_RIDGE * len(now) * np.eye(regressors.shape[1])
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
