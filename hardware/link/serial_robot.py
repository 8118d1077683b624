"""The physical toy car: a remote control on a serial port and a tracker above the floor."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from hardware.arguments import number, text
from hardware.robot import Robot
from hardware.toy_car import CAR
from hardware.trackers.gates import GateLimits
from hardware.trackers.tracker import Tracker
from sysid_evo.errors import InvalidArgument, LinkLost
from sysid_evo.registry import register_robot, trackers

if TYPE_CHECKING:
    from hardware.link.serial_connection import SerialConnection

PATIENCE = 5.0  # s


@register_robot("serial")
class SerialRobot(Robot):
    """The toy car behind its remote control (docs/hardware.md).

    ``port`` is the serial device, best by its name in /dev/serial/by-id; None for the only one
    there. ``tracker`` is a `Tracker` or a table with its registered name as ``driver`` and its
    arguments; without one the car can be commanded, not seen. ``patience`` is how long in s
    `connect` tries. ``gate`` is a table of what the car can do, if that is more than `GateLimits` says.
    The constructor opens nothing. Raises `InvalidArgument`, `UnknownName`.
    """

    requires: ClassVar[tuple[str, ...]] = ("cobs", "serial")
    dynamics = None

    def __init__(
        self,
        *,
        port: str | None = None,
        tracker: Tracker | Mapping[str, Any] | None = None,
        name: str = "serial",
        patience: float = PATIENCE,
        gate: GateLimits | Mapping[str, Any] | None = None,
    ) -> None:
        self.name = text("serial robot: name", name)
        self.system = CAR
        self.port = None if port is None else text("serial robot: port", port)
        self.tracker = _tracker(tracker)
        self.patience = number("serial robot: patience", patience, above=0.0)
        self.gate = GateLimits.read(gate)

    def check(self) -> None:
        """Raise `LinkLost` or `InvalidArgument` if there is no such port, and what the tracker finds missing."""
        super().check()
        from hardware.link.port import NO_DEVICE, only_port

        port = self.port or only_port()
        if not Path(port).exists():
            raise LinkLost(f"port {port}: {NO_DEVICE}")
        if self.tracker is not None:
            self.tracker.check()

    def connect(self, *, seed: int | None = None) -> SerialConnection:
        """Open a session in neutral. Raises `LinkLost`, `IncompatibleRobot`, `InvalidArgument`, `MissingExtra`."""
        super().check()
        from hardware.link.port import only_port
        from hardware.link.serial_connection import SerialConnection, open_session

        stream = None if self.tracker is None else self.tracker.open()
        try:
            port, session = open_session(self.port or only_port(), self.patience)
        except BaseException:
            if stream is not None:
                stream.close()
            raise
        return SerialConnection(port, session, stream, self.gate)


def _tracker(given: Tracker | Mapping[str, Any] | None) -> Tracker | None:
    if given is None or isinstance(given, Tracker):
        return given
    arguments = dict(given) if isinstance(given, Mapping) else {}
    driver = arguments.pop("driver", None)
    if not isinstance(driver, str):
        raise InvalidArgument(
            f'serial robot: expected tracker = {{driver = "NAME", ...}} with one of {", ".join(trackers.names())}, '
            f"got {given!r}"
        )
    return trackers.make(driver, **arguments)
