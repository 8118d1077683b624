"""What a robot is to the rest: a system, a connection to command it and to see where it is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics
from sysid_evo.system import System


@dataclass(frozen=True)
class Measurement:
    """One frame of a tracker.

    ``source_time`` is when the frame was taken, ``arrival_time`` when it got here, both in s on the
    connection's clock. ``pose`` (n_pose,) is in the units of the system's motion; where ``valid``
    is false the tracker has lost ``body`` and the pose means nothing.
    """

    source_time: float
    arrival_time: float
    frame: int
    body: str
    valid: bool
    pose: Array


class Connection(ABC):
    """A session with a robot; use it in a ``with`` statement.

    The robot is neutral before the first command, after a command outlives its ``valid_for``, and
    on every way out of the ``with`` statement.
    """

    @abstractmethod
    def send(self, control: Array, *, valid_for: float) -> None:
        """Command ``control`` (nu,) for at most ``valid_for`` s. Raises `ShapeError`, `LinkLost`."""

    @abstractmethod
    def measure(self, timeout: float) -> Measurement | None:
        """Return the next frame, or None if there is none within ``timeout`` s. Raises `LinkLost`."""

    @abstractmethod
    def close(self) -> None:
        """Put the robot in neutral and end the session; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Robot(ABC):
    """What the registry of robots holds. ``dynamics`` is None for a physical robot."""

    name: str
    system: System
    dynamics: Dynamics | None

    @abstractmethod
    def connect(self, *, seed: int | None = None) -> Connection:
        """Open a session; ``seed`` fixes what an emulated robot draws and means nothing to a physical one."""
