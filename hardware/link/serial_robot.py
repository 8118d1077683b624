"""The physical toy car: a remote control on a serial port and a tracker above the floor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hardware.link.port import only_port
from hardware.link.serial_connection import SerialConnection, open_session
from hardware.robot import Robot
from hardware.toy_car import CAR
from hardware.trackers.tracker import Tracker
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import register_robot, trackers

PATIENCE = 5.0  # s


@register_robot("serial")
class SerialRobot(Robot):
    """The toy car behind its remote control (docs/hardware.md).

    ``port`` is the serial device, best by its name in /dev/serial/by-id; None for the only one
    there. ``tracker`` is a `Tracker` or a table with its registered name as ``driver`` and its
    arguments; without one the car can be commanded, not seen. ``patience`` is how long in s
    `connect` tries. Raises `InvalidArgument`, `UnknownName`.
    """

    dynamics = None

    def __init__(
        self,
        *,
        port: str | None = None,
        tracker: Tracker | Mapping[str, Any] | None = None,
        name: str = "serial",
        patience: float = PATIENCE,
    ) -> None:
        if not patience > 0.0:
            raise InvalidArgument(f"serial robot: expected patience > 0 s, got {patience}")
        self.name = name
        self.system = CAR
        self.port = port
        self.tracker = _tracker(tracker)
        self.patience = patience

    def connect(self, *, seed: int | None = None) -> SerialConnection:
        """Open a session in neutral. Raises `LinkLost`, `IncompatibleRobot`, `InvalidArgument`."""
        stream = None if self.tracker is None else self.tracker.open()
        try:
            port, session = open_session(self.port or only_port(), self.patience)
        except BaseException:
            if stream is not None:
                stream.close()
            raise
        return SerialConnection(port, session, stream)


def _tracker(given: Tracker | Mapping[str, Any] | None) -> Tracker | None:
    if given is None or isinstance(given, Tracker):
        return given
    arguments = dict(given)
    driver = arguments.pop("driver", None)
    if not isinstance(driver, str):
        raise InvalidArgument(
            f'serial robot: expected tracker = {{driver = "NAME", ...}} with one of {", ".join(trackers.names())}, '
            f"got {dict(given)}"
        )
    return trackers.make(driver, **arguments)
