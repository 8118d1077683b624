"""Causal estimates of states from poses, and their delay."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hardware.connection import Measurement
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System
from sysid_evo.types import Array, check_shape


@dataclass(frozen=True)
class StateEstimate:
    """The estimated state of the robot at ``time`` (s, the connection's clock).

    ``pose`` (n_pose,) is the newest accepted one, ``age`` s old; ``state`` (nx,) comes from the poses up to it by a
    causal filter, so it lags behind.
    """

    time: float
    pose: Array
    state: Array
    age: float


class StateEstimator(Protocol):
    """Makes estimates from accepted frames; the loop asks for one at every tick."""

    def restart(self) -> None: ...
    def add(self, measurement: Measurement) -> None: ...
    def estimate(self, time: float) -> StateEstimate | None: ...


WINDOW = 0.1  # s
LAG = 0.02
"""s; the value that minimises the error of the yaw rate as it is used, for this window and the emulated car
(``python -m tests.benchmarks.robot.estimator``)."""
READY = 0.6
"""Share of the window that poses must cover to distinguish a curvature from noise,"""
MIN_POSES = 6
"""and the minimum number of poses: after a dropout, or with a slow tracker, older ones are kept for it, up to"""
LONGEST = 2.5  # windows


class PoseEstimator:
    """A parabola through the last poses, and the body velocities on it slightly before the newest.

    With t the time of a pose minus that of the newest, x, y and heading are each fitted over the last
    ``window`` s by least squares::

        q(t) = a + b t + c t^2,  estimate at t = -lag:  q = a - b lag + c lag^2,  dq/dt = b - 2 c lag

    and (dx/dt, dy/dt) is turned by -heading into forward and lateral speed. Constant accelerations cause no error. The
    variance of dq/dt is lowest in the middle of the window and sixteen times as large at the newest pose, so ``lag``
    trades delay for noise. The headings are unwrapped. Raises `IncompatibleSystem` if poses do not determine every
    state.
    """

    def __init__(self, system: System, *, window: float = WINDOW, lag: float = LAG) -> None:
        motion = system.motion
        if not isinstance(motion, PlanarBody):
            raise IncompatibleSystem(
                "the estimator needs a planar body, but the system has "
                f"{'no motion' if motion is None else 'the motion ' + motion.kind}"
            )
        missing = [name for name in system.state_names if name not in motion.roles().values()]
        if missing:
            raise IncompatibleSystem(f"poses do not determine the states {', '.join(missing)}: no estimator for them")
        self.window = window
        self.lag = lag
        self._motion = motion
        self._names = system.state_names
        self._times: deque[float] = deque()
        self._poses: deque[Array] = deque()

    def restart(self) -> None:
        """Forget all poses: the next one does not continue the track."""
        self._times.clear()
        self._poses.clear()

    def add(self, measurement: Measurement) -> None:
        """Take in an accepted pose; one that is not newer than the newest is ignored."""
        time, pose = measurement.source_time, measurement.pose
        if self._times:
            if time <= self._times[-1]:
                return
            turn = pose[2] - self._poses[-1][2]
            pose = np.array([pose[0], pose[1], self._poses[-1][2] + np.remainder(turn + np.pi, 2.0 * np.pi) - np.pi])
        self._times.append(time)
        self._poses.append(pose)
        while (age := time - self._times[0]) > LONGEST * self.window or (age > self.window and self._covers(1)):
            self._times.popleft()
            self._poses.popleft()

    def estimate(self, time: float) -> StateEstimate | None:
        """Return the estimate at ``time`` (s, the connection's clock), or None if the window has too few poses."""
        if not self._covers(0):
            return None
        newest = self._times[-1]
        poses = np.array(self._poses)
        t = (np.array(self._times) - newest) / self.window
        coefficients = np.linalg.lstsq(np.stack([np.ones_like(t), t, t * t], axis=1), poses, rcond=None)[0]
        at = -self.lag / self.window
        rates = (coefficients[1] + 2.0 * at * coefficients[2]) / self.window
        there = coefficients[0] + at * coefficients[1] + at * at * coefficients[2]
        velocities = self._motion.velocities(there, rates)
        state = np.array([velocities[name] for name in self._names], dtype=np.float64)
        return StateEstimate(time, self._poses[-1].copy(), state, time - newest)

    def _covers(self, first: int) -> bool:
        """Whether the poses from the ``first`` on are enough for an estimate."""
        enough = len(self._times) - first >= MIN_POSES
        return enough and self._times[-1] - self._times[first] >= READY * self.window


class NewestPoseEstimator:
    """An estimator for pilots that only need the newest pose: its states are all neutral."""

    def __init__(self, system: System) -> None:
        self._state = system.neutral_state
        self._newest: Measurement | None = None

    def restart(self) -> None:
        """Forget the pose."""
        self._newest = None

    def add(self, measurement: Measurement) -> None:
        """Take in an accepted pose."""
        self._newest = measurement

    def estimate(self, time: float) -> StateEstimate | None:
        """Return the newest pose, None before the first."""
        newest = self._newest
        return None if newest is None else StateEstimate(time, newest.pose, self._state, time - newest.source_time)


LONGEST_DELAY = 0.2  # s: the longest delay that is searched
STEP = 0.001  # s
KNOWN_DRIVE = 20.0  # s
FREQUENCIES = (0.3, 0.7, 1.1)  # Hz, of the speeds of a known drive


def measure_delays(
    system: System, times: Array, truth: Array, estimate_times: Array, estimates: Array
) -> tuple[float, ...]:
    """Return the delay (s) of every state: ``estimates`` (N, nx) against ``truth`` (T, nx), linear between ``times``.

    The delay is the maximum of the parabola through the highest correlation and its neighbours, searched from 0 to
    0.2 s. Estimates from the first 0.2 s of the recording are left out.
    """
    truth = check_shape("truth", truth, (len(times), system.nx))
    estimates = check_shape("estimates", estimates, (len(estimate_times), system.nx))
    late = estimate_times >= times[0] + LONGEST_DELAY + STEP
    shifts = STEP * np.arange(-1, round(LONGEST_DELAY / STEP) + 2)
    found = []
    for column, estimated in zip(truth.T, estimates[late].T, strict=True):
        true = [np.interp(estimate_times[late] - shift, times, column) for shift in shifts]
        curve = np.array([_correlation(one, estimated) for one in true])
        peak = int(np.clip(curve.argmax(), 1, len(curve) - 2))
        before, at, after = curve[peak - 1 : peak + 2]
        bend = before - 2.0 * at + after
        found.append(float(shifts[peak] + (STEP * 0.5 * (before - after) / bend if bend < 0.0 else 0.0)))
    return tuple(found)


def estimator_delays(system: System, *, frame_interval: float) -> tuple[float, ...]:
    """Return the delays (s) of `PoseEstimator` alone, on a known drive with frames every ``frame_interval`` s."""
    times: Array = np.arange(0.0, KNOWN_DRIVE, frame_interval)
    states, poses = synthetic_drive(system, times)
    estimator = PoseEstimator(system)
    known: list[tuple[float, Array]] = []
    for frame, (time, pose) in enumerate(zip(times, poses, strict=True)):
        estimator.add(Measurement(time, time, frame, "", True, pose))
        estimate = estimator.estimate(time)
        if estimate is not None:
            known.append((time, estimate.state))
    return measure_delays(system, times, states, np.array([t for t, _ in known]), np.array([s for _, s in known]))


def synthetic_drive(system: System, times: Array) -> tuple[Array, Array]:
    """Return states (T, nx) and poses (T, 3) of a made-up drive whose speeds oscillate smoothly around zero."""
    motion = system.motion
    assert isinstance(motion, PlanarBody)
    forward, lateral, turning = motion.indices(system.state_names)
    waves = np.sin(2.0 * np.pi * np.outer(times, FREQUENCIES) + np.arange(len(FREQUENCIES)))
    states = np.zeros((len(times), system.nx))
    states[:, forward] = 0.5 * (waves[:, 0] + waves[:, 1])
    states[:, turning] = waves[:, 1] + waves[:, 2]
    if lateral is not None:
        states[:, lateral] = 0.1 * waves[:, 2]
    poses = np.zeros((len(times), motion.n_pose))
    for k in range(1, len(times)):
        dt = float(times[k] - times[k - 1])
        poses[k] = system.move(poses[k - 1], states[k - 1], states[k], dt)
    return states, poses


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    scale = np.sqrt((a @ a) * (b @ b))
    return float(a @ b / scale) if scale > 0.0 else 0.0
