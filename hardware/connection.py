"""A session with a robot: commands go out, frames come in; and what can open one."""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol

from hardware.listener import RobotStatus
from hardware.measurement import Measurement
from hardware.session import Session
from hardware.trackers.gates import GateLimits
from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics
from sysid_evo.system import System


class Connection(Session):
    """A session with a robot; use it in a ``with`` statement.

    The robot is neutral before the first command, after a command outlives its ``valid_for``, and
    on every way out of the ``with`` statement. One thread uses it.
    """

    @property
    @abstractmethod
    def time(self) -> float:
        """The connection's clock in s: the host's `time.monotonic`, or simulated time."""

    @property
    def round_trip(self) -> float | None:
        """The time in s from the newest answered command to the robot's answer; None from one that gives none."""
        return None

    @property
    def gate_limits(self) -> GateLimits:
        """What the body can do from one frame to the next: others are not believed."""
        return GateLimits()

    @property
    def status(self) -> RobotStatus | None:
        """The newest word of the robot; None from one that says nothing."""
        return None

    @abstractmethod
    def send(self, control: Array, *, valid_for: float) -> None:
        """Command ``control`` (nu,) for at most ``valid_for`` s. Raises `ShapeError`, `LinkLost`."""

    @abstractmethod
    def measure(self, timeout: float) -> Measurement | None:
        """Return the next frame, or None if there is none within ``timeout`` s. Raises `LinkLost`.

        Frames that came in between calls are kept and returned in turn; simulated time moves only here.
        """

    @abstractmethod
    def close(self) -> None:
        """Put the robot in neutral and end the session; a second call does nothing."""


class Connectable(Protocol):
    """What can be driven: a `Robot`, see there."""

    name: str
    system: System
    dynamics: Dynamics | None

    def connect(self, *, seed: int | None = None) -> Connection:
        """Open a session."""
        ...
