"""How long a control takes to act: the prewhitened cross-correlation of control and acceleration.

Commands are strongly correlated with their own past, so that a plain cross-correlation is smeared
over many lags. Both series are therefore filtered with the autoregressive model that turns the
control into white noise; what is left of their correlation is the response to one impulse.
Source: Box and Jenkins, Time Series Analysis, chapter on transfer functions.

What a state does by itself is taken out of its acceleration first (`fit_linear`), so that the swing
back of a pendulum, or a position that follows its speed, is no answer to a control. The delay is that
of the first peak worth mentioning, as a later one may be a backswing, however large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.linear_fit import fit_linear, state_terms
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.motion import PlanarBody

ORDER = 8
"""Order of the autoregressive model of a control."""

LATEST, LATEST_STEPS, MOST_STEPS = 0.5, 10, 50
EARLIEST = -0.1
"""Lags looked at: from -0.1 s to 0.5 s, but to 10 steps at least and to 50 at most.

A lag below 0 means that the body moved before the command was logged, so that the log's clocks
disagree; a human driver, who reacts later than 0.1 s, cannot cause it.
"""

CLEAR, WEAK = 4.0, 0.1
"""A peak is clear from this many standard deviations of the correlation of unrelated series on, and from
this correlation on."""

FIRST = 0.5
"""Share of the highest peak that makes a first peak worth mentioning."""


@dataclass(frozen=True)
class Delay:
    """How ``control`` acts on the acceleration of ``state``: first ``steps`` after it is set.

    0 steps: the control at sample k acts on the change from k to k + 1. ``seconds`` is that between
    steps, from a parabola through the peak. ``strength`` is the correlation there, in [-1, 1];
    ``clear`` tells whether unrelated series of this length would rarely reach it.
    """

    control: str
    state: str
    steps: int
    seconds: float
    strength: float
    clear: bool
    at_speed: bool


def find_delays(dataset: Dataset) -> tuple[Delay, ...]:
    """Return the delay of every control on every state; a control that is constant has none.

    On a planar body the control and its product with the forward speed are tried, and the stronger
    kept; not on the forward speed itself, whose noise would be on both sides.
    """
    system = dataset.system
    latest = min(max(LATEST_STEPS, round(LATEST / system.dt)), MOST_STEPS)
    lags = range(max(round(EARLIEST / system.dt), -MOST_STEPS), latest + 1)
    episodes = [episode for episode in dataset if len(episode) > ORDER + len(lags)]
    changes = [system.acceleration(episode.states[:-1], episode.states[1:]) for episode in episodes]
    fit = fit_linear(dataset, latest)
    if fit is not None:
        changes = [a - state_terms(system, e.states[:-1]) @ fit.rate for a, e in zip(changes, episodes, strict=True)]
    forward, speeds = -1, None
    if isinstance(system.motion, PlanarBody):
        forward = system.motion.indices(system.state_names)[0]
        speeds = [episode.states[:-1, forward] for episode in episodes]
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
    clear = max(CLEAR / np.sqrt(samples), WEAK)
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
        whitening = _whitening(series)
        return cls(whitening, [np.convolve(one, whitening, mode="valid") for one in series])

    def response(self, outputs: list[Array], lags: range) -> Array:
        """Return the correlation with ``outputs``, filtered alike, at each lag."""
        answers = [np.convolve(one, self.filter, mode="valid") for one in outputs]
        return np.array([_correlation(self.series, answers, lag) for lag in lags])


def _whitening(series: list[Array]) -> Array:
    """Return the filter (ORDER + 1,) whose output is white."""
    now = np.concatenate([s[ORDER:] for s in series])
    regressors = np.ones((len(now), ORDER + 1))
    for lag in range(1, ORDER + 1):
        np.concatenate([s[ORDER - lag : len(s) - lag] for s in series], out=regressors[:, lag - 1])
    weights = np.linalg.lstsq(regressors, now, rcond=None)[0][:ORDER]
    return np.concatenate([[1.0], -weights])


def _correlation(commands: list[Array], responses: list[Array], lag: int) -> float:
    u = np.concatenate([c[max(-lag, 0) : len(c) - max(lag, 0)] for c in commands])
    a = np.concatenate([r[max(lag, 0) : len(r) - max(-lag, 0)] for r in responses])
    u, a = u - u.mean(), a - a.mean()
    scale = np.sqrt((u @ u) * (a @ a))
    return float(u @ a / scale) if scale > 0.0 else 0.0


def _first_peak(curve: Array, clear: float) -> int:
    """Return the place of the first peak that is clear and half as high as the highest; else of the highest."""
    size = np.abs(curve)
    worth = np.flatnonzero(size >= max(clear, FIRST * size.max()))
    if not len(worth):
        return int(size.argmax())
    peak = int(worth[0])
    while peak + 1 < len(curve) and size[peak + 1] > size[peak] and curve[peak + 1] * curve[peak] > 0.0:
        peak += 1
    return peak


def _vertex(curve: Array, peak: int) -> float:
    """Return where the parabola through the peak and its neighbours has its vertex, -0.5 to 0.5 from the peak."""
    if not 0 < peak < len(curve) - 1:
        return 0.0
    before, at, after = curve[peak - 1 : peak + 2]
    bend = before - 2.0 * at + after
    return 0.0 if bend == 0.0 else float(0.5 * (before - after) / bend)
