"""The other side of `process`: makes a tracker's frames and writes them to a pipe.

    python -m hardware.trackers.feed DESCRIPTOR

The first line of standard input describes the tracker (`ProcessTracker.describe`).
"""

from __future__ import annotations

import contextlib
import fcntl
import importlib
import json
import os
import select
import sys
from typing import Any

from hardware.trackers.process import RECORD, ProcessTracker, record_of
from sysid_evo.errors import SysidEvoError


def hang_on_life_line() -> None:
    """Let the system end this process when standard input closes, even while it blocks inside a library.

    SIGIO is sent when the state of the pipe changes, and its default is to end the process; no Python code needs to run
    for that, unlike with a waiting thread.
    """
    fcntl.fcntl(0, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(0, fcntl.F_SETFL, fcntl.fcntl(0, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([0], [], [], 0.0)[0]:
        os._exit(0)


def make(description: dict[str, Any]) -> ProcessTracker:
    """Return the tracker with this ``description``."""
    thing = getattr(importlib.import_module(description["module"]), description["class"])
    if not (isinstance(thing, type) and issubclass(thing, ProcessTracker)):
        raise TypeError(f"expected a ProcessTracker, got {description['class']}")
    return thing(**description["arguments"])


def feed(tracker: ProcessTracker, pipe: int) -> None:
    """Write the tracker's frames to ``pipe`` until they end; frames without room are dropped."""
    os.set_blocking(pipe, False)
    answered = False
    for item in tracker.frames():
        if not answered:
            os.write(pipe, record_of(True))
            answered = True
        if item is None:
            continue
        record = record_of(item)
        if len(record) == RECORD:
            with contextlib.suppress(BlockingIOError):
                os.write(pipe, record)


def main() -> None:
    pipe = int(sys.argv[1])
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(0, 1)
        if not byte:
            os._exit(0)
        line += byte
    hang_on_life_line()
    try:
        feed(make(json.loads(line)), pipe)
        last = "the source has ended"
    except SysidEvoError as error:
        last = str(error)
    except Exception as error:  # a driver may fail in any way; the other side must be notified
        last = f"{type(error).__name__}: {error}"
    os.set_blocking(pipe, True)
    with contextlib.suppress(OSError):
        os.write(pipe, record_of(last))
    os._exit(1)


if __name__ == "__main__":
    main()
