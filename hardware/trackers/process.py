"""Trackers in a process of their own, which isolates whatever blocks, crashes or starts threads.

The process sends records of one length (`RECORD` bytes of JSON) through a pipe. A record is written completely or not
at all, so the pipe is a bounded queue: if it is not read for a while (128 frames, 0.6 s at 200 Hz), further frames are
dropped there. When this process ends in any way, the system closes the other's standard input, and a signal ends it.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import select
import subprocess
import sys
import time
from abc import abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from hardware.connection import Measurement
from hardware.trackers.tracker import Tracker, TrackerStream
from sysid_evo.errors import LinkLost

RECORD = 512  # bytes: POSIX writes these to a pipe completely or not at all
PATIENCE = 10.0  # s for the source to answer


class ProcessTracker(Tracker):
    """A tracker whose frames are made in a process of its own; a frozen dataclass of JSON values."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]

    @abstractmethod
    def frames(self) -> Iterator[Measurement | None]:
        """Connect, then yield frames as they arrive; runs in the other process.

        Times are on `time.monotonic`. The first item, and any while there is no frame, is None. Raises `LinkLost`; the
        end of the iterator is the end of the stream.
        """

    def open(self) -> TrackerStream:
        """Start the process and wait for its source. Raises `LinkLost`, `MissingExtra`."""
        self.check()
        return ProcessStream(self)

    def describe(self) -> dict[str, Any]:
        """Return a description, as JSON, with which the other process makes the same tracker."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {"module": type(self).__module__, "class": type(self).__qualname__, "arguments": values}


class ProcessStream(TrackerStream):
    """The frames of a `ProcessTracker`; each call of `read` takes one record from the pipe."""

    def __init__(self, tracker: ProcessTracker) -> None:
        self._name, self._body = tracker.name, tracker.body
        self._pipe, theirs = os.pipe()
        paths = os.pathsep.join(path or str(Path.cwd()) for path in sys.path)  # as in this process
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "hardware.trackers.feed", str(theirs)],
                env={**os.environ, "PYTHONPATH": paths},
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(theirs,),
                start_new_session=True,
            )
        except OSError:
            os.close(self._pipe)
            raise
        finally:
            os.close(theirs)
        try:
            assert self._process.stdin is not None
            try:
                self._process.stdin.write(json.dumps(tracker.describe()).encode() + b"\n")
                self._process.stdin.flush()
            except BrokenPipeError as error:
                raise LinkLost(f"tracker {self._name}: its process ended before it began") from error
            if self._record(PATIENCE) is None:
                raise LinkLost(
                    f"tracker {self._name}: nothing answered within {PATIENCE:g} s; is it running and streaming?"
                )
        except BaseException:
            self.close()
            raise

    def read(self, timeout: float) -> Measurement | None:
        record = self._record(timeout)
        if record is None:
            return None
        source, arrival, frame, valid, pose = record
        values = np.full(3, math.nan) if pose is None else np.array(pose, dtype=np.float64)
        return Measurement(source, arrival, frame, self._body, valid, values)

    def fileno(self) -> int:
        return self._pipe

    def close(self) -> None:
        if self._pipe < 0:
            return
        pipe, self._pipe = self._pipe, -1
        os.close(pipe)
        self._process.kill()
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._process.wait()

    def _record(self, timeout: float) -> Any:
        """Return the next record, None after ``timeout`` s. Raises `LinkLost` when the process is over."""
        if self._pipe < 0:
            raise LinkLost(f"tracker {self._name}: the stream is closed: open another")
        deadline = time.monotonic() + timeout
        while not select.select([self._pipe], [], [], max(0.0, deadline - time.monotonic()))[0]:
            if time.monotonic() >= deadline:
                return None
        data = os.read(self._pipe, RECORD)
        if len(data) == RECORD:
            record = json.loads(data)
            if not isinstance(record, str):
                return record
            raise LinkLost(f"tracker {self._name}: {record}")
        raise LinkLost(f"tracker {self._name}: its process ended (exit code {self._process.wait()})")


def record_of(item: Measurement | str | bool) -> bytes:
    """Return a record: a frame, the sentence that ends a stream, or True for a source that has answered."""
    if isinstance(item, Measurement):
        pose = [float(value) for value in item.pose] if item.valid else None
        values = [item.source_time, item.arrival_time, item.frame, item.valid, pose]
        return json.dumps(values).encode().ljust(RECORD)
    while len(record := json.dumps(item).encode()) > RECORD:
        item = str(item)[:-1]
    return record.ljust(RECORD)
