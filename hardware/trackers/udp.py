"""A stream of JSON datagrams, one a frame: what any tracker can be made to send in ten lines."""

from __future__ import annotations

import contextlib
import math
import select
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from hardware.arguments import choice, text, whole
from hardware.measurement import Measurement
from hardware.trackers.message import LONGEST, FrameMessage, parse_message
from hardware.trackers.source_clock import SourceClock
from hardware.trackers.tracker import Tracker, TrackerStream
from sysid_evo.errors import InvalidData, LinkLost
from sysid_evo.registry import register_tracker

BUFFER = 1 << 18  # bytes the system keeps for us: over two seconds of a body at 200 Hz
FUTURE = 0.01  # s that a frame on the host's own clock may be ahead of it


@register_tracker("udp")
@dataclass(frozen=True)
class UdpTracker(Tracker):
    """Listens on ``host``:``port`` for ``{"time": s, "frame": n, "body": str, "valid": bool, "pose": [m, m, rad]}``.

    ``clock`` is "source" for times on any clock, which are mapped by `SourceClock`, or "host" for
    times that are the host's `time.monotonic` already. Port 0 takes a free one. Only datagrams
    from the address ``sender`` count, if it is given.
    """

    body: str
    port: int
    host: str = "127.0.0.1"
    clock: Literal["source", "host"] = "source"
    sender: str | None = None
    name = "udp"

    def __post_init__(self) -> None:
        text("tracker udp: body", self.body)
        whole("tracker udp: port", self.port, least=0, most=65535)
        text("tracker udp: host", self.host)
        choice("tracker udp: clock", self.clock, ("source", "host"))
        if self.sender is not None:
            text("tracker udp: sender", self.sender)

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
    """An open socket. ``counters`` says how many datagrams became frames, and why the others did not."""

    def __init__(self, tracker: UdpTracker, receiver: socket.socket) -> None:
        self._tracker = tracker
        self._socket = receiver
        self._clock = SourceClock()
        self._restarts = 0
        self._newest = -math.inf
        self._counts = dict.fromkeys(("frames", "malformed", "other_body", "other_sender", "out_of_order", "future"), 0)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that it listens on."""
        host, port = self._socket.getsockname()
        return str(host), int(port)

    @property
    def counters(self) -> Mapping[str, int]:
        """Datagrams by what became of them."""
        return {**self._counts, "clock_restarts": self._clock.restarts}

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
        """Return the frame of the datagram that waits, None if none does or it is not a good one."""
        if self._socket.fileno() < 0:
            raise LinkLost("tracker udp: the stream is closed: open another")
        try:
            data, (sender, _) = self._socket.recvfrom(LONGEST + 1)
        except BlockingIOError:
            return None
        arrival = time.monotonic()
        if self._tracker.sender is not None and sender != self._tracker.sender:
            self._counts["other_sender"] += 1
            return None
        try:
            message = parse_message(data)
        except InvalidData:
            self._counts["malformed"] += 1
            return None
        if message.body != self._tracker.body:
            self._counts["other_body"] += 1
            return None
        return self._stamp(message, arrival)

    def _stamp(self, message: FrameMessage, arrival: float) -> Measurement | None:
        """Return ``message`` with its times on the host's clock, None if it was overtaken or its time cannot be."""
        if self._tracker.clock == "host":
            source = message.time
            if source > arrival + FUTURE:
                self._counts["future"] += 1
                return None
        else:
            source = self._clock.map(message.time, arrival)
            if self._clock.restarts > self._restarts:
                self._restarts, self._newest = self._clock.restarts, -math.inf
        if message.time <= self._newest:
            self._counts["out_of_order"] += 1
            return None
        self._newest = message.time
        self._counts["frames"] += 1
        return Measurement(source, arrival, message.frame, message.body, message.valid, message.pose)
