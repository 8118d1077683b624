"""The contract of a session with a robot: commands out, frames of a tracker and the robot's status in."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from types import TracebackType
from typing import Any, Protocol, Self

from hardware.arguments import check_integer, check_number, check_table
from sysid_evo.models import Dynamics
from sysid_evo.system import System
from sysid_evo.types import Array

TIME_TO_LIVE = 0.15  # s for which a command is valid: a robot whose host has died stops after it


MOST_FRAMES = 1_000_000  # the largest number of frames in a limit of the gate


@dataclass(frozen=True)
class GateLimits:
    """Limits of a body's motion between two accepted frames dt s apart, in addition to the tracker's errors.

    It moves at most ``speed`` dt + ``position_error`` and never more than ``jump`` m; it turns at most ``yaw_rate`` dt
    + ``heading_error`` and never more than ``turn`` rad. Under a drive command at most ``frozen`` poses in a row are
    equal to the last bit, since a real tracker has noise (None for one without noise). A body that appears at another
    place is accepted again when its frames are consistent: after ``confirm`` of them if it could have moved there, as
    after a dropout; after ``recover`` s if it could not, because then it is another body or a flipped one. A run ends
    before. A robot that can do more sets its own limits: ``[gate]`` in its file, or ``gate=GateLimits(speed=8.0)``.
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
                check_number(f"gate: {name}", value, above=0.0)
        for name in ("position_error", "heading_error"):
            check_number(f"gate: {name}", getattr(self, name), minimum=0.0)
        check_integer("gate: confirm", self.confirm, minimum=1, maximum=MOST_FRAMES)
        if self.frozen is not None:
            check_integer("gate: frozen", self.frozen, minimum=1, maximum=MOST_FRAMES)

    @classmethod
    def read(cls, given: GateLimits | Mapping[str, Any] | None) -> GateLimits:
        """Return limits from a table such as ``[gate]`` in a robot's file; None means the defaults.

        Raises `InvalidArgument`.
        """
        if isinstance(given, GateLimits):
            return given
        return cls(**check_table("gate", {} if given is None else given, (item.name for item in fields(cls))))

    def to_dict(self) -> dict[str, float | None]:
        """Return the limits as strict JSON (an absent limit is null)."""
        return {
            name: value if value is not None and math.isfinite(value) else None for name, value in asdict(self).items()
        }

    @classmethod
    def from_dict(cls, value: Mapping[str, float | None]) -> GateLimits:
        """Inverse of `to_dict`. Raises `TypeError` or `InvalidArgument` if they are no limits."""
        limits: dict[str, Any] = {k: math.inf if v is None and k != "frozen" else v for k, v in value.items()}
        return cls(**limits)


class Closeable(ABC):
    """An open resource; the ``with`` statement closes it on every exit."""

    @abstractmethod
    def close(self) -> None:
        """Close it; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Connection(Closeable):
    """A session with a robot; use it in a ``with`` statement.

    The robot is neutral before the first command, after a command outlives its ``valid_for``, and on every exit from
    the ``with`` statement. One thread uses it.
    """

    gate_limits: GateLimits = GateLimits()
    """Limits of the body's motion from one frame to the next: frames beyond them are rejected."""

    @property
    @abstractmethod
    def time(self) -> float:
        """The connection's clock in s: the host's `time.monotonic`, or simulated time."""

    @property
    def round_trip(self) -> float | None:
        """Time in s from the newest answered command to the robot's answer; None if it is not measured."""
        return None

    @property
    def status(self) -> RobotStatus | None:
        """The newest status of the robot; None from a robot that sends none."""
        return None

    @abstractmethod
    def send(self, control: Array, *, valid_for: float) -> None:
        """Command ``control`` (nu,) for at most ``valid_for`` s. Raises `ShapeError`, `LinkLost`."""

    @abstractmethod
    def measure(self, timeout: float) -> Measurement | None:
        """Return the next frame, or None if there is none within ``timeout`` s. Raises `LinkLost`.

        Frames that arrive between calls are kept and returned in turn; simulated time advances only here.
        """

    @abstractmethod
    def close(self) -> None:
        """Put the robot in neutral and end the session; a second call does nothing."""


class Connectable(Protocol):
    """The part of a `Robot` that the control loop needs."""

    name: str
    system: System
    dynamics: Dynamics | None

    def connect(self, *, seed: int | None = None) -> Connection:
        """Open a session."""
        ...


@dataclass(frozen=True)
class Command:
    """A control (nu,) sent at tick ``tick``, which was due at ``due``; times in s on the connection's clock."""

    tick: int
    due: float
    time: float
    control: Array


@dataclass(frozen=True)
class Measurement:
    """One frame of a tracker.

    ``source_time`` is when the frame was taken, ``arrival_time`` when it was received. Both are in s on the
    connection's clock; a tracker with its own clock is mapped to the host's (`time.monotonic`). ``pose`` (n_pose,) is
    in the units of the system's motion. If ``valid`` is false, the tracker has lost ``body`` and the pose has no
    meaning.
    """

    source_time: float
    arrival_time: float
    frame: int
    body: str
    valid: bool
    pose: Array


@dataclass(frozen=True)
class RobotStatus:
    """A status message of the robot.

    ``time`` is when it was received (s, the connection's clock), ``robot_time`` when it was sent (s, the robot's
    clock). ``state`` is its mode in one word ("driving", "neutral", "tripped"), ``control`` (nu,) the state of its
    outputs, ``counters`` are its counters since it started.
    """

    time: float
    robot_time: float
    state: str
    control: Array
    counters: Mapping[str, int] = field(default_factory=dict)


class Listener:
    """Is notified of every event in a session, in order of time; here each method does nothing.

    It is called from the thread of the loop: a listener returns within a millisecond and never raises.
    """

    def on_measurement(self, measurement: Measurement) -> None:
        """Handle a frame of the tracker."""

    def on_command(self, command: Command) -> None:
        """Handle a control that was sent."""

    def on_status(self, status: RobotStatus) -> None:
        """Handle a status of the robot."""

    def close(self) -> None:
        """Finish; a second call does nothing."""
