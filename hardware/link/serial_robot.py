"""The physical toy car: description, buttons of its remote, handshake, session on port and tracker."""

from __future__ import annotations

import secrets
import select
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from hardware.arguments import check_number, check_text
from hardware.connection import Connection, GateLimits, Measurement, RobotStatus
from hardware.link.messages import EXCLUSIVE, Buttons
from hardware.link.port import NO_DEVICE, SerialPort, only_port
from hardware.link.session import HostSession
from hardware.robot import Robot
from hardware.toy_car import CAR
from hardware.trackers.tracker import Tracker, TrackerStream
from sysid_evo.errors import InvalidArgument, LinkLost
from sysid_evo.registry import register_robot, trackers
from sysid_evo.types import Array, check_shape

PATIENCE = 5.0  # s


@register_robot("serial")
class SerialRobot(Robot):
    """The toy car with its remote control (docs/hardware.md).

    ``port`` is the serial device, best by its name in /dev/serial/by-id; None for the only one there. ``tracker`` is a
    `Tracker` or a table with its registered name as ``driver`` and its arguments; without one the car can be commanded,
    but has no pose. ``patience`` is the time in s for which `connect` tries. ``gate`` is a table of the car's limits of
    motion, if they are above the defaults of `GateLimits`.
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
        self.name = check_text("serial robot: name", name)
        self.system = CAR
        self.port = None if port is None else check_text("serial robot: port", port)
        self.tracker = _tracker(tracker)
        self.patience = check_number("serial robot: patience", patience, above=0.0)
        self.gate = GateLimits.read(gate)

    def check(self) -> None:
        """Raise `LinkLost` or `InvalidArgument` if there is no such port, and the errors of the tracker's check."""
        super().check()
        port = self.port or only_port()
        if not Path(port).exists():
            raise LinkLost(f"port {port}: {NO_DEVICE}")
        if self.tracker is not None:
            self.tracker.check()

    def connect(self, *, seed: int | None = None) -> SerialConnection:
        """Open a session in neutral. Raises `LinkLost`, `IncompatibleRobot`, `InvalidArgument`, `MissingExtra`."""
        super().check()
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


BACKOFF, BACKOFF_MAX = 0.2, 2.0  # s between two attempts to reach a robot, doubled each time


def open_session(port: str, patience: float) -> tuple[SerialPort, HostSession]:
    """Return ``port`` with a new session on it, trying for ``patience`` s.

    A robot that resets when its port is opened needs one or two of them. Raises `LinkLost`,
    `IncompatibleRobot`.
    """
    deadline = time.monotonic() + patience
    backoff = BACKOFF
    while True:
        try:
            return _shake_hands(port, deadline)
        except LinkLost as error:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise LinkLost(f"no robot within {patience:g} s: {error}") from error
        time.sleep(min(backoff, left))
        backoff = min(2.0 * backoff, BACKOFF_MAX)


def _shake_hands(name: str, deadline: float) -> tuple[SerialPort, HostSession]:
    """Open the port and repeat one HELLO on it until it is answered or the time is over."""
    port = SerialPort(name)
    try:
        session = HostSession(nonce=secrets.randbits(32))
        poll = select.poll()
        poll.register(port.fileno(), select.POLLIN)
        port.read()
        backoff = BACKOFF
        while time.monotonic() < deadline:
            port.write(b"\0" + session.hello())
            again = time.monotonic() + backoff
            while (left := min(again, deadline) - time.monotonic()) > 0.0:
                poll.poll(1000.0 * left)
                session.receive(port.read(), time.monotonic())
                session.check(time.monotonic())
                if session.is_open:
                    return port, session
            backoff = min(2.0 * backoff, BACKOFF_MAX)
        raise LinkLost(f"the device on {name} does not answer; is it the remote, flashed with hardware/firmware?")
    except BaseException:
        port.close()
        raise


LONGEST_WAIT = 0.1  # s after which a measurement checks the robot again


class SerialConnection(Connection):
    """An open session; the clock is `time.monotonic`. Made by `SerialRobot.connect`.

    Any end (silence, a trip, an unplugged cable) is final: every later call raises `LinkLost`, and only another
    `connect` continues. Without a tracker `measure` never returns a frame.
    """

    def __init__(
        self, port: SerialPort, session: HostSession, tracker: TrackerStream | None, gate: GateLimits | None = None
    ) -> None:
        self.gate_limits = GateLimits.read(gate)
        self._port = port
        self._session = session
        self._tracker = tracker
        self._open = True
        self._lost: LinkLost | None = None
        self._poll = select.poll()
        self._poll.register(port.fileno(), select.POLLIN)
        if tracker is not None:
            self._poll.register(tracker.fileno(), select.POLLIN)

    @property
    def time(self) -> float:
        return time.monotonic()

    @property
    def status(self) -> RobotStatus | None:
        status = self._session.status
        if status is None:
            return None
        return RobotStatus(
            self._session.heard,
            status.clock_ms / 1000.0,
            status.state.name.lower(),
            control_of_buttons(status.buttons),
            status.counters,
        )

    @property
    def round_trip(self) -> float | None:
        """The time in s from the newest answered command to its status."""
        return self._session.round_trip

    def send(self, control: Array, *, valid_for: float) -> None:
        buttons = buttons_of(control)
        self._listen()
        self._write(self._session.command(buttons, valid_for, time.monotonic()))

    def measure(self, timeout: float) -> Measurement | None:
        deadline = time.monotonic() + timeout
        while True:
            self._listen()
            frame = None if self._tracker is None else self._tracker.read(0.0)
            if frame is not None:
                return frame
            left = deadline - time.monotonic()
            if left <= 0.0:
                return None
            self._poll.poll(1000.0 * min(left, LONGEST_WAIT))

    def close(self) -> None:
        if not self._open:
            return
        self._open = False
        try:
            with suppress(LinkLost):
                self._port.discard()
                self._port.write(self._session.stop())
        finally:
            self._port.close()
            if self._tracker is not None:
                self._tracker.close()

    def _listen(self) -> None:
        """Take in all data from the robot, then check the newest."""
        if not self._open:
            raise LinkLost(f"the connection on {self._port.name} is closed: open another with connect()")
        if self._lost is not None:
            raise self._lost
        try:
            self._session.receive(self._port.read(), time.monotonic())
            self._session.check(time.monotonic())
        except LinkLost as lost:
            self._lost = lost
            raise

    def _write(self, frames: bytes) -> None:
        try:
            self._port.write(frames)
        except LinkLost as lost:
            self._lost = lost
            raise


DRIVE = {-1.0: Buttons.BACKWARD, 0.0: Buttons.NONE, 1.0: Buttons.FORWARD}
STEER = {-1.0: Buttons.RIGHT, 0.0: Buttons.NONE, 1.0: Buttons.LEFT}


def buttons_of(control: Array) -> Buttons:
    """Return the buttons for ``control`` (2,): drive and steer, each -1, 0 or 1.

    Mutually exclusive buttons never result. Raises `ShapeError`, `InvalidArgument`.
    """
    values = check_shape("control", control, (CAR.nu,)).tolist()
    pressed = Buttons.NONE
    for value, table, name in zip(values, (DRIVE, STEER), CAR.control_names, strict=True):
        if value not in table:
            raise InvalidArgument(f"control {name!r}: expected -1, 0 or 1, got {value}")
        pressed |= table[value]
    return pressed


def control_of_buttons(buttons: Buttons) -> Array:
    """Return the control (2,) that closes ``buttons``. Raises `InvalidArgument` for a mutually exclusive pair."""
    if any(buttons & pair == pair for pair in EXCLUSIVE):
        raise InvalidArgument(f"buttons: expected at most one of each pair, got {buttons!r}")
    drive = (Buttons.FORWARD in buttons) - (Buttons.BACKWARD in buttons)
    steer = (Buttons.LEFT in buttons) - (Buttons.RIGHT in buttons)
    return np.array([drive, steer], dtype=np.float64)
