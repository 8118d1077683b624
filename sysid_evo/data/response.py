"""Responses of states to controls: delays, a linear fit, stretches without any."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray

ORDER = 8
"""Order of the autoregressive model of a control."""

LATEST, LATEST_STEPS, MOST_STEPS = 0.5, 10, 50
EARLIEST = -0.1
"""Range of lags: from -0.1 s to 0.5 s, but to at least 10 and at most 50 steps.

A negative lag means that the body moved before the command was logged, so the clocks of the log disagree. A human
driver cannot be the cause, because reactions take more than 0.1 s.
"""

CLEAR_PEAK, MIN_CORRELATION = 4.0, 0.1
"""A peak is clear above this many standard deviations of the correlation of unrelated series, and above this
correlation."""

FIRST = 0.5
"""Least height of a first peak, as a share of the highest one."""


@dataclass(frozen=True)
class Delay:
    """The delay from ``control`` to the acceleration of ``state``, in ``steps``.

    0 steps: the control at sample k acts on the change from k to k + 1. ``seconds`` is the delay between
    steps, from a parabola through the peak. ``strength`` is the correlation at the peak, in [-1, 1]; it is
    ``clear`` if unrelated series of this length rarely reach it.
    """

    control: str
    state: str
    steps: int
    seconds: float
    strength: float
    clear: bool
    at_speed: bool


def find_delays(dataset: Dataset) -> tuple[Delay, ...]:
    """Return the delay of every control on every state, except for constant controls.

    Commands are strongly correlated with their own past, so a plain cross-correlation is smeared over many lags.
    Both series are therefore filtered with the autoregressive model that turns the control into white noise; the
    remaining correlation is the impulse response (Box and Jenkins, Time Series Analysis, chapter on transfer
    functions). The unforced response of a state, such as the swing back of a pendulum, is subtracted from its
    acceleration first (`fit_linear`). The delay is that of the first high peak, because later peaks may be backswings.

    On a planar body the control and its product with the forward speed are tried, and the stronger
    correlation is used; except for the forward speed itself, whose noise would be on both sides.
    """
    system = dataset.system
    latest = min(max(LATEST_STEPS, round(LATEST / system.dt)), MOST_STEPS)
    lags = range(max(round(EARLIEST / system.dt), -MOST_STEPS), latest + 1)
    episodes = [episode for episode in dataset if len(episode) > ORDER + len(lags)]
    changes = [system.acceleration(episode.states[:-1], episode.states[1:]) for episode in episodes]
    fit = fit_linear(dataset, latest)
    if fit is not None:
        changes = [a - state_terms(system, e.states[:-1]) @ fit.rate for a, e in zip(changes, episodes, strict=True)]
    forward = _forward(system)
    speeds = None if forward is None else [episode.states[:-1, forward] for episode in episodes]
    delays = []
    for i, control in enumerate(system.control_names):
        if not episodes or np.ptp(np.concatenate([episode.controls[:, i] for episode in episodes])) == 0.0:
            continue
        plain = [episode.controls[:, i] for episode in episodes]
        inputs = {False: _Whitened.of(plain)}
        if speeds is not None:
            inputs[True] = _Whitened.of([u * speed for u, speed in zip(plain, speeds, strict=True)])
        for j, state in enumerate(system.state_names):
            outputs = [change[:, j] for change in changes]
            curves = {False: inputs[False].response(outputs, lags)}
            if speeds is not None and j != forward:
                curves[True] = inputs[True].response(outputs, lags)
            at_speed = max(curves, key=lambda key: np.abs(curves[key]).max())
            delays.append(_delay(control, state, curves[at_speed], at_speed, lags, episodes, system.dt))
    return tuple(delays)


def _delay(
    control: str, state: str, curve: Array, at_speed: bool, lags: range, episodes: list[Trajectory], dt: float
) -> Delay:
    samples = sum(len(episode) - ORDER for episode in episodes)
    clear = max(CLEAR_PEAK / np.sqrt(samples), MIN_CORRELATION)
    peak = _first_peak(curve, clear)
    return Delay(
        control,
        state,
        steps=lags[peak],
        seconds=float((lags[peak] + _vertex(np.abs(curve), peak)) * dt),
        strength=float(curve[peak]),
        clear=bool(np.abs(curve[peak]) > clear),
        at_speed=at_speed,
    )


@dataclass(frozen=True)
class _Whitened:
    """One control through the ``filter`` (ORDER + 1,) that makes it white, one series for each episode."""

    filter: Array
    series: list[Array]

    @classmethod
    def of(cls, series: list[Array]) -> _Whitened:
        now = np.concatenate([s[ORDER:] for s in series])
        regressors = np.ones((len(now), ORDER + 1))
        for lag in range(1, ORDER + 1):
            np.concatenate([s[ORDER - lag : len(s) - lag] for s in series], out=regressors[:, lag - 1])
        weights = np.linalg.lstsq(regressors, now, rcond=None)[0][:ORDER]
        whitening = np.concatenate([[1.0], -weights])
        return cls(whitening, [np.convolve(one, whitening, mode="valid") for one in series])

    def response(self, outputs: list[Array], lags: range) -> Array:
        """Return the correlation with ``outputs``, passed through the same filter, at each lag."""
        answers = [np.convolve(one, self.filter, mode="valid") for one in outputs]
        return np.array([_correlation(self.series, answers, lag) for lag in lags])


def _correlation(commands: list[Array], responses: list[Array], lag: int) -> float:
    u = np.concatenate([c[max(-lag, 0) : len(c) - max(lag, 0)] for c in commands])
    a = np.concatenate([r[max(lag, 0) : len(r) - max(-lag, 0)] for r in responses])
    u, a = u - u.mean(), a - a.mean()
    scale = np.sqrt((u @ u) * (a @ a))
    return float(u @ a / scale) if scale > 0.0 else 0.0


def _first_peak(curve: Array, clear: float) -> int:
    """Return the index of the first peak that is clear and half as high as the highest; else of the highest."""
    size = np.abs(curve)
    peaks = np.flatnonzero(size >= max(clear, FIRST * size.max()))
    if not len(peaks):
        return int(size.argmax())
    peak = int(peaks[0])
    while peak + 1 < len(curve) and size[peak + 1] > size[peak] and curve[peak + 1] * curve[peak] > 0.0:
        peak += 1
    return peak


def _vertex(curve: Array, peak: int) -> float:
    """Return the vertex of the parabola through the peak and its neighbours, -0.5 to 0.5 from the peak."""
    if not 0 < peak < len(curve) - 1:
        return 0.0
    before, at, after = curve[peak - 1 : peak + 2]
    bend = before - 2.0 * at + after
    return 0.0 if bend == 0.0 else float(0.5 * (before - after) / bend)


INTEGRATES = 0.3
"""Modes with a longer time constant, as a share of the longest episode, count as integrators without a time constant.
"""

BLOCK = 16384
"""Steps whose regressors are in memory at a time."""


@dataclass(frozen=True)
class LinearFit:
    """The least-squares fit of the changes of states in a data set.

    ``rate`` (nx + one for each periodic state, nx): the change of state j per second is
    ``state_terms(states) @ rate[:, j]`` plus the response to the controls. ``explained`` (nx,) is the
    share of the variance of the next state that states and controls explain, 0 to 1. ``scales`` are
    the time constants 1 / |eigenvalue| in s of the decaying modes, in rising order: decay time of a real mode,
    1 / angular frequency of an oscillation.
    """

    rate: Array
    explained: Array
    scales: tuple[float, ...]


def fit_linear(dataset: Dataset, lags: int) -> LinearFit | None:
    """Return the fit of changes to the state and the controls of this and ``lags`` earlier steps; None for few rows.

    The fit separates the response to controls from the free response of the states, such as a pendulum that swings
    back, whose modes give the time constants. On a planar body the controls times the forward speed are regressors
    too, because the effect of steering is proportional to it.
    """
    system = dataset.system
    episodes = [episode for episode in dataset if len(episode) > lags]
    if not episodes:
        return None
    rows = sum(len(episode) - lags for episode in episodes)
    n_terms = system.nx + len(system.periods)
    n_inputs = acting_controls(system, episodes[0].states[:1], episodes[0].controls[:1]).shape[1]
    if rows < 3 * (n_terms + 1 + n_inputs * (lags + 1)):
        return None
    weights = _least_squares(_blocks(system, episodes, lags))
    left = system.dt**2 * _variance(y - x @ weights for x, y in _blocks(system, episodes, lags))
    total = _variance(episode.states[lags:-1] for episode in episodes)
    explained = 1.0 - np.divide(left, total, out=np.zeros_like(left), where=total > 0.0)
    modes = np.linalg.eigvals(np.eye(system.nx) + system.dt * weights[: system.nx].T)
    decaying = modes[(np.abs(modes) < 1.0) & (np.abs(modes) > 0.0)]
    slowest = INTEGRATES * max(episode.duration for episode in episodes)
    scales = sorted(float(s) for s in system.dt / np.abs(np.log(decaying.astype(complex))) if s < slowest)
    return LinearFit(weights[:n_terms], np.clip(explained, 0.0, 1.0), tuple(scales))


def state_terms(system: System, states: Array) -> Array:
    """Return the regressors made from ``states`` (T, nx), (T, nx + one for each periodic state).

    They are the states; a periodic one is replaced by its sine, scaled to equal the angle near neutral, and its cosine,
    which follows all others.
    """
    terms, cosines = states.copy(), []
    for i, period in system.periods.items():
        angle = (states[:, i] - system.neutral_state[i]) * TURN / period
        terms[:, i] = np.sin(angle) * period / TURN
        cosines.append(np.cos(angle))
    return np.column_stack([terms, *cosines])


def _blocks(system: System, episodes: Sequence[Trajectory], lags: int) -> Iterator[tuple[Array, Array]]:
    """Yield regressors (n, terms) and changes (n, nx) of up to `BLOCK` steps, to limit the memory."""
    for episode in episodes:
        for first in range(lags, len(episode), BLOCK):
            last = min(first + BLOCK, len(episode))
            states = episode.states[first:last]
            inputs = acting_controls(system, episode.states[first - lags : last], episode.controls[first - lags : last])
            past = [inputs[lags - lag : len(inputs) - lag] for lag in range(lags + 1)]
            regressors = np.concatenate([state_terms(system, states), np.ones((len(states), 1)), *past], axis=1)
            yield regressors, system.acceleration(states, episode.states[first + 1 : last + 1])


def _least_squares(blocks: Iterator[tuple[Array, Array]]) -> Array:
    """Return the weights by the normal equations of scaled columns, much faster than an SVD of the rows."""
    products: Array | float = 0.0
    for regressors, targets in blocks:
        products = products + regressors.T @ np.concatenate([regressors, targets], axis=1)
    square, answer = np.split(np.asarray(products), [len(np.asarray(products))], axis=1)
    size = np.sqrt(np.diag(square))
    scale = np.where(size > 0.0, size, 1.0)
    solution = np.linalg.lstsq(square / np.outer(scale, scale), answer / scale[:, None], rcond=1e-13)[0]
    return np.asarray(solution / scale[:, None])


def _variance(blocks: Iterator[Array]) -> Array:
    """Return the variance of each column over all ``blocks`` (n, c)."""
    count, mean, squares = 0, np.zeros(1), np.zeros(1)
    for block in blocks:
        off = block.mean(axis=0) - mean
        both = count + len(block)
        squares = squares + ((block - block.mean(axis=0)) ** 2).sum(axis=0) + off**2 * count * len(block) / both
        mean = mean + off * len(block) / both
        count = both
    return np.asarray(squares / count)


def _forward(system: System) -> int | None:
    if not isinstance(system.motion, PlanarBody):
        return None
    return system.motion.indices(system.state_names)[0]


def acting_controls(system: System, states: Array, controls: Array) -> Array:
    """Return the controls (T, nu), on a planar body followed by their products with the forward speed."""
    forward = _forward(system)
    if forward is None:
        return controls
    return np.concatenate([controls, controls * states[:, [forward]]], axis=1)


RESPONSE = 1.5
"""Time (s) after the start of a window in which a robot at rest responds."""
FEWEST_SAMPLES = 10
"""Minimum number of samples of a window."""
WHOLE = 0.8
"""Share of an episode at rest from which it may be left out."""
NEIGHBOURS, FEWEST_NEIGHBOURS, CLOSE = 5, 3, 0.3
"""Number of similar windows that are compared, the least number of them, and the largest difference of a command, as a
share of its range in all data."""
RESPONDING, EVIDENCE = 0.8, 2.0
"""Share of the similar windows in which the robot moved, and the time (s) of windows of a stretch where it should have.
"""


def without_dead_stretches(dataset: Dataset) -> Dataset:
    """Return ``dataset`` without the stretches in which commands have no effect, and with a note on them.

    A stretch at rest of a planar body is left out if the robot left rest under similar commands in other episodes. Rest
    without a command, or under commands that never move the robot, is kept. Other systems have no standstill. It is the
    same object if nothing is left out, or if nothing would be left.
    """
    if not isinstance(dataset.system.motion, PlanarBody):
        return dataset
    still = [~moving for moving in dataset.moving]
    resting = [rows.mean() >= WHOLE for rows in still]
    if not any(resting):
        return dataset
    pairs = list(zip(dataset, _dead(dataset, still, resting), strict=True))
    dead, kept = [[episode for episode, is_dead in pairs if is_dead == wanted] for wanted in (True, False)]
    if not dead or not kept:
        return dataset
    seconds, names = sum(map(len, dead)) * dataset.system.dt, ", ".join(episode.name for episode in dead)
    note = (
        f"{seconds:.0f} s of {dataset.duration:.0f} s are left out, in {names}: the robot did not move "
        "under commands that move it in other episodes. Was it blocked or switched off?"
    )
    return replace(dataset.with_episodes(kept), notes=(*dataset.notes, note))


def _dead(dataset: Dataset, still: list[BoolArray], resting: list[bool]) -> list[bool]:
    """Return which of the ``resting`` episodes are those in which the robot should have moved.

    Commands of a window at rest are similar if their means over both halves are. A command counts as far as it is
    correlated with leaving rest.
    """
    dt = dataset.system.dt
    size = max(FEWEST_SAMPLES, round(RESPONSE / dt))
    stride = max(1, size // 6)
    windows = [
        (number, start, *(half.mean(axis=0) for half in np.array_split(episode.controls[start : start + size], 2)))
        for number, (episode, rest) in enumerate(zip(dataset, still, strict=True))
        for start in range(0, len(episode) - size + 1, stride)
        if rest[start]
    ]
    owner, begin = (np.array([window[i] for window in windows], dtype=np.int64) for i in (0, 1))
    responded = np.array([not still[i][start : start + size + 1].all() for i, start in zip(owner, begin, strict=True)])
    known = ~np.array(resting)[owner]
    if known.sum() < FEWEST_NEIGHBOURS or responded[known].all() or not responded[known].any():
        return [False] * len(resting)
    commands = np.array([np.concatenate(window[2:]) for window in windows])
    spread = np.tile(np.ptp(np.concatenate([episode.controls for episode in dataset]), axis=0), 2)
    off = commands[known] - commands[known].mean(axis=0)
    weights = np.abs(off.T @ (responded[known] - responded[known].mean())) / np.maximum(
        np.sqrt((off**2).sum(axis=0)), TINY
    )
    features = commands / np.where(spread > 0.0, spread, 1.0) * (weights / weights.max())
    others, expected = np.flatnonzero(known), np.zeros(len(resting))
    for row in np.flatnonzero(~known & ~responded):
        distance = np.abs(features[others] - features[row]).max(axis=1)
        nearest = np.argsort(distance, kind="stable")[:NEIGHBOURS]
        near = responded[others[nearest[distance[nearest] <= CLOSE]]]
        expected[owner[row]] += len(near) >= FEWEST_NEIGHBOURS and near.mean() >= RESPONDING
    return [bool(one) for one in expected * stride * dt >= EVIDENCE]


TINY = 1e-12
