"""From poses to body velocities, without looking ahead."""

from __future__ import annotations

from collections import deque

import numpy as np

from hardware.loop.pilot import Estimate
from hardware.measurement import Measurement
from sysid_evo.arrays import Array
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System

WINDOW = 0.1  # s
LAG = 0.02
"""s; with this window, where the error of the yaw rate as it is used is least on the emulated car
(``python -m tests.benchmarks.robot.estimator``)."""
READY = 0.6
"""Share of the window that poses must cover, so that a curvature can be told from noise,"""
MIN_POSES = 6
"""and the fewest poses: after a dropout, or of a slow tracker, older ones are kept for that, up to"""
LONGEST = 2.5  # windows


class PoseEstimator:
    """A parabola through the last poses, and the body velocities on it a little before the newest.

    With t the time of a pose less that of the newest, x, y and heading are each fitted over the last
    ``window`` s by least squares::

        q(t) = a + b t + c t^2,    estimate at t = -lag:  q = a - b lag + c lag^2,  dq/dt = b - 2 c lag

    and (dx/dt, dy/dt) is turned by -heading into forward and lateral speed. Accelerations up to
    constant are followed without error; the variance of dq/dt is lowest in the middle of the window
    and sixteen times as large at the newest pose, so ``lag`` buys quiet for delay. The headings are
    unwrapped. Raises `IncompatibleSystem` if poses do not tell every state.
    """

    def __init__(self, system: System, *, window: float = WINDOW, lag: float = LAG) -> None:
        motion = system.motion
        if not isinstance(motion, PlanarBody):
            raise IncompatibleSystem(
                "the estimator needs a planar body, but the system has "
                f"{'no motion' if motion is None else 'the motion ' + motion.kind}"
            )
        untold = [name for name in system.state_names if name not in motion.roles().values()]
        if untold:
            raise IncompatibleSystem(f"poses do not tell the states {', '.join(untold)}: no estimator for this system")
        self.window = window
        self.lag = lag
        self._motion = motion
        self._names = system.state_names
        self._times: deque[float] = deque()
        self._poses: deque[Array] = deque()

    def restart(self) -> None:
        """Forget all poses: what comes next is not the continuation of what was."""
        self._times.clear()
        self._poses.clear()

    def add(self, measurement: Measurement) -> None:
        """Take in an accepted pose; one that is not newer than the newest is left out."""
        time, pose = measurement.source_time, measurement.pose
        if self._times:
            if time <= self._times[-1]:
                return
            turn = pose[2] - self._poses[-1][2]
            pose = np.array([pose[0], pose[1], self._poses[-1][2] + np.remainder(turn + np.pi, 2.0 * np.pi) - np.pi])
        self._times.append(time)
        self._poses.append(pose)
        while self._outdated(time):
            self._times.popleft()
            self._poses.popleft()

    @property
    def newest(self) -> float | None:
        """The source time of the newest pose in s; None without one."""
        return self._times[-1] if self._times else None

    def estimate(self, time: float) -> Estimate | None:
        """Return what is known at ``time`` (s, the connection's clock), or None while the window is too empty."""
        if not self._covers(0):
            return None
        newest = self._times[-1]
        poses = np.array(self._poses)
        t = (np.array(self._times) - newest) / self.window
        coefficients = np.linalg.lstsq(np.stack([np.ones_like(t), t, t * t], axis=1), poses, rcond=None)[0]
        at = -self.lag / self.window
        rates = (coefficients[1] + 2.0 * at * coefficients[2]) / self.window
        there = coefficients[0] + at * coefficients[1] + at * at * coefficients[2]
        told = self._motion.velocities(there, rates)
        state = np.array([told[name] for name in self._names], dtype=np.float64)
        return Estimate(time, self._poses[-1].copy(), state, time - newest)

    def _covers(self, first: int) -> bool:
        """Whether the poses from the ``first`` on are enough for an estimate."""
        enough = len(self._times) - first >= MIN_POSES
        return enough and self._times[-1] - self._times[first] >= READY * self.window

    def _outdated(self, time: float) -> bool:
        """Whether the oldest pose is to be dropped now that the newest is of ``time``."""
        age = time - self._times[0]
        return age > LONGEST * self.window or (age > self.window and self._covers(1))
