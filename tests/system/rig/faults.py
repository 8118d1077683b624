"""What can go wrong between the host and the emulated car, and when."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace

from sysid_evo.errors import InvalidArgument

KINDS = {
    "stall": "no byte arrives until the window ends, then all of them",
    "unplug": "the port is gone; it comes back, under the same link, when the window ends",
    "reset": "the firmware starts again as the window begins",
    "version": "the firmware answers with the next major version",
    "dropout": "frames that do not see the body",
    "silence": "no frames",
    "frozen": "frames with the pose at the beginning of the window",
    "identity_swap": "this body and another one bear each other's names",
    "yaw_flip": "the heading is half a turn off",
}


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault of a ``kind`` of `KINDS`, from ``at`` s after the start for ``duration`` s. Raises `InvalidArgument`."""

    kind: str
    at: float = 0.0
    duration: float = math.inf

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InvalidArgument(f"fault: expected one of {', '.join(KINDS)}, got {self.kind!r}")
        if not 0.0 <= self.at < math.inf or not self.duration > 0.0:
            raise InvalidArgument(f"fault {self.kind!r}: expected at >= 0 and duration > 0 s, got {self}")

    def to_json(self) -> str:
        """Return the fault as one line of JSON; what never ends is left out."""
        return json.dumps({name: value for name, value in asdict(self).items() if value != math.inf})


class FaultSchedule:
    """All faults of a session; times are in s on the clock that ``start`` was read from."""

    def __init__(self, faults: Iterable[Fault], start: float) -> None:
        self.start = start
        self._faults = list(faults)

    def add(self, fault: Fault, now: float) -> None:
        """Take in a fault whose ``at`` counts from ``now``."""
        self._faults.append(replace(fault, at=now - self.start + fault.at))

    def active(self, kind: str, now: float) -> bool:
        """Whether a fault of ``kind`` happens ``now``."""
        return self.end(kind, now) > now

    def end(self, kind: str, now: float) -> float:
        """Return when the last fault of ``kind`` that happens ``now`` ends; -inf if none does."""
        begun = (fault for fault in self._faults if fault.kind == kind and self.start + fault.at <= now)
        ends = (self.start + fault.at + fault.duration for fault in begun)
        return max((end for end in ends if end > now), default=-math.inf)

    def begun(self, kind: str, now: float) -> int:
        """Return how many faults of ``kind`` have begun so far."""
        return sum(fault.kind == kind and self.start + fault.at <= now for fault in self._faults)

    def next_change(self, now: float) -> float:
        """Return when the next fault begins or ends; inf if none does."""
        edges = (edge for fault in self._faults for edge in (fault.at, fault.at + fault.duration))
        return min((self.start + edge for edge in edges if self.start + edge > now), default=math.inf)
