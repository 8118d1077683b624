"""What can go wrong between the host and the emulated car, and when."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace

from sysid_evo.errors import InvalidArgument

WIRE_FAULTS = {
    "flip": "a byte arrives with other bits",
    "drop": "a byte does not arrive",
    "duplicate": "a byte arrives twice",
    "delay": "a byte, and those behind it, arrive `seconds` later",
    "stall": "no byte arrives until the window ends, then all of them",
    "unplug": "the port is gone; it comes back, under the same link, when the window ends",
    "reset": "the firmware starts again as the window begins",
    "version": "the firmware answers with the next major version",
}
TRACKER_FAULTS = {
    "dropout": "frames that do not see the body",
    "silence": "no frames",
    "frozen": "frames with the pose at the beginning of the window",
    "identity_swap": "this body and another one bear each other's names",
    "yaw_flip": "the heading is half a turn off",
}
KINDS = {**WIRE_FAULTS, **TRACKER_FAULTS}
WHOLE = ("stall", "unplug", "reset", "version", "frozen", "identity_swap")
"""Faults of a whole window, to which a chance for each byte or frame does not apply."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault of a ``kind`` of `KINDS` and the windows of time in which it happens.

    The first window opens at ``at`` s after the start and lasts ``duration`` s; with ``every`` (s)
    another one opens that much after the one before. Within a window each byte or frame is hit
    with ``probability``. ``seconds`` is the length of a delay. Raises `InvalidArgument`.
    """

    kind: str
    at: float = 0.0
    duration: float = math.inf
    every: float = math.inf
    probability: float = 1.0
    seconds: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InvalidArgument(f"fault: expected one of {', '.join(KINDS)}, got {self.kind!r}")
        if not (math.isfinite(self.at) and self.at >= 0.0):
            raise InvalidArgument(f"fault {self.kind!r}: expected at >= 0 s, got {self.at}")
        if not 0.0 < self.duration <= self.every:
            raise InvalidArgument(
                f"fault {self.kind!r}: expected 0 < duration <= every, got {self.duration} and {self.every} s"
            )
        if not 0.0 <= self.probability <= 1.0:
            raise InvalidArgument(f"fault {self.kind!r}: expected 0 <= probability <= 1, got {self.probability}")
        if self.kind in WHOLE and self.probability != 1.0:
            raise InvalidArgument(
                f"fault {self.kind!r} takes a whole window: give at, duration, every, not a probability"
            )
        if not (math.isfinite(self.seconds) and self.seconds >= 0.0 and (self.seconds > 0.0) == (self.kind == "delay")):
            raise InvalidArgument(f"fault {self.kind!r}: seconds > 0 belong to a delay alone, got {self.seconds}")

    def to_json(self) -> str:
        """Return the fault as one line of JSON; what never ends is left out."""
        return json.dumps({name: value for name, value in asdict(self).items() if value != math.inf})

    def window(self, elapsed: float) -> int:
        """Return the number of windows that have opened ``elapsed`` s after the start."""
        if elapsed < self.at:
            return 0
        return 1 if math.isinf(self.every) else 1 + int((elapsed - self.at) // self.every)

    def end(self, elapsed: float) -> float:
        """Return when the window that is open at ``elapsed`` ends, in s after the start; -inf if none is open."""
        opened = self.window(elapsed)
        if opened == 0:
            return -math.inf
        begin = self.at if opened == 1 else self.at + (opened - 1) * self.every
        return begin + self.duration if elapsed < begin + self.duration else -math.inf


class FaultSchedule:
    """All faults of a session; times are in s on the clock that ``start`` was read from."""

    def __init__(self, faults: Iterable[Fault], start: float) -> None:
        self.start = start
        self._faults = list(faults)

    def add(self, fault: Fault, now: float) -> None:
        """Take in a fault whose ``at`` counts from ``now``."""
        self._faults.append(replace(fault, at=now - self.start + fault.at))

    def active(self, kind: str, now: float) -> Iterator[Fault]:
        """Yield the faults of ``kind`` with an open window."""
        for fault in self._faults:
            if fault.kind == kind and fault.end(now - self.start) > -math.inf:
                yield fault

    def end(self, kind: str, now: float) -> float:
        """Return when the last open window of ``kind`` ends; -inf if none is open."""
        ends = [fault.end(now - self.start) for fault in self._faults if fault.kind == kind]
        return self.start + max(ends, default=-math.inf)

    def windows(self, kind: str, now: float) -> int:
        """Return how many windows of ``kind`` have opened so far."""
        return sum(fault.window(now - self.start) for fault in self._faults if fault.kind == kind)

    def next_change(self, now: float) -> float:
        """Return when the next window opens or closes; inf if none does."""
        elapsed, times = now - self.start, [math.inf]
        for fault in self._faults:
            end, opened = fault.end(elapsed), fault.window(elapsed)
            if end > elapsed:
                times.append(end)
            following = fault.at if opened == 0 else fault.at + opened * fault.every
            times.append(following)
        return self.start + min(times)
