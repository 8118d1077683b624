"""The tracker beside the emulated car: its frames as JSON datagrams, some of them wrong."""

from __future__ import annotations

import contextlib
import json
import math
import socket
from collections import deque

import numpy as np

from hardware.connection import Measurement
from hardware.trackers.udp import FrameMessage
from sysid_evo.types import Array
from tests.system.rig.faults import FaultSchedule

OTHER_BODY = "other"
OTHER_POSE = (1.2, -0.8, 2.0)  # m, m, rad: where the other body stands


def format_message(message: FrameMessage) -> bytes:
    """Return ``message`` as one line of JSON without its end; a pose that is not valid is null."""
    pose = [float(value) for value in message.pose] if message.valid else None
    fields = {"time": message.time, "frame": message.frame, "body": message.body, "valid": message.valid, "pose": pose}
    return json.dumps(fields, allow_nan=False).encode()


class PoseStream:
    """Sends each frame of ``body`` to ``address`` when it is due; without an address nothing is sent."""

    def __init__(self, address: tuple[str, int] | None, body: str, faults: FaultSchedule) -> None:
        self._address = address
        self._body = body
        self._faults = faults
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._frozen: Array | None = None

    @property
    def due(self) -> float:
        """When the next datagram has to go (s); inf if none waits."""
        return self._waiting[0][0] if self._waiting else math.inf

    def add(self, frame: Measurement) -> None:
        """Take in a true frame, taken at its ``source_time``, and let the faults of that time act on it."""
        now, pose, valid = frame.source_time, frame.pose, frame.valid
        if not self._faults.active("frozen", now):
            self._frozen = pose
        elif self._frozen is not None:
            pose = self._frozen
        if self._faults.active("yaw_flip", now):
            pose = np.array([pose[0], pose[1], math.remainder(pose[2] + math.pi, 2.0 * math.pi)])
        if self._faults.active("dropout", now):
            valid = False
        if self._faults.active("silence", now):
            return
        if self._faults.active("identity_swap", now):
            self._queue(frame, OTHER_BODY, pose, valid)
            self._queue(frame, self._body, np.array(OTHER_POSE), True)
        else:
            self._queue(frame, self._body, pose, valid)

    def send(self, now: float) -> None:
        """Send what is due at ``now``; a datagram that finds no room or no listener is lost."""
        while self._waiting and self._waiting[0][0] <= now:
            _, data = self._waiting.popleft()
            if self._address is not None:
                with contextlib.suppress(BlockingIOError, ConnectionError):
                    self._socket.sendto(data, self._address)

    def close(self) -> None:
        self._socket.close()

    def _queue(self, frame: Measurement, body: str, pose: Array, valid: bool) -> None:
        message = FrameMessage(frame.source_time, frame.frame, body, valid, pose)
        self._waiting.append((frame.arrival_time, format_message(message)))
