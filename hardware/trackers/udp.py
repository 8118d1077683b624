"""JSON datagrams as a tracker: message format, checks, socket."""

from __future__ import annotations

import contextlib
import json
import math
import select
import socket
import time
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from hardware.arguments import check_choice, check_integer, check_text
from hardware.connection import Measurement
from hardware.trackers.tracker import SourceClock, Tracker, TrackerStream
from sysid_evo.errors import InvalidData, LinkLost
from sysid_evo.registry import register_tracker
from sysid_evo.types import Array

BUFFER = 1 << 18  # bytes of the system's buffer: over two seconds of a body at 200 Hz
FUTURE = 0.01  # s that a frame on the host's own clock may be ahead of it


@register_tracker("udp")
@dataclass(frozen=True)
class UdpTracker(Tracker):
    """Listens on ``host``:``port`` for ``{"time": s, "frame": n, "body": str, "valid": bool, "pose": [m, m, rad]}``.

    One datagram is one frame: any tracker can send them with ten lines of code. ``clock`` is "source" for times on any
    clock, which are mapped by `SourceClock`, or "host" for times of the host's `time.monotonic`. Port 0 is a free one.
    With ``sender`` only datagrams from that address are accepted.
    """

    body: str
    port: int
    host: str = "127.0.0.1"
    clock: Literal["source", "host"] = "source"
    sender: str | None = None
    name = "udp"

    def __post_init__(self) -> None:
        check_text("tracker udp: body", self.body)
        check_integer("tracker udp: port", self.port, minimum=0, maximum=65535)
        check_text("tracker udp: host", self.host)
        check_choice("tracker udp: clock", self.clock, ("source", "host"))
        if self.sender is not None:
            check_text("tracker udp: sender", self.sender)

    def open(self) -> UdpStream:
        """Listen; frames may begin at any time. Raises `LinkLost` if the port is taken or the host is not ours."""
        receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
            receiver.bind((self.host, self.port))
        except OSError as error:
            receiver.close()
            raise LinkLost(
                f"tracker udp: cannot listen on {self.host}:{self.port} ({error.strerror}); "
                "is another program listening there?"
            ) from error
        receiver.setblocking(False)
        return UdpStream(self, receiver)


class UdpStream(TrackerStream):
    """An open socket; datagrams that are no frame of the body are left out."""

    def __init__(self, tracker: UdpTracker, receiver: socket.socket) -> None:
        self._tracker = tracker
        self._socket = receiver
        self._clock = SourceClock()
        self._restarts = 0
        self._newest = -math.inf

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of the socket."""
        host, port = self._socket.getsockname()
        return str(host), int(port)

    def read(self, timeout: float) -> Measurement | None:
        deadline = time.monotonic() + timeout
        while True:
            measurement = self._receive()
            left = deadline - time.monotonic()
            if measurement is not None or left <= 0.0:
                return measurement
            with contextlib.suppress(InterruptedError):
                select.select([self._socket], [], [], left)

    def fileno(self) -> int:
        return self._socket.fileno()

    def close(self) -> None:
        self._socket.close()

    def _receive(self) -> Measurement | None:
        """Return the frame of the waiting datagram, None if there is none or it is invalid."""
        if self._socket.fileno() < 0:
            raise LinkLost("tracker udp: the stream is closed: open another")
        try:
            data, (sender, _) = self._socket.recvfrom(LONGEST + 1)
        except BlockingIOError:
            return None
        arrival = time.monotonic()
        if self._tracker.sender is not None and sender != self._tracker.sender:
            return None
        try:
            message = parse_message(data)
        except InvalidData:
            return None
        return self._stamp(message, arrival) if message.body == self._tracker.body else None

    def _stamp(self, message: FrameMessage, arrival: float) -> Measurement | None:
        """Return ``message`` with its times on the host's clock, None if out of order or with an impossible time."""
        if self._tracker.clock == "host":
            source = message.time
            if source > arrival + FUTURE:
                return None
        else:
            source = self._clock.map(message.time, arrival)
            if self._clock.restarts > self._restarts:
                self._restarts, self._newest = self._clock.restarts, -math.inf
        if message.time <= self._newest:
            return None
        self._newest = message.time
        return Measurement(source, arrival, message.frame, message.body, message.valid, message.pose)


LONGEST = 1024  # bytes of a message
LARGEST_FRAME = 2**63 - 1
LARGEST = 1e12
"""Limit of times in s, coordinates in m and angles in rad: above any clock in use, below an overflow."""
N_POSE = 3


@dataclass(frozen=True)
class FrameMessage:
    """Content of a message: ``time`` in s on the source's clock, planar ``pose`` (3,) in m, m, rad or NaN."""

    time: float
    frame: int
    body: str
    valid: bool
    pose: Array


def parse_message(data: bytes) -> FrameMessage:
    """Return the message in ``data``. Raises `InvalidData` for anything but a complete message of valid numbers."""
    if len(data) > LONGEST:
        raise InvalidData(f"frame: expected at most {LONGEST} bytes, got more")
    try:
        fields = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InvalidData(f"frame: expected a JSON object, got {data[:40]!r}") from error
    if not isinstance(fields, dict):
        raise InvalidData(f"frame: expected a JSON object, got {type(fields).__name__}")
    frame, body, valid = (fields.get(name) for name in ("frame", "body", "valid"))
    if type(frame) is not int or not 0 <= frame <= LARGEST_FRAME:
        raise InvalidData(f"frame: expected frame, a whole number from 0 to 2^63 - 1, got {_short(frame)}")
    if not isinstance(body, str):
        raise InvalidData(f"frame: expected body, a name, got {_short(body)}")
    if not isinstance(valid, bool):
        raise InvalidData(f"frame: expected valid, true or false, got {_short(valid)}")
    time = _finite(fields.get("time"), "time")
    pose = np.full(N_POSE, np.nan)
    if valid:
        values = fields.get("pose")
        if not isinstance(values, list) or len(values) != N_POSE:
            raise InvalidData(f"frame: expected pose, a list of x, y and heading, got {_short(values)}")
        pose = np.array([_finite(value, "pose") for value in values])
    return FrameMessage(time, frame, body, valid, pose)


def _finite(value: Any, name: str) -> float:
    if type(value) in (int, float) and -LARGEST < value < LARGEST:
        return float(value)
    raise InvalidData(f"frame: expected numbers within {LARGEST:g} in {name}, got {_short(value)}")


def _short(value: Any) -> str:
    return type(value).__name__ if isinstance(value, (int, list, dict)) else repr(value)[:40]
