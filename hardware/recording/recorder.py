"""The recorder: a listener that writes a session into a journal as it happens."""

from __future__ import annotations

import math
import platform
import struct
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hardware.listener import Command, Listener, RobotStatus
from hardware.measurement import Measurement
from hardware.recording.journal import JournalWriter
from hardware.recording.records import Kind, TimedCommand, pack_command, pack_frame, pack_status, seal
from hardware.session import Session
from hardware.trackers.gates import GateLimits
from sysid_evo.errors import InvalidData
from sysid_evo.system import System

VERSIONS = {name: version(name) for name in ("sysid-evo", "numpy")} | {"python": platform.python_version()}


class Recorder(Session, Listener):
    """Writes every frame, command and status of a session with ``robot`` to a new journal at ``path``.

    ``body`` (default: the first seen) and ``limits`` tell what reads it which frames to believe.

    Each call is one write to the system's cache, some ten microseconds. A disk that cannot take a
    record does not stop a robot: the record is counted in ``lost``, and ``problem`` says why.
    `close` waits for the disk.
    """

    def __init__(
        self, path: str | Path, system: System, *, robot: str, body: str | None = None, limits: GateLimits | None = None
    ) -> None:
        self.path = Path(path)
        self.lost = 0
        self.problem: str | None = None
        self._status: RobotStatus | None = None
        self._journal = JournalWriter(
            self.path,
            {
                "system": system.to_dict(),
                "robot": robot,
                "body": body,
                "limits": (GateLimits() if limits is None else limits).to_dict(),
                "versions": VERSIONS,
            },
        )

    def measured(self, measurement: Measurement) -> None:
        self._write(Kind.FRAME, pack_frame, measurement)

    def commanded(self, command: Command) -> None:
        status = self._status
        robot_time = math.nan if status is None else status.robot_time + command.time - status.time
        self._write(Kind.COMMAND, pack_command, TimedCommand(command, robot_time))

    def reported(self, status: RobotStatus) -> None:
        self._status = status
        self._write(Kind.STATUS, pack_status, status)

    def close(self) -> None:
        try:
            self._journal.close()
        except OSError as error:
            self.problem = f"{self.path}: {error}"

    def _write(self, kind: Kind, pack: Callable[[Any], bytes], event: object) -> None:
        try:
            self._journal.append(seal(kind, pack(event)))
        except (OSError, struct.error, InvalidData) as error:
            self.lost += 1
            self.problem = f"{self.path}: {error}"
