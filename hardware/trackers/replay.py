"""Replay: the frames of a log, as a tracker."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hardware.arguments import check_number, check_text
from hardware.connection import Measurement
from hardware.recording.journal import SUFFIX, read_journal
from hardware.trackers.process import ProcessTracker
from hardware.trackers.tracker import TrackerStream
from sysid_evo.data.readers import find_reader
from sysid_evo.errors import InvalidData, LinkLost
from sysid_evo.registry import register_tracker

COLUMNS = ("t", "x", "y", "heading")
STEP = 0.1  # s: the longest wait without a frame


@register_tracker("replay")
@dataclass(frozen=True)
class ReplayTracker(ProcessTracker):
    """The frames of ``body`` in the file ``path``: a journal, or a log with the columns t, x, y, heading.

    The log's units are s, m, m, rad. ``speed`` 1 is the log's own rate, 2 twice as fast, on `time.monotonic`; at speed
    0 frames are returned as fast as they are read, with the times of the log. The end of the log is a lost link.
    """

    body: str
    path: str
    speed: float = 1.0
    name = "replay"

    def __post_init__(self) -> None:
        check_text("tracker replay: body", self.body)
        check_text("tracker replay: path", self.path)
        check_number("tracker replay: speed", self.speed, minimum=0.0)

    def check(self) -> None:
        super().check()
        _there(Path(self.path))

    def open(self) -> TrackerStream:
        """Read the log and begin. Raises `InvalidData` if it cannot be read, `LinkLost` if the body is not in it."""
        frames = logged(Path(self.path), self.body)
        return super().open() if self.speed > 0.0 else _AskedStream(iter(frames))

    def frames(self) -> Iterator[Measurement | None]:
        frames = logged(Path(self.path), self.body)
        yield None
        begin = time.monotonic()
        for frame in frames:
            due = begin + (frame.arrival_time - frames[0].source_time) / self.speed
            while (left := due - time.monotonic()) > 0.0:
                time.sleep(min(left, STEP))
                yield None
            source = begin + (frame.source_time - frames[0].source_time) / self.speed
            yield replace(frame, source_time=source, arrival_time=time.monotonic())


class _AskedStream(TrackerStream):
    """Frames that are always available; a pipe with one byte makes it readable for `select`."""

    def __init__(self, frames: Iterator[Measurement]) -> None:
        self._frames = frames
        self._pipe, self._other = os.pipe()
        os.write(self._other, b"\n")

    def read(self, timeout: float) -> Measurement | None:
        frame = next(self._frames, None)
        if frame is None:
            raise LinkLost("tracker replay: the source has ended")
        return frame

    def fileno(self) -> int:
        return self._pipe

    def close(self) -> None:
        if self._pipe >= 0:
            os.close(self._pipe)
            os.close(self._other)
        self._pipe = self._other = -1
        self._frames = iter(())


def logged(path: Path, body: str) -> list[Measurement]:
    """Return the frames of ``body`` in a log; in a table, all of them. Raises `InvalidData`, `LinkLost`."""
    _there(path)
    if path.suffix == SUFFIX:
        frames = [frame for frame in read_journal(path).frames if frame.body == body]
        if not frames:
            raise LinkLost(f"tracker replay: no frame of {body!r} in {path.name}")
        return frames
    columns = find_reader(path).read(path, COLUMNS).columns
    times = columns["t"]
    if np.any(np.diff(times) <= 0.0):
        raise InvalidData(f"{path.name}, column 't': expected rising times")
    poses = np.stack([columns[name] for name in COLUMNS[1:]], axis=1)
    return [
        Measurement(float(t), float(t), number, body, True, pose)
        for number, (t, pose) in enumerate(zip(times, poses, strict=True))
    ]


def _there(path: Path) -> None:
    if not path.is_file():
        raise InvalidData(f"{path}: expected a log, found no such file")
