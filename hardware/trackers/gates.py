"""Which frames of a tracker are believed, and where one track ends and another begins."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from hardware.arguments import number, table, whole
from hardware.measurement import Measurement
from hardware.trackers.excess import WORDS, Excess, distance, turn
from sysid_evo.arrays import Array

ACCEPTED = ""
JUMPED, FLIPPED, TOO_FAST, TURNED_TOO_FAST = "jumped", "flipped", "too fast", "turned too fast"
CONTRADICTIONS = (JUMPED, FLIPPED, TOO_FAST, TURNED_TOO_FAST)
"""Why a frame cannot follow on the one before."""
LARGEST = 1e9  # s, m, rad: no clock, room or spin reaches it
MOST_FRAMES = 1_000_000


@dataclass(frozen=True)
class Verdict:
    """What becomes of a frame: ``accepted``, or dropped for a ``reason``; ``broke``: a new track begins with it."""

    accepted: bool
    reason: str = ACCEPTED
    broke: bool = False


@dataclass(frozen=True)
class GateLimits:
    """What a body can do between two accepted frames dt s apart, beyond the tracker's own errors.

    It moves at most ``speed`` dt + ``position_error`` and never over ``jump`` m; it turns at most
    ``yaw_rate`` dt + ``heading_error`` and never over ``turn`` rad. While it is told to drive, no
    more than ``frozen`` poses in a row are equal to the last bit: a real tracker is never that still
    (None for one without noise). A body that turns up elsewhere is believed again when its frames agree
    with each other: after ``confirm`` of them if it could have got there, as after a dropout; after
    ``recover`` s if it could not, because then it is another body or a flipped one. A run ends before.

    A robot that can do more says so: ``[gate]`` in its file, or ``gate=GateLimits(speed=8.0)``.
    """

    speed: float = 5.0
    yaw_rate: float = 12.0
    jump: float = 0.25
    turn: float = 1.0
    position_error: float = 0.01
    heading_error: float = 0.1
    frozen: int | None = 10
    confirm: int = 10
    recover: float = 0.6

    def __post_init__(self) -> None:
        for name in ("speed", "yaw_rate", "jump", "turn", "recover"):
            value = getattr(self, name)
            if value != math.inf:
                number(f"gate: {name}", value, above=0.0)
        for name in ("position_error", "heading_error"):
            number(f"gate: {name}", getattr(self, name), least=0.0)
        whole("gate: confirm", self.confirm, least=1, most=MOST_FRAMES)
        if self.frozen is not None:
            whole("gate: frozen", self.frozen, least=1, most=MOST_FRAMES)

    @classmethod
    def read(cls, given: GateLimits | Mapping[str, Any] | None) -> GateLimits:
        """Return limits from a table such as ``[gate]`` in a robot's file; None means the ones that hold for most.

        Raises `InvalidArgument`.
        """
        if isinstance(given, GateLimits):
            return given
        return cls(**table("gate", {} if given is None else given, (item.name for item in fields(cls))))

    def to_dict(self) -> dict[str, float | None]:
        """Return the limits as strict JSON (an absent limit is null)."""
        return {
            name: value if value is not None and math.isfinite(value) else None for name, value in asdict(self).items()
        }

    @classmethod
    def from_dict(cls, value: Mapping[str, float | None]) -> GateLimits:
        """Undo `to_dict`. Raises `TypeError` or `InvalidArgument` if they are no limits."""
        limits: dict[str, Any] = {k: math.inf if v is None and k != "frozen" else v for k, v in value.items()}
        return cls(**limits)


class PoseGate:
    """Decides frame by frame on planar poses of ``body`` (None: the first seen); it has no clock of its own.

    No two accepted frames of one track contradict `GateLimits`; a frame that does is dropped. If the
    body turns up elsewhere and stays consistent there, a new track begins, and the verdict on its
    first accepted frame says ``broke``: nothing may be computed across it.
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
        self._counts: Counter[str] = Counter()
        self._before: Measurement | None = None
        self._excess = Excess({name: getattr(self.limits, name) for name in WORDS})

    @property
    def excess(self) -> str:
        """By how much the frames since the newest believed one go beyond a limit, in a sentence; "" if they do not."""
        return self._excess.sentence

    @property
    def counters(self) -> Mapping[str, int]:
        """Frames by the reason of the verdict; "accepted" for those that have none, "tracks" that began."""
        return dict(self._counts)

    def accept(self, measurement: Measurement, *, driving: bool) -> Verdict:
        """Return the verdict on the next frame; ``driving``: a command other than neutral is in force."""
        verdict = self._judge(measurement, driving)
        if verdict.accepted:
            self._excess.clear()
            self._before = measurement
        elif verdict.reason in CONTRADICTIONS and self._last is not None and self._before is not None:
            self._excess.add(self._last, self._before, measurement)
            self._before = measurement
        self._counts[verdict.reason if not verdict.accepted else "accepted"] += 1
        if verdict.broke:
            self._counts["tracks"] += 1
        return verdict

    def _judge(self, frame: Measurement, driving: bool) -> Verdict:
        if self.body is None and frame.valid:
            self.body = frame.body
        if not frame.valid:
            return Verdict(False, "not valid")
        if frame.body != self.body:
            return Verdict(False, "of another body")
        if frame.pose.shape != (3,) or not _sound(*frame.pose, frame.source_time, frame.arrival_time):
            return Verdict(False, "not a number")
        if self._is_frozen(frame.pose, driving):
            self._thawed = True
            return Verdict(False, "frozen")
        if self._last is None:
            return self._begin(frame)
        if frame.source_time <= self._last.source_time:
            return Verdict(False, "not newer")
        reason = self._rivals_reason if self._follows_rival(frame) else self._contradiction(self._last, frame)
        if reason == ACCEPTED:
            if self._thawed:
                return self._begin(frame)
            self._last = frame
            self._rival.clear()
            return Verdict(True)
        self._rivals_reason = reason
        return self._begin(frame) if self._confirmed(frame) else Verdict(False, reason)

    def _begin(self, frame: Measurement) -> Verdict:
        self._last, self._thawed = frame, False
        self._rival.clear()
        return Verdict(True, broke=True)

    def _is_frozen(self, pose: Array, driving: bool) -> bool:
        """Count equal poses under a drive command; say whether there are too many.

        A pose that was found frozen stays so when the robot is stopped: else it would be believed again,
        and the robot driven on.
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
        """Return why ``after`` cannot follow on ``before``, "" if it can."""
        limits = self.limits
        if distance(before, after) > limits.jump:
            return JUMPED
        if turn(before, after) > limits.turn:
            return FLIPPED
        return self._out_of_reach(before, after)

    def _out_of_reach(self, before: Measurement, after: Measurement) -> str:
        """Return what the body would have had to exceed to get from ``before`` to ``after``, "" if nothing."""
        limits, dt = self.limits, after.source_time - before.source_time
        if distance(before, after) > limits.speed * dt + limits.position_error:
            return TOO_FAST
        if turn(before, after) > limits.yaw_rate * dt + limits.heading_error:
            return TURNED_TOO_FAST
        return ACCEPTED

    def _follows_rival(self, frame: Measurement) -> bool:
        """Whether a frame continues the dropped frames rather than the track.

        The track alone cannot tell: the longer ago its last frame, the more lies within its reach.
        """
        if self._last is None or not self._rival or self._contradiction(self._rival[-1], frame) != ACCEPTED:
            return False
        return self._effort(self._rival[-1], frame) < self._effort(self._last, frame)

    def _effort(self, before: Measurement, after: Measurement) -> float:
        """Return the least time in s to get from one pose to the other."""
        return max(distance(before, after) / self.limits.speed, turn(before, after) / self.limits.yaw_rate)

    def _confirmed(self, frame: Measurement) -> bool:
        """Add a frame to the track that rivals the accepted one; say whether it is believed by now."""
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


def _sound(*values: float) -> bool:
    return all(-LARGEST < value < LARGEST for value in values)
