"""What can be told about a session while it runs, and who is told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from hardware.measurement import Measurement
from sysid_evo.arrays import Array


@dataclass(frozen=True)
class Command:
    """A control (nu,) sent at tick ``tick``, which was due at ``due``; times in s on the connection's clock."""

    tick: int
    due: float
    time: float
    control: Array


@dataclass(frozen=True)
class RobotStatus:
    """What the robot said of itself.

    ``time`` is when it got here (s, the connection's clock), ``robot_time`` when it was said (s, the
    robot's clock); ``state`` is a word for what it does ("driving", "neutral", "tripped"),
    ``control`` (nu,) what its outputs are set to, ``counters`` what it has counted since it started.
    """

    time: float
    robot_time: float
    state: str
    control: Array
    counters: Mapping[str, int] = field(default_factory=dict)


class Listener:
    """Is told of everything that happens in a session, in the order of time; each method does nothing here.

    Called from the loop's own thread: a listener returns within a millisecond and never raises.
    """

    def measured(self, measurement: Measurement) -> None:
        """Take note of a frame of the tracker."""

    def commanded(self, command: Command) -> None:
        """Take note of a control that was sent."""

    def reported(self, status: RobotStatus) -> None:
        """Take note of what the robot said."""

    def close(self) -> None:
        """Finish; a second call does nothing."""
