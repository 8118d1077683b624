"""Plausibility of a tracker's frames: which are accepted, where a track breaks, and how far limits are exceeded."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hardware.connection import GateLimits, Measurement
from sysid_evo.types import Array

ACCEPTED = ""
JUMPED, FLIPPED, TOO_FAST, TURNED_TOO_FAST = "jumped", "flipped", "too fast", "turned too fast"
CONTRADICTIONS = (JUMPED, FLIPPED, TOO_FAST, TURNED_TOO_FAST)
"""Reasons why a frame cannot follow the one before."""
LARGEST = 1e9  # s, m, rad: beyond any clock, room or rotation


@dataclass(frozen=True)
class GateVerdict:
    """Verdict on a frame: ``accepted``, or rejected for a ``reason``; with ``new_track`` a new track begins."""

    accepted: bool
    reason: str = ACCEPTED
    new_track: bool = False


class PoseGate:
    """Decides frame by frame on planar poses of ``body`` (None: the first seen); it has no clock of its own.

    Two accepted frames of one track never contradict `GateLimits`; a frame that does is rejected. If the body appears
    at another place and stays consistent there, a new track begins, and the verdict on its first accepted frame has
    ``new_track``: nothing may be computed across it.
    """

    def __init__(self, body: str | None, limits: GateLimits | None = None) -> None:
        self.body = body
        self.limits = GateLimits() if limits is None else limits
        self._last: Measurement | None = None
        self._rival: list[Measurement] = []
        self._rivals_reason = ACCEPTED
        self._seen = b""
        self._repeats = 0
        self._thawed = False
        self._before: Measurement | None = None
        self._excess = LimitExcess({name: getattr(self.limits, name) for name in WORDS})

    @property
    def excess(self) -> str:
        """How far the frames since the newest accepted one exceed a limit, in a sentence; "" if they do not."""
        return self._excess.sentence

    def accept(self, measurement: Measurement, *, driving: bool) -> GateVerdict:
        """Return the verdict on the next frame; ``driving``: a command other than neutral is in force."""
        verdict = self._judge(measurement, driving)
        if verdict.accepted:
            self._excess.clear()
            self._before = measurement
        elif verdict.reason in CONTRADICTIONS and self._last is not None and self._before is not None:
            self._excess.add(self._last, self._before, measurement)
            self._before = measurement
        return verdict

    def _judge(self, frame: Measurement, driving: bool) -> GateVerdict:
        if self.body is None and frame.valid:
            self.body = frame.body
        if not frame.valid:
            return GateVerdict(False, "not valid")
        if frame.body != self.body:
            return GateVerdict(False, "of another body")
        numbers = (*frame.pose.ravel(), frame.source_time, frame.arrival_time)
        if frame.pose.shape != (3,) or not all(-LARGEST < number < LARGEST for number in numbers):
            return GateVerdict(False, "not a number")
        if self._is_frozen(frame.pose, driving):
            self._thawed = True
            return GateVerdict(False, "frozen")
        if self._last is None:
            return self._begin(frame)
        if frame.source_time <= self._last.source_time:
            return GateVerdict(False, "not newer")
        reason = self._rivals_reason if self._follows_rival(frame) else self._contradiction(self._last, frame)
        if reason == ACCEPTED:
            if self._thawed:
                return self._begin(frame)
            self._last = frame
            self._rival.clear()
            return GateVerdict(True)
        self._rivals_reason = reason
        return self._begin(frame) if self._confirmed(frame) else GateVerdict(False, reason)

    def _begin(self, frame: Measurement) -> GateVerdict:
        self._last, self._thawed = frame, False
        self._rival.clear()
        return GateVerdict(True, new_track=True)

    def _is_frozen(self, pose: Array, driving: bool) -> bool:
        """Count equal poses under a drive command; return whether there are too many.

        A pose that was found frozen stays so when the robot is stopped: otherwise it would be accepted again, and the
        robot would drive on.
        """
        limit = self.limits.frozen
        bits = pose.tobytes()
        same, self._seen = bits == self._seen, bits
        if not same:
            self._repeats = 0
        elif driving:
            self._repeats += 1
        elif limit is None or self._repeats < limit:
            self._repeats = 0
        return limit is not None and self._repeats >= limit

    def _contradiction(self, before: Measurement, after: Measurement) -> str:
        """Return why ``after`` cannot follow ``before``, "" if it can."""
        limits = self.limits
        if distance(before, after) > limits.jump:
            return JUMPED
        if turn(before, after) > limits.turn:
            return FLIPPED
        return self._out_of_reach(before, after)

    def _out_of_reach(self, before: Measurement, after: Measurement) -> str:
        """Return the limit that the body would have exceeded to get from ``before`` to ``after``, "" if none."""
        limits, dt = self.limits, after.source_time - before.source_time
        if distance(before, after) > limits.speed * dt + limits.position_error:
            return TOO_FAST
        if turn(before, after) > limits.yaw_rate * dt + limits.heading_error:
            return TURNED_TOO_FAST
        return ACCEPTED

    def _follows_rival(self, frame: Measurement) -> bool:
        """Return whether a frame continues the rejected frames rather than the track.

        The track alone does not decide that: the longer ago its last frame, the more is within its reach.
        """
        if self._last is None or not self._rival or self._contradiction(self._rival[-1], frame) != ACCEPTED:
            return False
        return self._effort(self._rival[-1], frame) < self._effort(self._last, frame)

    def _effort(self, before: Measurement, after: Measurement) -> float:
        """Return the least time in s to get from one pose to the other."""
        return max(distance(before, after) / self.limits.speed, turn(before, after) / self.limits.yaw_rate)

    def _confirmed(self, frame: Measurement) -> bool:
        """Add a frame to the track that competes with the accepted one; return whether it is accepted now."""
        rival = self._rival
        if rival and frame.source_time <= rival[-1].source_time:
            return False
        if rival and self._contradiction(rival[-1], frame) != ACCEPTED:
            rival.clear()
        rival.append(frame)
        first = rival[0]
        if self._last is not None and self._out_of_reach(self._last, first) == ACCEPTED:
            return len(rival) >= self.limits.confirm
        del rival[1:-1]
        return frame.source_time - first.source_time >= self.limits.recover


SHARE = 0.9
"""Quantile of the speeds from frame to frame that is used as the robot's: a single outlier does not count."""
REMEMBERED = 200  # frames: a second at 200 Hz, longer than a run continues without a pose
WORDS = {
    "speed": ("it moves at {:.1f} m/s", "m/s"),
    "yaw_rate": ("it turns at {:.1f} rad/s", "rad/s"),
    "jump": ("it was seen {:.2f} m from where it was", "m"),
    "turn": ("it was seen turned by {:.2f} rad", "rad"),
}
"""Sentence for a value beyond each limit, and the limit's unit; the first exceeded one explains the others."""


class LimitExcess:
    """Keeps the motion of the body while its frames are rejected; ``limits`` are the four of `WORDS`.

    One distant frame is an error of the tracker; a robot that is faster than its limits is fast from frame to frame. So
    a speed counts if a tenth of the steps between neighbouring frames, and at least one other, are as fast; the robot
    brakes as soon as it is lost.
    """

    def __init__(self, limits: Mapping[str, float]) -> None:
        self._limits = limits
        self._steps: deque[tuple[float, float]] = deque(maxlen=REMEMBERED)
        self._away = 0.0, 0.0

    def clear(self) -> None:
        """Forget everything, because a frame was accepted."""
        self._steps.clear()

    def add(self, accepted: Measurement, before: Measurement, frame: Measurement) -> None:
        """Take in a rejected ``frame``, the one ``before`` it, and the last that was ``accepted``."""
        self._away = distance(accepted, frame), turn(accepted, frame)
        dt = frame.source_time - before.source_time
        if dt > 0.0:
            self._steps.append((distance(before, frame) / dt, turn(before, frame) / dt))

    @property
    def sentence(self) -> str:
        """The motion, the limit that it exceeds and the key that sets it; "" if it exceeds none."""
        if not self._steps:
            return ""
        fast = np.quantile(np.array(self._steps), SHARE, axis=0, method="lower").tolist()
        seen = (*(fast if len(self._steps) > 1 else (0.0, 0.0)), *self._away)
        for value, (key, (words, unit)) in zip(seen, WORDS.items(), strict=True):
            if value > self._limits[key]:
                return (
                    f"{words.format(value)}, frames above {key} = {self._limits[key]:g} {unit} are rejected; "
                    f"if the robot can do that, raise {key} in [gate] of its file"
                )
        return ""


def distance(before: Measurement, after: Measurement) -> float:
    """Return the distance of two planar poses in m."""
    return math.hypot(after.pose[0] - before.pose[0], after.pose[1] - before.pose[1])


def turn(before: Measurement, after: Measurement) -> float:
    """Return the angle between two planar poses, 0 to pi rad."""
    return abs(math.remainder(after.pose[2] - before.pose[2], 2.0 * math.pi))
