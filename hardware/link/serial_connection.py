"""A session with a robot on a serial port, and with the tracker that sees it."""

from __future__ import annotations

import secrets
import select
import time
from collections.abc import Mapping
from contextlib import suppress

from hardware.connection import Connection
from hardware.link.buttons import buttons_of, control_of
from hardware.link.messages import HelloAcknowledgement
from hardware.link.port import SerialPort
from hardware.link.session import HostSession
from hardware.listener import RobotStatus
from hardware.measurement import Measurement
from hardware.trackers.gates import GateLimits
from hardware.trackers.tracker import TrackerStream
from sysid_evo.arrays import Array
from sysid_evo.errors import LinkLost

BACKOFF, BACKOFF_MAX = 0.2, 2.0  # s between two attempts to reach a robot, doubled each time
LONGEST_WAIT = 0.1  # s after which a measurement looks at the robot again


class SerialConnection(Connection):
    """An open session; the clock is `time.monotonic`. Made by `SerialRobot.connect`.

    Whatever ends it (silence, a trip, a pulled plug) ends it for good: every later call raises
    `LinkLost`, and only another `connect` drives on. Without a tracker `measure` never sees a frame.
    """

    def __init__(
        self, port: SerialPort, session: HostSession, tracker: TrackerStream | None, gate: GateLimits | None = None
    ) -> None:
        self._gate = GateLimits.read(gate)
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
    def gate_limits(self) -> GateLimits:
        return self._gate

    @property
    def status(self) -> RobotStatus | None:
        status = self._session.status
        if status is None:
            return None
        return RobotStatus(
            self._session.heard,
            status.clock_ms / 1000.0,
            status.state.name.lower(),
            control_of(status.buttons),
            status.counters,
        )

    @property
    def acknowledgement(self) -> HelloAcknowledgement:
        """What the robot said of itself when the session began: versions, reset cause, boot count."""
        assert self._session.acknowledgement is not None
        return self._session.acknowledgement

    @property
    def round_trip(self) -> float | None:
        """The time in s from the newest answered command to its status."""
        return self._session.round_trip

    @property
    def counters(self) -> Mapping[str, int]:
        """What the host has counted: commands, dropped ones, good, damaged and unknown frames."""
        return {**self._session.counters, "dropped": self._port.dropped}

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
        """Take in all that the robot has said, then judge by the newest."""
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
